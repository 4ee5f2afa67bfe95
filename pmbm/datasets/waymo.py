"""Waymo Open: truth from v2 parquet files or a metrics.Objects file, detections and results as
metrics.Objects; times in microseconds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np

from pmbm.datasets.files import Place, prepare_folder, result_file, safe_name
from pmbm.datasets.logs import (
    Box,
    LogFolder,
    Timeline,
    log_comparison,
    log_recording,
    log_tracks,
    submission_boxes,
)
from pmbm.datasets.poses import STANDING
from pmbm.datasets.waymo_files import (
    OBJECTS,
    SUBMISSION,
    TYPES,
    Found,
    decoded,
    read_objects,
    read_v2_boxes,
    read_v2_poses,
)
from pmbm.datasets.wire import encode
from pmbm.durable import replace_bytes
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import iou
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.metrics.benchmarks.waymo import RULES
from pmbm.types import Label, Recording, TrackSequence

_LABELS: Final[Mapping[str, Label]] = {
    "VEHICLE": Label.CAR,
    "PEDESTRIAN": Label.PEDESTRIAN,
    "SIGN": Label.OTHER,
    "CYCLIST": Label.CYCLIST,
}
SCORED: Final = ("VEHICLE", "PEDESTRIAN", "CYCLIST")
_MAX_RANGE: Final = 80.0
_TRACKING_3D: Final = 4
_LIDAR_ALL: Final = 1
_NUMBERS: Final = {name: number for number, name in TYPES.items()}
_PER_SECOND: Final = 10**6


@dataclass(frozen=True, kw_only=True)
class Waymo(LogFolder):
    """Segments of a split.

    root : a folder with `vehicle_pose` and, for truth, `lidar_box`, a parquet file a segment in
        each; or a metrics.Objects file with the truth of all segments, which has no poses, so that
        the vehicle's own frame stands for the world.
    detections : a metrics.Objects file with the detections of all segments; None for none.
    classes : of VEHICLE, PEDESTRIAN, CYCLIST, SIGN.

    Truth of `lidar_box` in which the lidar has no point is not observable, and not considered in
    scoring; a metrics.Objects file is taken as it is, as the official tool takes it.  Results are
    metrics.Objects files, one a segment, which `submit` joins, or one file for all segments.
    """

    name: ClassVar = "waymo"
    title: ClassVar = "Waymo"
    class_labels: ClassVar = _LABELS
    rules: ClassVar = RULES

    classes: tuple[str, ...] = SCORED

    def sequences(self) -> list[str]:
        """The names of all segments."""
        if self.root.is_file():
            return sorted(read_objects(self.root))
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
        """Write `out`/SEGMENT.bin, a metrics.Objects message, and give its path.

        A box that overlaps a detection which is marked as overlapping a no-label zone is marked so,
        too: the official script knows zones by that mark alone.
        """
        timeline = self._known_timeline(sequence)
        frames = submission_boxes(timeline, tracks, _LABELS, self.classes)
        zones = {} if self.detections is None else self._detected(sequence)
        objects = [
            _object(box, sequence, stamp, unlabelled)
            for stamp, boxes in zip(timeline.stamps, frames, strict=True)
            for box, unlabelled in zip(boxes, _in_zones(boxes, zones.get(stamp, [])), strict=True)
        ]
        name = safe_name(sequence, Place(self.root), "sequences")
        path = prepare_folder(Path(out)) / f"{name}.bin"
        replace_bytes(path, encode({"objects": objects}, OBJECTS))
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/SEGMENT.bin (or of a file for all segments, in `folder` or in its
        place) in the world, one report for every frame."""
        timeline = self._known_timeline(sequence)
        path = self._result_path(sequence, folder)
        return log_tracks(timeline, _frames(self._results(path, sequence), timeline, path), _LABELS)

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Labels and results of one class in the vehicle's frame, without labels that are not
        observable."""
        labelled = {
            stamp: [box for box in boxes if box.observable]
            for stamp, boxes in self._truth(sequence).items()
        }
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

        method : at most 25 characters.  Raises InputError where a segment has no result, or a bad
        one.
        """
        if not 0 < len(method) <= 25:
            raise InputError("Waymo: a method's name", expected="1 to 25 characters", got=method)
        objects: list[Any] = []
        for sequence in sequences:
            path = self._result_path(sequence, out)
            self._results(path, sequence)
            found = decoded(path).get("objects", [])
            objects += [one for one in found if one["context_name"] == sequence]
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
            return _segment(read_objects(self.root, named=True), sequence, self.root)
        return read_v2_boxes(self._v2("lidar_box", sequence), sequence)

    def _detected(self, sequence: str) -> Found:
        path = Path(str(self.detections))
        return _segment(read_objects(path), sequence, path)

    def _result_path(self, sequence: str, folder: Path) -> Path:
        name = safe_name(sequence, Place(Path(folder)), "sequences")
        return result_file(Path(folder), f"{name}.bin", self.sequences)

    def _results(self, path: Path, sequence: str) -> Found:
        """The boxes of a segment.  Without any track its own file is empty, which is a right
        message; in a file for all segments it has to have one."""
        found = read_objects(path, named=True)
        if path.stem != sequence:
            return _segment(found, sequence, path)
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
        poses = read_v2_poses(self._v2("vehicle_pose", sequence), sequence)
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


def _in_zones(boxes: Sequence[Box], detected: Sequence[Box]) -> list[bool]:
    """Whether each box overlaps, seen from above, a detection in a no-label zone."""
    marked = [box for box in detected if box.excused]
    if not boxes or not marked:
        return [False] * len(boxes)
    first, second = ([np.array(column) for column in _geometry(side)] for side in (boxes, marked))
    shared = iou(*first, *second, vertical=False)
    return [bool(row.any()) for row in shared > 0]


def _geometry(boxes: Sequence[Box]) -> tuple[list[Any], list[Any], list[float]]:
    return [b.place for b in boxes], [b.size for b in boxes], [b.yaw for b in boxes]


def _object(box: Box, sequence: str, stamp: int, unlabelled: bool) -> dict[str, Any]:
    centre = {f"center_{axis}": value for axis, value in zip("xyz", box.place, strict=True)}
    sides = dict(zip(("length", "width", "height"), box.size, strict=True))
    return {
        "object": {
            "box": {**centre, **sides, "heading": box.yaw},
            "type": _NUMBERS[box.kind],
            "id": box.name,
        },
        "score": box.score,
        **({"overlap_with_nlz": True} if unlabelled else {}),
        "context_name": sequence,
        "frame_timestamp_micros": stamp,
    }
