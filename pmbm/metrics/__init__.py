"""Metrics of multi-object tracking, each by its published rule.

`evaluate` scores a run and `combine` several as one; `catalogue` holds the names.

- core: scenes, matching, formulas and values, which all metrics share;
- families: one module for metrics that are counted together, with its count function;
- benchmarks: one module for each benchmark, by its own rules, quirks included.

The functions of families and benchmarks are pure and may be used alone, on a `core.scene.Scene` of
truth and tracks.
"""

from pmbm.metrics.catalogue import DEFAULT_METRICS
from pmbm.metrics.core.parameters import MetricParameters
from pmbm.metrics.core.result import Evaluation, MetricValue, combine
from pmbm.metrics.evaluation import evaluate
from pmbm.metrics.families.gospa import Gospa, gospa
from pmbm.metrics.families.ospa import Ospa, ospa

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
