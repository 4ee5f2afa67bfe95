"""Metrics of multi-object tracking, each by its published rule.

`evaluate` scores a run and `combine` several as one; `catalogue` holds the names.  The functions
behind them are pure and may be used alone, on a `scene.Scene` of truth and tracks:

- distances of sets: gospa, ospa; of whole tracks: trajectory (OSPA(2)), tgospa;
- matching frame by frame: clear; of identities: identity; of both: hota; siap;
- what a testbed asks besides: testbed, consistency (NEES), calibration;
- the benchmarks by their own rules, quirks included: argoverse1, waymo, kitti, nuscenes,
  trackeval, and `benchmarks`, which gives their scores as evaluations.
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
