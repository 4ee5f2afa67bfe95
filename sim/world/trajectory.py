"""The path of one object on the tick clock, and how paths become the frames of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmbm.labels import Label
from pmbm.sim.world.scene import Scene, truth_of
from pmbm.types import BoolArray, FloatArray, Site

REACH_MARGIN = 5.0
"""m beyond the range at which an object that was inside is gone for good; the gap keeps one that
drives along the edge from flickering."""


GROUP = 10_000
"""Ids of one named group of objects start at a multiple of this, so that more copies, or more
births, leave every other object its id, and with it its luck."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The path of one object from its first tick to its last, in the world frame.

    id : the object's, in the truth.
    first : tick of row 0; rows are consecutive ticks.
    position (T,2) : m.  yaw (T,) : rad, not wrapped.  crashed (T,) : has collided.
    """

    id: int
    name: str
    label: Label
    size: tuple[float, float, float]
    first: int
    position: FloatArray
    yaw: FloatArray
    crashed: BoolArray

    def velocity(self, tick_rate: float) -> FloatArray:
        """(T,2) m/s by finite differences, central where there are neighbours: the simulator's
        own velocity leaves out the slip angle and is off by metres per second in bends."""
        if len(self.position) < 2:
            return np.zeros_like(self.position)
        return np.asarray(np.gradient(self.position, 1.0 / tick_rate, axis=0, edge_order=1))


def part(path: Trajectory, start: int, stop: int) -> Trajectory:
    """Rows [start, stop) of a path."""
    rows = slice(start, stop)
    return replace(
        path,
        first=path.first + start,
        position=path.position[rows],
        yaw=path.yaw[rows],
        crashed=path.crashed[rows],
    )


def presence(distance: FloatArray, reach: float) -> tuple[int, int]:
    """The rows [start, stop) in which an object belongs to the scene: from when it first comes
    within `reach` of the sensor until it has left for good."""
    inside = np.flatnonzero(distance <= reach)
    if len(inside) == 0:
        return 0, 0
    start = int(inside[0])
    gone = np.flatnonzero(distance[start:] > reach + REACH_MARGIN)
    return start, start + int(gone[0]) if len(gone) else len(distance)


def to_scene(
    name: str,
    site: Site,
    trajectories: Sequence[Trajectory],
    sensor_pose: FloatArray,
    *,
    tick_rate: int,
    rate: int,
    frames: int,
    provenance: Mapping[str, Any],
) -> Scene:
    """Sample paths at the frames' ticks.

    sensor_pose (ticks,3) : at every tick from 0.
    """
    step = tick_rate // rate
    present: list[Trajectory] = []
    frame_parts, row_parts = [np.zeros(0, np.int64)], []
    for path in sorted(trajectories, key=lambda path: path.id):
        ticks = slice(path.first, path.first + len(path.yaw))
        offset = path.position - sensor_pose[ticks, :2]
        start, stop = presence(np.hypot(offset[:, 0], offset[:, 1]), site.max_range)
        first_frame = -(-(path.first + start) // step)
        seen = np.arange(first_frame, min(frames, -(-(path.first + stop) // step)))
        if len(seen):
            present.append(path)
            frame_parts.append(seen)
            row_parts.append(seen * step - path.first)
    frame = np.concatenate(frame_parts)
    # The frames one after the other, and in each the objects in the order of their ids.
    order = np.argsort(frame, kind="stable")
    counts = [len(rows) for rows in row_parts]

    def of_object(values: list[Any], shape: tuple[int, ...] = ()) -> NDArray[Any]:
        return np.repeat(np.array(values).reshape(-1, *shape), counts, axis=0)[order]

    def of_row(parts: list[NDArray[Any]], shape: tuple[int, ...] = ()) -> NDArray[Any]:
        rows = [part[row] for part, row in zip(parts, row_parts, strict=True)]
        return np.concatenate([np.zeros((0, *shape)), *rows])[order]

    size = of_object([path.size for path in present], (3,))
    position = of_row([path.position for path in present], (2,))
    poses = sensor_pose[: frames * step : step]
    time = [number * step / tick_rate for number in range(frames)]
    truth = truth_of(
        site,
        poses,
        time,
        np.bincount(frame, minlength=frames),
        {
            "id": of_object([path.id for path in present]).astype(np.int64),
            "position": np.concatenate([position, size[:, 2:] / 2], axis=1),
            "size": size,
            "yaw": of_row([path.yaw for path in present]),
            "velocity": of_row([path.velocity(tick_rate) for path in present], (2,)),
            "label": of_object([path.label for path in present]).astype(np.int64),
            "crashed": of_row([path.crashed for path in present]),
        },
    )
    return Scene(
        name=name,
        site=site,
        truth=truth,
        sensor_pose=poses,
        stamp=np.array([n * step * 1_000_000_000 // tick_rate for n in range(frames)], np.int64),
        rate=float(rate),
        object_name={path.id: path.name for path in present},
        provenance=provenance,
    )
