"""Columns of tables from recordings and tracks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pmbm.arrays import FloatArray
from pmbm.errors import InputError
from pmbm.labels import Label

if TYPE_CHECKING:
    from pmbm.types import Recording, TrackSequence


def recording_columns(recording: Recording) -> dict[str, dict[str, NDArray[Any]]]:
    """Table -> column -> cells.

    Raises InputError where some deliveries have raw scores and others have not, and where one has
    a velocity of its sensor and no radial ones.
    """
    return {
        "truth": truth_columns(recording),
        "detections": detection_columns(recording),
        "poses": pose_columns(recording),
    }


def truth_columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """Column -> cells of a recording's truth."""
    truth = recording.truth
    count = [len(frame) for frame in truth]
    identity = _joined([frame.id for frame in truth], np.int64)
    names = recording.object_name
    return {
        "frame": np.repeat(np.arange(len(truth)), count),
        "time": np.repeat([frame.time for frame in truth], count),
        "id": identity,
        **_box_columns(truth),
        **_velocity_columns(truth),
        "class": _class_names(truth),
        "visibility": _joined([frame.visibility for frame in truth], np.float64),
        "observable": _joined([frame.observable for frame in truth], np.bool_),
        "crashed": _joined([frame.crashed for frame in truth], np.bool_),
        "name": np.array([names.get(i) for i in identity.tolist()], dtype=object),
        **_observable_by(recording),
    }


def detection_columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """Column -> cells of a recording's detections, delivery by delivery."""
    seen = recording.detections
    count = [len(delivery) for delivery in seen]
    columns = {
        "frame": np.repeat(recording.frame, count),
        "time": np.repeat([recording.truth[f].time for f in recording.frame.tolist()], count),
        **_box_columns(seen),
        "score": _joined([delivery.score for delivery in seen], np.float64),
    }
    for delivery in seen:
        if (delivery.radial_velocity is None) != (delivery.sensor_velocity is None):
            raise InputError(
                "a velocity of the sensor without radial ones", field="sensor_velocity"
            )
    raw = [delivery.raw_score for delivery in seen]
    if any(scores is not None for scores in raw):
        if any(scores is None for scores in raw):
            raise InputError("raw scores in some deliveries and not in others", field="raw_score")
        columns["raw_score"] = _joined([scores for scores in raw if scores is not None], np.float64)
    columns["class"] = _class_names(seen)
    if recording.origin is not None:
        caused = []
        for frame, origin in zip(recording.frame.tolist(), recording.origin, strict=True):
            identity = recording.truth[frame].id
            caused += [str(identity[row]) if row >= 0 else None for row in origin.tolist()]
        columns["truth_id"] = np.array(caused, dtype=object)
    if any(delivery.sensor for delivery in seen):
        columns["sensor"] = np.repeat(np.array([d.sensor or None for d in seen], object), count)
    if any(delivery.sensor_velocity is not None for delivery in seen):
        none = [np.full(n, np.nan) for n in count]
        radial = [d.radial_velocity for d in seen]
        columns["radial_velocity"] = _joined(
            [n if r is None else r for n, r in zip(none, radial, strict=True)], np.float64
        )
    pairs = zip(recording.frame.tolist(), [delivery.sensor for delivery in seen], strict=True)
    if len(set(pairs)) < len(seen):
        columns["delivery"] = np.repeat(np.arange(len(seen)), count)
    return columns


def _observable_by(recording: Recording) -> dict[str, NDArray[Any]]:
    """The column of the same name, of a recording of several sensors."""
    if not recording.observable_by:
        return {}
    names = list(recording.observable_by)
    flags = [_joined(list(recording.observable_by[name]), np.bool_) for name in names]
    said = [
        " ".join(name for name, flag in zip(names, row, strict=True) if flag) or None
        for row in zip(*(flag.tolist() for flag in flags), strict=True)
    ]
    return {"observable_by": np.array(said, dtype=object)}


def pose_columns(recording: Recording) -> dict[str, NDArray[Any]]:
    """Column -> cells of a recording's frames and sensor poses: a row a delivery, in order of
    arrival, and one for each frame that has none."""
    frame, frames = recording.frame, len(recording.truth)
    absent = np.setdiff1d(np.arange(frames), frame)
    latest = np.maximum.accumulate(frame) if len(frame) else frame
    at = np.searchsorted(latest, absent)
    whole = np.insert(frame, at, absent)
    delivered = np.insert(np.ones(len(frame), bool), at, False)
    time = np.array([value.time for value in recording.truth])[whole]
    poses = np.full((len(whole), 3), np.nan)
    poses[delivered] = np.array([d.sensor_pose for d in recording.detections]).reshape(-1, 3)
    columns = {
        "frame": whole,
        "time": time,
        "stamp": recording.stamp[whole],
        "x": poses[:, 0],
        "y": poses[:, 1],
        "yaw": poses[:, 2],
        "delivered": delivered,
    }
    own = time.copy()
    own[delivered] = [delivery.time for delivery in recording.detections]
    if (own != time).any():
        columns["delivery_time"] = own
    if any(delivery.sensor for delivery in recording.detections):
        names = np.full(len(whole), None, dtype=object)
        names[delivered] = [delivery.sensor or None for delivery in recording.detections]
        columns["sensor"] = names
    if any(delivery.sensor_velocity is not None for delivery in recording.detections):
        velocity = np.full((len(whole), 2), np.nan)
        velocity[delivered] = [
            (np.nan, np.nan) if d.sensor_velocity is None else d.sensor_velocity
            for d in recording.detections
        ]
        columns |= {"vx": velocity[:, 0], "vy": velocity[:, 1]}
    return columns


def track_columns(
    tracks: TrackSequence, frame: NDArray[Any], time: FloatArray
) -> dict[str, NDArray[Any]]:
    """Column -> cells of tracks.  frame (F,), time (F,) : what each frame of the recording is
    called, and its time."""
    count = [len(step) for step in tracks]
    whole = np.repeat(tracks.frame, count)
    return {
        "frame": frame[whole],
        "time": time[whole],
        "id": _joined([step.id for step in tracks], np.int64),
        **_box_columns(tracks.steps),
        **_velocity_columns(tracks.steps),
        "score": _joined([step.score for step in tracks], np.float64),
        "class": _class_names(tracks.steps),
    }


def _box_columns(frames: Any) -> dict[str, NDArray[Any]]:
    position = np.concatenate([np.zeros((0, 3)), *(frame.position for frame in frames)])
    size = np.concatenate([np.zeros((0, 3)), *(frame.size for frame in frames)])
    return {
        **dict(zip("xyz", position.T, strict=True)),
        **dict(zip(("length", "width", "height"), size.T, strict=True)),
        "yaw": _joined([frame.yaw for frame in frames], np.float64),
    }


def _velocity_columns(frames: Any) -> dict[str, NDArray[Any]]:
    velocity = np.concatenate([np.zeros((0, 2)), *(frame.velocity for frame in frames)])
    return dict(zip(("vx", "vy"), velocity.T, strict=True))


def _class_names(frames: Any) -> NDArray[Any]:
    names = np.array([label.name.lower() for label in Label], dtype=object)
    return names[_joined([frame.label for frame in frames], np.int64)]


def _joined(parts: list[NDArray[Any]], dtype: Any) -> NDArray[Any]:
    return np.concatenate([np.zeros(0, dtype), *parts]).astype(dtype, copy=False)
