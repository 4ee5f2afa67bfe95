"""The Argoverse baseline: the organisers' Kalman tracker over their CBGS detections."""

from __future__ import annotations

from dataclasses import dataclass

from pmbm.baselines.skeleton import SkeletonConfig, skeleton_tracker
from pmbm.types import Detections, Tracks


@dataclass(frozen=True, kw_only=True)
class ArgoverseConfig(SkeletonConfig):
    """Parameters of the Argoverse baseline; the defaults are its published ones."""

    min_score: float = 0.3
    min_hits: int = 5
    max_age: float = 15.0


class ArgoverseTracker:
    """The Argoverse baseline behind the tracker protocol: class by class, a Kalman filter of boxes,
    bird's-eye IoU, the Hungarian method; a track is shown from its `min_hits`-th detection on, also
    in frames that do not find it, until `max_age`.

    Source: the defaults of the Argoverse CBGS Kalman tracker; velocities reported in m/s, score
    that of the track's last detection.
    """

    def __init__(self, config: ArgoverseConfig | None = None) -> None:
        self.config = config or ArgoverseConfig()
        self._boxes = skeleton_tracker(self.config, vertical=False, coasting=True)

    def step(self, detections: Detections, /) -> Tracks:
        """Advance by one frame's detections, and report.

        Raises InputError, the state untouched, where time runs backwards, and where tracks times
        detections of a label exceed `MOST_PAIRS`.
        """
        return self._boxes.step(detections)
