"""A trial as compact data for the page: columns of integers, packed.

Every per-row quantity is a column of fixed-point integers (centimetres, milliradians).  Rows are
sorted by object, then frame, so that differences between neighbours are small; the differences
are zigzag-coded, split into byte planes, deflated and written as base64.  300 frames of 50 boxes
with their detections and one tracker take about 0.3 MB.  The intensity of undetected objects is a
grid of bytes a step, as differences to the step before: at most 1.5 million cells in all.
"""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.labels import Label
from pmbm.reports.hidden_grid import CODES, DECADES, LOWEST, hidden_grid
from pmbm.reports.matching import BoolPair, first_detection, identity_switches, matched
from pmbm.reports.values import ReplayPage
from pmbm.types import CLUTTER, FloatArray, IntArray, Recording, Tracks, TrackSequence

METRE, RADIAN, SHARE, SPEED = 0.01, 0.001, 0.01, 0.05
"""Resolution of lengths, angles, shares and speeds; far finer than a screen shows."""

_LARGEST = 5e8
"""Of a packed integer: what zigzag codes of differences hold, in 32 bits."""

PLOTTED = ("gospa", "gospa_localisation", "gospa_missed", "gospa_false")

OBSERVABLE, CRASHED, DETECTED = 1, 2, 4
"""Bits of a truth row's flags; DETECTED: the detector has reported the object by this frame."""


def encode_replay(replay: ReplayPage) -> dict[str, Any]:
    """The replay as a JSON-able dict; `templates/replay/decode.js` is its reader."""
    recording = replay.recording
    centre = _centre(recording)
    blob = _Blob()
    matches = {
        name: [
            matched(recording.truth[frame], step)
            for frame, step in zip(tracks.frame.tolist(), tracks, strict=True)
        ]
        for name, tracks in replay.tracks.items()
    }
    return {
        "name": recording.name,
        "title": replay.title,
        "start": min(max(replay.start, 0), max(len(recording) - 1, 0)),
        "centre": centre.tolist(),
        "times": [round(frame.time, 4) for frame in recording.truth],
        "labels": [label.name.lower() for label in Label],
        "site": _site(recording, centre),
        "poses": _poses(recording, centre, blob),
        "truth": _truth(recording, centre, blob),
        "detections": _detections(recording, centre, blob),
        "trackers": [
            {
                "name": name,
                **_tracks(tracks, matches[name], centre, blob),
                "switches": _switches(recording, tracks),
                "missed": _missed(recording, tracks, matches[name], blob),
                "undetected": _undetected(recording, replay.maps.get(name, tracks), centre, blob),
                "steps": tracks.frame.tolist(),
                "series": _series(replay.series.get(name, {})),
            }
            for name, tracks in replay.tracks.items()
        ],
        "blob": blob.text(),
    }


class _Blob:
    """Columns of integers, one after the other."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._bytes = 0

    def table(self, **columns: tuple[ArrayLike, float]) -> dict[str, Any]:
        """Pack columns, each with its resolution; the reader finds them by the given offsets."""
        places = {}
        rows = 0
        for name, (values, resolution) in columns.items():
            scaled = np.asarray(values, dtype=np.float64) / resolution
            integers = np.rint(np.clip(scaled, -_LARGEST, _LARGEST)).astype(np.int64)
            rows = len(integers)
            places[name] = [self._bytes, resolution]
            self._add(integers)
        return {"rows": rows, "columns": places}

    def _add(self, integers: IntArray) -> None:
        steps = np.diff(integers, prepend=0).astype(np.int32)
        zigzag = ((steps << 1) ^ (steps >> 31)).astype("<u4")
        planes = np.ascontiguousarray(zigzag.view(np.uint8).reshape(-1, 4).T)
        self._parts.append(planes.tobytes())
        self._bytes += planes.size

    def raw(self, values: NDArray[np.uint8]) -> int:
        """Bytes as they are; the place where they begin."""
        begin = self._bytes
        self._parts.append(values.tobytes())
        self._bytes += values.size
        return begin

    def text(self) -> str:
        return base64.b64encode(zlib.compress(b"".join(self._parts), 9)).decode("ascii")


def _truth(recording: Recording, centre: FloatArray, blob: _Blob) -> dict[str, Any]:
    frames = [(index, frame) for index, frame in enumerate(recording.truth) if len(frame)]
    rows = _stack((index, len(frame)) for index, frame in frames)
    ids = _column([frame.id for _, frame in frames], np.int64)
    order = np.lexsort((rows, ids))
    known, which = np.unique(ids, return_inverse=True)
    first_seen = first_detection(recording)
    seen = np.array([first_seen.get(int(i), len(recording)) for i in known])
    pick = _Picker(frames, order)
    flags = (
        OBSERVABLE * pick("observable").astype(np.int64)
        + CRASHED * pick("crashed").astype(np.int64)
        + DETECTED * (seen[which[order]] <= rows[order])
    )
    return {
        "ids": [str(i) for i in known.tolist()],
        "names": [recording.object_name.get(i, "") for i in known.tolist()],
        **blob.table(
            frame=(rows[order], 1),
            object=(which[order], 1),
            **_box_columns(pick, centre),
            **_velocity_columns(pick),
            visibility=(pick("visibility"), SHARE),
            flags=(flags, 1),
        ),
    }


def _detections(recording: Recording, centre: FloatArray, blob: _Blob) -> dict[str, Any]:
    deliveries = [
        (int(recording.frame[d]), value)
        for d, value in enumerate(recording.detections)
        if len(value)
    ]
    rows = _stack((index, len(value)) for index, value in deliveries)
    origin = np.full(len(rows), CLUTTER)
    known: IntArray = np.zeros(0, np.int64)
    if recording.origin is not None:
        full = [d for d, value in enumerate(recording.detections) if len(value)]
        ids = [
            np.where(
                recording.origin[d] == CLUTTER,
                CLUTTER,
                np.append(recording.truth[recording.frame[d]].id, CLUTTER)[recording.origin[d]],
            )
            for d in full
        ]
        flat = _column(ids, np.int64)
        clutter = _column([recording.origin[d] == CLUTTER for d in full], np.bool_)
        known, which = np.unique(flat[~clutter], return_inverse=True)
        origin[~clutter] = which
    order = np.lexsort((rows, origin))
    pick = _Picker(deliveries, order)
    names = [one.name for one in recording.site.sensors]
    sensors = {}
    if names:
        number = [(names.index(value.sensor), len(value)) for _, value in deliveries]
        sensors = {"sensor": (_stack(number)[order], 1)}
    return {
        "origins": None if recording.origin is None else [str(i) for i in known.tolist()],
        **blob.table(
            frame=(rows[order], 1),
            origin=(origin[order], 1),
            **_box_columns(pick, centre),
            score=(pick("score"), SHARE),
            **sensors,
        ),
    }


def _tracks(
    tracks: TrackSequence, matches: list[BoolPair], centre: FloatArray, blob: _Blob
) -> dict[str, Any]:
    indices = [s for s, step in enumerate(tracks) if len(step)]
    steps = [(int(tracks.frame[s]), tracks[s]) for s in indices]
    rows = _stack((index, len(step)) for index, step in steps)
    ids = _column([step.id for _, step in steps], np.int64)
    order = np.lexsort((rows, ids))
    known, which = np.unique(ids, return_inverse=True)
    pick = _Picker(steps, order)
    false = ~_column([matches[s][0] for s in indices], np.bool_)[order]
    columns = dict(
        frame=(rows[order], 1),
        object=(which[order], 1),
        **_box_columns(pick, centre),
        **_velocity_columns(pick),
        score=(pick("score"), SHARE),
        false=(false, 1),
    )
    if steps and all(step.covariance is not None for _, step in steps):
        covariance = _column([_planar(step) for _, step in steps], width=3)[order]
        columns |= {name: (covariance[:, k], METRE) for k, name in enumerate(("sx", "sy", "sxy"))}
    return {"ids": [str(i) for i in known.tolist()], **blob.table(**columns)}


def _planar(step: Tracks) -> FloatArray:
    """Standard deviations in x and y and the signed root of the covariance (K,3), m."""
    assert step.covariance is not None
    planar = step.covariance[:, :2, :2]
    variance = np.clip(planar[:, [0, 1], [0, 1]], 0.0, None)
    mixed = planar[:, 0, 1]
    return np.column_stack([np.sqrt(variance), np.sign(mixed) * np.sqrt(np.abs(mixed))])


def _missed(
    recording: Recording,
    tracks: TrackSequence,
    matches: list[BoolPair],
    blob: _Blob,
) -> dict[str, Any]:
    """Frame and object of every observable object that no track is near."""
    frames, objects = [], []
    known = np.unique(_column([frame.id for frame in recording.truth], np.int64))
    for frame, (_, found) in zip(tracks.frame.tolist(), matches, strict=True):
        truth = recording.truth[frame]
        lost = truth.id[~found & truth.observable]
        frames += [frame] * len(lost)
        objects += np.searchsorted(known, lost).tolist()
    order = np.lexsort((frames, objects))
    return blob.table(
        frame=(np.array(frames, dtype=np.int64)[order], 1),
        object=(np.array(objects, dtype=np.int64)[order], 1),
    )


def _switches(recording: Recording, tracks: TrackSequence) -> list[list[int | str]]:
    """Frame, and as text the object's id and its old and new track ids."""
    return [
        [switch.frame, str(switch.object), str(switch.old), str(switch.new)]
        for switch in identity_switches(recording, tracks)
    ]


def _undetected(
    recording: Recording, tracks: TrackSequence, centre: FloatArray, blob: _Blob
) -> dict[str, Any] | None:
    """The intensity of undetected objects, one window of cells a step."""
    grid = hidden_grid(recording, tracks, centre)
    if grid is None:
        return None
    change = np.diff(grid.code, axis=0, prepend=np.zeros_like(grid.code[:1]))
    return {
        "cell": grid.cell,
        "lowest": LOWEST,
        "decades": DECADES / (CODES - 1),
        "side": grid.code.shape[1],
        "codes": blob.raw(change),
        **blob.table(frame=(grid.frame, 1), i=(grid.corner[:, 0], 1), j=(grid.corner[:, 1], 1)),
    }


def _poses(recording: Recording, centre: FloatArray, blob: _Blob) -> dict[str, Any]:
    """Where the sensor was in each frame, or the carrier of several; the nearest delivery's pose
    where one is missing."""
    pose = np.zeros((len(recording), 3))
    if len(recording.detections):
        order = np.argsort(recording.frame, kind="stable")
        frames = recording.frame[order]
        given = np.array([recording.site.carrier_pose(recording.detections[d]) for d in order])
        last = np.clip(
            np.searchsorted(frames, np.arange(len(recording)), side="right") - 1, 0, None
        )
        pose = given[last]
    return blob.table(
        x=(pose[:, 0] - centre[0], METRE),
        y=(pose[:, 1] - centre[1], METRE),
        yaw=(np.unwrap(pose[:, 2]), RADIAN),
    )


def _site(recording: Recording, centre: FloatArray) -> dict[str, Any]:
    site = recording.site

    def rings(polygons: Iterable[FloatArray]) -> list[list[float]]:
        return [np.round(polygon - centre, 2).ravel().tolist() for polygon in polygons]

    return {
        "range": site.max_range,
        "fovCentre": site.fov_centre,
        "fovHalf": site.fov_half_angle,
        "occluders": rings(site.occluders),
        "sensors": [
            {
                "name": one.name,
                "mount": np.round(one.mount, 4).tolist(),
                "range": one.max_range,
                "fovCentre": one.fov_centre,
                "fovHalf": one.fov_half_angle,
            }
            for one in site.sensors
        ],
        "drivable": None if site.drivable_area is None else rings(site.drivable_area),
    }


def _centre(recording: Recording) -> FloatArray:
    """A point of the world near the traffic: datasets' coordinates are far from zero."""
    position = _column([frame.position for frame in recording.truth], width=3)
    return np.rint(position[:, :2].mean(axis=0)) if len(position) else np.zeros(2)


class _Picker:
    """A field of all frames' rows as one column, sorted."""

    def __init__(self, frames: list[tuple[int, Any]], order: NDArray[np.intp]) -> None:
        self._frames = frames
        self._order = order

    def __call__(self, name: str) -> NDArray[Any]:
        if not self._frames:
            width = {"position": (3,), "size": (3,), "velocity": (2,)}.get(name, ())
            return np.zeros((0, *width))
        return np.concatenate([getattr(value, name) for _, value in self._frames])[self._order]


def _box_columns(pick: _Picker, centre: FloatArray) -> dict[str, tuple[ArrayLike, float]]:
    position, size = pick("position"), pick("size")
    return {
        "x": (position[:, 0] - centre[0], METRE),
        "y": (position[:, 1] - centre[1], METRE),
        "yaw": (pick("yaw"), RADIAN),
        "length": (size[:, 0], METRE),
        "width": (size[:, 1], METRE),
        "label": (pick("label"), 1),
    }


def _velocity_columns(pick: _Picker) -> dict[str, tuple[ArrayLike, float]]:
    velocity = pick("velocity")
    return {"vx": (velocity[:, 0], SPEED), "vy": (velocity[:, 1], SPEED)}


def _stack(counts: Iterable[tuple[int, int]]) -> IntArray:
    """Each index repeated as often as its count says."""
    pairs = np.array(list(counts), dtype=np.int64).reshape(-1, 2)
    return np.repeat(pairs[:, 0], pairs[:, 1])


def _column(parts: list[Any], dtype: Any = np.float64, width: int | None = None) -> NDArray[Any]:
    empty = np.zeros((0,) if width is None else (0, width), dtype)
    return np.concatenate([empty, *parts])


def _series(series: Mapping[str, FloatArray]) -> dict[str, list[float | None]]:
    """The plotted series; over observable objects where that is given, as the marks are."""
    chosen = {name: series.get(f"{name}_observable", series.get(name)) for name in PLOTTED}
    return {name: _rounded(values) for name, values in chosen.items() if values is not None}


def _rounded(values: ArrayLike) -> list[float | None]:
    """Four significant digits, or None where undefined."""
    return [
        float(f"{value:.4g}") if np.isfinite(value) else None
        for value in np.asarray(values, dtype=np.float64).tolist()
    ]


__all__ = ["encode_replay"]
