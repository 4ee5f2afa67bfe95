"""The skeleton that two of the baselines share: a box Kalman filter with one variance for boxes and
one for velocities, overlap, the Hungarian method, counted hits (AB3DMOT, Sec. III)."""

from __future__ import annotations

from dataclasses import dataclass

from pmbm.baselines.association import hungarian_iou
from pmbm.baselines.box_filter import BoxNoise
from pmbm.baselines.lifecycle import BoxTracker, Lifecycle
from pmbm.validation import Checker

_POSITIVE = (
    "max_age",
    "frame_rate",
    "initial_variance",
    "initial_velocity_variance",
    "process_variance",
    "process_velocity_variance",
    "measurement_variance",
)


@dataclass(frozen=True, kw_only=True)
class SkeletonConfig:
    """Parameters of the skeleton.

    min_score : detections below it are not looked at.
    iou_gate : least IoU of a track and its detection.
    min_hits : detections in all before a track is reported.
    max_age : frames without a detection after which a track ends.
    report_above : a track is reported while its last detection scored at least this.
    frame_rate : frames per second in which ages and velocities are counted, Hz.
    initial_variance, initial_velocity_variance : diagonal of P at birth (m, rad; per frame).
    process_variance, process_velocity_variance : diagonal of Q per frame.
    measurement_variance : diagonal of R.
    """

    min_score: float
    iou_gate: float = 0.1
    min_hits: int
    max_age: float
    report_above: float = 0.0
    frame_rate: float = 10.0
    initial_variance: float = 10.0
    initial_velocity_variance: float = 1e4
    process_variance: float = 1.0
    process_velocity_variance: float = 0.01
    measurement_variance: float = 1.0

    def __post_init__(self) -> None:
        door = Checker(self, type(self).__name__)
        for name in ("min_score", "report_above"):
            door.number(name, at_least=0.0, at_most=1.0)
        door.number("iou_gate", above=0.0, at_most=1.0)
        door.count("min_hits", at_least=1)
        for name in _POSITIVE:
            door.number(name, above=0.0)


def skeleton_tracker(config: SkeletonConfig, *, vertical: bool, coasting: bool) -> BoxTracker:
    """A fresh run of the skeleton: 3D or bird's-eye IoU, coasting tracks shown or not."""
    noise = BoxNoise.uniform(
        initial=config.initial_variance,
        initial_velocity=config.initial_velocity_variance,
        process=config.process_variance,
        process_velocity=config.process_velocity_variance,
        measurement=config.measurement_variance,
    )
    return BoxTracker(
        lifecycle=Lifecycle(
            min_score=config.min_score,
            min_hits=config.min_hits,
            max_age=config.max_age,
            coasting=coasting,
            report_above=config.report_above,
            frame_rate=config.frame_rate,
        ),
        noise=lambda _label: noise,
        associate=hungarian_iou(config.iou_gate, vertical=vertical),
    )
