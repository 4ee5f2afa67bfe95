"""Recordings from the boxes and poses that a dataset's reader found, frame by frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from pmbm.datasets.poses import Pose
from pmbm.types import (
    BoolArray,
    Detections,
    FloatArray,
    GroundTruth,
    IntArray,
    Label,
    Recording,
    Site,
    Tracks,
    TrackSequence,
)


@dataclass(frozen=True, eq=False, kw_only=True)
class SourceBoxes:
    """The boxes of one frame in the sensor's frame (x forward, y left, z up), upright in it.

    position (N,3), size (N,3), yaw (N,) : centre, length width height, heading; m, rad.
    label (N,) : `Label` values.
    name (N,) : the source's ids; empty for detections.
    score, raw_score (N,) or None : of detections.
    visibility (N,), observable (N,) or None : of truth; all seen where None.
    velocity (N,2) or None : of truth, in the world, m/s.
    """

    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    label: IntArray
    name: Sequence[str] = ()
    score: FloatArray | None = None
    raw_score: FloatArray | None = None
    visibility: FloatArray | None = None
    observable: BoolArray | None = None
    velocity: FloatArray | None = None


def box_table(rows: Sequence[Sequence[float]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Position (N,3), size (N,3) and yaw (N,) from rows x y z, l w h, yaw."""
    table = np.array(rows, dtype=np.float64).reshape(-1, 7)
    return table[:, :3], table[:, 3:6], table[:, 6]


def detection_frame(
    time: float, pose: Pose, boxes: SourceBoxes, sensor_pose: FloatArray
) -> Detections:
    """One delivery in the world."""
    n = len(boxes.position)
    return Detections(
        time=time,
        position=pose.to_world(boxes.position),
        size=boxes.size,
        yaw=pose.yaw_to_world(boxes.yaw),
        score=np.ones(n) if boxes.score is None else boxes.score,
        raw_score=boxes.raw_score,
        label=boxes.label.astype(np.int64),
        sensor_pose=sensor_pose,
    )


def truth_frames(
    times: FloatArray,
    poses: Sequence[Pose],
    frames: Sequence[SourceBoxes],
    *,
    ids: Sequence[IntArray] | None = None,
) -> tuple[tuple[GroundTruth, ...], dict[int, str]]:
    """The truth in the world and the source's id of each id.

    Ids, where not given, are numbered by first appearance.  Velocities that a source does not give
    are differences of positions: central where the object is in both neighbouring frames, one-sided
    where it is in one, zero where it is in none.
    """
    number: dict[str, int] = {}
    for boxes in frames:
        for name in boxes.name:
            number.setdefault(name, len(number))
    if ids is None:
        ids = [np.array([number[name] for name in boxes.name], dtype=np.int64) for boxes in frames]
    places = [pose.to_world(boxes.position) for pose, boxes in zip(poses, frames, strict=True)]
    speeds = _differences(times, ids, places)
    truth = []
    for k, (pose, boxes) in enumerate(zip(poses, frames, strict=True)):
        n = len(ids[k])
        truth.append(
            GroundTruth(
                time=float(times[k]),
                id=ids[k],
                position=places[k],
                size=boxes.size,
                yaw=pose.yaw_to_world(boxes.yaw),
                velocity=speeds[k] if boxes.velocity is None else boxes.velocity,
                label=boxes.label.astype(np.int64),
                visibility=np.ones(n) if boxes.visibility is None else boxes.visibility,
                observable=np.ones(n, bool) if boxes.observable is None else boxes.observable,
                crashed=np.zeros(n, bool),
            )
        )
    return tuple(truth), {value: key for key, value in number.items()}


def _differences(
    times: FloatArray, ids: Sequence[IntArray], places: Sequence[FloatArray]
) -> list[FloatArray]:
    row_of = [{object_id: row for row, object_id in enumerate(frame.tolist())} for frame in ids]
    speeds = []
    for k, frame in enumerate(ids):
        speed = np.zeros((len(frame), 2))
        for row, object_id in enumerate(frame.tolist()):
            known = [
                (times[j], places[j][row_of[j][object_id], :2])
                for j in (k - 1, k, k + 1)
                if 0 <= j < len(ids) and object_id in row_of[j]
            ]
            if len(known) > 1:
                (start, first), (end, last) = known[0], known[-1]
                speed[row] = (last - first) / (end - start)
        speeds.append(speed)
    return speeds


def recording(
    *,
    name: str,
    stamp: Sequence[int],
    times: FloatArray,
    poses: Sequence[Pose],
    truth: Sequence[SourceBoxes],
    detections: Sequence[SourceBoxes | None],
    site: Site,
    provenance: Mapping[str, Any],
    sensor_poses: Sequence[FloatArray] | None = None,
) -> Recording:
    """All frames in the world; a frame whose detections are None has no delivery.

    poses : of the frame that boxes are given in.
    sensor_poses : x, y, yaw of the sensor, where that is another.
    """
    sensors = [pose.planar for pose in poses] if sensor_poses is None else sensor_poses
    frames, object_name = truth_frames(times, poses, truth)
    delivered = [k for k, boxes in enumerate(detections) if boxes is not None]
    return Recording(
        name=name,
        site=site,
        truth=frames,
        detections=tuple(
            detection_frame(float(times[k]), poses[k], boxes, sensors[k])
            for k, boxes in enumerate(detections)
            if boxes is not None
        ),
        frame=np.array(delivered, dtype=np.int64),
        stamp=np.array(stamp, dtype=np.int64),
        object_name=object_name,
        provenance=provenance,
    )


def track_frames(
    times: FloatArray,
    poses: Sequence[Pose],
    frames: Sequence[SourceBoxes],
    *,
    ids: Sequence[IntArray],
) -> TrackSequence:
    """Results read from a file, in the world; velocities are those of `truth_frames`."""
    truth, _ = truth_frames(times, poses, frames, ids=ids)
    return TrackSequence(
        steps=tuple(
            Tracks(
                time=frame.time,
                id=frame.id,
                position=frame.position,
                size=frame.size,
                yaw=frame.yaw,
                velocity=frame.velocity,
                score=np.ones(len(frame)) if boxes.score is None else boxes.score,
                label=frame.label,
            )
            for frame, boxes in zip(truth, frames, strict=True)
        ),
        frame=np.arange(len(truth)),
    )


def merge(parts: Sequence[SourceBoxes]) -> SourceBoxes:
    """The boxes of several sources in one frame; what any part lacks is None."""
    if not parts:
        return nothing()

    def joined(name: str) -> Any:
        values = [getattr(part, name) for part in parts]
        return None if any(value is None for value in values) else np.concatenate(values)

    return SourceBoxes(
        name=[name for part in parts for name in part.name],
        **{f.name: joined(f.name) for f in fields(SourceBoxes) if f.name != "name"},
    )


def box_corners(position: FloatArray, size: FloatArray, yaw: FloatArray) -> FloatArray:
    """The eight corners (N,8,3) of upright boxes; bits 0, 1, 2 of a corner's index are its side in
    length, width and height."""
    sign = np.array([[(i >> bit & 1) - 0.5 for bit in range(3)] for i in range(8)])
    local = sign * size[:, None]
    cos, sin = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x = local[..., 0] * cos - local[..., 1] * sin
    y = local[..., 0] * sin + local[..., 1] * cos
    return np.stack([x, y, local[..., 2]], axis=-1) + position[:, None]


def nothing() -> SourceBoxes:
    """A frame without boxes."""
    return SourceBoxes(
        position=np.zeros((0, 3)),
        size=np.zeros((0, 3)),
        yaw=np.zeros(0),
        label=np.zeros(0, np.int64),
    )


def named_labels(names: Sequence[str], table: Mapping[str, Label]) -> IntArray:
    """The labels of a dataset's class names."""
    return np.array([table[name] for name in names], dtype=np.int64)
