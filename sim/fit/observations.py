"""Observations of a detector in recordings with known origins, as flat tables."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.geometry import wrap_angle
from pmbm.sim.detector.boxes import in_view, polar, targets
from pmbm.sim.detector.calibration import first_boxes
from pmbm.sim.detector.replay import replay
from pmbm.types import BoolArray, FloatArray, IntArray, Recording


@dataclass(frozen=True, eq=False)
class Opportunities:
    """Every chance to detect an object: R rows of truth in view, in frames that were delivered.

    recording (R,), object_id (R,), frame (R,) : which chance it is.
    label (R,), distance (R,), visibility (R,) : of the object then.
    found (R,) : whether it was detected.
    """

    recording: IntArray
    object_id: IntArray
    frame: IntArray
    label: IntArray
    distance: FloatArray
    visibility: FloatArray
    found: BoolArray

    def take(self, rows: NDArray[Any]) -> Opportunities:
        """Only these rows (indices or a mask)."""
        return Opportunities(*(getattr(self, f.name)[rows] for f in fields(self)))


@dataclass(frozen=True, eq=False)
class Detected:
    """Every first box of an object, R of them, beside its truth.

    chance (R,) : row of `Opportunities`.
    place (R,2) : from the sensor, x along its yaw, m.
    error (R,3) : of the centre, along and across the line of sight and upward, m.
    size (R,3), true_size (R,3) : m.
    yaw (R,), true_yaw (R,) : relative to the line of sight to the object, rad.
    score (R,) : confidence.
    """

    chance: IntArray
    place: FloatArray
    error: FloatArray
    size: FloatArray
    true_size: FloatArray
    yaw: FloatArray
    true_yaw: FloatArray
    score: FloatArray

    def take(self, rows: NDArray[Any]) -> Detected:
        """Only these rows (indices or a mask)."""
        return Detected(*(getattr(self, f.name)[rows] for f in fields(self)))

    @property
    def yaw_error(self) -> FloatArray:
        """The error of the heading in [-pi, pi), rad."""
        return wrap_angle(self.yaw - self.true_yaw)


@dataclass(frozen=True, eq=False)
class FalseAlarms:
    """Every box in view that is no object's first, R of them.

    recording (R,), frame (R,), label (R,) : where it is from, and what it says it is.
    position (R,2) : in the world, m.
    place (R,2) : from the sensor, x along its yaw, m.
    distance (R,), bearing (R,) : from the sensor, bearing relative to its yaw.
    heading (R,) : of the sensor, rad.
    size (R,3), yaw (R,), score (R,) : yaw relative to the line of sight.
    """

    recording: IntArray
    frame: IntArray
    label: IntArray
    position: FloatArray
    place: FloatArray
    distance: FloatArray
    bearing: FloatArray
    heading: FloatArray
    size: FloatArray
    yaw: FloatArray
    score: FloatArray


@dataclass(frozen=True, eq=False)
class Observations:
    """Opportunities, detections and false boxes of some recordings.

    frames (S,) : delivered frames of each; truth_frames (S,) : frames of truth of each.
    fields_of_view (S,2) : half-angle, rad, and maximum range, m, of each.
    """

    chances: Opportunities
    hits: Detected
    falses: FalseAlarms
    frames: IntArray
    truth_frames: IntArray
    fields_of_view: FloatArray


def gather(recordings: Sequence[Recording]) -> Observations:
    """The evidence of recordings.

    Raises InputError for no recordings, or one without origins.
    """
    if not recordings:
        raise InputError("no recordings to learn from", expected="one or more")
    parts = [_gather(number, recording) for number, recording in enumerate(recordings)]
    offset = np.cumsum([0] + [len(chances.found) for chances, _, _ in parts])
    hits = [
        Detected(hits.chance + start, *(getattr(hits, f.name) for f in fields(hits)[1:]))
        for (_, hits, _), start in zip(parts, offset, strict=False)
    ]
    return Observations(
        chances=_joined(Opportunities, [chances for chances, _, _ in parts]),
        hits=_joined(Detected, hits),
        falses=_joined(FalseAlarms, [falses for _, _, falses in parts]),
        frames=np.array([len(np.unique(recording.frame)) for recording in recordings]),
        truth_frames=np.array([len(recording) for recording in recordings]),
        fields_of_view=np.array([[r.site.fov_half_angle, r.site.max_range] for r in recordings]),
    )


def _joined(kind: Any, tables: list[Any]) -> Any:
    return kind(*(np.concatenate([getattr(t, f.name) for t in tables]) for f in fields(kind)))


def _gather(number: int, recording: Recording) -> tuple[Opportunities, Detected, FalseAlarms]:
    if recording.origin is None:
        raise InputError(
            f"recording '{recording.name}' does not know where its boxes come from",
            field="origin",
        )
    scene = replay(recording)
    seen = targets(scene)
    seen = seen.take(np.isin(seen.frame, recording.frame))
    start = np.zeros(len(scene) + 1, dtype=np.int64)
    start[1:] = np.cumsum([len(frame) for frame in scene.truth])
    chance_of = np.full(start[-1] + 1, -1)
    chance_of[start[seen.frame] + seen.row] = np.arange(len(seen))

    sizes = [len(detections) for detections in recording.detections]
    delivery = np.repeat(np.arange(len(sizes)), sizes)
    box = {
        name: np.concatenate([getattr(d, name) for d in recording.detections])
        for name in ("position", "size", "yaw", "score", "label")
    }
    origin = np.concatenate(recording.origin)
    first = np.concatenate(
        [
            first_boxes(detections.score, rows)
            for detections, rows in zip(recording.detections, recording.origin, strict=True)
        ]
    )
    frame = recording.frame[delivery]
    pose = np.array([detections.sensor_pose for detections in recording.detections])[delivery]
    distance, bearing = polar(box["position"], pose)

    relative = wrap_angle(bearing - pose[:, 2])
    place = distance[:, None] * np.stack([np.cos(relative), np.sin(relative)], axis=1)

    chance = np.where(first, chance_of[start[frame] + np.maximum(origin, 0)], -1)
    hit = chance >= 0
    true = seen.take(chance[hit])
    found = np.zeros(len(seen), dtype=bool)
    found[chance[hit]] = True
    offset = box["position"][hit] - true.position
    cos, sin = np.cos(true.bearing), np.sin(true.bearing)
    hits = Detected(
        chance=chance[hit],
        place=place[hit],
        error=np.stack(
            [
                offset[:, 0] * cos + offset[:, 1] * sin,
                -offset[:, 0] * sin + offset[:, 1] * cos,
                offset[:, 2],
            ],
            axis=1,
        ),
        size=box["size"][hit],
        true_size=true.size,
        yaw=wrap_angle(box["yaw"][hit] - true.bearing),
        true_yaw=wrap_angle(true.yaw - true.bearing),
        score=box["score"][hit],
    )
    false = ~first & in_view(scene.site, distance, relative)
    falses = FalseAlarms(
        recording=np.full(np.count_nonzero(false), number),
        frame=frame[false],
        label=box["label"][false].astype(np.int64),
        position=box["position"][false, :2],
        place=place[false],
        distance=distance[false],
        bearing=relative[false],
        heading=pose[false, 2],
        size=box["size"][false],
        yaw=wrap_angle(box["yaw"][false] - bearing[false]),
        score=box["score"][false],
    )
    chances = Opportunities(
        recording=np.full(len(seen), number),
        object_id=seen.object_id,
        frame=seen.frame,
        label=seen.label,
        distance=seen.distance,
        visibility=seen.visibility,
        found=found,
    )
    return chances, hits, falses
