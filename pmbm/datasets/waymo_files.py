"""Waymo Open's files: metrics.Objects messages and v2 parquet tables, as boxes by time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pmbm.datasets.columns import numbers, read_columns
from pmbm.datasets.files import (
    LARGEST_SIZE,
    Place,
    id_value,
    integer_value,
    read_bytes,
    text_value,
)
from pmbm.datasets.logs import Box, each_name_once
from pmbm.datasets.poses import Pose, pose
from pmbm.datasets.wire import WireError, decode, message, numbered, repeated
from pmbm.errors import InputError

TYPES: Final = {1: "VEHICLE", 2: "PEDESTRIAN", 3: "SIGN", 4: "CYCLIST"}
_LARGEST_ANGLE: Final = 100.0
_LEVEL_2: Final = 2

_BOX: Final = numbered(
    center_x=(1, "double"),
    center_y=(2, "double"),
    center_z=(3, "double"),
    width=(4, "double"),
    length=(5, "double"),
    height=(6, "double"),
    heading=(7, "double"),
)
_LABEL: Final = numbered(
    box=(1, message("box", _BOX)),
    type=(3, "int"),
    id=(4, "string"),
    tracking_difficulty_level=(6, "int"),
)
_OBJECT: Final = numbered(
    object=(1, message("object", _LABEL)),
    score=(2, "float"),
    overlap_with_nlz=(3, "bool"),
    context_name=(4, "string"),
    frame_timestamp_micros=(5, "int"),
)
OBJECTS: Final = numbered(objects=(1, message("objects", _OBJECT, repeated=True)))
"""metrics.Objects, without its no-label zones."""
_INFERENCE_RESULTS: Final = (11, message("inference_results", OBJECTS))
SUBMISSION: Final = numbered(
    task=(1, "int"),
    unique_method_name=(2, "string"),
    authors=(3, repeated("authors", "string")),
    affiliation=(4, "string"),
    description=(5, "string"),
    method_link=(6, "string"),
    inference_results=_INFERENCE_RESULTS,
    sensor_type=(12, "int"),
    account_name=(13, "string"),
    object_types=(14, repeated("object_types", "int")),
)

_V2: Final = "[LiDARBoxComponent]."
_V2_PLACE: Final = tuple(f"{_V2}box.center.{axis}" for axis in "xyz")
_V2_SIZE: Final = tuple(f"{_V2}box.size.{axis}" for axis in "xyz")
_V2_HEADING: Final = f"{_V2}box.heading"
_V2_TYPE: Final = f"{_V2}type"
_V2_POINTS: Final = f"{_V2}num_lidar_points_in_box"
_V2_LEVEL: Final = f"{_V2}difficulty_level.tracking"
_V2_POSE: Final = "[VehiclePoseComponent].world_from_vehicle.transform"
_CONTEXT: Final = "key.segment_context_name"
_STAMP: Final = "key.frame_timestamp_micros"
_OBJECT_ID: Final = "key.laser_object_id"

Found = dict[int, list[Box]]
"""The boxes of a segment by time stamp."""


def decoded(path: Path) -> dict[str, Any]:
    """The metrics.Objects message of a file, or that inside a Submission message; InputError where
    it is neither."""
    content = read_bytes(path)
    try:
        # metrics.Objects has no field of that number.
        submission = decode(content, numbered(inference_results=_INFERENCE_RESULTS))
        inside = submission.get("inference_results")
        return decode(content, OBJECTS) if inside is None else inside
    except WireError as error:
        raise InputError(
            f"not a metrics.Objects message: {error}", file=path, field=error.path
        ) from None


def read_objects(path: Path, *, named: bool = False) -> dict[str, Found]:
    """A metrics.Objects file: segment -> stamp -> boxes, by time.  Ids are read where `named`.

    Raises InputError for anything but finite boxes of known types, each id once in a frame.
    """
    segments: dict[str, Found] = {}
    for row, item in enumerate(decoded(path).get("objects", [])):
        place = Place(path, rows=(row,))
        for field in ("context_name", "frame_timestamp_micros", "object"):
            if field not in item:
                raise place.error("a field is missing", field=field)
        stamp, label = item["frame_timestamp_micros"], item["object"]
        name = label.get("id", "") if named else ""
        place = Place(path, stamp, name or None, (row,))
        if named and not name:
            raise place.error("a field is missing", field="object.id")
        frames = segments.setdefault(item["context_name"], {})
        frames.setdefault(stamp, []).append(_read_box(item, label, name, place))
    if named:
        for frames in segments.values():
            for stamp, boxes in frames.items():
                each_name_once(boxes, Place(path, frame=stamp), "object.id")
    return {name: dict(sorted(frames.items())) for name, frames in sorted(segments.items())}


def _read_box(item: Mapping[str, Any], label: Mapping[str, Any], name: str, place: Place) -> Box:
    box = label.get("box", {})
    for field in (f.name for f in _BOX.values()):
        if field not in box:
            raise place.error("a field is missing", field=f"object.box.{field}")
    x, y, z = (place.finite(box[f"center_{axis}"], f"box.center_{axis}") for axis in "xyz")
    length, width, height = (
        place.finite(box[side], f"box.{side}", above=0.0, within=LARGEST_SIZE)
        for side in ("length", "width", "height")
    )
    return Box(
        kind=_kind(label.get("type", 0), place, "object.type"),
        name=name,
        place=(x, y, z),
        size=(length, width, height),
        yaw=place.finite(box["heading"], "box.heading", within=_LARGEST_ANGLE),
        score=_score(item.get("score", 1.0), place),
        hard=label.get("tracking_difficulty_level", 0) == _LEVEL_2,
        # Nothing is labelled in a no-label zone, so nothing there can be told to be false.
        excused=bool(item.get("overlap_with_nlz", False)),
    )


def _kind(number: int, place: Place, field: str) -> str:
    if number not in TYPES:
        raise place.error("an unknown type", field=field, expected=sorted(TYPES), got=number)
    return TYPES[number]


def _score(value: float, place: Place) -> float:
    if not 0.0 <= value <= 1.0:
        raise place.error("a number out of range", field="score", expected="[0, 1]", got=value)
    return value


def read_v2_boxes(path: Path, sequence: str) -> Found:
    """A `lidar_box` table of one segment, in which boxes without a lidar point are not observable;
    errors as in `read_objects`."""
    table = read_columns(
        path,
        (_CONTEXT, _STAMP, _OBJECT_ID, *_V2_PLACE, *_V2_SIZE, _V2_HEADING, _V2_TYPE),
        optional=(_V2_LEVEL, _V2_POINTS),
        parquet=True,
    )
    found: Found = {}
    for stamp, row, values in _rows_of(table.rows(), path, sequence):
        name = id_value(values[_OBJECT_ID], Place(path, stamp, rows=(row,)), _OBJECT_ID)
        place = Place(path, stamp, name, (row,))
        x, y, z = numbers(values, _V2_PLACE, place)
        length, width, height = numbers(values, _V2_SIZE, place, above=0.0, within=LARGEST_SIZE)
        (heading,) = numbers(values, (_V2_HEADING,), place, within=_LARGEST_ANGLE)
        box = Box(
            kind=_kind(integer_value(values[_V2_TYPE], place, _V2_TYPE), place, _V2_TYPE),
            name=name,
            place=(x, y, z),
            size=(length, width, height),
            yaw=heading,
            observable=integer_value(values.get(_V2_POINTS, 1), place, _V2_POINTS) > 0,
            hard=values.get(_V2_LEVEL) == _LEVEL_2,
        )
        found.setdefault(stamp, []).append(box)
    for stamp, boxes in found.items():
        each_name_once(boxes, Place(path, frame=stamp), _OBJECT_ID)
    return dict(sorted(found.items()))


def read_v2_poses(path: Path, sequence: str) -> dict[int, Pose]:
    """A `vehicle_pose` table of one segment: the vehicle in the world by time stamp."""
    table = read_columns(path, (_CONTEXT, _STAMP, _V2_POSE), parquet=True)
    poses: dict[int, Pose] = {}
    for stamp, row, values in _rows_of(table.rows(), path, sequence):
        place = Place(path, frame=stamp, rows=(row,))
        items = values[_V2_POSE]
        if not isinstance(items, list) or len(items) != 16:
            raise place.error("a transform of the wrong size", field=_V2_POSE, expected=16)
        matrix = [place.finite(item, _V2_POSE) for item in items]
        if matrix[12:] != [0.0, 0.0, 0.0, 1.0]:
            raise place.error("not a rigid motion", field=_V2_POSE, got=matrix[12:])
        if stamp in poses:
            raise place.error("two poses of one time", field=_STAMP)
        rows = [matrix[0:4], matrix[4:8], matrix[8:12]]
        poses[stamp] = pose([row[:3] for row in rows], [row[3] for row in rows], place)
    if not poses:
        raise Place(path).error("no poses")
    return dict(sorted(poses.items()))


def _rows_of(
    rows: Iterator[tuple[int, dict[str, Any]]], path: Path, sequence: str
) -> Iterator[tuple[int, int, dict[str, Any]]]:
    """Stamp, row number and row; InputError for rows of another segment."""
    for row, values in rows:
        place = Place(path, rows=(row,))
        context = text_value(values[_CONTEXT], place, _CONTEXT)
        if context != sequence:
            raise place.error(
                "a row of another segment", field=_CONTEXT, expected=sequence, got=context
            )
        yield integer_value(values[_STAMP], place, _STAMP), row, values
