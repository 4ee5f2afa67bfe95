"""nuScenes: tables of JSON records, detections and results of one JSON file; everything in the
global frame, times in microseconds."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final

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
from pmbm.datasets.nuscenes_tables import (
    LABELS,
    MODALITIES,
    RANGE,
    Tables,
    counted,
    modalities,
    read_results,
    result_boxes,
)
from pmbm.datasets.poses import yaw_quaternion
from pmbm.durable import replace_text
from pmbm.errors import InputError
from pmbm.metrics.benchmarks.nuscenes import RULES
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.types import Recording, TrackSequence

CLASSES: Final = tuple(LABELS)
_MOST_BOXES: Final = 500


@dataclass(frozen=True, kw_only=True)
class NuScenes(LogFolder):
    """Scenes of a version.

    root : the folder of the tables, such as `v1.0-mini`.
    detections : a detection file with every sample of the scenes; None for none.
    classes : of the seven that are tracked.

    World: the map's frame.  Truth is observable where the benchmark counts it: with a lidar or
    radar point, in its class's range, not in a bicycle rack.  Results are files of the submission's
    form, one a scene; `submit` joins them.
    """

    name: ClassVar = "nuscenes"
    title: ClassVar = "nuScenes"
    class_labels: ClassVar = LABELS
    rules: ClassVar = RULES

    classes: tuple[str, ...] = CLASSES

    def sequences(self) -> list[str]:
        """The names of all scenes."""
        return sorted(self._tables.scenes)

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One scene in the map's frame; without `truth` its annotations are not read.

        Raises InputError for missing or bad tables, and for a sample without detections listed.
        """
        tokens, timeline = self._frames(sequence)
        found = None
        if self.detections is not None:
            path = Path(self.detections)
            found = result_boxes(read_results(path), path, tokens, "detection", named=False)
        return log_recording(
            name=f"nuscenes-{sequence}",
            timeline=timeline,
            truth=self._truth(tokens, timeline) if truth else None,
            detections=found,
            labels=LABELS,
            classes=self.classes,
            max_range=max(RANGE.values()),
            provenance={"dataset": "nuscenes", "sequence": sequence},
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/SCENE.json, of the submission's form with every sample of the scene, and give
        its path.  Raises InputError where a sample has more than 500 boxes."""
        tokens, timeline = self._frames(sequence)
        results = {}
        for token, boxes in zip(
            tokens, submission_boxes(timeline, tracks, LABELS, self.classes), strict=True
        ):
            if len(boxes) > _MOST_BOXES:
                raise InputError(
                    "nuScenes: too many boxes in a sample",
                    frame=token,
                    expected=f"at most {_MOST_BOXES}",
                    got=len(boxes),
                    hint="raise the score from which tracks are reported",
                )
            results[token] = [_row(box, token) for box in boxes]
        name = safe_name(sequence, Place(self.root), "sequences")
        path = prepare_folder(Path(out)) / f"{name}.json"
        _write(path, results, self._modalities)
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/SCENE.json (or of a file for all scenes, in `folder` or in its
        place) in the map's frame, one report for every sample.

        Raises InputError for missing samples."""
        tokens, timeline = self._frames(sequence)
        return log_tracks(timeline, self._results(sequence, tokens, folder), LABELS)

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Annotations and results of one class in the map's frame, what the benchmark does not
        count left out on both sides."""
        tokens, timeline = self._frames(sequence)
        racks = [self._racks(token) for token in tokens]
        truth, results = (
            [
                [box for box in frame if box.observable and counted(box, where, near)]
                for frame, where, near in zip(frames, timeline.poses, racks, strict=True)
            ]
            for frames in (self._truth(tokens, timeline), self._results(sequence, tokens, folder))
        )
        return log_comparison(timeline, truth, results, kind, LABELS)

    def submit(self, sequences: Sequence[str], out: Path) -> Path:
        """Join the results of these scenes into `out`/submission.json.

        Raises InputError where a scene has no result."""
        joined: dict[str, Any] = {}
        used = []
        for sequence in sequences:
            tokens, _ = self._frames(sequence)
            path, document = self._result_file(sequence, out)
            boxes = result_boxes(document, path, tokens, "tracking", named=True)
            used.append(modalities(document, path))
            joined |= {
                token: [_row(box, token) for box in frame]
                for token, frame in zip(tokens, boxes, strict=True)
            }
        path = Path(out) / "submission.json"
        _write(path, joined, {name: any(one[name] for one in used) for name in MODALITIES})
        return path

    @cached_property
    def _tables(self) -> Tables:
        return Tables(self.root)

    def _frames(self, sequence: str) -> tuple[list[str], Timeline]:
        return self._tables.timeline(sequence)

    def _truth(self, tokens: Sequence[str], timeline: Timeline) -> list[list[Box]]:
        return [
            self._tables.boxes(token, where)
            for token, where in zip(tokens, timeline.poses, strict=True)
        ]

    def _racks(self, token: str) -> list[Box]:
        return self._tables.racks(token)

    @cached_property
    def _modalities(self) -> Mapping[str, bool]:
        """What the detections were made from; without detections, what a file that says nothing
        stands for."""
        if self.detections is None:
            return MODALITIES
        path = Path(self.detections)
        return modalities(read_results(path), path)

    def _result_file(self, sequence: str, folder: Path) -> tuple[Path, Mapping[str, Any]]:
        """Where the scene's results are, and what stands there."""
        name = safe_name(sequence, Place(Path(folder)), "sequences")
        path = result_file(Path(folder), f"{name}.json", self.sequences)
        return path, read_results(path)

    def _results(self, sequence: str, tokens: Sequence[str], folder: Path) -> list[list[Box]]:
        path, document = self._result_file(sequence, folder)
        return result_boxes(document, path, tokens, "tracking", named=True)


def _row(box: Box, token: str) -> dict[str, Any]:
    length, width, height = box.size
    return {
        "sample_token": token,
        "translation": list(box.place),
        "size": [width, length, height],
        "rotation": yaw_quaternion(box.yaw),
        "velocity": list(box.velocity or (0.0, 0.0)),
        "tracking_id": box.name,
        "tracking_name": box.kind,
        "tracking_score": box.score,
    }


def _write(path: Path, results: Mapping[str, Any], modalities: Mapping[str, bool]) -> None:
    document = {"meta": dict(modalities), "results": results}
    replace_text(path, json.dumps(document, indent=1, allow_nan=False))
