"""Argoverse 2 sensor logs: annotations, detections and poses in feather files; times in ns."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

from pmbm.datasets.columns import (
    Columns,
    int_list,
    numbers,
    read_columns,
    write_columns,
)
from pmbm.datasets.files import (
    LARGEST_SIZE,
    Place,
    id_value,
    integer_value,
    prepare_folder,
    result_file,
    safe_name,
    text_value,
)
from pmbm.datasets.logs import (
    Box,
    LogFolder,
    Timeline,
    each_name_once,
    log_comparison,
    log_recording,
    log_tracks,
    submission_boxes,
)
from pmbm.datasets.poses import Pose, matrix_yaw, pose, quaternion_matrix, yaw_quaternion
from pmbm.errors import nearest_hint
from pmbm.metrics.benchmarks.argoverse2 import RULES
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.types import Label, Recording, TrackSequence

_LABELS: Final[Mapping[str, Label]] = {
    "REGULAR_VEHICLE": Label.CAR,
    "LARGE_VEHICLE": Label.TRUCK,
    "BOX_TRUCK": Label.TRUCK,
    "TRUCK": Label.TRUCK,
    "TRUCK_CAB": Label.TRUCK,
    "VEHICULAR_TRAILER": Label.TRUCK,
    "BUS": Label.BUS,
    "SCHOOL_BUS": Label.BUS,
    "ARTICULATED_BUS": Label.BUS,
    "RAILED_VEHICLE": Label.BUS,
    "MOTORCYCLE": Label.MOTORCYCLIST,
    "MOTORCYCLIST": Label.MOTORCYCLIST,
    "BICYCLE": Label.CYCLIST,
    "BICYCLIST": Label.CYCLIST,
    "WHEELED_DEVICE": Label.CYCLIST,
    "WHEELED_RIDER": Label.CYCLIST,
    "PEDESTRIAN": Label.PEDESTRIAN,
    "OFFICIAL_SIGNALER": Label.PEDESTRIAN,
    "STROLLER": Label.PEDESTRIAN,
    "WHEELCHAIR": Label.PEDESTRIAN,
    "ANIMAL": Label.OTHER,
    "DOG": Label.OTHER,
    "BOLLARD": Label.OTHER,
    "CONSTRUCTION_BARREL": Label.OTHER,
    "CONSTRUCTION_CONE": Label.OTHER,
    "MESSAGE_BOARD_TRAILER": Label.OTHER,
    "MOBILE_PEDESTRIAN_CROSSING_SIGN": Label.OTHER,
    "SIGN": Label.OTHER,
    "STOP_SIGN": Label.OTHER,
    "TRAFFIC_LIGHT_TRAILER": Label.OTHER,
}
DEFAULT: Final = ("REGULAR_VEHICLE", "PEDESTRIAN", "BICYCLIST", "BUS", "BOX_TRUCK", "MOTORCYCLIST")
"""The commonest class of each label."""
_EGO: Final = "EGO_VEHICLE"
_BOX: Final = ("tx_m", "ty_m", "tz_m")
_SIZE: Final = ("length_m", "width_m", "height_m")
_ROTATION: Final = ("qw", "qx", "qy", "qz")
_COMMON: Final = ("timestamp_ns", "category", *_SIZE, *_ROTATION, *_BOX)
_PER_SECOND: Final = 10**9
_MAX_RANGE: Final = 150.0


@dataclass(frozen=True, kw_only=True)
class Argoverse2(LogFolder):
    """Logs of a split.

    root : holds a folder for each log, with its poses and, for truth, its annotations.
    detections : one feather file with the detections of all logs; None for none.
    classes : any that differ in label.

    World: the city's frame.  Truth without a single lidar point in it is not observable.  A log's
    frames are the sweeps that are annotated or have detections.  Results are feather files of the
    annotations' form with a score, one a log or one for all with a log_id, and a list of all frames
    as a note; where they have none, a sweep without a row is one without tracks.
    """

    name: ClassVar = "argoverse2"
    title: ClassVar = "Argoverse 2"
    class_labels: ClassVar = _LABELS
    rules: ClassVar = RULES

    classes: tuple[str, ...] = DEFAULT

    def sequences(self) -> list[str]:
        """The names of all logs: those with poses."""
        logs = [path.parent.name for path in self.root.glob("*/city_SE3_egovehicle.feather")]
        if not logs:
            raise Place(self.root).error("no logs", expected="LOG/city_SE3_egovehicle.feather")
        return sorted(logs)

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One log in the city's frame; without `truth` no more is read of its annotations than the
        times of its sweeps.

        Raises InputError for missing or bad files, and for a sweep that has no pose of exactly its
        time.
        """
        labelled = self._truth(sequence) if truth or self.detections is None else {}
        detected = {} if self.detections is None else self._detected(sequence)
        timeline = self._timeline(sequence, self._sweeps(sequence, detected))
        return log_recording(
            name=f"argoverse2-{sequence}",
            timeline=timeline,
            truth=_frames(labelled, timeline) if truth else None,
            detections=None if self.detections is None else _frames(detected, timeline),
            labels=_LABELS,
            classes=self.classes,
            max_range=_MAX_RANGE,
            provenance={"dataset": "argoverse2", "sequence": sequence},
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/LOG.feather and give its path."""
        detected = {} if self.detections is None else self._detected(sequence)
        timeline = self._timeline(sequence, self._sweeps(sequence, detected))
        frames = submission_boxes(timeline, tracks, _LABELS, self.classes)
        rows = [
            (stamp, box)
            for stamp, boxes in zip(timeline.stamps, frames, strict=True)
            for box in boxes
        ]
        columns: dict[str, list[Any]] = {
            "timestamp_ns": [stamp for stamp, _ in rows],
            "track_uuid": [box.name for _, box in rows],
            "category": [box.kind for _, box in rows],
            "score": [box.score for _, box in rows],
        }
        for names, values in (
            (_SIZE, [box.size for _, box in rows]),
            (_BOX, [box.place for _, box in rows]),
            (_ROTATION, [yaw_quaternion(box.yaw) for _, box in rows]),
        ):
            for place, name in enumerate(names):
                columns[name] = [value[place] for value in values]
        path = prepare_folder(Path(out)) / f"{sequence}.feather"
        write_columns(path, columns, {"frames": list(timeline.stamps)})
        return path

    def submit(self, sequences: Sequence[str], folder: Path) -> Path:
        """Join these logs' results into `folder`/submission.feather: the rows of the dataset's
        own detection files (log_id, boxes in the vehicle's frame, score) with a track_uuid.

        The official script scores Python objects, which would be run to be read: none is written.
        Raises InputError where a log has no result, or a bad one."""
        names = ("log_id", "track_uuid", "score", *_COMMON)
        joined: dict[str, list[Any]] = {name: [] for name in names}
        frames = {}
        for sequence in sequences:
            stamps, _ = self._results(sequence, folder)
            frames[sequence] = list(stamps)
            table = self._result_table(sequence, folder)
            own = _rows_of(table, sequence)
            for name in names[1:]:
                joined[name] += [table.values[name][row] for row in own]
            joined["log_id"] += [sequence] * len(own)
        path = Path(folder) / "submission.feather"
        write_columns(path, joined, {"frames": frames})
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/LOG.feather (or of a file for all logs, in `folder` or in its
        place) in the city's frame, a report for every frame that they are of."""
        stamps, results = self._results(sequence, folder)
        timeline = self._timeline(sequence, stamps)
        return log_tracks(timeline, _frames(results, timeline), _LABELS)

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Annotations and results of one class in the vehicle's frame.

        Raises InputError unless the list of the results' frames, or without a list what rows there
        are, fits the annotated sweeps."""
        labelled = self._truth(sequence)
        stamps, results = self._results(sequence, folder)
        place = Place(self._result_path(sequence, folder))
        for stamp in sorted(set(stamps) ^ set(labelled)):
            known = "annotated but not in the results" if stamp in labelled else "not annotated"
            raise place.error(f"a frame is {known}", frame=stamp, field="timestamp_ns")
        timeline = self._timeline(sequence, sorted(labelled))
        truth, tracks = _frames(labelled, timeline), _frames(results, timeline)
        return log_comparison(timeline, truth, tracks, kind, _LABELS)

    def _folder(self, sequence: str) -> Path:
        return self.root / safe_name(sequence, Place(self.root), "sequences")

    def _annotations(self, sequence: str) -> Path:
        path = self._folder(sequence) / "annotations.feather"
        with_ego = path.with_name("annotations_with_ego.feather")
        return with_ego if not path.exists() and with_ego.exists() else path

    def _truth(self, sequence: str) -> dict[int, list[Box]]:
        table = read_columns(
            self._annotations(sequence),
            (*_COMMON, "track_uuid"),
            parquet=False,
            optional=("num_interior_pts",),
        )
        return _read_boxes(table, range(table.length), named=True)

    def _sweeps(self, sequence: str, detected: Iterable[int]) -> list[int]:
        """The stamps of the log's frames, by time: a sweep without a detection has no row in the
        table of detections, so what else tells of it is asked."""
        path = self._annotations(sequence)
        annotated: set[int] = set()
        if path.exists() or self.detections is None:
            table = read_columns(path, ("timestamp_ns",), parquet=False)
            annotated = {
                integer_value(stamp, Place(path, rows=(row,)), "timestamp_ns")
                for row, stamp in enumerate(table.values["timestamp_ns"])
            }
        return sorted(annotated.union(detected))

    def _detected(self, sequence: str) -> dict[int, list[Box]]:
        path = Path(str(self.detections))
        table = read_columns(path, (*_COMMON, "score", "log_id"), parquet=False)
        return _read_boxes(table, _rows_of(table, sequence), named=False)

    def _result_path(self, sequence: str, folder: Path) -> Path:
        name = safe_name(sequence, Place(Path(folder)), "sequences")
        return result_file(Path(folder), f"{name}.feather", self.sequences)

    def _result_table(self, sequence: str, folder: Path) -> Columns:
        path = self._result_path(sequence, folder)
        needed = (*_COMMON, "score", "track_uuid")
        return read_columns(path, needed, parquet=False, optional=("log_id",))

    def _results(self, sequence: str, folder: Path) -> tuple[tuple[int, ...], dict[int, list[Box]]]:
        """The stamps of the frames that the results are of, and the boxes by stamp."""
        table = self._result_table(sequence, folder)
        listed = table.note.get("frames")
        if isinstance(listed, dict):
            listed = listed.get(sequence)
        stamps = int_list(listed)
        rows = _rows_of(table, sequence, listed=stamps is not None)
        found = _read_boxes(table, rows, named=True)
        if stamps is None:
            detected = () if self.detections is None else self._detected(sequence)
            return tuple(sorted({*self._sweeps(sequence, detected), *found})), found
        if list(stamps) != sorted({*stamps, *found}):
            raise Place(table.file).error(
                "the list of frames is not that of the rows", field="frames"
            )
        return stamps, found

    def _timeline(self, sequence: str, stamps: Sequence[int]) -> Timeline:
        path = self._folder(sequence) / "city_SE3_egovehicle.feather"
        table = read_columns(path, ("timestamp_ns", *_ROTATION, *_BOX), parquet=False)
        wanted = set(stamps)
        poses: dict[int, Pose] = {}
        for row, values in table.rows():
            place = Place(path, rows=(row,))
            stamp = integer_value(values["timestamp_ns"], place, "timestamp_ns")
            if stamp not in wanted:
                continue
            place = Place(path, frame=stamp, rows=(row,))
            if stamp in poses:
                raise place.error("two poses of one time", field="timestamp_ns")
            rotation = quaternion_matrix(numbers(values, _ROTATION, place), place)
            poses[stamp] = pose(rotation, numbers(values, _BOX, place), place)
        for stamp in stamps:
            if stamp not in poses:
                raise Place(path, frame=stamp).error("a sweep without a pose", field="timestamp_ns")
        return Timeline(tuple(stamps), _PER_SECOND, tuple(poses[stamp] for stamp in stamps))


def _frames(found: Mapping[int, list[Box]], timeline: Timeline) -> list[list[Box]]:
    return [found.get(stamp, []) for stamp in timeline.stamps]


def _rows_of(table: Columns, log: str, *, listed: bool = False) -> list[int]:
    """The rows of one log; all of a table that does not name logs.  Raises InputError where there
    are none, unless the log is `listed`."""
    if "log_id" not in table.values:
        return list(range(table.length))
    names = [
        text_value(name, Place(table.file, rows=(row,)), "log_id")
        for row, name in enumerate(table.values["log_id"])
    ]
    if log not in names and not listed:
        known = sorted(set(names))
        raise Place(table.file).error(
            f"no boxes of log {log}",
            field="log_id",
            hint=nearest_hint(log, known, "log") if len(known) < 50 else None,
        )
    return [row for row, name in enumerate(names) if name == log]


def _read_boxes(table: Columns, rows: Iterable[int], *, named: bool) -> dict[int, list[Box]]:
    """Stamp -> boxes of these rows, by time."""
    found: dict[int, list[Box]] = {}
    for row in rows:
        values = {name: column[row] for name, column in table.values.items()}
        place = Place(table.file, rows=(row,))
        stamp = integer_value(values["timestamp_ns"], place, "timestamp_ns")
        place = Place(table.file, frame=stamp, rows=(row,))
        kind = text_value(values["category"], place, "category")
        boxes = found.setdefault(stamp, [])
        if kind == _EGO:
            continue
        name = id_value(values["track_uuid"], place, "track_uuid") if named else ""
        boxes.append(_read_box(values, kind, name, Place(table.file, stamp, name or None, (row,))))
    if named:
        for stamp, boxes in found.items():
            each_name_once(boxes, Place(table.file, frame=stamp), "track_uuid")
    return dict(sorted(found.items()))


def _read_box(values: Mapping[str, Any], kind: str, name: str, place: Place) -> Box:
    if kind not in _LABELS:
        raise place.error(
            "an unknown class", field="category", got=kind, hint=nearest_hint(kind, _LABELS)
        )
    x, y, z = numbers(values, _BOX, place)
    length, width, height = numbers(values, _SIZE, place, above=0.0, within=LARGEST_SIZE)
    rotation = quaternion_matrix(numbers(values, _ROTATION, place), place)
    score = place.finite(values.get("score", 1.0), "score", within=1.0)
    if score < 0:
        raise place.error("a number out of range", field="score", expected="[0, 1]", got=score)
    points = values.get("num_interior_pts", 1)
    return Box(
        kind,
        name,
        (x, y, z),
        (length, width, height),
        matrix_yaw(rotation),
        score=score,
        observable=integer_value(points, place, "num_interior_pts") > 0,
    )
