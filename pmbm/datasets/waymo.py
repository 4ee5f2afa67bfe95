"""Waymo Open: truth from v2 parquet files or a metrics.Objects file, detections and results as
metrics.Objects; times in microseconds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pmbm.datasets.columns import integer, numbers, read_columns, text
from pmbm.datasets.files import (
    LARGEST_SIZE,
    Place,
    prepare_folder,
    read_bytes,
    replace_bytes,
    safe_name,
)
from pmbm.datasets.frames import Comparison
from pmbm.datasets.logs import (
    Box,
    Timeline,
    checked_classes,
    each_name_once,
    log_comparison,
    log_recording,
    log_tracks,
    submission_boxes,
)
from pmbm.datasets.poses import STANDING, Pose, pose
from pmbm.datasets.wire import WireError, decode, encode, message, numbered, repeated
from pmbm.errors import InputError, nearest_hint
from pmbm.types import Label, Recording, TrackSequence

_LABELS: Final[Mapping[str, Label]] = {
    "VEHICLE": Label.CAR,
    "PEDESTRIAN": Label.PEDESTRIAN,
    "SIGN": Label.OTHER,
    "CYCLIST": Label.CYCLIST,
}
SCORED: Final = ("VEHICLE", "PEDESTRIAN", "CYCLIST")
_TYPES: Final = {1: "VEHICLE", 2: "PEDESTRIAN", 3: "SIGN", 4: "CYCLIST"}
_NUMBERS: Final = {name: number for number, name in _TYPES.items()}
_PER_SECOND: Final = 10**6
_MAX_RANGE: Final = 80.0
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
SUBMISSION: Final = numbered(
    task=(1, "int"),
    unique_method_name=(2, "string"),
    authors=(3, repeated("authors", "string")),
    affiliation=(4, "string"),
    description=(5, "string"),
    method_link=(6, "string"),
    inference_results=(11, message("inference_results", OBJECTS)),
    sensor_type=(12, "int"),
    account_name=(13, "string"),
    object_types=(14, repeated("object_types", "int")),
)
_TRACKING_3D: Final = 4
_LIDAR_ALL: Final = 1

_V2: Final = "[LiDARBoxComponent]."
_V2_PLACE: Final = tuple(f"{_V2}box.center.{axis}" for axis in "xyz")
_V2_SIZE: Final = tuple(f"{_V2}box.size.{axis}" for axis in "xyz")
_V2_HEADING: Final = f"{_V2}box.heading"
_V2_TYPE: Final = f"{_V2}type"
_V2_LEVEL: Final = f"{_V2}difficulty_level.tracking"
_V2_POSE: Final = "[VehiclePoseComponent].world_from_vehicle.transform"
_CONTEXT: Final = "key.segment_context_name"
_STAMP: Final = "key.frame_timestamp_micros"
_OBJECT_ID: Final = "key.laser_object_id"

Found = dict[int, list[Box]]


@dataclass(frozen=True, kw_only=True)
class Waymo:
    """Segments of a split.

    root : a folder with `vehicle_pose` and, for truth, `lidar_box`, a parquet file a segment in
        each; or a metrics.Objects file with the truth of all segments, which has no poses, so that
        the vehicle's own frame stands for the world.
    detections : a metrics.Objects file with the detections of all segments; None for none.
    classes : of VEHICLE, PEDESTRIAN, CYCLIST, SIGN.

    Results are metrics.Objects files, one a segment; `submit` joins them.
    """

    root: Path
    detections: str | None = None
    classes: tuple[str, ...] = SCORED

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", Path(self.root))
        object.__setattr__(self, "classes", checked_classes(self.classes, _LABELS, "Waymo"))

    @property
    def labels(self) -> tuple[int, ...]:
        """The labels of the classes asked for, in their order."""
        return tuple(_LABELS[name] for name in self.classes)

    def sequences(self) -> list[str]:
        """The names of all segments."""
        if self.root.is_file():
            return sorted(_read_objects(self.root))
        names = sorted(path.stem for path in (self.root / "vehicle_pose").glob("*.parquet"))
        if not names:
            raise Place(self.root / "vehicle_pose").error("no segments", expected="*.parquet")
        return names

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One segment in the world; without `truth` its labels are not read.

        Its frames are those with a pose; of a metrics.Objects truth, those with a box.  Raises
        InputError for missing or bad files and for boxes of frames that the segment does not have.
        """
        detected = None if self.detections is None else self._detected(sequence)
        labelled = self._truth(sequence) if truth else None
        timeline = self._timeline(sequence, labelled, detected)
        return log_recording(
            name=f"waymo-{sequence}",
            timeline=timeline,
            truth=None if labelled is None else _frames(labelled, timeline, self.root),
            detections=(
                None
                if detected is None
                else _frames(detected, timeline, Path(str(self.detections)))
            ),
            labels=_LABELS,
            classes=self.classes,
            max_range=_MAX_RANGE,
            provenance={
                "dataset": "waymo",
                "sequence": sequence,
                "ego_motion": not self.root.is_file(),
            },
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/SEGMENT.bin, a metrics.Objects message, and give its path."""
        timeline = self._known_timeline(sequence)
        frames = submission_boxes(timeline, tracks, _LABELS, self.classes)
        objects = [
            _object(box, sequence, stamp)
            for stamp, boxes in zip(timeline.stamps, frames, strict=True)
            for box in boxes
        ]
        name = safe_name(sequence, Place(self.root), "sequences")
        path = prepare_folder(Path(out)) / f"{name}.bin"
        replace_bytes(path, encode({"objects": objects}, OBJECTS))
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/SEGMENT.bin in the world, one report for every frame."""
        timeline = self._known_timeline(sequence)
        path = self._result_path(sequence, folder)
        return log_tracks(timeline, _frames(self._results(path, sequence), timeline, path), _LABELS)

    def compared(self, sequence: str, kind: str, folder: Path) -> Comparison:
        """Labels and results of one class in the vehicle's frame."""
        labelled = self._truth(sequence)
        path = self._result_path(sequence, folder)
        results = self._results(path, sequence)
        timeline = self._timeline(sequence, labelled, results if self.root.is_file() else None)
        return log_comparison(
            timeline,
            _frames(labelled, timeline, self.root),
            _frames(results, timeline, path),
            kind,
            _LABELS,
        )

    def submit(self, sequences: Sequence[str], out: Path, *, method: str, account: str) -> Path:
        """Join the results of these segments into `out`/submission.bin, a Submission message.

        method : at most 25 characters.  Raises InputError where a segment has no result.
        """
        if not 0 < len(method) <= 25:
            raise InputError("Waymo: a method's name", expected="1 to 25 characters", got=method)
        objects: list[Any] = []
        for sequence in sequences:
            path = self._result_path(sequence, out)
            objects += _decoded(path).get("objects", [])
        submission = {
            "task": _TRACKING_3D,
            "unique_method_name": method,
            "inference_results": {"objects": objects},
            "sensor_type": _LIDAR_ALL,
            "account_name": account,
            "object_types": [_NUMBERS[name] for name in self.classes],
        }
        path = Path(out) / "submission.bin"
        replace_bytes(path, encode(submission, SUBMISSION))
        return path

    def _truth(self, sequence: str) -> Found:
        if self.root.is_file():
            return _segment(_read_objects(self.root, named=True), sequence, self.root)
        return _read_v2_boxes(self._v2("lidar_box", sequence), sequence)

    def _detected(self, sequence: str) -> Found:
        path = Path(str(self.detections))
        return _segment(_read_objects(path), sequence, path)

    def _result_path(self, sequence: str, folder: Path) -> Path:
        return Path(folder) / f"{safe_name(sequence, Place(Path(folder)), 'sequences')}.bin"

    def _results(self, path: Path, sequence: str) -> Found:
        """A segment without any track is an empty file, which is a right message."""
        found = _read_objects(path, named=True)
        for other in found:
            if other != sequence:
                raise Place(path).error(
                    "results of another segment", field="context_name", expected=sequence, got=other
                )
        return found.get(sequence, {})

    def _v2(self, component: str, sequence: str) -> Path:
        name = safe_name(sequence, Place(self.root), "sequences")
        return self.root / component / f"{name}.parquet"

    def _known_timeline(self, sequence: str) -> Timeline:
        if not self.root.is_file():
            return self._timeline(sequence, None, None)
        detected = None if self.detections is None else self._detected(sequence)
        return self._timeline(sequence, self._truth(sequence), detected)

    def _timeline(self, sequence: str, labelled: Found | None, detected: Found | None) -> Timeline:
        if self.root.is_file():
            stamps = sorted({*(labelled or {}), *(detected or {})})
            return Timeline(tuple(stamps), _PER_SECOND, (STANDING,) * len(stamps))
        poses = _read_v2_poses(self._v2("vehicle_pose", sequence), sequence)
        return Timeline(tuple(poses), _PER_SECOND, tuple(poses.values()))


def _frames(found: Found, timeline: Timeline, file: Path) -> list[list[Box]]:
    for stamp in found:
        if stamp not in set(timeline.stamps):
            raise Place(file, frame=stamp).error("a frame without a pose")
    return [found.get(stamp, []) for stamp in timeline.stamps]


def _segment(segments: Mapping[str, Found], sequence: str, path: Path) -> Found:
    if sequence not in segments:
        raise Place(path).error(
            f"no boxes of segment {sequence}",
            field="context_name",
            hint=nearest_hint(sequence, segments, "segment") if len(segments) < 50 else None,
        )
    return segments[sequence]


def _decoded(path: Path) -> dict[str, Any]:
    try:
        return decode(read_bytes(path), OBJECTS)
    except WireError as error:
        raise InputError(
            f"not a metrics.Objects message: {error}", file=path, field=error.path
        ) from None


def _read_objects(path: Path, *, named: bool = False) -> dict[str, Found]:
    """Segment -> stamp -> boxes, by time."""
    segments: dict[str, Found] = {}
    for row, item in enumerate(_decoded(path).get("objects", [])):
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
    )


def _kind(number: int, place: Place, field: str) -> str:
    if number not in _TYPES:
        raise place.error("an unknown type", field=field, expected=sorted(_TYPES), got=number)
    return _TYPES[number]


def _score(value: float, place: Place) -> float:
    if not 0.0 <= value <= 1.0:
        raise place.error("a number out of range", field="score", expected="[0, 1]", got=value)
    return value


def _read_v2_boxes(path: Path, sequence: str) -> Found:
    table = read_columns(
        path,
        (_CONTEXT, _STAMP, _OBJECT_ID, *_V2_PLACE, *_V2_SIZE, _V2_HEADING, _V2_TYPE),
        optional=(_V2_LEVEL,),
        parquet=True,
    )
    found: Found = {}
    for stamp, row, values in _rows_of(table.rows(), path, sequence):
        name = text(values[_OBJECT_ID], Place(path, stamp, rows=(row,)), _OBJECT_ID)
        place = Place(path, stamp, name, (row,))
        x, y, z = numbers(values, _V2_PLACE, place)
        length, width, height = numbers(values, _V2_SIZE, place, above=0.0, within=LARGEST_SIZE)
        (heading,) = numbers(values, (_V2_HEADING,), place, within=_LARGEST_ANGLE)
        box = Box(
            kind=_kind(integer(values[_V2_TYPE], place, _V2_TYPE), place, _V2_TYPE),
            name=name,
            place=(x, y, z),
            size=(length, width, height),
            yaw=heading,
            hard=values.get(_V2_LEVEL) == _LEVEL_2,
        )
        found.setdefault(stamp, []).append(box)
    for stamp, boxes in found.items():
        each_name_once(boxes, Place(path, frame=stamp), _OBJECT_ID)
    return dict(sorted(found.items()))


def _read_v2_poses(path: Path, sequence: str) -> dict[int, Pose]:
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
        context = text(values[_CONTEXT], place, _CONTEXT)
        if context != sequence:
            raise place.error(
                "a row of another segment", field=_CONTEXT, expected=sequence, got=context
            )
        yield integer(values[_STAMP], place, _STAMP), row, values


def _object(box: Box, sequence: str, stamp: int) -> dict[str, Any]:
    centre = {f"center_{axis}": value for axis, value in zip("xyz", box.place, strict=True)}
    sides = dict(zip(("length", "width", "height"), box.size, strict=True))
    return {
        "object": {
            "box": {**centre, **sides, "heading": box.yaw},
            "type": _NUMBERS[box.kind],
            "id": box.name,
        },
        "score": box.score,
        "context_name": sequence,
        "frame_timestamp_micros": stamp,
    }
