"""Benchmarks by their own rules, quirks included: one module each.

A module holds what its benchmark counts, its metrics, their evaluation over several sequences
(`evaluate_NAME`), and the named rules by which `pmbm evaluate` compares a dataset's files.
"""

from pmbm.metrics.benchmarks.argoverse1 import evaluate_argoverse1
from pmbm.metrics.benchmarks.kitti import evaluate_kitti
from pmbm.metrics.benchmarks.nuscenes import evaluate_nuscenes
from pmbm.metrics.benchmarks.trackeval import evaluate_trackeval
from pmbm.metrics.benchmarks.waymo import evaluate_waymo

__all__ = [
    "evaluate_argoverse1",
    "evaluate_kitti",
    "evaluate_nuscenes",
    "evaluate_trackeval",
    "evaluate_waymo",
]
