"""The trackers that ours is compared with, on one shared box Kalman filter."""

from __future__ import annotations

from pmbm.baselines.argoverse import ArgoverseConfig, ArgoverseTracker

__all__ = ["ArgoverseConfig", "ArgoverseTracker"]
