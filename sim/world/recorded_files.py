"""Files of recorded traffic: tables of truth, CommonRoad scenarios, floating car data of SUMO.

The obstacles of a CommonRoad file are read here and not by commonroad-io, whose pinned protobuf
goes with no other package, and which finds a state by its place in the list and not by its time.
"""

from __future__ import annotations

import gzip
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from pmbm.errors import InputError, InputWarning, nearest_hint
from pmbm.labels import Label
from pmbm.types import BoolArray, FloatArray

Classes = Mapping[str, Label | None]
"""The file's own names -> labels, None for what is left out."""
_ASIDE = 1.0
"""m to the side, beyond a quarter of the way ahead, that no vehicle moves in one step."""


@dataclass(frozen=True, eq=False)
class RecordedObject:
    """An object of a file, with its samples.

    name : the file's own.
    size : length, width, height, m.
    time (T,) : s, increasing.  position (T,2) : of the box's centre, m.  yaw (T,) : rad.
    crashed (T,) : has collided.
    cut (T-1,) : whether nothing is known between a sample and the next: it was moved by hand.
    """

    name: str
    label: Label
    size: tuple[float, float, float]
    time: FloatArray
    position: FloatArray
    yaw: FloatArray
    crashed: BoolArray
    cut: BoolArray


def read(path: Path, types: Sequence[Path], classes: Classes) -> tuple[RecordedObject, ...]:
    """The objects of a file: a table by its name (.csv, .parquet), else by its first element."""
    if path.suffix in (".csv", ".parquet"):
        return _from_table(path, classes)
    root = _root(path) if path.suffix in (".xml", ".gz") else path.suffix
    if root == "fcd-export":
        return _from_fcd(path, types, classes)
    if root == "commonRoad":
        return _from_commonroad(path, classes)
    raise InputError(
        "no recorded traffic",
        file=path,
        expected=".csv or .parquet, a CommonRoad file, or SUMO's FCD (fcd-export)",
        got=root,
    )


@dataclass(eq=False)
class _Rows:
    """The samples collected of one object."""

    label: Label
    size: tuple[float, float, float]
    time: list[float] = field(default_factory=list)
    state: list[tuple[float, float, float]] = field(default_factory=list)

    def object(self, name: str, cut: BoolArray | None = None) -> RecordedObject:
        """The object, its states in order of time."""
        time = np.array(self.time)
        order = np.argsort(time, kind="stable")
        state = np.array(self.state).reshape(-1, 3)[order]
        none = np.zeros(max(len(time) - 1, 0), bool)
        return RecordedObject(
            name=name,
            label=self.label,
            size=self.size,
            time=time[order],
            position=state[:, :2],
            yaw=state[:, 2],
            crashed=np.zeros(len(time), bool),
            cut=none if cut is None else cut,
        )


def _from_table(path: Path, classes: Classes) -> tuple[RecordedObject, ...]:
    """A table of truth in the world (docs/guide/tables.md); an object's size is its median."""
    from pmbm.datasets.table_files import located, read_table
    from pmbm.tables.reading import parts

    with located(path):
        found = parts({"truth": read_table(path, "truth")}, classes=classes)
    columns = found.truth
    time = np.repeat(found.clock.time, found.truth_count)
    objects = []
    ids, first = np.unique(columns["id"], return_index=True)
    for identity in ids[np.argsort(first)].tolist():
        rows = columns["id"] == identity
        length, width, height = np.median(columns["size"][rows], axis=0).tolist()
        objects.append(
            RecordedObject(
                name=found.object_name.get(identity, str(identity)),
                label=Label(int(np.bincount(columns["label"][rows]).argmax())),
                size=(length, width, height),
                time=time[rows],
                position=columns["position"][rows, :2],
                yaw=columns["yaw"][rows],
                crashed=columns["crashed"][rows],
                cut=np.zeros(rows.sum() - 1, bool),
            )
        )
    return tuple(objects)


_VEHICLE_CLASSES: Mapping[str, tuple[Label, tuple[float, float, float]]] = {
    "passenger": (Label.CAR, (5.0, 1.8, 1.5)),
    "private": (Label.CAR, (5.0, 1.8, 1.5)),
    "taxi": (Label.CAR, (5.0, 1.8, 1.5)),
    "evehicle": (Label.CAR, (5.0, 1.8, 1.5)),
    "emergency": (Label.TRUCK, (6.5, 2.16, 2.86)),
    "delivery": (Label.TRUCK, (6.5, 2.16, 2.86)),
    "truck": (Label.TRUCK, (7.1, 2.4, 2.4)),
    "trailer": (Label.TRUCK, (16.5, 2.55, 4.0)),
    "bus": (Label.BUS, (12.0, 2.5, 3.4)),
    "coach": (Label.BUS, (14.0, 2.6, 4.0)),
    "motorcycle": (Label.MOTORCYCLIST, (2.2, 0.9, 1.5)),
    "moped": (Label.MOTORCYCLIST, (2.1, 0.8, 1.7)),
    "bicycle": (Label.CYCLIST, (1.6, 0.65, 1.7)),
    "pedestrian": (Label.PEDESTRIAN, (0.215, 0.478, 1.719)),
}
"""SUMO's vClass -> label, and length, width, height where a type does not say them, m."""
_DEFAULT_TYPES: Mapping[str, str] = {
    "DEFAULT_VEHTYPE": "passenger",
    "DEFAULT_BIKETYPE": "bicycle",
    "DEFAULT_PEDTYPE": "pedestrian",
    "DEFAULT_TAXITYPE": "taxi",
}


def _from_fcd(path: Path, types: Sequence[Path], classes: Classes) -> tuple[RecordedObject, ...]:
    """Floating car data: the front bumper and a compass angle, every step.

    Lengths and classes stand with the vehicle types, in the run's files of routes.
    """
    known = {name: _VEHICLE_CLASSES[kind] for name, kind in _DEFAULT_TYPES.items()}
    for file in types:
        known |= _vehicle_types(file)
    found: dict[str, _Rows] = {}
    for moment in _elements(path, "timestep"):
        time = _number(path, moment, "time")
        for one in moment:
            if one.tag not in ("vehicle", "person"):
                continue
            name, kind = _text(path, one, "id"), _text(path, one, "type")
            label, size = _of_type(path, name, kind, known, classes)
            if label is None:
                continue
            x, y, angle = (_number(path, one, key) for key in ("x", "y", "angle"))
            yaw = np.deg2rad(90.0 - angle)
            back = size[0] / 2 if one.tag == "vehicle" else 0.0
            rows = found.setdefault(name, _Rows(label, size))
            if rows.time and time <= rows.time[-1]:
                raise InputError(
                    "times must increase", file=path, object_id=name, field="time", got=time
                )
            rows.time.append(time)
            rows.state.append((x - back * np.cos(yaw), y - back * np.sin(yaw), yaw))
    jumps = {name: _moved_aside(rows) for name, rows in found.items()}
    moved = [(found[name].time[int(np.argmax(cut)) + 1], name) for name, cut in jumps.items()
             if cut.any()]  # fmt: skip
    if moved:
        time, name = min(moved)
        warnings.warn(
            InputWarning(
                f"{sum(int(cut.sum()) for cut in jumps.values())} times a vehicle is moved aside "
                f"in one step, first {name} at {time:g} s, which no path leads through (file "
                f"{path}); run sumo with --lanechange.duration 3, and without parking beside the "
                "lane"
            ),
            stacklevel=2,
        )
    return tuple(rows.object(name, jumps[name]) for name, rows in found.items())


def _moved_aside(rows: _Rows) -> BoolArray:
    """(T-1,) the steps that lead farther to the side than a vehicle goes: changes of lanes and
    parking, as SUMO makes them by default."""
    state = np.array(rows.state)
    step = np.diff(state[:, :2], axis=0)
    turn = np.unwrap(state[:, 2])
    middle = (turn[1:] + turn[:-1]) / 2
    ahead = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    aside = step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle)
    return np.abs(aside) > _ASIDE + np.abs(ahead) / 4


def _vehicle_types(path: Path) -> dict[str, tuple[Label, tuple[float, float, float]]]:
    """Vehicle type -> label and size, of a file of routes or of additional things."""
    found = {}
    for one in _elements(path, "vType"):
        kind = one.get("vClass", "passenger")
        label, usual = _VEHICLE_CLASSES.get(kind, (Label.OTHER, Label.OTHER.default_size))
        length, width, height = (
            usual[side] if one.get(key) is None else _number(path, one, key)
            for side, key in enumerate(("length", "width", "height"))
        )
        if min(length, width, height) <= 0:
            raise InputError(
                "a size out of range", file=path, object_id=one.get("id"), expected="above 0, m"
            )
        found[_text(path, one, "id")] = (label, (length, width, height))
    return found


def _of_type(
    path: Path,
    name: str,
    kind: str,
    known: Mapping[str, tuple[Label, tuple[float, float, float]]],
    classes: Classes,
) -> tuple[Label | None, tuple[float, float, float]]:
    # SUMO writes "car@f1.0" for a type of one vehicle alone, made from another.
    plain = kind if kind in known else kind.partition("@")[0]
    if plain not in known:
        raise InputError(
            "a vehicle type that no file of types has",
            file=path,
            object_id=name,
            field="type",
            got=kind,
            hint='say types = ["FILE.rou.xml"] in [scene]: lengths stand there',
        )
    label, size = known[plain]
    return classes.get(plain, label), size


_OBSTACLES: Mapping[str, Label] = {
    "car": Label.CAR,
    "taxi": Label.CAR,
    "parkedVehicle": Label.CAR,
    "priorityVehicle": Label.CAR,
    "truck": Label.TRUCK,
    "bus": Label.BUS,
    "motorcycle": Label.MOTORCYCLIST,
    "bicycle": Label.CYCLIST,
    "pedestrian": Label.PEDESTRIAN,
}
"""CommonRoad's types of obstacles that move; others are of the label `other`."""


def _from_commonroad(path: Path, classes: Classes) -> tuple[RecordedObject, ...]:
    """The static and dynamic obstacles of a CommonRoad scenario (2018b, 2020a): states by their own
    time, boxes by their shape's origin.  Those without a state at an exact place are refused."""
    step, last = None, 0
    found: dict[str, _Rows] = {}
    still = []
    for one in _elements(path, "dynamicObstacle", "staticObstacle", "obstacle", "commonRoad"):
        if one.tag == "commonRoad":
            step = _number(path, one, "timeStepSize")
            continue
        name, kind = _text(path, one, "id"), (one.findtext("type") or "").strip()
        label = classes.get(kind, _OBSTACLES.get(kind, Label.OTHER))
        if label is None:
            continue
        length, width, origin = _shape(path, one, name)
        rows = _Rows(label, (length, width, label.default_height))
        for state in [*one.findall("initialState"), *one.findall("trajectory/state")]:
            time = _exact(path, state, "time", name, otherwise=0.0)
            x = _exact(path, state, "position/point/x", name)
            y = _exact(path, state, "position/point/y", name)
            yaw = _exact(path, state, "orientation", name, otherwise=0.0)
            rows.time.append(time)
            rows.state.append((x - origin * np.cos(yaw), y - origin * np.sin(yaw), yaw))
        if len(set(rows.time)) < len(rows.time) or not rows.time:
            raise InputError(
                "two states of one time" if rows.time else "an obstacle without a state",
                file=path,
                object_id=name,
            )
        if one.find("trajectory") is None:
            still.append(name)
        last = max(last, int(max(rows.time)))
        found[f"{name}"] = rows
    if step is None or step <= 0:
        raise InputError("no length of a step", file=path, field="timeStepSize", got=step)
    for name in still:
        found[name].time = [float(k) for k in range(last + 1)]
        found[name].state = found[name].state[:1] * (last + 1)
    for rows in found.values():
        # Numbers of steps are whole, so that a product is the time to the last bit at every rate.
        rows.time = [round(k) * step for k in rows.time]
    return tuple(rows.object(name) for name, rows in found.items())


def _shape(path: Path, one: ElementTree.Element, name: str) -> tuple[float, float, float]:
    """Length and width, and how far ahead of the box's centre the obstacle's position is, m: of a
    truck, unless its shape says otherwise, that of the rear axle."""

    def number(key: str) -> float:
        return _exact(path, one, f"shape/{key}", name)

    shapes = list(one.find("shape") or ())
    kind = shapes[0].tag if len(shapes) == 1 else None
    if kind == "rectangle":
        shift = one.findtext("shape/rectangle/originXShift")
        origin = 0.0 if shift is None else number("rectangle/originXShift")
        return number("rectangle/length"), number("rectangle/width"), origin
    if kind == "circle":
        return 2 * number("circle/radius"), 2 * number("circle/radius"), 0.0
    if kind == "truckShape":
        length = number("truckShape/truckDims/length")
        axle = number("truckShape/truckDims/distFromRearToRearAxle")
        shift = one.findtext("shape/truckShape/originXShift")
        origin = axle - length / 2 if shift is None else number("truckShape/originXShift")
        return length, number("truckShape/truckDims/width"), origin
    raise InputError(
        "a shape that is no box",
        file=path,
        object_id=name,
        field="shape",
        expected="one rectangle, circle or truckShape",
        got=kind or f"{len(shapes)} shapes",
    )


def _exact(
    path: Path,
    one: ElementTree.Element,
    place: str,
    name: str,
    otherwise: float | None = None,
) -> float:
    """A number at a place within an element, by itself or in <exact>."""
    found = one.find(f"{place}/exact")
    text = one.find(place) if found is None else found
    if text is None and otherwise is not None:
        return otherwise
    try:
        value = float((text.text if text is not None else None) or "")
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(
            "no exact number", file=path, object_id=name, field=place, expected="a finite number"
        )
    return value


def _elements(path: Path, *tags: str) -> Iterator[ElementTree.Element]:
    """The elements of these names, each once it is whole, and then forgotten; gzip by the name."""
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            for _, element in ElementTree.iterparse(stream):
                if element.tag in tags:
                    yield element
                    element.clear()
    except (OSError, EOFError, ElementTree.ParseError) as error:
        raise InputError(f"not a readable XML file: {error}", file=path) from None


def _root(path: Path) -> str:
    """The name of the file's first element."""
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            for _, element in ElementTree.iterparse(stream, events=("start",)):
                return element.tag
    except (OSError, EOFError, ElementTree.ParseError) as error:
        raise InputError(f"not a readable XML file: {error}", file=path) from None
    return ""


def _text(path: Path, one: ElementTree.Element, key: str) -> str:
    value = one.get(key)
    if not value:
        raise InputError(
            "an attribute is missing", file=path, object_id=one.get("id"), field=key,
            hint=nearest_hint(key, one.keys(), "attribute"),
        )  # fmt: skip
    return value


def _number(path: Path, one: ElementTree.Element, key: str) -> float:
    try:
        value = float(_text(path, one, key))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        value = np.nan
    if not abs(value) <= 1e8:
        raise InputError(
            "not a number", file=path, object_id=one.get("id"), field=key,
            expected="a finite number", got=one.get(key),
        )  # fmt: skip
    return value
