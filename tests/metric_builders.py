"""Small recordings and tracks written as points, for tests of metrics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pmbm.types import GroundTruth, Recording, Tracks

Points = Mapping[int, Sequence[float]]
"""id -> (x, y) or (x, y, z), m."""


def truth_frame(
    points: Points, time: float = 0.0, *, hidden: Sequence[int] = (), label: int = 0, **columns: Any
) -> GroundTruth:
    """Ground truth of one frame; ids in `hidden` are not observable."""
    n = len(points)
    seen = np.array([name not in hidden for name in points], np.bool_)
    values = {
        "size": np.tile([4.5, 1.9, 1.6], (n, 1)),
        "yaw": np.zeros(n),
        "velocity": np.zeros((n, 2)),
        "label": np.full(n, label),
        "visibility": seen.astype(float),
        "observable": seen,
        "crashed": np.zeros(n, np.bool_),
        **columns,
    }
    return GroundTruth(
        time=time, id=np.array(list(points), np.int64), position=_xyz(points), **values
    )


def tracks_frame(points: Points, time: float = 0.0, *, label: int = 0, **columns: Any) -> Tracks:
    """What a tracker says of one frame."""
    n = len(points)
    values = {
        "size": np.tile([4.5, 1.9, 1.6], (n, 1)),
        "yaw": np.zeros(n),
        "velocity": np.zeros((n, 2)),
        "score": np.full(n, 0.9),
        "label": np.full(n, label),
        **columns,
    }
    return Tracks(time=time, id=np.array(list(points), np.int64), position=_xyz(points), **values)


def recording_of(truth: Sequence[GroundTruth], name: str = "made by hand") -> Recording:
    """A recording of this truth without detections."""
    return Recording(
        name=name,
        truth=tuple(truth),
        detections=(),
        frame=np.zeros(0, np.int64),
        stamp=np.arange(len(truth)),
    )


def run_of(
    truth: Sequence[Points],
    tracks: Sequence[Points],
    *,
    dt: float = 0.1,
    hidden: Mapping[int, Sequence[int]] | None = None,
) -> tuple[Recording, list[Tracks]]:
    """A recording and a tracker's reports, frame by frame; `hidden`: frame -> unobservable ids."""
    return (
        recording_of(
            [
                truth_frame(points, k * dt, hidden=(hidden or {}).get(k, ()))
                for k, points in enumerate(truth)
            ]
        ),
        [tracks_frame(points, k * dt) for k, points in enumerate(tracks)],
    )


def _xyz(points: Points) -> np.ndarray:
    return np.array([(*point, 0.0)[:3] for point in points.values()], float).reshape(-1, 3)
