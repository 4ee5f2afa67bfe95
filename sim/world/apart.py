"""Solid objects keep apart: births wait for a free way, scripted followers brake.

Nothing changes for objects that would not overlap: their paths stay as they are, to the bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from pmbm.sim.world.trajectory import Trajectory, part, presence
from pmbm.types import FloatArray

GAP = 0.5
"""m that what waits or brakes leaves between itself and another."""

_FORESIGHT = 10.0
"""s that a driver looks ahead."""
_ACCELERATION, _BRAKING, _HARDEST_BRAKING = 2.0, 3.0, 8.0
_STANDING_GAP, _HEADWAY = 0.5, 0.8
"""Of the Intelligent Driver Model (Treiber et al. 2000): m/s^2, m and s."""
_STRIDE = 10
"""Ticks from one look for pairs that are near to the next."""
_STANDING = 0.1
"""m/s below which an object stands."""


def separation(
    offset: FloatArray, yaw: FloatArray, other_yaw: FloatArray, size: FloatArray, other: FloatArray
) -> FloatArray:
    """By how much boxes are apart (...), m, along the axis that shows it best; negative where they
    overlap (separating axis theorem).

    offset (..., 2) : from the first boxes' centres to the others'.
    yaw, other_yaw (...) : rad.  size, other (2,) or (..., 2) : length and width, m.
    """
    turn = other_yaw - yaw
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    apart = []
    for heading, own, its in ((yaw, size, other), (other_yaw, other, size)):
        c, s = np.cos(heading), np.sin(heading)
        along = np.abs(offset[..., 0] * c + offset[..., 1] * s)
        aside = np.abs(offset[..., 1] * c - offset[..., 0] * s)
        apart += [
            along - (own[..., 0] + its[..., 0] * cos + its[..., 1] * sin) / 2,
            aside - (own[..., 1] + its[..., 0] * sin + its[..., 1] * cos) / 2,
        ]
    return np.max(apart, axis=0)


def in_scene(path: Trajectory, sensor_pose: FloatArray, reach: float) -> Trajectory:
    """The part of a path, which may be empty, in which its object belongs to the scene.

    sensor_pose (ticks,3) : at every tick from 0.
    """
    ticks = slice(path.first, path.first + len(path.yaw))
    offset = path.position - sensor_pose[ticks, :2]
    return part(path, *presence(np.hypot(offset[:, 0], offset[:, 1]), reach))


def first_meeting(path: Trajectory, other: Trajectory, gap: float) -> int | None:
    """The first tick at which two objects are within the gap of each other, or None."""
    first = max(path.first, other.first)
    last = min(path.first + len(path.yaw), other.first + len(other.yaw))
    if first >= last:
        return None
    own, its = (slice(first - p.first, last - p.first) for p in (path, other))
    offset = other.position[its] - path.position[own]
    near = np.flatnonzero(
        np.hypot(offset[:, 0], offset[:, 1]) < _radius(path) + _radius(other) + gap
    )
    if len(near) == 0:
        return None
    apart = separation(
        offset[near],
        path.yaw[own][near],
        other.yaw[its][near],
        np.array(path.size[:2]),
        np.array(other.size[:2]),
    )
    met = near[apart < gap]
    return first + int(met[0]) if len(met) else None


def overlaps(paths: Sequence[Trajectory]) -> list[tuple[int, int, int]]:
    """Which boxes overlap: (tick, i, j), the first tick of paths i < j, in order of time."""
    found = []
    for i, j in _near_pairs(paths):
        tick = first_meeting(paths[i], paths[j], 0.0)
        if tick is not None:
            found.append((tick, i, j))
    return sorted(found)


def _near_pairs(paths: Sequence[Trajectory]) -> set[tuple[int, int]]:
    """The pairs i < j of paths that may ever be in touch, and some that are not."""
    lengths = np.array([len(path.yaw) for path in paths], dtype=np.int64)
    first = np.array([path.first for path in paths], dtype=np.int64)
    there = np.flatnonzero(lengths).tolist()
    radius = max((_radius(paths[n]) for n in there), default=0.0)
    step = max(
        (float(np.abs(np.diff(paths[n].position, axis=0)).max(initial=0.0)) for n in there),
        default=0.0,
    )
    # A diagonal step is longer by a root of 2 at most.
    farthest = 2.0 * radius + 2.0 * np.sqrt(2.0) * step * _STRIDE
    pairs: set[tuple[int, int]] = set()
    for tick in range(int(first.min(initial=0)), int((first + lengths).max(initial=0)), _STRIDE):
        present = [n for n in there if first[n] < tick + _STRIDE and tick < first[n] + lengths[n]]
        if len(present) < 2:
            continue
        rows = [int(min(max(tick - first[n], 0), lengths[n] - 1)) for n in present]
        places = [paths[n].position[row] for n, row in zip(present, rows, strict=True)]
        near = cKDTree(places).query_pairs(farthest)
        pairs |= {(present[a], present[b]) for a, b in near}
    return pairs


def marked_crashed(paths: Sequence[Trajectory]) -> list[Trajectory]:
    """The paths of vehicles on a road, those that overlap marked as crashed from then on: the
    simulator marks what collides in a step, and not what it has put into one place."""
    crashed = [path.crashed.copy() for path in paths]
    for tick, i, j in overlaps(paths):
        rows = [(n, tick - paths[n].first) for n in (i, j)]
        if not any(crashed[n][row] for n, row in rows):
            for n, row in rows:
                crashed[n][row:] = True
    return [
        path if np.array_equal(path.crashed, marks) else replace(path, crashed=marks)
        for path, marks in zip(paths, crashed, strict=True)
    ]


def followed(
    tracks: Sequence[Trajectory],
    others: Sequence[Trajectory],
    sensor_pose: FloatArray,
    reach: float,
    tick_rate: int,
) -> tuple[list[Trajectory], tuple[int, Trajectory, Trajectory] | None]:
    """Scripted objects that brake, on their own paths, for what they would run into.

    Of two that would overlap the one yields that has the other ahead of it: the follower, and the
    one whose front would touch the other's side.  What stands yields to nobody, and `others`, which
    do not see scripted objects, neither.

    sensor_pose (ticks,3) : at every tick from 0; what is beyond `reach` of it is no matter.
    Returns the tracks, and an overlap that braking could not prevent: its tick, and both objects.
    """
    driven = list(tracks)
    leaders: dict[int, set[int]] = {}
    while True:
        everything = [*driven, *others]
        known = {frozenset((i, j)) for i, ahead in leaders.items() for j in ahead}
        found = dict[frozenset[int], tuple[int, int, int]]()
        for tick, i, j in overlaps([in_scene(p, sensor_pose, reach) for p in everything]):
            if i < len(driven):
                found.setdefault(frozenset((i, j)), (tick, i, j))
        for pair, (tick, i, j) in found.items():
            yields = _yields(tick, i, j, everything, len(driven))
            if pair in known or yields is None:
                return driven, (tick, everything[i], everything[j])
            leaders.setdefault(yields, set()).add(i + j - yields)
        if not found:
            return driven, None
        driven = list(tracks)
        for number in _leaders_first(leaders):
            ahead = [[*driven, *others][n] for n in sorted(leaders[number])]
            driven[number] = _braked(tracks[number], ahead, 1.0 / tick_rate)


def _radius(path: Trajectory) -> float:
    return float(np.hypot(*path.size[:2])) / 2


def _yields(tick: int, i: int, j: int, paths: Sequence[Trajectory], may_yield: int) -> int | None:
    """The one of two objects that first touch at a tick which is to brake for the other, if either
    can."""
    ahead = {}
    for own, other in ((i, j), (j, i)):
        row, its = tick - paths[own].first, tick - paths[other].first
        before = paths[own].position[max(row - 1, 0)]
        if own < may_yield and row > 0 and (before != paths[own].position[row]).any():
            yaw = paths[own].yaw[row]
            offset = paths[other].position[its] - paths[own].position[row]
            ahead[own] = float(offset @ (np.cos(yaw), np.sin(yaw)))
    return max(ahead, key=lambda own: (ahead[own], own), default=None)


def _leaders_first(leaders: dict[int, set[int]]) -> list[int]:
    """Those that yield, each behind those that it yields to as far as they have an order."""
    order: list[int] = []
    waiting = sorted(leaders)
    while waiting:
        free = (n for n in waiting if not leaders[n] & set(waiting))
        chosen = next(free, waiting[0])
        waiting.remove(chosen)
        order.append(chosen)
    return order


def _braked(path: Trajectory, leaders: Sequence[Trajectory], dt: float) -> Trajectory:
    """The object on its path, slowed down for its leaders by the Intelligent Driver Model, whose
    wanted speed is that of its script."""
    drive = _Drive(path, leaders, dt)
    ticks = len(path.yaw)
    progress = np.arange(ticks, dtype=np.float64)
    rate = 1.0
    for tick in range(ticks - 1):
        rate = drive.next_rate(tick, progress[tick], rate)
        progress[tick + 1] = min(progress[tick] + rate, ticks - 1)
    position, yaw = drive.pose(progress)
    return replace(path, position=position, yaw=yaw)


def _going_on(path: Trajectory, ticks: int) -> Trajectory:
    """The path, and so many ticks more as in its last."""
    step = path.position[-1] - path.position[max(len(path.yaw) - 2, 0)]
    more = path.position[-1] + np.arange(1, ticks + 1)[:, None] * step
    return replace(
        path,
        position=np.concatenate([path.position, more]),
        yaw=np.append(path.yaw, np.repeat(path.yaw[-1:], ticks)),
        crashed=np.append(path.crashed, np.repeat(path.crashed[-1:], ticks)),
    )


class _Drive:
    """The progress of one object, which may fall behind its script and never leaves its path."""

    def __init__(self, path: Trajectory, leaders: Sequence[Trajectory], dt: float) -> None:
        ahead = round(_FORESIGHT / dt)
        end = path.first + len(path.yaw)
        # What lasts to the end of the run is seen to go on after it.
        self.leaders = [
            _going_on(leader, ahead) if leader.first + len(leader.yaw) == end else leader
            for leader in leaders
        ]
        self.path = _going_on(path, ahead)
        self.dt = dt
        self.rows = np.arange(len(self.path.yaw))
        self.yaw = np.unwrap(self.path.yaw)
        steps = np.hypot(*np.diff(self.path.position, axis=0).T)
        self.along = np.concatenate([[0.0], np.cumsum(steps)])
        self.speed = np.append(steps, steps[-1:]) / dt

    def pose(self, progress: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Positions (T,2) and headings (T,) at progresses (T,), in ticks of the script."""
        x, y, yaw = (
            np.interp(progress, self.rows, column) for column in (*self.path.position.T, self.yaw)
        )
        return np.stack([x, y], axis=1), yaw

    def next_rate(self, tick: int, progress: float, rate: float) -> float:
        """Ticks of the script to go in the next tick: 1 where the way is free, less in a queue."""
        meetings = [
            found
            for pace in {1.0, rate}
            for leader in self.leaders
            if (found := self._meeting(tick, progress, pace, leader)) is not None
        ]
        wanted = float(np.interp(progress, self.rows, self.speed))
        if wanted < _STANDING:
            return 0.0 if any(seconds < _BRAKING for _, _, seconds in meetings) else 1.0
        speed = rate * wanted
        change = _ACCELERATION * (1.0 - rate**4)
        for gap, its_speed, _ in meetings:
            closing = speed * (speed - its_speed) / (2.0 * np.sqrt(_ACCELERATION * _BRAKING))
            wish = _STANDING_GAP + max(0.0, speed * _HEADWAY + closing)
            change = min(change, _ACCELERATION * (1.0 - rate**4 - (wish / max(gap, 0.01)) ** 2))
        change = max(change, -_HARDEST_BRAKING)
        return float(np.clip(rate + change * self.dt / wanted, 0.0, 1.0))

    def _meeting(
        self, tick: int, progress: float, pace: float, leader: Trajectory
    ) -> tuple[float, float, float] | None:
        """Where the leader would be met at this pace: the gap to it now, m, its speed along the
        path, m/s, and the time until then, s."""
        here = self.path.first + tick
        ticks = np.arange(1, round(_FORESIGHT / self.dt) + 1)
        its = here + ticks - leader.first
        there = (its >= 0) & (its < len(leader.yaw))
        ticks, its = ticks[there], its[there]
        steps = progress + pace * ticks.astype(np.float64)
        position, yaw = self.pose(steps)
        apart = separation(
            leader.position[its] - position,
            yaw,
            leader.yaw[its],
            np.array(self.path.size[:2]),
            np.array(leader.size[:2]),
        )
        touching = np.flatnonzero(apart < GAP)
        if not len(touching):
            return None
        at = int(touching[0])
        moved = leader.position[its[at]] - leader.position[max(its[at] - 1, 0)]
        its_speed = max(0.0, float(moved @ (np.cos(yaw[at]), np.sin(yaw[at])))) / self.dt
        way = float(np.interp(steps[at], self.rows, self.along)) - float(
            np.interp(progress, self.rows, self.along)
        )
        seconds = float(ticks[at]) * self.dt
        return way - its_speed * seconds, its_speed, seconds
