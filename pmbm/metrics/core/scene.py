"""Truth and tracks of a run in flat tables: what every metric reads.

Rows are sorted by frame and, inside a frame, by id, so that no metric can depend on the order of
objects inside a frame.  Distances of a frame's pairs are computed once and shared.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import InputError
from pmbm.geometry import paired_iou
from pmbm.types import GroundTruth, Recording, Tracks, TrackSequence


@dataclass(frozen=True, eq=False, kw_only=True)
class BoxRows:
    """The boxes of one side of the comparison over all frames.

    frame, id (N,) : rows sorted by frame, then id; each id at most once in a frame.
    position (N,3), size (N,3), yaw (N,), velocity (N,2), label (N,) : as in `pmbm.types`.
    score (N,) : existence probability or confidence; 1 for truth.
    observable (N,) : True for tracks.
    covariance (N,4,4) : of [x, y, vx, vy]; NaN rows where the tracker gives none.
    """

    frame: IntArray
    id: IntArray
    position: FloatArray
    size: FloatArray
    yaw: FloatArray
    velocity: FloatArray
    label: NDArray[np.int8]
    score: FloatArray
    observable: BoolArray
    covariance: FloatArray

    def __len__(self) -> int:
        return len(self.id)

    def take(self, rows: ArrayLike) -> BoxRows:
        """The same with these rows only (a mask, or indices in ascending order)."""
        index = np.asarray(rows)
        return BoxRows(**{f.name: getattr(self, f.name)[index] for f in fields(self)})

    def count(self, frames: int) -> IntArray:
        """Rows in each of `frames` frames, (F,)."""
        return np.bincount(self.frame, minlength=frames)

    @cached_property
    def ids(self) -> IntArray:
        """The distinct ids, ascending."""
        return np.unique(self.id)

    @cached_property
    def index(self) -> IntArray:
        """The place in `ids` of each row's id, (N,)."""
        return np.searchsorted(self.ids, self.id)

    @cached_property
    def by_object(self) -> IntArray:
        """The rows sorted by id, then frame, (N,)."""
        return np.lexsort((self.frame, self.id))


@dataclass(frozen=True, eq=False, kw_only=True)
class NearPairs:
    """All truth and track rows of the same frame, in order of truth row, then track row.

    frame, truth, track (Q,) : the frame, and rows of the two `BoxRows`.
    distance (Q,) : between centres in (x, y), m.
    distance_xyz (Q,) : between centres in (x, y, z), m.
    """

    frame: IntArray
    truth: IntArray
    track: IntArray
    distance: FloatArray
    distance_xyz: FloatArray

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: ArrayLike) -> NearPairs:
        index = np.asarray(rows)
        return NearPairs(**{f.name: getattr(self, f.name)[index] for f in fields(self)})


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoredScene:
    """A run to be scored: F frames of truth and tracks.

    time (F,) : s, increasing.
    truth, tracks : the two sides.
    """

    time: FloatArray
    truth: BoxRows
    tracks: BoxRows

    def __len__(self) -> int:
        """Frames."""
        return len(self.time)

    @property
    def period(self) -> float | None:
        """Median time between frames, s, or None with fewer than two frames."""
        return float(np.median(np.diff(self.time))) if len(self.time) > 1 else None

    @cached_property
    def pairs(self) -> NearPairs:
        """Every pair of a truth and a track of the same frame."""
        return _measured(self, *pair_rows(self.truth.frame, self.tracks.count(len(self))))

    def near(self, distance: float) -> NearPairs:
        """The pairs whose centres are nearer than this in (x, y), m; kept for smaller distances."""
        reach, pairs = self.__dict__.get("_near", (-np.inf, None))
        if reach < distance:
            pairs = _near_pairs(self, distance)
            self.__dict__["_near"] = (distance, pairs)
        elif distance < reach:
            pairs = pairs.take(pairs.distance < distance)
        return pairs

    def with_rows(self, truth: ArrayLike, tracks: ArrayLike) -> ScoredScene:
        """The same frames with only these rows of either side."""
        return ScoredScene(
            time=self.time, truth=self.truth.take(truth), tracks=self.tracks.take(tracks)
        )


def _measured(scene: ScoredScene, truth: IntArray, track: IntArray) -> NearPairs:
    """These pairs of rows with their distances."""
    offset = scene.truth.position[truth] - scene.tracks.position[track]
    offset *= offset
    flat = offset[:, 0] + offset[:, 1]
    return NearPairs(
        frame=scene.truth.frame[truth],
        truth=truth,
        track=track,
        distance=np.sqrt(flat),
        distance_xyz=np.sqrt(flat + offset[:, 2]),
    )


def _near_pairs(scene: ScoredScene, distance: float) -> NearPairs:
    """The pairs nearer than `distance`, found by sweeping along x or y in all frames at once."""
    truth, tracks = scene.truth, scene.tracks
    if len(truth) == 0 or len(tracks) == 0:
        return scene.pairs
    own, theirs = truth.position[:, :2].T.copy(), tracks.position[:, :2].T.copy()
    low = np.minimum(own.min(axis=1), theirs.min(axis=1))
    extent = np.maximum(own.max(axis=1), theirs.max(axis=1)) - low
    axis = int(extent[1] > extent[0])
    # Frames lie one after the other along one line, too far apart to meet.
    stride = extent[axis] + 2 * distance + 1.0
    truth_key = truth.frame * stride + (own[axis] - low[axis])
    track_key = tracks.frame * stride + (theirs[axis] - low[axis])
    rounding = 8 * np.finfo(np.float64).eps * (len(scene) * stride + np.abs(low).max())
    margin = distance + rounding
    order = np.argsort(track_key)
    track_key = track_key[order]
    first = np.searchsorted(track_key, truth_key - margin)
    beyond = np.searchsorted(track_key, truth_key + margin)
    a, place = _ranges(first, beyond)
    across = own[1 - axis][a] - theirs[1 - axis][order][place]
    near = np.flatnonzero(np.abs(across) < margin)
    a, b = a[near], order[place[near]]
    # By track inside each truth row, which the sweep leaves in order of place.
    in_order = np.argsort(a * np.int64(len(tracks)) + b)
    pairs = _measured(scene, a[in_order], b[in_order])
    return pairs.take(np.flatnonzero(pairs.distance < distance))


def _ranges(first: IntArray, beyond: IntArray) -> tuple[IntArray, IntArray]:
    """The numbers first[i] to beyond[i] - 1 for every i: which i (E,), and the number (E,)."""
    count = beyond - first
    which = np.repeat(np.arange(len(first)), count)
    begin = np.cumsum(count) - count
    return which, np.arange(len(which)) - np.repeat(begin - first, count)


def pair_overlap(scene: ScoredScene, *, vertical: bool = True) -> FloatArray:
    """Intersection over union of the scene's pairs (Q,): of rotated boxes' volumes, or with
    `vertical=False` of their bird's-eye areas."""
    truth, tracks, pairs = scene.truth, scene.tracks, scene.pairs
    overlap = np.zeros(len(pairs))
    reach = np.hypot(truth.size[:, 0], truth.size[:, 1])[pairs.truth]
    reach += np.hypot(tracks.size[:, 0], tracks.size[:, 1])[pairs.track]
    near = np.flatnonzero(pairs.distance < reach / 2)
    a, b = pairs.truth[near], pairs.track[near]
    overlap[near] = paired_iou(
        truth.position[a],
        truth.size[a],
        truth.yaw[a],
        tracks.position[b],
        tracks.size[b],
        tracks.yaw[b],
        vertical=vertical,
    )
    return overlap


def pair_rows(truth_frame: IntArray, tracks_per_frame: IntArray) -> tuple[IntArray, IntArray]:
    """Rows (Q,) and (Q,) of all truth and track pairs of a frame, both sides sorted by frame."""
    beyond = np.cumsum(tracks_per_frame)
    return _ranges((beyond - tracks_per_frame)[truth_frame], beyond[truth_frame])


def scene_of(recording: Recording, tracks: TrackSequence | Sequence[Tracks]) -> ScoredScene:
    """The frames that were stepped, against the truth of those frames.

    Raises InputError where `tracks` has frames that the recording has not, is a plain sequence of
    another length than the recording, or has times that do not increase.
    """
    if isinstance(tracks, TrackSequence):
        frame = tracks.frame
        if len(frame) and frame[-1] >= len(recording):
            raise InputError(
                f"tracks and recording '{recording.name}' have unequal frames",
                frame=int(frame[-1]),
                field="frame",
                expected=f"0 to {len(recording) - 1}",
                got=int(frame[-1]),
            )
    else:
        if len(tracks) != len(recording):
            raise InputError(
                f"tracks and recording '{recording.name}' have unequal frames",
                field="tracks",
                expected=f"{len(recording)} frames",
                got=len(tracks),
                hint="give the TrackSequence of run(), which knows its frames, or one Tracks value "
                "per frame of truth",
            )
        frame = np.arange(len(recording))
    return make_scene([recording.truth[k] for k in frame], tracks)


def make_scene(truth: Sequence[GroundTruth], tracks: Iterable[Tracks]) -> ScoredScene:
    """The scene of these frames, `tracks[k]` reported for `truth[k]`.

    Raises InputError where their numbers differ or times do not increase.
    """
    reports = list(tracks)
    for position, report in enumerate(reports):
        if not isinstance(report, Tracks):
            raise InputError(
                "not tracks", frame=position, expected="pmbm.Tracks", got=type(report).__name__
            )
    if len(truth) != len(reports):
        raise InputError(
            "truth and tracks have unequal frames",
            field="tracks",
            expected=f"{len(truth)} frames",
            got=len(reports),
        )
    time = np.array([frame.time for frame in truth], dtype=np.float64)
    check_increasing(time, "truth")
    check_increasing(np.array([report.time for report in reports]), "tracks")
    return ScoredScene(time=time, truth=_truth_boxes(truth), tracks=_track_boxes(reports))


def check_increasing(time: FloatArray, what: str) -> None:
    """Raise InputError, naming the first frame, where times do not increase."""
    unordered = np.flatnonzero(np.diff(time) <= 0) + 1
    if len(unordered):
        raise InputError(
            f"times of the {what} must increase",
            frame=int(unordered[0]),
            field="time",
            expected=f"above {time[unordered[0] - 1]:g} s",
            got=float(time[unordered[0]]),
        )


def _truth_boxes(frames: Sequence[GroundTruth]) -> BoxRows:
    rows = sum(map(len, frames))
    columns = _columns(frames)
    return sorted_boxes(
        "truth",
        **columns,
        score=np.ones(rows),
        observable=_joined([frame.observable for frame in frames], (0,), np.bool_),
        covariance=np.full((rows, 4, 4), np.nan),
    )


def _track_boxes(frames: Sequence[Tracks]) -> BoxRows:
    rows = sum(map(len, frames))
    columns = _columns(frames)
    covariance = [
        np.full((len(frame), 4, 4), np.nan) if frame.covariance is None else frame.covariance
        for frame in frames
    ]
    return sorted_boxes(
        "tracks",
        **columns,
        score=_joined([frame.score for frame in frames], (0,), np.float64),
        observable=np.ones(rows, np.bool_),
        covariance=_joined(covariance, (0, 4, 4), np.float64),
    )


def _columns(frames: Sequence[GroundTruth] | Sequence[Tracks]) -> dict[str, Any]:
    return {
        "frame": np.repeat(np.arange(len(frames)), [len(frame) for frame in frames]),
        "id": _joined([frame.id for frame in frames], (0,), np.int64),
        "position": _joined([frame.position for frame in frames], (0, 3), np.float64),
        "size": _joined([frame.size for frame in frames], (0, 3), np.float64),
        "yaw": _joined([frame.yaw for frame in frames], (0,), np.float64),
        "velocity": _joined([frame.velocity for frame in frames], (0, 2), np.float64),
        "label": _joined([frame.label for frame in frames], (0,), np.int8),
    }


def _joined(arrays: list[Any], empty: tuple[int, ...], dtype: type) -> NDArray[Any]:
    return np.concatenate(arrays) if arrays else np.zeros(empty, dtype)


def sorted_boxes(what: str = "boxes", **columns: NDArray[Any]) -> BoxRows:
    """One side from tables in any order of rows: sorted by frame, then id.

    columns : those of `BoxRows`.  Raises InputError, naming the frame and the id, for an id that
    comes twice in a frame, and for numbers that are not finite.
    """
    order = np.lexsort((columns["id"], columns["frame"]))
    boxes = BoxRows(**{name: column[order] for name, column in columns.items()})
    same = (np.diff(boxes.frame) == 0) & (np.diff(boxes.id) == 0)
    if same.any():
        row = int(np.flatnonzero(same)[0])
        raise InputError(
            f"{what}: an id twice in a frame",
            frame=int(boxes.frame[row]),
            object_id=int(boxes.id[row]),
            field="id",
            rows=np.sort(order[row : row + 2]),
        )
    for name in ("position", "size", "yaw", "velocity", "score"):
        values = getattr(boxes, name)
        bad = np.unique(np.nonzero(~np.isfinite(values))[0])
        if len(bad):
            raise InputError(
                f"{what}: bad {name}",
                frame=int(boxes.frame[bad[0]]),
                object_id=int(boxes.id[bad[0]]),
                field=name,
                rows=np.sort(order[bad]),
                expected="finite numbers",
                got=values[bad[0]],
            )
    return boxes
