"""The trackers that ours is compared with, on one shared box Kalman filter, and the bound that no
tracker can be expected to beat."""

from __future__ import annotations

from pmbm.baselines.argoverse import ArgoverseConfig, ArgoverseTracker
from pmbm.baselines.box_filter import BoxNoise
from pmbm.baselines.clairvoyant import ClairvoyantConfig, clairvoyant
from pmbm.baselines.probabilistic_kf import (
    ProbabilisticKFConfig,
    ProbabilisticKFTracker,
    fit_statistics,
)
from pmbm.baselines.waymo import WaymoConfig, WaymoTracker

__all__ = [
    "ArgoverseConfig",
    "ArgoverseTracker",
    "BoxNoise",
    "ClairvoyantConfig",
    "ProbabilisticKFConfig",
    "ProbabilisticKFTracker",
    "WaymoConfig",
    "WaymoTracker",
    "clairvoyant",
    "fit_statistics",
]
