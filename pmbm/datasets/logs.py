"""The frames, boxes and folders that datasets of driving logs share, in and out of the world."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from pmbm.datasets.files import Place
from pmbm.datasets.frames import (
    SourceBoxes,
    box_table,
    named_labels,
    recording,
    track_frames,
    truth_frames,
)
from pmbm.datasets.poses import STANDING, Pose
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.types import FloatArray, IntArray, Label, Recording, Site, Tracks, TrackSequence


@dataclass(frozen=True)
class Box:
    """One box of one frame, in the frame that the dataset gives boxes in.

    kind : the dataset's class.  name : its object's id, empty in detections.
    place (x, y, z), size (l, w, h), yaw : centre, m, rad.
    score : of detections and results.  visibility, observable, velocity : of truth; velocity in
        the world, m/s, or None.
    hard : of the more difficult kind, where the dataset tells.
    excused : of results; where unmatched, not false.
    """

    kind: str
    name: str
    place: tuple[float, float, float]
    size: tuple[float, float, float]
    yaw: float
    score: float = 1.0
    visibility: float = 1.0
    observable: bool = True
    velocity: tuple[float, float] | None = None
    hard: bool = False
    excused: bool = False


Frames = Sequence[Sequence[Box]]
"""The boxes of every frame of a log."""


@dataclass(frozen=True, eq=False)
class Timeline:
    """The frames of a log.

    stamps : increasing, in the dataset's own unit, of which there are `per_second`.
    poses : of the vehicle in the world.
    world_boxes : whether boxes are given in the world and not in the vehicle's frame.
    """

    stamps: tuple[int, ...]
    per_second: int
    poses: tuple[Pose, ...]
    world_boxes: bool = False

    @property
    def times(self) -> FloatArray:
        """Seconds since the first frame (F,); differences are taken before rounding."""
        first = self.stamps[0] if self.stamps else 0
        return np.array([(s - first) / self.per_second for s in self.stamps], dtype=np.float64)

    @property
    def box_poses(self) -> tuple[Pose, ...]:
        """The poses of the frame that boxes are given in."""
        return (STANDING,) * len(self.poses) if self.world_boxes else self.poses


def checked_classes(
    given: Sequence[str], table: Mapping[str, Label], dataset: str
) -> tuple[str, ...]:
    """The classes asked for; InputError for unknown ones, and for two of one label, which could not
    be told apart in the tracks."""
    taken: dict[Label, str] = {}
    for name in given:
        if name not in table:
            raise InputError(
                f"{dataset}: no class '{name}'",
                field="classes",
                hint=nearest_hint(name, table, "class"),
            )
        if table[name] in taken:
            raise InputError(
                f"{dataset}: two classes that cannot be tracked together",
                field="classes",
                got=f"{taken[table[name]]}, {name}",
                hint="run them one after the other",
            )
        taken[table[name]] = name
    return tuple(given)


@dataclass(frozen=True, kw_only=True)
class LogFolder:
    """The common fields and checks of adapters of driving logs.

    root : the dataset's folder.
    detections : where the detections are; None for none.
    classes : of `class_labels`, any that differ in label.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    """As its makers write it, for messages."""
    class_labels: ClassVar[Mapping[str, Label]]

    root: Path
    detections: str | None = None
    classes: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "root", Path(self.root))
        checked = checked_classes(self.classes, self.class_labels, self.title)
        object.__setattr__(self, "classes", checked)

    @property
    def known_classes(self) -> tuple[str, ...]:
        """All classes that may be asked for."""
        return tuple(self.class_labels)

    @property
    def labels(self) -> tuple[int, ...]:
        """The labels of the classes asked for, in their order."""
        return tuple(self.class_labels[name] for name in self.classes)


def each_name_once(boxes: Iterable[Box], place: Place, field: str) -> list[Box]:
    """The boxes; InputError where two of the frame have one name."""
    seen: set[str] = set()
    kept = []
    for box in boxes:
        if box.name in seen:
            raise Place(place.file, place.frame, box.name).error(
                "the same id twice in a frame", field=field
            )
        seen.add(box.name)
        kept.append(box)
    return kept


def log_recording(
    *,
    name: str,
    timeline: Timeline,
    truth: Frames | None,
    detections: Frames | None,
    labels: Mapping[str, Label],
    classes: Sequence[str],
    max_range: float,
    provenance: Mapping[str, Any],
) -> Recording:
    """The log in the world, of these classes; no truth where it is None, no delivery where there
    are no detections.  Raises InputError where the stamps do not increase."""
    frames = len(timeline.stamps)
    chosen = set(classes)
    boxes = [_source([b for b in f if b.kind in chosen], labels) for f in truth or [()] * frames]
    seen = (
        [None] * frames
        if detections is None
        else [_source([b for b in f if b.kind in chosen], labels) for f in detections]
    )
    kinds = {b.name: b.kind for f in truth or () for b in f if b.kind in chosen}
    return recording(
        name=name,
        stamp=timeline.stamps,
        times=timeline.times,
        poses=timeline.box_poses,
        sensor_poses=[pose.planar for pose in timeline.poses],
        truth=boxes,
        detections=seen,
        site=Site(max_range=max_range),
        provenance={**provenance, "class": dict(sorted(kinds.items()))},
    )


def log_tracks(timeline: Timeline, results: Frames, labels: Mapping[str, Label]) -> TrackSequence:
    """Results in the world; ids that are numbers keep them, others are numbered by appearance."""
    return track_frames(
        timeline.times,
        timeline.box_poses,
        [_source(frame, labels) for frame in results],
        ids=_numbers(results),
    )


def log_comparison(
    timeline: Timeline, truth: Frames, results: Frames, kind: str, labels: Mapping[str, Label]
) -> ComparedSequence:
    """Truth and results of one class in the frame that the dataset gives boxes in."""
    sides = []
    for frames in (truth, results):
        chosen = [[box for box in frame if box.kind == kind] for frame in frames]
        numbers = _numbers(chosen)
        order = [np.argsort(frame) for frame in numbers]
        rows = [[f[i] for i in o.tolist()] for f, o in zip(chosen, order, strict=True)]
        ids = [frame[o] for frame, o in zip(numbers, order, strict=True)]
        sides.append((rows, ids))
    standing = (STANDING,) * len(timeline.stamps)
    (truth_rows, truth_ids), (track_rows, track_ids) = sides
    compared = truth_frames(
        timeline.times, standing, [_source(frame, labels) for frame in truth_rows], ids=truth_ids
    )[0]
    tracks = track_frames(
        timeline.times, standing, [_source(frame, labels) for frame in track_rows], ids=track_ids
    )
    return ComparedSequence(
        truth=compared,
        tracks=tuple(tracks),
        excused=np.array([box.excused for frame in track_rows for box in frame], dtype=bool),
        hard=np.array([box.hard for frame in truth_rows for box in frame], dtype=bool),
        sensor=np.array([pose.translation for pose in timeline.poses]).reshape(-1, 3),
    )


def submission_boxes(
    timeline: Timeline, tracks: TrackSequence, labels: Mapping[str, Label], classes: Sequence[str]
) -> list[list[Box]]:
    """The tracks of every frame of the log, in the frame that the dataset gives boxes in; frames
    that were not reported are empty.

    Raises InputError for a frame that the log does not have, and for a track of a label that none
    of the classes has.
    """
    kind_of = {labels[kind]: kind for kind in classes}
    frames: list[list[Box]] = [[] for _ in timeline.stamps]
    for frame, step in zip(tracks.frame.tolist(), tracks, strict=True):
        if frame >= len(frames):
            raise InputError(
                "tracks of a frame that the log does not have",
                frame=frame,
                expected=f"0 to {len(frames) - 1}",
            )
        frames[frame] = _boxes_of(step, timeline.box_poses[frame], kind_of)
    return frames


def _boxes_of(tracks: Tracks, pose: Pose, kind_of: Mapping[Label, str]) -> list[Box]:
    unknown = {Label(label) for label in tracks.label.tolist()} - set(kind_of)
    if unknown:
        raise InputError(
            "a track of a class that was not asked for",
            field="label",
            expected=[label.name for label in kind_of],
            got=sorted(label.name for label in unknown),
        )
    place, yaw = pose.to_sensor(tracks.position), pose.yaw_to_sensor(tracks.yaw)
    return [
        Box(
            kind=kind_of[Label(int(tracks.label[i]))],
            name=str(tracks.id[i]),
            place=tuple(place[i].tolist()),
            size=tuple(tracks.size[i].tolist()),
            yaw=float(yaw[i]),
            score=float(tracks.score[i]),
            velocity=tuple(tracks.velocity[i].tolist()),
        )
        for i in range(len(tracks))
    ]


def _source(boxes: Sequence[Box], labels: Mapping[str, Label]) -> SourceBoxes:
    position, size, yaw = box_table([(*box.place, *box.size, box.yaw) for box in boxes])
    velocity = [box.velocity for box in boxes if box.velocity is not None]
    return SourceBoxes(
        position=position,
        size=size,
        yaw=yaw,
        label=named_labels([box.kind for box in boxes], labels),
        name=[box.name for box in boxes],
        score=np.array([box.score for box in boxes]),
        visibility=np.array([box.visibility for box in boxes]),
        observable=np.array([box.observable for box in boxes], dtype=bool),
        velocity=np.array(velocity) if boxes and len(velocity) == len(boxes) else None,
    )


def _numbers(frames: Frames) -> list[IntArray]:
    names = list(dict.fromkeys(box.name for frame in frames for box in frame))
    plain = all(name.isascii() and name.isdigit() and len(name) < 19 for name in names)
    exact = plain and len({int(name) for name in names}) == len(names)
    number = {name: int(name) if exact else place for place, name in enumerate(names)}
    return [np.array([number[box.name] for box in frame], dtype=np.int64) for frame in frames]
