"""The path of one object on the tick clock, and how paths become the frames of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmbm.labels import Label
from pmbm.sim.world.scene import Scene, make_scene
from pmbm.types import BoolArray, FloatArray, Site

REACH_MARGIN = 5.0
"""m beyond the range at which an object that was inside is gone for good; the gap keeps one that
drives along the edge from flickering."""


GROUP = 10_000
"""Ids of one named group of objects start at a multiple of this, so that more copies, or more
births, leave every other object its id, and with it its luck."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One object from its first tick to its last, in the world frame.

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


Row = tuple[Trajectory, int, FloatArray]
"""A path, its row at a frame's tick, its velocity there."""


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
    rows: list[list[Row]] = [[] for _ in range(frames)]
    names = {}
    for path in sorted(trajectories, key=lambda path: path.id):
        ticks = slice(path.first, path.first + len(path.yaw))
        offset = path.position - sensor_pose[ticks, :2]
        start, stop = presence(np.hypot(offset[:, 0], offset[:, 1]), site.max_range)
        velocity = path.velocity(tick_rate)
        first_frame = -(-(path.first + start) // step)
        for frame in range(first_frame, min(frames, -(-(path.first + stop) // step))):
            row = frame * step - path.first
            rows[frame].append((path, row, velocity[row]))
            names[path.id] = path.name
    return make_scene(
        name,
        site,
        float(rate),
        sensor_pose[: frames * step : step],
        [_frame(frame * step / tick_rate, row) for frame, row in enumerate(rows)],
        object_name=names,
        provenance=provenance,
        stamp=[frame * step * 1_000_000_000 // tick_rate for frame in range(frames)],
    )


def _frame(time: float, rows: list[Row]) -> dict[str, Any]:
    return {
        "time": time,
        "id": np.array([path.id for path, *_ in rows], dtype=np.int64),
        "position": np.array(
            [(*path.position[row], path.size[2] / 2) for path, row, _ in rows]
        ).reshape(-1, 3),
        "size": np.array([path.size for path, *_ in rows]).reshape(-1, 3),
        "yaw": np.array([path.yaw[row] for path, row, _ in rows], dtype=np.float64),
        "velocity": np.array([velocity for *_, velocity in rows]).reshape(-1, 2),
        "label": np.array([path.label for path, *_ in rows], dtype=np.int64),
        "crashed": np.array([path.crashed[row] for path, row, _ in rows], dtype=bool),
    }
