"""Scripted motion: paths that are known beforehand, for which no traffic is simulated."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np

from pmbm.geometry import wrap_angle
from pmbm.sim.schema import Births, Body, Path, Track
from pmbm.sim.streams import Purpose, Streams
from pmbm.sim.world.apart import GAP, first_meeting, in_scene
from pmbm.sim.world.trajectory import Trajectory, part
from pmbm.types import FloatArray


def own_stream(streams: Streams, name: str) -> np.random.Generator:
    """The traffic stream of one named object: no other object moves its draws."""
    return streams.generator(Purpose.TRAFFIC, zlib.crc32(name.encode()) + 1)


DENSEST = 5.0
"""Births a second of the process that all rates are thinned from."""


def poses(path: Path, ticks: int, tick_rate: int) -> tuple[FloatArray, FloatArray]:
    """Positions (T,2) and headings (T,) along a path at `ticks` ticks from its start; a path of
    given poses ends with the last of them, so that T may be smaller."""
    time = np.arange(ticks) / tick_rate
    if path.poses:
        table = np.array(path.poses)
        time = time[time <= table[-1, 0] - table[0, 0] + 1e-9] + table[0, 0]
        turned = np.unwrap(np.deg2rad(table[:, 3]))
        columns = [np.interp(time, table[:, 0], column) for column in (*table.T[1:3], turned)]
        return np.stack(columns[:2], axis=1), columns[2]
    # Twice as fine as the ticks: Simpson's rule wants the middle of each interval.
    fine = np.arange(2 * ticks - 1) / (2 * tick_rate)
    knots, speeds, turns = [0.0], [path.speed], [np.deg2rad(path.yaw_deg)]
    for move in path.moves:
        knots.append(knots[-1] + move.seconds)
        speeds.append(speeds[-1] if move.speed is None else move.speed)
        turns.append(turns[-1] + np.deg2rad(move.turn_deg))
    speed, yaw = np.interp(fine, knots, speeds), np.interp(fine, knots, turns)
    rate = np.stack([speed * np.cos(yaw), speed * np.sin(yaw)], axis=1)
    steps = (rate[:-2:2] + 4 * rate[1::2] + rate[2::2]) / (6 * tick_rate)
    travelled = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return np.array(path.start) + travelled, yaw[::2]


def track_trajectories(
    group: int, name: str, track: Track, ticks: int, tick_rate: int, streams: Streams
) -> list[Trajectory]:
    """The copies of one scripted object over `ticks` ticks, each with its own jitter; ids count up
    from `group`."""
    found = []
    for copy in range(track.count):
        sway = 2 * own_stream(streams, f"{name}:{copy}").random(5) - 1
        jitter = track.jitter
        row, column = divmod(copy, track.per_row or track.count)
        x, y = (
            track.start[axis] + column * track.offset[axis] + row * track.row_offset[axis]
            for axis in (0, 1)
        )
        path = track.model_copy(
            update={
                "start": [
                    x + jitter.x * sway[0],
                    y + jitter.y * sway[1],
                ],
                "yaw_deg": track.yaw_deg + jitter.yaw_deg * sway[2],
                "speed": max(track.speed + jitter.speed * sway[3], 0.0),
            }
        )
        spawn = track.spawn + jitter.spawn * sway[4]
        if track.poses:
            spawn += track.poses[0][0]
        first = max(round(spawn * tick_rate), 0)
        last = ticks if track.despawn is None else min(ticks, round(track.despawn * tick_rate))
        if first < last:
            found.append(
                _trajectory(
                    group + copy,
                    name if track.count == 1 else f"{name}:{copy}",
                    track,
                    first,
                    *poses(path, last - first, tick_rate),
                )
            )
    return found


def birth_trajectories(
    group: int,
    name: str,
    births: Births,
    sensor_pose: FloatArray,
    max_range: float,
    tick_rate: int,
    streams: Streams,
    others: Sequence[Trajectory] | None,
) -> list[Trajectory]:
    """Objects born as a Poisson process about the sensor (poses (T,3), one a tick) that go
    straight on.

    One dense marked process is thinned, so that a higher rate only adds objects, and a larger
    share of deaths in mid-range only shortens the lives that it concerns.  A birth whose object
    would meet another is put off until its way is free; those that a lower rate has too go first.

    others : what is there already; None where objects may meet.
    """
    ticks = len(sensor_pose)
    most = int(2 * DENSEST * ticks / tick_rate) + 50
    marks = own_stream(streams, name).random((most, 9))
    born = np.cumsum(-np.log1p(-marks[:, 0]) / DENSEST)
    found = []
    there = [in_scene(path, sensor_pose, max_range) for path in others or ()]
    chosen = np.flatnonzero((marks[:, 1] < births.rate / DENSEST) & (born * tick_rate < ticks))
    for index in chosen[np.argsort(marks[chosen, 1], kind="stable")]:
        _, _, bearing, popup, depth, aim, pace, vanish, life = marks[index]
        angle = 2 * np.pi * bearing
        if popup < births.popup:
            radius, yaw = max_range * (0.1 + 0.6 * np.sqrt(depth)), 2 * np.pi * aim
        else:
            radius, yaw = max_range, angle + np.pi + np.pi / 2 * (aim - 0.5)
        speed = births.speed[0] + pace * (births.speed[1] - births.speed[0])
        inward = -radius * np.cos(angle - yaw)
        chord = inward + np.sqrt(inward**2 + max_range**2 - radius**2)
        life_ticks = ticks
        if vanish < births.vanish:
            life_ticks = int((0.2 + 0.6 * life) * chord / speed * tick_rate)
        away = radius * np.array([np.cos(angle), np.sin(angle)])
        for first in range(int(born[index] * tick_rate), ticks, max(tick_rate // 10, 1)):
            start = sensor_pose[first, :2] + away
            path = Path(start=start.tolist(), yaw_deg=float(np.rad2deg(yaw)), speed=float(speed))
            whole = _trajectory(
                group + int(index),
                f"{name}:{index}",
                births,
                first,
                *poses(path, ticks - first, tick_rate),
            )
            seen = in_scene(whole, sensor_pose, max_range)
            if others is None or all(first_meeting(seen, other, GAP) is None for other in there):
                there.append(seen)
                if life_ticks > 0:
                    found.append(part(whole, 0, life_ticks))
                break
    return found


def sensor_poses(path: Path | None, pose: list[float] | None, ticks: int, rate: int) -> FloatArray:
    """(T,3) poses of a sensor that follows a path, or stands where the file says."""
    if path is None:
        x, y, yaw_deg = pose or (0.0, 0.0, 0.0)
        return np.tile([x, y, wrap_angle(np.deg2rad(yaw_deg))], (ticks, 1))
    position, yaw = poses(path, ticks, rate)
    missing = ticks - len(yaw)
    table = np.column_stack([position, wrap_angle(yaw)])
    return np.concatenate([table, np.repeat(table[-1:], missing, axis=0)])


def _trajectory(
    object_id: int, name: str, body: Body, first: int, position: FloatArray, yaw: FloatArray
) -> Trajectory:
    return Trajectory(
        id=object_id,
        name=name,
        label=body.kind,
        size=body.size,
        first=first,
        position=position,
        yaw=yaw,
        crashed=np.zeros(len(yaw), bool),
    )
