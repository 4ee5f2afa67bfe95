"""Metrics of multi-object tracking, each by its published rule.

`evaluate` scores a run; the functions behind it are pure and may be used alone.
"""

from pmbm.metrics.catalogue import DEFAULT_METRICS
from pmbm.metrics.evaluation import evaluate
from pmbm.metrics.gospa import Gospa, gospa
from pmbm.metrics.ospa import Ospa, ospa
from pmbm.metrics.parameters import MetricParameters
from pmbm.metrics.result import Evaluation, MetricValue, combine

__all__ = [
    "DEFAULT_METRICS",
    "Evaluation",
    "Gospa",
    "MetricParameters",
    "MetricValue",
    "Ospa",
    "combine",
    "evaluate",
    "gospa",
    "ospa",
]
