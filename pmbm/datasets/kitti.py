"""KITTI tracking: labels, calibration, detections and poses in; the 18-column submission out."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import ClassVar, Final

import numpy as np

from pmbm.datasets.files import Place, prepare_folder, write_zip
from pmbm.datasets.frames import (
    SourceBoxes,
    box_corners,
    merge,
    named_labels,
    nothing,
    recording,
    track_frames,
    truth_frames,
)
from pmbm.datasets.kitti_files import (
    CameraCalibration,
    KittiObjects,
    format_objects,
    image_boxes,
    read_calibration,
    read_detections,
    read_objects,
    read_poses,
    to_camera,
    to_sensor,
)
from pmbm.datasets.poses import STANDING, Pose
from pmbm.durable import replace_text
from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import wrap_angle
from pmbm.metrics.benchmarks.kitti import RULES
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.score import logistic
from pmbm.types import (
    BoolArray,
    FloatArray,
    GroundTruth,
    IntArray,
    Label,
    Recording,
    Site,
    Tracks,
    TrackSequence,
)

PERIOD: Final = 0.1
"""Seconds between frames."""
CLASSES: Final = ("Car", "Pedestrian", "Cyclist")
"""Those that are detected and scored."""
NEIGHBOURS: Final[Mapping[str, tuple[str, ...]]] = {
    "Car": ("Van",),
    "Pedestrian": ("Person", "Person_sitting"),
    "Cyclist": (),
}
"""Truth so like a class that following it counts neither way."""
_LABELS: Final[Mapping[str, Label]] = {
    "Car": Label.CAR,
    "Van": Label.CAR,
    "Truck": Label.TRUCK,
    "Pedestrian": Label.PEDESTRIAN,
    "Person": Label.PEDESTRIAN,
    "Person_sitting": Label.PEDESTRIAN,
    "Cyclist": Label.CYCLIST,
    "Tram": Label.OTHER,
    "Misc": Label.OTHER,
}
_TYPES: Final[Mapping[Label, str]] = {
    Label.CAR: "Car",
    Label.TRUCK: "Truck",
    Label.PEDESTRIAN: "Pedestrian",
    Label.CYCLIST: "Cyclist",
}
_VISIBILITY: Final[Mapping[int, float]] = {-1: 1.0, 0: 1.0, 1: 0.75, 2: 0.25, 3: 0.0}
"""The middle of what each occlusion level stands for; 3 is unknown, and not scored."""
_SMALLEST_PIXELS: Final = 25.0
_EPS: Final = float(np.finfo(np.float64).eps)
_MAX_RANGE: Final = 80.0
_CONFIDENCE: Final[Mapping[str, tuple[float, float]]] = {
    "Car": (0.81, -2.85),
    "Pedestrian": (1.32, -4.11),
    "Cyclist": (0.75, -3.23),
}
"""Slope and offset of the logistic that turns a PointRCNN logit into the probability that the box
is true: fitted to the origins (3D IoU of at least .25) of the detections in the training sequences
0000, 0002-0005, 0007, 0009, 0011 and 0017."""


@dataclass(frozen=True, kw_only=True)
class Kitti:
    """KITTI tracking sequences in a folder.

    root : holds `calib` and, for truth, `label_02`.
    detections : the folder of detection files, with `{class}` in place of the class's name where
        there is a folder for each; None for none.
    poses : a folder with a file of poses a sequence (12 numbers a line, or the 30 of `oxts`); None
        to track in the moving camera's own frame.
    classes : of `CLASSES`.

    World: the first camera's place, x forward, y left, z up; one frame a tenth of a second.
    """

    name: ClassVar = "kitti"
    rules: ClassVar = RULES

    root: Path
    detections: str | None = None
    poses: Path | None = None
    classes: tuple[str, ...] = CLASSES

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", Path(self.root))
        object.__setattr__(self, "poses", None if self.poses is None else Path(self.poses))
        object.__setattr__(self, "classes", tuple(self.classes))
        for name in self.classes:
            if name not in CLASSES:
                raise InputError(
                    f"KITTI: no class '{name}'",
                    field="classes",
                    hint=nearest_hint(name, CLASSES, "class"),
                )
        if len(set(self.classes)) < len(self.classes):
            raise InputError("KITTI: a class is named twice", field="classes", got=self.classes)

    @property
    def known_classes(self) -> tuple[str, ...]:
        """All classes that may be asked for."""
        return CLASSES

    @property
    def labels(self) -> tuple[int, ...]:
        """The labels of the classes asked for, in their order."""
        return tuple(_LABELS[name] for name in self.classes)

    @property
    def without_poses(self) -> bool:
        """Whether the world is the moving camera's own frame."""
        return self.poses is None

    def sequences(self) -> list[str]:
        """The names of all sequences: those with a calibration."""
        folder = self.root / "calib"
        names = sorted(path.stem for path in folder.glob("*.txt")) if folder.is_dir() else []
        if not names:
            raise InputError("KITTI: no sequences", file=folder, expected="files NNNN.txt")
        return names

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One sequence in the world; without `truth` its labels are not read.

        Truth holds the classes asked for and, not observable, their neighbours; what is truncated
        or occluded beyond judgement is not observable either, as the benchmark's rules have it.
        Detections carry the detector's logit as `raw_score` and a logistic of it as `score`.
        Origins are unknown.

        Raises InputError for missing or bad files, and for frames that have no pose.
        """
        calibration, poses = self._places(sequence)
        labels = self._labels(sequence) if truth else None
        seen = [self._detections(sequence, kind) for kind in self._kinds()]
        tables = [*seen] if labels is None else [*seen, labels]
        frames = self._frames(sequence, poses, tables)
        if poses is None:
            poses = (STANDING,) * frames
        truths, kinds = [nothing()] * frames, {}
        if labels is not None:
            labels, counted = self._scored(labels)
            truths = _truth(labels, frames, counted)
            kinds = dict(zip(labels.id.tolist(), labels.type, strict=True))
        return recording(
            name=f"kitti-{sequence}",
            stamp=range(frames),
            times=_times(frames),
            poses=poses,
            truth=truths,
            detections=_merged([_detected(objects, frames) for objects in seen], frames),
            site=Site(fov_half_angle=calibration.half_field_of_view, max_range=_MAX_RANGE),
            provenance={
                "dataset": "kitti",
                "sequence": sequence,
                "ego_motion": self.poses is not None,
                "class": {str(key): kind for key, kind in sorted(kinds.items())},
            },
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/NNNN.txt, the submission's 18 columns, and give its path.

        Boxes are brought back into the camera of their frame; the image box is that of the part the
        image shows, and a box with no part in the image is left out, as the labels leave it out.
        Truncation and occlusion are -1, "not said".
        """
        calibration, poses = self._places(sequence)
        lines = []
        for frame, step in zip(tracks.frame.tolist(), tracks, strict=True):
            if poses is not None and frame >= len(poses):
                raise InputError("KITTI: a frame without a pose", frame=frame, field="frame")
            pose = STANDING if poses is None else poses[frame]
            lines.append(format_objects(_submission(frame, step, pose, calibration)))
        path = prepare_folder(Path(out)) / f"{sequence}.txt"
        replace_text(path, "".join(lines))
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/NNNN.txt in the world, one report for every frame; scores outside
        [0, 1] go through the logistic function."""
        _, poses = self._places(sequence)
        path = Path(folder) / f"{_checked(sequence)}.txt"
        results = read_objects(path, scored=True)
        if not results.solid.all():
            raise _first(results, ~results.solid, path).error(
                "a result without a 3D box has no place in the world", field="height"
            )
        tables = (
            [results]
            if poses is not None or not self._has_labels()
            else [
                results,
                self._labels(sequence),
            ]
        )
        frames = self._frames(sequence, poses, tables)
        assert results.score is not None
        score = results.score
        if len(score) and (score.min() < 0 or score.max() > 1):
            score = logistic(score)
        boxes = []
        for rows in _by_frame(results, frames):
            boxes.append(replace(_boxes(results, rows), score=score[rows]))
        return track_frames(
            _times(frames),
            (STANDING,) * frames if poses is None else poses,
            boxes,
            ids=[results.id[rows] for rows in _by_frame(results, frames)],
        )

    def submit(self, sequences: Sequence[str], folder: Path) -> Path:
        """Pack the results of these sequences into `folder`/submission.zip.

        Raises InputError where a sequence has no result, or a bad one: one without an image box,
        which is all that the benchmark compares, among them."""
        for sequence in sequences:
            results = self.results(sequence, folder)
            if not results.in_image.all():
                path = Path(folder) / f"{sequence}.txt"
                raise _first(results, ~results.in_image, path).error(
                    "a result without an image box",
                    field="bbox",
                    expected="left, top, right, bottom",
                    got=results.box[np.argmin(results.in_image)].tolist(),
                    hint="the benchmark compares image boxes; pmbm track writes them",
                )
        path = Path(folder) / "submission.zip"
        write_zip(path, {f"{name}.txt": Path(folder) / f"{name}.txt" for name in sequences})
        return path

    def unjudged(self, sequence: str) -> tuple[BoolArray, ...]:
        """Of the detections of each frame, as `recording` has them, those that the labels leave
        open: no higher than 25 pixels, or more than half inside a DontCare region.  Without an
        image box, that of the 3D box is taken."""
        calibration, poses = self._places(sequence)
        labels = self._labels(sequence)
        seen = [
            _with_image_boxes(self._detections(sequence, kind), calibration)
            for kind in self._kinds()
        ]
        frames = self._frames(sequence, poses, [*seen, labels])
        parts = [(_excused(one, labels), _by_frame(one, frames)) for one in seen]
        return tuple(
            np.concatenate([np.zeros(0, bool), *(flag[rows[k]] for flag, rows in parts)])
            for k in range(frames)
        )

    def objects(self, sequence: str) -> KittiObjects:
        """The labels in the dataset's own terms."""
        return self._labels(sequence)

    def results(self, sequence: str, folder: Path) -> KittiObjects:
        """A result file in the dataset's own terms."""
        return read_objects(Path(folder) / f"{_checked(sequence)}.txt", scored=True)

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Labels and results of one class in the camera's frame, by the benchmark's rules: truth of
        neighbouring classes, truncated, or occluded beyond judgement is not observable; results no
        higher than 25 pixels, or more than half inside a DontCare region, are excused.  Where there
        is no image box, that of the 3D box is taken.

        Raises InputError where either file is missing or bad: a frame without results counts as
        empty, a sequence without them is refused.
        """
        labels, results = self._labels(sequence), self.results(sequence, folder)
        results = results.take([i for i, name in enumerate(results.type) if name == kind])
        if not (labels.in_image.all() and results.in_image.all()):
            calibration, _ = self._places(sequence)
            labels = _with_image_boxes(labels, calibration)
            results = _with_image_boxes(results, calibration)
        frames = max(labels.length, results.length)
        results = results.by_id()
        flat = None
        if not results.solid.all():
            flat = _first(results, ~results.solid, Path(folder) / f"{sequence}.txt").error(
                "a result without a 3D box", field="height", expected="above 0"
            )
            results = replace(results, size=np.where(results.solid[:, None], results.size, 1.0))
        image, truth = _judged(labels, kind, frames)
        standing = (STANDING,) * frames
        return ComparedSequence(
            truth=truth,
            tracks=tuple(
                track_frames(
                    _times(frames),
                    standing,
                    [_boxes(results, rows) for rows in _by_frame(results, frames)],
                    ids=[results.id[rows] for rows in _by_frame(results, frames)],
                )
            ),
            excused=_excused(results, labels),
            truth_image=image,
            tracks_image=results.box,
            confidence=results.score,
            image_only=flat,
        )

    def _places(self, sequence: str) -> tuple[CameraCalibration, tuple[Pose, ...] | None]:
        calibration = read_calibration(self.root / "calib" / f"{_checked(sequence)}.txt")
        if self.poses is None:
            return calibration, None
        return calibration, read_poses(self.poses / f"{sequence}.txt", calibration)

    def _has_labels(self) -> bool:
        return (self.root / "label_02").is_dir()

    def _labels(self, sequence: str) -> KittiObjects:
        return read_objects(self.root / "label_02" / f"{_checked(sequence)}.txt", scored=False)

    def _kinds(self) -> Sequence[str | None]:
        if self.detections is None:
            return ()
        return self.classes if "{class}" in self.detections else (None,)

    def _detections(self, sequence: str, kind: str | None) -> KittiObjects:
        assert self.detections is not None
        folder = Path(self.detections.replace("{class}", kind or ""))
        objects = read_detections(folder / f"{sequence}.txt", kind)
        wanted = [i for i, name in enumerate(objects.type) if name in self.classes]
        return objects.take(wanted)

    def _frames(
        self, sequence: str, poses: tuple[Pose, ...] | None, tables: Sequence[KittiObjects]
    ) -> int:
        """Frames of the sequence: one a pose; without poses, up to the last frame named."""
        length = max((table.length for table in tables), default=0)
        if poses is None:
            return length
        if length > len(poses):
            raise Place(self.poses / f"{sequence}.txt" if self.poses else Path()).error(
                "a frame without a pose",
                frame=length - 1,
                expected=f"{length} lines",
                got=len(poses),
            )
        return len(poses)

    def _scored(self, labels: KittiObjects) -> tuple[KittiObjects, BoolArray]:
        """The rows of the classes asked for and their neighbours, and which are the former."""
        near = {kind for name in self.classes for kind in NEIGHBOURS[name]}
        kept = labels.take([i for i, k in enumerate(labels.type) if k in (*self.classes, *near)])
        return kept, np.array([kind in self.classes for kind in kept.type], dtype=bool)


@lru_cache(maxsize=8)
def _judged(
    labels: KittiObjects, kind: str, frames: int
) -> tuple[FloatArray, tuple[GroundTruth, ...]]:
    """Image boxes and frames of the truth that one class is compared with, its neighbours too, in
    order of id: once for all results that are compared with it."""
    rows = [i for i, name in enumerate(labels.type) if name in (kind, *NEIGHBOURS[kind])]
    truth = labels.take(rows).by_id()
    counted = np.array([name == kind for name in truth.type], dtype=bool)
    made, _ = truth_frames(
        _times(frames),
        (STANDING,) * frames,
        _truth(truth, frames, counted),
        ids=[truth.id[rows] for rows in _by_frame(truth, frames)],
    )
    return truth.box, made


def _truth(labels: KittiObjects, frames: int, counted: BoolArray) -> list[SourceBoxes]:
    observable = counted & (labels.occluded <= 2) & (labels.truncated <= 0)
    return [
        replace(
            _boxes(labels, rows),
            name=[str(value) for value in labels.id[rows]],
            visibility=np.array([_VISIBILITY[i] for i in labels.occluded[rows].tolist()]),
            observable=observable[rows],
        )
        for rows in _by_frame(labels, frames)
    ]


def _excused(results: KittiObjects, labels: KittiObjects) -> BoolArray:
    left, top, right, bottom = results.box.T
    small = bottom - top <= _SMALLEST_PIXELS
    inside = np.zeros(len(results), dtype=bool)
    area = np.maximum((right - left) * (bottom - top), np.finfo(float).tiny)
    for frame, region in zip(labels.dont_care_frame, labels.dont_care_box, strict=True):
        width = np.minimum(right, region[2]) - np.maximum(left, region[0])
        height = np.minimum(bottom, region[3]) - np.maximum(top, region[1])
        shared = np.clip(width, 0, None) * np.clip(height, 0, None) / area
        inside |= (results.frame == frame) & (shared > 0.5 + _EPS)
    return small | inside


def _with_image_boxes(objects: KittiObjects, calibration: CameraCalibration) -> KittiObjects:
    """An image box for each object that has none, but a filler (-1 -1 -1 -1, 0 0 0 0): that of the
    part of its 3D box which the image shows; where it shows none, 0 0 0 0, as high as nothing."""
    rows = np.flatnonzero(objects.solid & ~objects.in_image)
    solid = _boxes(objects, rows)
    corners = to_camera(box_corners(solid.position, solid.size, solid.yaw))
    box = objects.box.copy()
    for row, shown in zip(rows, image_boxes(corners, calibration), strict=True):
        box[row] = 0.0 if shown is None else shown
    return replace(objects, box=box)


def _first(objects: KittiObjects, rows: BoolArray, path: Path) -> Place:
    """The place of the first of these rows."""
    row = int(np.argmax(rows))
    return Place(path, frame=int(objects.frame[row]), object_id=int(objects.id[row]))


def _checked(sequence: str) -> str:
    if not re.fullmatch(r"[0-9]{4}", sequence):
        raise InputError(
            "KITTI: no such sequence", field="sequences", expected="NNNN", got=sequence
        )
    return sequence


def _times(frames: int) -> FloatArray:
    return np.arange(frames, dtype=np.float64) * PERIOD


def _by_frame(objects: KittiObjects, frames: int) -> list[IntArray]:
    """The rows of each frame, in the file's order."""
    order = np.argsort(objects.frame, kind="stable")
    cuts = np.searchsorted(objects.frame[order], np.arange(1, frames))
    return np.split(order, cuts) if frames else []


def _boxes(objects: KittiObjects, rows: IntArray) -> SourceBoxes:
    """From the centre of the bottom face and the yaw about y (down) to the centre and the yaw about
    z (up)."""
    size = objects.size[rows]
    position = to_sensor(objects.bottom[rows])
    position[:, 2] += size[:, 2] / 2
    return SourceBoxes(
        position=position,
        size=size,
        yaw=wrap_angle(-np.pi / 2 - objects.rotation_y[rows]),
        label=named_labels([objects.type[i] for i in rows], _LABELS),
    )


def _detected(objects: KittiObjects, frames: int) -> list[SourceBoxes]:
    assert objects.score is not None
    confidence = np.array([_CONFIDENCE[kind] for kind in objects.type]).reshape(-1, 2)
    score = logistic(confidence[:, 0] * objects.score + confidence[:, 1])
    return [
        replace(_boxes(objects, rows), score=score[rows], raw_score=objects.score[rows])
        for rows in _by_frame(objects, frames)
    ]


def _merged(parts: Sequence[Sequence[SourceBoxes]], frames: int) -> list[SourceBoxes]:
    return [merge([part[k] for part in parts]) for k in range(frames)]


def _submission(
    frame: int, tracks: Tracks, pose: Pose, calibration: CameraCalibration
) -> KittiObjects:
    centre = pose.to_sensor(tracks.position)
    yaw = pose.yaw_to_sensor(tracks.yaw)
    boxes = list(image_boxes(to_camera(box_corners(centre, tracks.size, yaw)), calibration))
    rows = np.array([i for i, box in enumerate(boxes) if box is not None], dtype=np.int64)
    height = tracks.size[rows, 2]
    bottom = to_camera(centre[rows] - np.outer(height / 2, [0.0, 0.0, 1.0]))
    rotation = wrap_angle(-np.pi / 2 - yaw[rows])
    n = len(rows)
    return KittiObjects(
        frame=np.full(n, frame),
        id=tracks.id[rows],
        type=tuple(_TYPES.get(Label(label), "Misc") for label in tracks.label[rows].tolist()),
        truncated=np.full(n, -1.0),
        occluded=np.full(n, -1),
        alpha=wrap_angle(rotation - np.arctan2(bottom[:, 0], bottom[:, 2])),
        box=np.array([boxes[i] for i in rows]).reshape(-1, 4),
        size=tracks.size[rows],
        bottom=bottom,
        rotation_y=rotation,
        solid=np.ones(n, dtype=bool),
        score=tracks.score[rows],
        dont_care_frame=np.zeros(0, np.int64),
        dont_care_box=np.zeros((0, 4)),
    )
