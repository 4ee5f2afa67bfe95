"""The Argoverse baseline: the organisers' Kalman tracker over their CBGS detections."""

from __future__ import annotations

from dataclasses import dataclass

from pmbm.baselines.association import hungarian_iou
from pmbm.baselines.box_filter import BoxNoise
from pmbm.baselines.lifecycle import BoxTracker, Lifecycle
from pmbm.door import Door
from pmbm.types import Detections, Tracks


@dataclass(frozen=True, kw_only=True)
class ArgoverseConfig:
    """Parameters of the Argoverse baseline; the defaults are its published ones.

    min_score : detections below it are not looked at.
    iou_gate : least bird's-eye IoU of a track and its detection.
    min_hits : detections in all before a track is reported.
    max_age : frames without a detection after which a track ends.
    frame_rate : frames per second in which ages and velocities are counted, Hz.
    initial_variance, initial_velocity_variance : diagonal of P at birth (m, rad; per frame).
    process_variance, process_velocity_variance : diagonal of Q per frame.
    measurement_variance : diagonal of R.
    """

    min_score: float = 0.3
    iou_gate: float = 0.1
    min_hits: int = 5
    max_age: float = 15.0
    frame_rate: float = 10.0
    initial_variance: float = 10.0
    initial_velocity_variance: float = 1e4
    process_variance: float = 1.0
    process_velocity_variance: float = 0.01
    measurement_variance: float = 1.0

    def __post_init__(self) -> None:
        door = Door(self, "Argoverse baseline")
        door.number("min_score", at_least=0.0, at_most=1.0)
        door.number("iou_gate", above=0.0, at_most=1.0)
        door.count("min_hits", at_least=1)
        for name in (
            "max_age",
            "frame_rate",
            "initial_variance",
            "initial_velocity_variance",
            "process_variance",
            "process_velocity_variance",
            "measurement_variance",
        ):
            door.number(name, above=0.0)


class ArgoverseTracker:
    """The Argoverse baseline behind the tracker protocol: class by class, a Kalman filter of boxes,
    bird's-eye IoU, the Hungarian method; a track is shown from its `min_hits`-th detection on, also
    in frames that do not find it, until `max_age`.

    Source: the defaults of the Argoverse CBGS Kalman tracker; velocities reported in m/s, score
    that of the track's last detection.
    """

    def __init__(self, config: ArgoverseConfig | None = None) -> None:
        self.config = config = config or ArgoverseConfig()
        noise = BoxNoise.uniform(
            initial=config.initial_variance,
            initial_velocity=config.initial_velocity_variance,
            process=config.process_variance,
            process_velocity=config.process_velocity_variance,
            measurement=config.measurement_variance,
        )
        self._boxes = BoxTracker(
            lifecycle=Lifecycle(
                min_hits=config.min_hits,
                max_age=config.max_age,
                coasting=True,
                frame_rate=config.frame_rate,
            ),
            noise=lambda _label: noise,
            associate=hungarian_iou(config.iou_gate, vertical=False),
            min_score=lambda _label: config.min_score,
        )

    def step(self, detections: Detections, /) -> Tracks:
        """One frame's detections in, the tracks reported after it out.

        Raises InputError, the state untouched, where time runs backwards.
        """
        return self._boxes.step(detections)
