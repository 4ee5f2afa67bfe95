"""The Waymo baseline: the Kalman tracker of the Waymo paper, reconstructed."""

from __future__ import annotations

from dataclasses import dataclass

from pmbm.baselines.skeleton import SkeletonConfig, skeleton_tracker
from pmbm.types import Detections, Tracks


@dataclass(frozen=True, kw_only=True)
class WaymoConfig(SkeletonConfig):
    """Parameters of the Waymo baseline.  None were published: these are the skeleton's own, and
    `min_score` is to be the best single threshold on tuning data."""

    min_score: float = 0.5
    min_hits: int = 3
    max_age: float = 2.0


class WaymoTracker:
    """The Waymo baseline behind the tracker protocol: class by class, a Kalman filter of boxes, 3D
    IoU, the Hungarian method; a track is shown from its `min_hits`-th detection on, in frames that
    find it.

    Source: Sun et al. 2020, "Scalability in Perception for Autonomous Driving: Waymo Open Dataset",
    Sec. 5.2, on AB3DMOT's skeleton; score that of the track's last detection.
    """

    def __init__(self, config: WaymoConfig | None = None) -> None:
        self.config = config or WaymoConfig()
        self._boxes = skeleton_tracker(self.config, vertical=True, coasting=False)

    def step(self, detections: Detections, /) -> Tracks:
        """Advance by one frame's detections, and report.

        Raises InputError, the state untouched, where time runs backwards, and where tracks times
        detections of a label exceed `MOST_PAIRS`.
        """
        return self._boxes.step(detections)
