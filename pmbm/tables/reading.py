"""Recordings' columns from tables."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import NOT_YET_CONFIRMED, InputError, nearest_hint
from pmbm.labels import OBSERVABLE_SHARE, Label
from pmbm.tables.axes import Axes, axes
from pmbm.tables.boxes import WHOLE, boxes, differences, each_once, identities, labels_of
from pmbm.tables.cells import Cells, arrow_package
from pmbm.tables.clock import Clock, Placed, clock, keys
from pmbm.tables.columns import COLUMNS
from pmbm.validation import frozen

if TYPE_CHECKING:
    import pandas as pd

Frame = Literal["world", "ego"]
"""Of boxes in tables."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Frames and sensor poses, P rows.

    row (F,) : the row of each frame, its first.  planar (P,3) : x, y, yaw of the sensor.
    axes : P motions of the frame that boxes may be given in, or None without a table.
    stamp (F,) : of the frames.
    delivered (D,) : rows that are deliveries, in order of arrival.  frame (D,) : of each.
    time (D,) : of each, NaN where it is the frame's.
    sensor (D,) : name of each one's sensor.  velocity (D,2) : of the sensor, NaN where not told.
    """

    row: IntArray
    planar: FloatArray
    axes: Axes | None
    stamp: IntArray
    delivered: IntArray
    frame: IntArray
    time: FloatArray
    sensor: NDArray[Any]
    velocity: FloatArray


def _poses(cells: Cells | None, frames: Clock) -> Poses:
    """The poses of a table; without one, a sensor at the origin and a delivery a frame."""
    every = np.arange(len(frames.key))
    stamp = np.round(frames.time * 1e9).astype(np.int64)
    if cells is None:
        planar, time = np.zeros((len(every), 3)), np.full(len(every), np.nan)
        unnamed: NDArray[Any] = np.full(len(every), "", dtype=object)
        still = np.full((len(every), 2), np.nan)
        return Poses(every, planar, None, stamp, every, every, time, unnamed, still)
    frame = np.searchsorted(frames.key, keys(cells, frames.by))
    _, row = np.unique(frame, return_index=True)
    delivered = cells.flags("delivered", np.ones(len(cells), bool))
    alone = np.bincount(frame, minlength=len(every))[frame] == 1
    if (~delivered & ~alone).any():
        raise cells.error(
            "a frame that is delivered and is not",
            "delivered",
            int(np.argmax(~delivered & ~alone)),
            expected="one row for a frame without a delivery",
        )
    given, told = cells.integers("stamp")
    stamp = np.where(told[row], given[row], stamp)
    rows = np.flatnonzero(delivered)
    planar = np.column_stack([cells.numbers(name, 0.0) for name in ("x", "y", "yaw")])
    index, names = cells.texts("sensor")
    velocity = np.column_stack([cells.numbers(name) for name in ("vx", "vy")])
    return Poses(
        row=row,
        planar=planar,
        axes=axes(cells),
        stamp=stamp,
        delivered=rows,
        frame=frame[rows],
        time=cells.numbers("delivery_time")[rows],
        sensor=np.array([*names, ""], dtype=object)[index[rows]],
        velocity=velocity[rows],
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Parts:
    """The columns that a recording is made from.

    key (F,), time (F,), stamp (F,) : of the frames, as `Clock` and `Poses` have them.
    pose (F,3) : x, y, yaw of the sensor.
    axes : of the frames, from the ego's frame to the world, or None.
    truth_count (F,), truth : rows of each frame, and their columns as `GroundTruth` has them.
    frame (D,), delivery_time (D,), delivery_pose (D,3) : of the deliveries.
    detection_count (D,), detections : of each delivery, as `Detections` has them.
    of_sensor : field of `Detections` -> of each delivery, where there are several sensors.
    origin (D,) or None : of each delivery the truth rows, as `Recording` has them.
    object_name : id -> the source's own name.
    observable_by : as `Recording` has it.
    """

    clock: Clock
    stamp: IntArray
    pose: FloatArray
    axes: Axes | None
    truth_count: IntArray
    truth: Mapping[str, NDArray[Any]]
    frame: IntArray
    delivery_time: FloatArray
    delivery_pose: FloatArray
    detection_count: IntArray
    detections: Mapping[str, NDArray[Any]]
    of_sensor: Mapping[str, list[Any]]
    origin: list[IntArray] | None
    object_name: Mapping[int, str]
    observable_by: Mapping[str, tuple[BoolArray, ...]]


def parts(
    tables: Mapping[str, Cells],
    *,
    frame: Frame = "world",
    classes: Mapping[str, Label | None] | None = None,
    rate: float = 10.0,
    frames_only: Sequence[str] = ("tracks",),
) -> Parts:
    """What a recording's tables say: truth, detections and poses, of which any may be missing.

    frame : that boxes are given in; "ego" needs poses.
    classes : see `labels_of`.  rate : frames a second, where no table has times.
    frames_only : tables of which no more is read than which frames there are.
    Raises InputError with table, column and row.
    """
    if frame == "ego" and "poses" not in tables:
        raise InputError("boxes in the ego's frame need poses", field="frame", got=frame)
    frames = clock(tables, rate)
    tables = {what: cells for what, cells in tables.items() if what not in frames_only}
    poses = _poses(tables.get("poses"), frames)
    ego = poses.axes if frame == "ego" else None
    of_frames = None if ego is None else ego.take(poses.row)
    truth = Rows(np.zeros(len(frames.key), np.int64), {"id": np.zeros(0, np.int64)})
    if "truth" in tables:
        truth = _truth(tables["truth"], frames, of_frames, classes or {})
    delivered, time, detections = poses.delivered, poses.time, Rows(np.zeros(0, np.int64), {})
    if "detections" in tables:
        detections, time = _detections(tables["detections"], frames, poses, ego, classes or {})
    else:
        delivered = delivered[:0]
    number = len(delivered)
    of_sensor = _of_sensors(tables["detections"], detections, poses) if number else {}
    seen_by = truth.columns.pop("observable_by", None)
    names = detections.columns.pop("truth_id", None)
    origin = None
    if names is not None and "truth" in tables:
        origin = _origin(tables["detections"], detections, names, truth, poses.frame)
    return Parts(
        clock=frames,
        stamp=poses.stamp,
        pose=poses.planar[poses.row],
        axes=of_frames,
        truth_count=truth.count,
        truth=truth.columns,
        frame=poses.frame[:number],
        delivery_time=np.where(np.isnan(time), frames.time[poses.frame], time)[:number],
        delivery_pose=poses.planar[delivered],
        detection_count=detections.count,
        detections=detections.columns,
        of_sensor=of_sensor,
        origin=origin,
        object_name=truth.name,
        observable_by={} if seen_by is None else _observable_by(seen_by, truth.count),
    )


@dataclass(frozen=True, eq=False)
class Rows:
    """Boxes in order of their groups, frames or deliveries.

    count (G,) : rows of each.  columns : name -> (R, ...).
    row (R,) : their rows in the table.  name : id -> the source's own name.
    number : id in the table -> id here, None where it is the same.
    whole : whether no class was left out.
    """

    count: IntArray
    columns: dict[str, NDArray[Any]]
    row: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    name: Mapping[int, str] = field(default_factory=dict)
    number: Mapping[str, int] | None = None
    whole: bool = True


def track_rows(
    cells: Cells, frames: Clock, ego: Axes | None, classes: Mapping[str, Label | None]
) -> Rows:
    """The rows of a table of tracks, as `Tracks` has them.

    ego : of the frames; None for boxes in the world.
    Raises InputError with column and row.
    """
    placed = frames.place(cells)
    rows = _followed(cells, frames, placed, ego, classes, {"score": cells.numbers("score", 1.0)})
    below = rows.columns["id"] < 0
    if below.any():
        row = int(np.argmax(below))
        raise cells.error(
            "not an id",
            "id",
            int(rows.row[row]),
            expected="a text or a whole number of at least 0",
            got=int(rows.columns["id"][row]),
            hint=NOT_YET_CONFIRMED,
        )
    return rows


def _truth(
    cells: Cells, frames: Clock, ego: Axes | None, classes: Mapping[str, Label | None]
) -> Rows:
    visibility = cells.numbers("visibility", 1.0)
    own: dict[str, NDArray[Any]] = {
        "visibility": visibility,
        "observable": cells.flags("observable", visibility >= OBSERVABLE_SHARE),
        "crashed": cells.flags("crashed", np.zeros(len(cells), bool)),
    }
    if cells.has("observable_by"):
        index, texts = cells.texts("observable_by")
        own["observable_by"] = np.array([*texts, ""], dtype=object)[index]
    return _followed(cells, frames, frames.place(cells), ego, classes, own)


def _followed(
    cells: Cells,
    frames: Clock,
    placed: Placed,
    ego: Axes | None,
    classes: Mapping[str, Label | None],
    own: Mapping[str, NDArray[Any]],
) -> Rows:
    """Boxes that have an identity and a velocity, with columns of their own."""
    label, kept = labels_of(cells, classes)
    identity, number = identities(cells)
    each_once(cells, placed.sorted(identity), placed)
    columns: dict[str, NDArray[Any]] = {
        "id": identity,
        **boxes(cells, label),
        "velocity": np.column_stack([cells.numbers("vx"), cells.numbers("vy")]),
        "label": label.astype(np.int8),
        **own,
    }
    columns = {name: placed.sorted(values) for name, values in columns.items()}
    frame = placed.frame
    if ego is not None:
        columns = ego.take(frame).to_world(columns)
    unknown = np.isnan(columns["velocity"])
    if unknown.any():
        speed = differences(columns["id"], columns["position"], placed, frames.time)
        columns["velocity"] = np.where(unknown, speed, columns["velocity"])
    names = {} if number is None else {place: text for text, place in number.items()}
    if cells.what == "truth" and cells.has("name"):
        index, texts = cells.texts("name")
        said = index >= 0
        names |= dict(zip(identity[said].tolist(), (texts[i] for i in index[said]), strict=True))
    row = np.arange(len(cells)) if placed.order is None else placed.order
    found = Rows(placed.count, columns, row, names, number)
    return found if kept.all() else _only(found, placed.sorted(kept), frame)


def _only(rows: Rows, kept: BoolArray, group: IntArray) -> Rows:
    """Those rows that are kept.  group (R,) : of each."""
    count = np.bincount(group[kept], minlength=len(rows.count))
    columns = {name: values[kept] for name, values in rows.columns.items()}
    there = set(columns["id"].tolist()) if "id" in columns else set()
    names = {number: name for number, name in rows.name.items() if number in there}
    return Rows(count, columns, rows.row[kept], names, rows.number, whole=False)


def _detections(
    cells: Cells,
    frames: Clock,
    poses: Poses,
    ego: Axes | None,
    classes: Mapping[str, Label | None],
) -> tuple[Rows, FloatArray]:
    """The boxes of every delivery, and the deliveries' times (D,), NaN where not told."""
    placed = frames.place(cells)
    delivery = _delivery(cells, placed, poses)
    label, kept = labels_of(cells, classes)
    columns: dict[str, NDArray[Any]] = {
        **boxes(cells, label),
        "score": cells.numbers("score", 1.0),
        "label": label.astype(np.int8),
    }
    if cells.has("raw_score") or ("raw_score" in cells.table.column_names and not len(cells)):
        columns["raw_score"] = cells.numbers("raw_score")
        empty = np.isnan(columns["raw_score"])
        if empty.any():
            raise cells.error(
                "an empty cell",
                "raw_score",
                int(np.argmax(empty)),
                expected="a raw score in every row, or in none",
            )
    if cells.has("radial_velocity"):
        columns["radial_velocity"] = cells.numbers("radial_velocity")
    if "truth_id" in cells.table.column_names:
        index, texts = cells.texts("truth_id")
        columns["truth_id"] = np.array([*texts, None], dtype=object)[index]
    order = None if (np.diff(delivery) >= 0).all() else np.argsort(delivery, kind="stable")
    if order is not None:
        columns = {name: values[order] for name, values in columns.items()}
        delivery, kept = delivery[order], kept[order]
    if ego is not None:
        columns = ego.take(poses.delivered[delivery]).to_world(columns)
    rows = np.arange(len(cells)) if order is None else order
    count = np.bincount(delivery, minlength=len(poses.delivered))
    found = Rows(count, columns, rows)
    time = _delivery_times(cells, frames, poses, found)
    return found if kept.all() else _only(found, kept, delivery), time


def _delivery(cells: Cells, placed: Placed, poses: Poses) -> IntArray:
    """(R,) the delivery of each row: by its number, or by the frame and, where the table names
    sensors, the sensor.  Raises InputError where there is none, or several."""
    frame = np.empty(len(cells), np.int64)
    frame[slice(None) if placed.order is None else placed.order] = placed.frame
    number, given = cells.integers("delivery")
    group, own = poses.frame, frame
    index, names = cells.texts("sensor")
    if names and poses.sensor.any():
        # A key for each frame and sensor; sensors that the poses do not know get one of their own.
        known = {name: place for place, name in enumerate(dict.fromkeys([*poses.sensor, *names]))}
        places = np.array([*(known[name] for name in names), known.get("", len(known))])
        group = group * (len(known) + 1) + np.array([known[name] for name in poses.sensor])
        own = own * (len(known) + 1) + places[index]
    elif len(names) > 1:
        row = int(np.argmax(index != index[0]))
        raise cells.error(
            "several sensors, and poses that name none",
            "sensor",
            row,
            expected="poses with a row for each delivery and its sensor",
            got=names[index[row]],
        )
    order = np.argsort(group, kind="stable")
    first = np.searchsorted(group[order], own, side="left")
    there = np.searchsorted(group[order], own, side="right") - first
    found = order[np.minimum(first, max(len(order) - 1, 0))] if len(order) else first
    result = np.where(given, number, found)
    inside = (result >= 0) & (result < len(group))
    right = inside & (given | (there == 1))
    right[inside] &= group[result[inside]] == own[inside]
    if not right.all():
        row = int(np.argmin(right))
        raise cells.error(
            "detections of no delivery" if there[row] < 2 else "detections of one of several",
            "delivery",
            row,
            expected=f"one of {np.flatnonzero(group == own[row]).tolist()}, which the poses say "
            "were delivered of this frame",
            got=int(number[row]) if given[row] else None,
        )
    return result


def _of_sensors(cells: Cells, rows: Rows, poses: Poses) -> dict[str, list[Any]]:
    """Field of `Detections` -> its value of each delivery, where sensors are named or move.

    Raises InputError unless a delivery has both radial velocities and that of its sensor, or none.
    """
    moves = np.asarray(np.isfinite(poses.velocity).all(axis=1), bool)
    if not poses.sensor.any() and not moves.any() and "radial_velocity" not in rows.columns:
        return {}
    empty = np.full(len(rows.row), np.nan)
    radial = rows.columns.pop("radial_velocity", empty)
    wrong = np.isnan(radial) == moves[np.repeat(np.arange(len(rows.count)), rows.count)]
    if wrong.any():
        place = int(np.argmax(wrong))
        raise cells.error(
            "radial velocities without that of the sensor, or the sensor's without them",
            "radial_velocity",
            int(rows.row[place]),
            expected="radial_velocity in all rows of a delivery and vx, vy in its row of the poses",
            got=None if np.isnan(radial[place]) else float(radial[place]),
        )
    parts = np.split(radial, np.cumsum(rows.count)[:-1])
    return {
        "sensor": poses.sensor.tolist(),
        "radial_velocity": [
            frozen(part) if m else None for part, m in zip(parts, moves, strict=True)
        ],
        "sensor_velocity": [
            frozen(one) if m else None for one, m in zip(poses.velocity, moves, strict=True)
        ],
    }


def _observable_by(names: NDArray[Any], count: IntArray) -> dict[str, tuple[BoolArray, ...]]:
    """Sensor -> per frame, whether it could see each object; sensors by name."""
    told = [set(text.split()) for text in names.tolist()]
    end = np.cumsum(count)[:-1]
    return {
        sensor: tuple(np.split(np.array([sensor in one for one in told], bool), end))
        for sensor in sorted(set().union(*told))
    }


def _delivery_times(cells: Cells, frames: Clock, poses: Poses, rows: Rows) -> FloatArray:
    """(D,) what the rows say, where the poses do not, or NaN where nobody does.

    Raises InputError where the rows of a delivery differ, or where their time is nearer to that of
    another frame.
    """
    time = poses.time.copy()
    if frames.by == "time" or not cells.has("time"):
        return time
    own = cells.numbers("time")[rows.row]
    group = np.repeat(np.arange(len(rows.count)), rows.count)
    asked = np.isnan(time)[group] & ~np.isnan(own)
    own, group, row = own[asked], group[asked], rows.row[asked]
    time[group[::-1]] = own[::-1]
    differ = time[group] != own
    if differ.any():
        place = int(np.argmax(differ))
        raise cells.error(
            "two times of one delivery",
            "time",
            int(row[place]),
            expected=float(time[group[place]]),
            got=float(own[place]),
        )
    step = np.median(np.diff(frames.time)) if len(frames.time) > 1 else np.inf
    usual = frames.time[poses.frame[group]]
    far = np.abs(own - usual) > step / 2
    if far.any():
        place = int(np.argmax(far))
        raise cells.error(
            "the time of another frame",
            "time",
            int(row[place]),
            expected=f"{float(usual[place])!r} within {step / 2:g} s",
            got=float(own[place]),
        )
    return time


def _origin(
    cells: Cells, detections: Rows, names: NDArray[Any], truth: Rows, frame: IntArray
) -> list[IntArray]:
    """Of each delivery the truth rows that its detections come from, CLUTTER where from none."""
    whole = np.repeat(np.arange(len(detections.count)), detections.count)
    row_of = {
        (f, i): place
        for f, i, place in zip(
            np.repeat(np.arange(len(truth.count)), truth.count).tolist(),
            truth.columns["id"].tolist(),
            (np.arange(truth.count.sum()) - np.repeat(_before(truth.count), truth.count)).tolist(),
            strict=True,
        )
    }
    origin = np.full(len(names), -1)
    frames = frame[whole].tolist()
    for place in np.flatnonzero(names != None).tolist():  # noqa: E711
        f, name = frames[place], names[place]
        if truth.number is not None:
            number = truth.number.get(name)
        else:
            number = int(name) if re.fullmatch(WHOLE, name) else None
        row = row_of.get((f, number), -1) if number is not None else -1
        if row < 0 and truth.whole:
            raise cells.error(
                "no such object in the truth of this frame",
                "truth_id",
                int(detections.row[place]),
                expected="the id of a row of truth, or an empty cell",
                got=name,
            )
        origin[place] = row
    return np.split(origin, np.cumsum(detections.count)[:-1]) if len(detections.count) else []


def _before(count: IntArray) -> IntArray:
    """The number of rows before each group."""
    return np.cumsum(count) - count


def cells_of(tables: Mapping[str, pd.DataFrame]) -> dict[str, Cells]:
    """The cells of DataFrames by the names of their tables.

    Raises InputError for an unknown table, and for columns that are none of its.
    """
    for what in tables:
        if what not in ("truth", "detections", "poses"):
            hint = nearest_hint(what, COLUMNS, "table")
            raise InputError(f"no table '{what}' in a recording", hint=hint)
    return {what: _cells(what, table) for what, table in tables.items()}


def _cells(what: str, table: pd.DataFrame) -> Cells:
    arrow = arrow_package()
    columns = {}
    for name in table.columns:
        try:
            columns[str(name)] = arrow.array(table[name], from_pandas=True)
        except (arrow.ArrowException, ValueError, TypeError) as error:
            raise InputError(
                f"{what}: cells of several kinds", field=str(name), got=str(error)
            ) from None
    return Cells(what, arrow.table(columns))
