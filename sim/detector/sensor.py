"""Events of whole frames: outages, lost and late deliveries, errors of clock and pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from pmbm.geometry import wrap_angle
from pmbm.sim.detector.boxes import Boxes, polar
from pmbm.sim.detector.knobs import NO_UNKNOWN_KEYS
from pmbm.sim.streams import Purpose, Streams, normal
from pmbm.sim.world.scene import Scene
from pmbm.types import BoolArray, FloatArray, IntArray
from pmbm.validation import NOT_NEGATIVE, SHARE, Bounds, check_fields


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """Faults of the sensor, its clock, its link and its pose.

    outage_start, outage_duration : s; for so long a sector is blind.  A blind sector reports
        nothing; with all of the view blind (a blackout) the frames are delivered empty.
    outage_centre, outage_half_angle : the sector, relative to the sensor's yaw, rad.
    fails_at : s from which on nothing is delivered at all; None, never.
    drop_probability : of a frame that is never delivered: no step at all, unlike an empty frame.
    late_probability, late_by : of a frame that comes late, after this many later frames.
    time_jitter : standard deviation, s, of the moment of measurement about its time stamp.
    ego_position_noise, ego_yaw_noise : standard deviation of the sensor's reported pose, m (x and
        y each) and rad, anew in every frame; its boxes are placed in the world by that pose.
    """

    outage_start: Annotated[float, NOT_NEGATIVE] = 5.0
    outage_duration: Annotated[float, NOT_NEGATIVE] = 0.0
    outage_centre: Annotated[float, Bounds()] = 0.0
    outage_half_angle: Annotated[float, Bounds(0.0, float(np.pi))] = float(np.pi)
    fails_at: Annotated[float | None, NOT_NEGATIVE] = None
    drop_probability: Annotated[float, SHARE] = 0.0
    late_probability: Annotated[float, SHARE] = 0.0
    late_by: Annotated[int, Bounds(1)] = 2
    time_jitter: Annotated[float, NOT_NEGATIVE] = 0.0
    ego_position_noise: Annotated[float, NOT_NEGATIVE] = 0.0
    ego_yaw_noise: Annotated[float, NOT_NEGATIVE] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "sensor")


SensorModel.__pydantic_config__ = NO_UNKNOWN_KEYS  # type: ignore[attr-defined]


def arrivals(model: SensorModel, time: FloatArray, streams: Streams) -> IntArray:
    """The frames that are delivered (D,), in order of arrival; time (F,) is that of each, s."""
    frames = len(time)
    drop, late, _ = streams.uniforms(Purpose.DROPOUT, frames, 3).T
    number = np.arange(frames)
    # Half a frame later than the last one that overtakes it.
    arrival = number + np.where(late < model.late_probability, model.late_by + 0.5, 0.0)
    order = np.argsort(arrival, kind="stable")
    delivered = drop >= model.drop_probability
    if model.fails_at is not None:
        delivered &= time < model.fails_at
    return order[delivered[order]]


def clock_error(model: SensorModel, frames: int, streams: Streams) -> FloatArray:
    """The delay of each frame's measurement after its stamp (F,), s."""
    return model.time_jitter * normal(streams.uniforms(Purpose.DROPOUT, frames, 3)[:, 2])


def blind(model: SensorModel, scene: Scene, boxes: Boxes) -> BoolArray:
    """Whether each box lies in a sector that is out at its time (R,)."""
    time = np.array([frame.time for frame in scene.truth])
    out = (time >= model.outage_start) & (time < model.outage_start + model.outage_duration)
    pose = scene.sensor_pose[boxes.frame]
    _, bearing = polar(boxes.position, pose)
    aside = np.abs(wrap_angle(bearing - pose[:, 2] - model.outage_centre))
    within: BoolArray = out[boxes.frame] & (aside <= model.outage_half_angle)
    return within


def reported_pose(model: SensorModel, scene: Scene, streams: Streams) -> FloatArray:
    """The sensor's pose (F,3) as the sensor believes it."""
    noise = normal(streams.uniforms(Purpose.EGO_POSE, len(scene), 3))
    spread = np.array([model.ego_position_noise, model.ego_position_noise, model.ego_yaw_noise])
    return scene.sensor_pose + spread * noise


def moved(boxes: Boxes, true_pose: FloatArray, pose: FloatArray) -> Boxes:
    """Boxes measured from `true_pose` (F,3), placed in the world as if from `pose` (F,3)."""
    true, said = true_pose[boxes.frame], pose[boxes.frame]
    turn = said[:, 2] - true[:, 2]
    offset = boxes.position[:, :2] - true[:, :2]
    cos, sin = np.cos(turn), np.sin(turn)
    x = said[:, 0] + offset[:, 0] * cos - offset[:, 1] * sin
    y = said[:, 1] + offset[:, 0] * sin + offset[:, 1] * cos
    return replace(
        boxes,
        position=np.stack([x, y, boxes.position[:, 2]], axis=1),
        yaw=wrap_angle(boxes.yaw + turn),
    )
