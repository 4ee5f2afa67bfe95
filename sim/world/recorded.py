"""Recorded traffic: what a file says of the objects that moved, and their paths on the tick clock.

A file is a table of truth, a CommonRoad scenario or a SUMO run's floating car data.  Between two
samples places and headings are linear in time; at a sample they are the sample's own bits.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pmbm.datasets.files import unreadable
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.sim.schema import RecordedScene
from pmbm.sim.world.recorded_files import RecordedObject, read
from pmbm.sim.world.trajectory import Trajectory
from pmbm.types import FloatArray

_AT_A_SAMPLE = 1e-6
"""s within which a tick is at a sample."""
_GAP = 1.5
"""Steps of the file from which on an object has been away in between."""


def recorded_objects(form: RecordedScene) -> tuple[RecordedObject, ...]:
    """The objects of a scene's file, in the order of their first appearance in it.

    Raises InputError where the file is none of those that can be read, or wrong.
    """
    return _read(files_state(form), tuple(sorted(form.classes.items())))


def files_state(form: RecordedScene) -> tuple[tuple[str, int, int], ...]:
    """The scene's files, and what tells that one has changed.

    Raises InputError for one that is not there.
    """
    return tuple((str(path), *_state(path)) for path in map(Path, (form.file, *form.types)))


@functools.lru_cache(maxsize=4)
def _read(
    state: tuple[tuple[str, int, int], ...], classes: tuple[tuple[str, str], ...]
) -> tuple[RecordedObject, ...]:
    path, *types = (Path(name) for name, *_ in state)
    known = {name: None if label == "ignored" else Label[label.upper()] for name, label in classes}
    return read(path, types, known)


def _state(path: Path) -> tuple[int, int]:
    """The file's time of change and size."""
    try:
        found = path.stat()
    except OSError as error:
        raise unreadable(path, error) from None
    return found.st_mtime_ns, found.st_size


def recorded_paths(
    form: RecordedScene, ticks: int, tick_rate: int
) -> tuple[list[Trajectory], FloatArray | None]:
    """The paths of all objects but the ego over `ticks` ticks, and the ego's poses (ticks,3), None
    without one.

    Raises InputError for an unknown ego, and where the file ends, or the ego is away, before the
    last tick.
    """
    objects = recorded_objects(form)
    first = min((one.time[0] for one in objects), default=0.0)
    last = max((one.time[-1] for one in objects), default=0.0)
    start = first if form.start is None else form.start
    time = start + np.arange(ticks) / tick_rate
    if start < first - _AT_A_SAMPLE:
        raise InputError(
            "starts before the recorded traffic",
            file=form.file,
            field="scene.start",
            expected=f"at least {first:g} s",
            got=f"{start:g} s",
        )
    # The tick beyond the last frame is there for differences alone.
    if time[max(ticks - 2, 0)] > last + _AT_A_SAMPLE:
        raise InputError(
            "longer than the recorded traffic",
            field="duration",
            expected=f"at most {max(last - start, 0.0):g} s, from scene.start = {start:g} s on",
            got=f"{(ticks - 2) / tick_rate:g} s and more",
        )
    steps = np.concatenate([np.zeros(0), *(np.diff(one.time) for one in objects)])
    step = float(np.median(steps)) if len(steps) else 0.0
    paths: list[Trajectory] = []
    ego = None
    for number, one in enumerate(objects):
        pieces = _pieces(number, one, time, step)
        if one.name == form.ego:
            ego = _ego_poses(one, pieces, ticks, time)
        else:
            paths += pieces
    if form.ego is not None and ego is None:
        raise InputError(
            "no such vehicle in the file",
            file=form.file,
            field="scene.ego",
            got=form.ego,
            hint=nearest_hint(form.ego, [one.name for one in objects][:1000], "vehicle"),
        )
    return paths, ego


def _pieces(number: int, one: RecordedObject, time: FloatArray, step: float) -> list[Trajectory]:
    """An object's path at the ticks, cut where it was away or was moved by hand."""
    away = one.cut | (np.diff(one.time) > _GAP * step)
    ends = [*(np.flatnonzero(away) + 1).tolist(), len(one.time)]
    found = []
    for begin, end in zip([0, *ends], ends, strict=False):
        own = slice(begin, end)
        at = one.time[own]
        inside = (time >= at[0] - _AT_A_SAMPLE) & (time <= at[-1] + _AT_A_SAMPLE)
        if inside.any():
            first = int(np.argmax(inside))
            when = time[inside]
            found.append(
                Trajectory(
                    id=number,
                    name=one.name,
                    label=one.label,
                    size=one.size,
                    first=first,
                    position=_sampled(when, at, one.position[own], one.position[own]),
                    yaw=_sampled(when, at, np.unwrap(one.yaw[own]), one.yaw[own]),
                    crashed=one.crashed[own][np.searchsorted(at, when + _AT_A_SAMPLE) - 1],
                )
            )
    return found


def _sampled(
    when: FloatArray, at: FloatArray, smooth: FloatArray, values: FloatArray
) -> FloatArray:
    """Values (T,...) at other times, linear between the samples, and at a sample its own bits.

    smooth (T,...) : the same, of angles without jumps by a whole turn.
    """
    place = np.interp(when, at, np.arange(len(at)))
    before = np.minimum(place.astype(np.int64), max(len(at) - 2, 0))
    after = np.minimum(before + 1, len(at) - 1)
    share = (place - before).reshape(-1, *[1] * (values.ndim - 1))
    made = np.asarray(smooth[before] + share * (smooth[after] - smooth[before]), np.float64)
    nearest = np.rint(place).astype(np.int64)
    exact = np.abs(when - at[nearest]) <= _AT_A_SAMPLE
    made[exact] = values[nearest[exact]]
    return made


def _ego_poses(
    one: RecordedObject, pieces: Sequence[Trajectory], ticks: int, time: FloatArray
) -> FloatArray:
    """Poses (ticks,3) of a vehicle that is there all the time."""
    whole = next((p for p in pieces if p.first == 0 and len(p.yaw) >= ticks - 1), None)
    if whole is None:
        there = [f"{time[p.first]:g} to {time[p.first + len(p.yaw) - 1]:g} s" for p in pieces] or [
            f"{one.time[0]:g} to {one.time[-1]:g} s"
        ]
        raise InputError(
            "the vehicle that carries the sensor is not there all the time",
            field="scene.ego",
            expected=f"scene.start and duration within {', '.join(there)}",
            got=f"{time[0]:g} to {time[-2]:g} s",
        )
    table = np.column_stack([whole.position, wrap_angle(whole.yaw)])
    return np.concatenate([table, table[-1:]])[:ticks]
