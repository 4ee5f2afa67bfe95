"""Argoverse 1 tracking: labels, detections and results of one JSON file a sweep; times in ns."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

from pmbm.datasets.files import (
    LARGEST_SIZE,
    Place,
    files_in,
    id_value,
    integer_value,
    json_key,
    json_list,
    json_object,
    json_vector,
    prepare_folder,
    read_json,
    safe_name,
    text_value,
    write_zip,
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
from pmbm.durable import replace_text
from pmbm.errors import nearest_hint
from pmbm.metrics.benchmarks.argoverse1 import RULES
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.types import Label, Recording, TrackSequence

_LABELS: Final[Mapping[str, Label]] = {
    "VEHICLE": Label.CAR,
    "PEDESTRIAN": Label.PEDESTRIAN,
    "ON_ROAD_OBSTACLE": Label.OTHER,
    "LARGE_VEHICLE": Label.TRUCK,
    "BICYCLE": Label.CYCLIST,
    "BICYCLIST": Label.CYCLIST,
    "BUS": Label.BUS,
    "OTHER_MOVER": Label.OTHER,
    "TRAILER": Label.TRUCK,
    "MOTORCYCLIST": Label.MOTORCYCLIST,
    "MOPED": Label.MOTORCYCLIST,
    "MOTORCYCLE": Label.MOTORCYCLIST,
    "STROLLER": Label.PEDESTRIAN,
    "EMERGENCY_VEHICLE": Label.TRUCK,
    "ANIMAL": Label.OTHER,
    "WHEELCHAIR": Label.PEDESTRIAN,
    "SCHOOL_BUS": Label.BUS,
}
SCORED: Final = ("VEHICLE", "PEDESTRIAN")
_SWEEPS: Final = "per_sweep_annotations_amodal"
_NAME: Final = re.compile(r"tracked_object_labels_([0-9]{1,18})\.json")
_PER_SECOND: Final = 10**9
_MAX_RANGE: Final = 100.0


@dataclass(frozen=True, kw_only=True)
class Argoverse1(LogFolder):
    """Logs of a split.

    root : holds a folder for each log, with labels and poses.
    detections : a folder of the same form, with a detection file for each sweep; None for none.
    classes : any that differ in label; the benchmark scores VEHICLE and PEDESTRIAN.

    World: the city's frame.  A sweep's time is that of its file's name.
    """

    name: ClassVar = "argoverse1"
    title: ClassVar = "Argoverse 1"
    class_labels: ClassVar = _LABELS
    rules: ClassVar = RULES

    classes: tuple[str, ...] = SCORED

    def sequences(self) -> list[str]:
        """The names of all logs."""
        logs = [path.name for path in self.root.glob("*") if (path / "poses").is_dir()]
        if not logs:
            raise Place(self.root).error("no logs", expected="folders with poses")
        return sorted(logs)

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One log in the city's frame; without `truth` its labels are not read.

        Raises InputError for missing or bad files, for a sweep without a pose, and where labels and
        detections are not of the same sweeps.
        """
        labelled = self._files(self.root, sequence) if truth or self.detections is None else None
        detected = None
        if self.detections is not None:
            detected = self._files(Path(self.detections), sequence)
        sweeps = labelled if labelled is not None else detected
        assert sweeps is not None
        if labelled is not None and detected is not None:
            _same_sweeps(labelled, detected)
        timeline = self._timeline(sequence, sweeps)
        return log_recording(
            name=f"argoverse1-{sequence}",
            timeline=timeline,
            truth=_read_all(labelled, named=True) if labelled is not None and truth else None,
            detections=None if detected is None else _read_all(detected, named=False),
            labels=_LABELS,
            classes=self.classes,
            max_range=_MAX_RANGE,
            provenance={"dataset": "argoverse1", "sequence": sequence},
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/LOG with a file for every sweep, empty ones too, and give its path."""
        timeline = self._known_timeline(sequence)
        frames = submission_boxes(timeline, tracks, _LABELS, self.classes)
        folder = prepare_folder(Path(out) / sequence / _SWEEPS)
        for stamp, boxes in zip(timeline.stamps, frames, strict=True):
            rows = [_row(box, stamp) for box in boxes]
            text = json.dumps(rows, indent=1, allow_nan=False)
            replace_text(folder / f"tracked_object_labels_{stamp}.json", text)
        return folder.parent

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/LOG in the city's frame, one report for every sweep.

        Raises InputError for missing sweeps."""
        timeline = self._known_timeline(sequence)
        return log_tracks(timeline, self._results(sequence, timeline, folder), _LABELS)

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Labels and results of one class in the vehicle's frame.  A sweep without a result file is
        refused: left out, as the official script leaves it out, its truth would not count."""
        labelled = self._files(self.root, sequence)
        timeline = self._timeline(sequence, labelled)
        truth = _read_all(labelled, named=True)
        results = self._results(sequence, timeline, folder)
        return log_comparison(timeline, truth, results, kind, _LABELS)

    def submit(self, sequences: Sequence[str], folder: Path) -> Path:
        """Pack the results of these logs into `folder`/submission.zip, a folder a log.

        Raises InputError where a log lacks a result of a sweep, or has a bad one."""
        members = {}
        for sequence in sequences:
            self._results(sequence, self._known_timeline(sequence), folder)
            for path in self._files(Path(folder), sequence).values():
                members[f"{sequence}/{_SWEEPS}/{path.name}"] = path
        archive = Path(folder) / "submission.zip"
        write_zip(archive, members)
        return archive

    def _results(self, sequence: str, timeline: Timeline, folder: Path) -> list[list[Box]]:
        files = self._files(Path(folder), sequence)
        _same_sweeps(dict.fromkeys(timeline.stamps, self.root / sequence), files)
        return _read_all(files, named=True)

    def _known_timeline(self, sequence: str) -> Timeline:
        source = self.root if self.detections is None else Path(self.detections)
        return self._timeline(sequence, self._files(source, sequence))

    def _files(self, root: Path, sequence: str) -> dict[int, Path]:
        """Stamp -> file, in order of time."""
        folder = root / safe_name(sequence, Place(root), "sequences") / _SWEEPS
        found = {}
        for path in files_in(folder, "*.json"):
            match = _NAME.fullmatch(path.name)
            if match is None:
                raise Place(path).error(
                    "a file of another name", expected="tracked_object_labels_<ns>.json"
                )
            if int(match[1]) in found:
                raise Place(path).error("two files of one time", frame=int(match[1]))
            found[int(match[1])] = path
        if not found:
            logs = [path.name for path in root.glob("*")] if root.is_dir() else []
            raise Place(folder).error(
                "no sweeps",
                expected="tracked_object_labels_<ns>.json",
                hint=nearest_hint(sequence, logs, "log") if len(logs) < 50 else None,
            )
        return dict(sorted(found.items()))

    def _timeline(self, sequence: str, sweeps: Mapping[int, Path]) -> Timeline:
        poses = tuple(
            _read_pose(self.root / sequence / "poses" / f"city_SE3_egovehicle_{stamp}.json", stamp)
            for stamp in sweeps
        )
        return Timeline(tuple(sweeps), _PER_SECOND, poses)


def _same_sweeps(expected: Mapping[int, Path], found: Mapping[int, Path]) -> None:
    for stamp, path in expected.items():
        if stamp not in found:
            missing = next(iter(found.values())).parent
            raise Place(missing, frame=stamp).error(
                "no file for a sweep",
                expected=f"tracked_object_labels_{stamp}.json",
                hint=f"the sweep is known from {path}",
            )
    for stamp, path in found.items():
        if stamp not in expected:
            raise Place(path, frame=stamp).error("a file of an unknown sweep")


def _read_all(files: Mapping[int, Path], *, named: bool) -> list[list[Box]]:
    return [_read_sweep(path, stamp, named=named) for stamp, path in files.items()]


def _read_sweep(path: Path, stamp: int, *, named: bool) -> list[Box]:
    place = Place(path, frame=stamp)
    boxes = []
    for index, item in enumerate(json_list(read_json(path), place)):
        boxes.append(_read_box(json_object(item, place), Place(path, stamp, rows=(index,)), named))
    return each_name_once(boxes, place, "track_label_uuid") if named else boxes


def _read_box(item: Mapping[str, Any], place: Place, named: bool) -> Box:
    name = ""
    if named:
        name = id_value(json_key(item, "track_label_uuid", place), place, "track_label_uuid")
        place = Place(place.file, place.frame, name, place.rows)
    integer_value(json_key(item, "timestamp", place), place, "timestamp")
    kind = json_key(item, "label_class", place)
    if isinstance(kind, dict):
        kind = json_key(kind, "name", place)
    kind = text_value(kind, place, "label_class")
    if kind not in _LABELS:
        raise place.error(
            "an unknown class", field="label_class", got=kind, hint=nearest_hint(kind, _LABELS)
        )
    x, y, z = (_component(item, "center", axis, place) for axis in "xyz")
    quaternion = [_component(item, "rotation", axis, place) for axis in "wxyz"]
    yaw = matrix_yaw(quaternion_matrix(quaternion, place))
    length, width, height = (
        place.finite(json_key(item, side, place), side, above=0.0, within=LARGEST_SIZE)
        for side in ("length", "width", "height")
    )
    score = place.finite(item.get("score", 1.0), "score", within=1.0)
    if score < 0:
        raise place.error("a number out of range", field="score", expected="[0, 1]", got=score)
    return Box(kind, name, (x, y, z), (length, width, height), yaw, score=score)


def _component(item: Mapping[str, Any], field: str, axis: str, place: Place) -> float:
    part = json_object(json_key(item, field, place), place, field)
    return place.finite(json_key(part, axis, place), f"{field}.{axis}")


def _read_pose(path: Path, stamp: int) -> Pose:
    place = Place(path, frame=stamp)
    item = json_object(read_json(path), place)
    quaternion = json_vector(json_key(item, "rotation", place), place, "rotation", 4)
    translation = json_vector(json_key(item, "translation", place), place, "translation", 3)
    return pose(quaternion_matrix(quaternion, place), translation, place)


def _row(box: Box, stamp: int) -> dict[str, Any]:
    w, x, y, z = yaw_quaternion(box.yaw)
    return {
        "center": dict(zip("xyz", box.place, strict=True)),
        "rotation": {"x": x, "y": y, "z": z, "w": w},
        **dict(zip(("length", "width", "height"), box.size, strict=True)),
        "track_label_uuid": box.name,
        "timestamp": stamp,
        "label_class": box.kind,
        "occlusion": 0,
        "score": box.score,
    }
