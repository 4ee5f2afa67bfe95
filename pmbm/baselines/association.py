"""How the baselines pair tracks with detections: each takes the predicted filters of one class and
the detected boxes (N,7) of that class, and gives the pairs as (track, detection) rows (M,2)."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from pmbm.baselines.box_filter import BOX, YAW, innovations
from pmbm.errors import InputError
from pmbm.geometry import iou
from pmbm.types import FloatArray, IntArray

Associate = Callable[[Sequence[Any], FloatArray], IntArray]

_ROUNDING: Final = 1e-9
"""An overlap that misses its gate by less than this lies on it."""
MOST_PAIRS: Final = 25_000_000
"""Pairs of a track and a detection that are held at once: 200 MB."""
_BLOCK: Final = 100_000
"""Pairs that are computed at once."""


def check_pairs(tracks: int, detections: int) -> None:
    """Raise InputError where a label has more pairs of a track and a detection than can be held."""
    if tracks * detections > MOST_PAIRS:
        raise InputError(
            f"too many detections of one label in a frame for a baseline that follows {tracks}",
            expected=f"at most {MOST_PAIRS // tracks}",
            got=detections,
            hint="raise min_score, or take the tracker 'pmbm'",
        )


def hungarian_iou(gate: float, *, vertical: bool) -> Associate:
    """The pairing of largest total IoU (of volumes, or bird's-eye with `vertical=False`), out of
    which pairs below `gate` are then dropped (AB3DMOT, Sec. III)."""

    def associate(filters: Sequence[Any], boxes: FloatArray) -> IntArray:
        predicted = np.array([kalman.x[:BOX, 0] for kalman in filters]).reshape(-1, BOX)
        overlap = np.empty((len(predicted), len(boxes)))
        for rows in _blocks(*overlap.shape):
            overlap[rows] = iou(*_parts(predicted[rows]), *_parts(boxes), vertical=vertical)
        track, detection = linear_sum_assignment(overlap, maximize=True)
        inside = overlap[track, detection] >= gate - _ROUNDING
        return np.column_stack([track, detection])[inside]

    return associate


def greedy_mahalanobis(gate: float) -> Associate:
    """Nearest pair first, while its Mahalanobis distance, over the seven measured components with
    S = H P H' + R, is below `gate` (Chiu et al. 2020, Sec. III, "data association")."""

    def associate(filters: Sequence[Any], boxes: FloatArray) -> IntArray:
        if not filters or not len(boxes):
            return np.zeros((0, 2), np.int64)
        distance = np.empty((len(filters), len(boxes)))
        for rows in _blocks(*distance.shape):
            difference = np.stack([innovations(kalman, boxes) for kalman in filters[rows]])
            spread = np.stack([kalman.P[:BOX, :BOX] + kalman.R for kalman in filters[rows]])
            scaled = np.linalg.solve(spread, difference.swapaxes(1, 2))
            distance[rows] = np.sqrt(np.einsum("tnd,tdn->tn", difference, scaled))
        return _nearest_first(distance, gate)

    return associate


def _blocks(tracks: int, detections: int) -> Iterator[slice]:
    """Rows of the tracks, few enough at a time for what is computed of each pair."""
    rows = max(_BLOCK // max(detections, 1), 1)
    return (slice(start, start + rows) for start in range(0, tracks, rows))


def _nearest_first(distance: FloatArray, gate: float) -> IntArray:
    pairs = []
    track_taken, detection_taken = (np.zeros(n, bool) for n in distance.shape)
    track, detection = np.nonzero(distance < gate)
    order = np.argsort(distance[track, detection], kind="stable")
    for t, d in zip(track[order].tolist(), detection[order].tolist(), strict=True):
        if not track_taken[t] and not detection_taken[d]:
            track_taken[t] = detection_taken[d] = True
            pairs.append((t, d))
    return np.array(pairs, np.int64).reshape(-1, 2)


def _parts(boxes: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    return boxes[:, :YAW], boxes[:, YAW + 1 :], boxes[:, YAW]
