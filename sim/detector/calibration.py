"""How far the scores of a recording can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmbm.errors import InputError
from pmbm.types import CLUTTER, BoolArray, Detections, FloatArray, IntArray, Recording


@dataclass(frozen=True, eq=False)
class ScoreReliability:
    """The reliability curve of scores; bins without boxes are left out.

    score (B,) : mean score of the bin's boxes.
    true_share (B,) : share of them that are an object's first box.
    count (B,) : how many they are.
    """

    score: FloatArray
    true_share: FloatArray
    count: IntArray

    @property
    def expected_error(self) -> float:
        """Expected calibration error: mean distance of score and true share over all boxes."""
        if not self.count.sum():
            return 0.0
        distance = np.abs(self.score - self.true_share)
        return float(np.sum(self.count * distance) / np.sum(self.count))


def first_boxes(score: FloatArray, origin: IntArray, delivery: IntArray | None = None) -> BoolArray:
    """Which detections (N,) are the surest of their object in their delivery (N,), of one delivery
    where none is given: no clutter, no duplicate, no second half."""
    if delivery is None:
        delivery = np.zeros(len(origin), np.int64)
    order = np.lexsort((-score, origin, delivery))
    first = np.ones(len(origin), dtype=bool)
    first[order[1:]] = (np.diff(origin[order]) != 0) | (np.diff(delivery[order]) != 0)
    return first & (origin != CLUTTER)


def reliability(recordings: Recording | Sequence[Recording], bins: int = 10) -> ScoreReliability:
    """The reliability curve over all boxes of recordings whose origins are known, in `bins` of
    equal width.

    Raises InputError for a recording without origins.
    """
    if isinstance(recordings, Recording):
        recordings = [recordings]
    deliveries = list[tuple[Detections, IntArray]]()
    for recording in recordings:
        if recording.origin is None:
            raise InputError(
                f"recording '{recording.name}' does not know where its boxes come from",
                field="origin",
            )
        deliveries += zip(recording.detections, recording.origin, strict=True)
    return reliability_of(deliveries, bins)


def reliability_of(
    deliveries: Sequence[tuple[Detections, IntArray]], bins: int = 10
) -> ScoreReliability:
    """The reliability curve of deliveries with their origins."""
    score = np.concatenate([np.zeros(0), *(detections.score for detections, _ in deliveries)])
    origin = np.concatenate([np.zeros(0, np.int64), *(origin for _, origin in deliveries)])
    delivery = np.repeat(np.arange(len(deliveries)), [len(origin) for _, origin in deliveries])
    return _binned(score, first_boxes(score, origin, delivery), bins)


def _binned(score: FloatArray, true: BoolArray, bins: int) -> ScoreReliability:
    bin_of = np.minimum((score * bins).astype(np.int64), bins - 1)
    count = np.bincount(bin_of, minlength=bins)
    some = count > 0
    return ScoreReliability(
        score=np.bincount(bin_of, score, bins)[some] / count[some],
        true_share=np.bincount(bin_of, true, bins)[some] / count[some],
        count=count[some],
    )
