"""The flat tables that the detector model works on: all frames of a scene in one go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.sim.streams import StreamMembers
from pmbm.sim.world.scene import Scene
from pmbm.types import FloatArray, IntArray, Site

TYPICAL_SIZE: Final = {
    Label.CAR: (4.4, 1.85, 1.6),
    Label.TRUCK: (9.0, 2.5, 3.5),
    Label.BUS: (11.0, 2.6, 3.2),
    Label.MOTORCYCLIST: (2.1, 0.8, 1.6),
    Label.CYCLIST: (1.8, 0.65, 1.7),
    Label.PEDESTRIAN: (0.7, 0.65, 1.75),
    Label.OTHER: (2.0, 1.5, 1.6),
}
"""Length, width, height, m: what false boxes are like, and toward which detectors err."""


@dataclass(frozen=True, eq=False)
class _Table:
    """Rows of arrays of equal length."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def take(self, rows: NDArray[Any]) -> Any:
        """The same table with only these rows (indices or a mask)."""
        return type(self)(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Boxes(_Table):
    """Boxes of a detector, R of them over all frames.

    frame (R,), origin (R,) : the truth frame, and the truth row in it or CLUTTER.
    position (R,3), size (R,3), yaw (R,), score (R,), label (R,) : as in `Detections`.
    ground_speed (R,) : of false boxes, m/s along the line of sight over the ground.
    """

    frame: IntArray
    origin: IntArray
    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    score: FloatArray
    label: IntArray
    ground_speed: FloatArray

    @classmethod
    def none(cls) -> Boxes:
        """No boxes."""
        whole, real = np.zeros(0, np.int64), np.zeros(0)
        return cls(whole, whole, np.zeros((0, 3)), np.zeros((0, 3)), real, real, whole, real)


@dataclass(frozen=True, eq=False)
class Targets(_Table):
    """The R rows of truth in all frames that there are to be detected, as the sensor meets them.

    frame (R,), row (R,), object_id (R,) : where the row stands in the scene.
    position (R,3), size (R,3), yaw (R,), velocity (R,2), label (R,) : as in `GroundTruth`.
    distance (R,), bearing (R,) : from the sensor to the centre, m and rad in the world.
    visibility (R,) : as in `GroundTruth`.
    """

    frame: IntArray
    row: IntArray
    object_id: IntArray
    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    velocity: FloatArray
    label: IntArray
    distance: FloatArray
    bearing: FloatArray
    visibility: FloatArray

    @property
    def members(self) -> StreamMembers:
        """The rows that belong to each object."""
        return StreamMembers(self.frame, self.object_id)


def targets(scene: Scene) -> Targets:
    """The truth inside the field of view and the range, frame after frame."""
    count = np.array([len(frame) for frame in scene.truth], dtype=np.int64)
    frame = np.repeat(np.arange(len(scene)), count)

    def column(name: str, shape: tuple[int, ...] = ()) -> NDArray[Any]:
        parts = [getattr(frame, name) for frame in scene.truth]
        return np.concatenate([np.zeros((0, *shape), parts[0].dtype if parts else float), *parts])

    position = column("position", (3,))
    distance, bearing = polar(position, scene.sensor_pose[frame])
    table = Targets(
        frame=frame,
        row=np.arange(len(frame)) - np.repeat(np.cumsum(count) - count, count),
        object_id=column("id"),
        position=position,
        size=column("size", (3,)),
        yaw=column("yaw"),
        velocity=column("velocity", (2,)),
        label=column("label").astype(np.int64),
        distance=distance,
        bearing=bearing,
        visibility=column("visibility"),
    )
    inside: Targets = table.take(
        in_view(scene.site, distance, bearing - scene.sensor_pose[frame, 2])
    )
    return inside


def polar(position: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Distance (R,) and bearing in the world (R,) of positions (R,2+) from poses (R,3)."""
    offset = position[:, :2] - pose[:, :2]
    return np.hypot(offset[:, 0], offset[:, 1]), np.arctan2(offset[:, 1], offset[:, 0])


def in_view(site: Site, distance: FloatArray, bearing: FloatArray) -> NDArray[np.bool_]:
    """Whether points at this distance and bearing from the sensor's axis are in its view (R,)."""
    aside = np.abs(wrap_angle(bearing - site.fov_centre))
    return (distance <= site.max_range) & (aside <= site.fov_half_angle)


def concatenate(tables: Sequence[Boxes]) -> Boxes:
    """Join tables into one of all their rows."""
    return Boxes(*(np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(Boxes)))
