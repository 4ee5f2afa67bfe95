"""Calibration of the scores of a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmbm.errors import InputError
from pmbm.metrics.families.existence import Reliability
from pmbm.metrics.families.existence import reliability as of_reports
from pmbm.types import CLUTTER, BoolArray, Detections, FloatArray, IntArray, Recording


def first_boxes(score: FloatArray, origin: IntArray, delivery: IntArray | None = None) -> BoolArray:
    """Which detections (N,) are the surest of their object in their delivery (N,), of one delivery
    where none is given: no clutter, no duplicate, no second half."""
    if delivery is None:
        delivery = np.zeros(len(origin), np.int64)
    order = np.lexsort((-score, origin, delivery))
    first = np.ones(len(origin), dtype=bool)
    first[order[1:]] = (np.diff(origin[order]) != 0) | (np.diff(delivery[order]) != 0)
    return first & (origin != CLUTTER)


def reliability(recordings: Recording | Sequence[Recording], bins: int = 10) -> Reliability:
    """How far the scores of recordings whose origins are known can be trusted: a box is true where
    it is an object's first; in `bins` of equal width.

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
) -> Reliability:
    """The reliability curve of deliveries with their origins."""
    score = np.concatenate([np.zeros(0), *(detections.score for detections, _ in deliveries)])
    origin = np.concatenate([np.zeros(0, np.int64), *(origin for _, origin in deliveries)])
    delivery = np.repeat(np.arange(len(deliveries)), [len(origin) for _, origin in deliveries])
    return of_reports(score, first_boxes(score, origin, delivery), bins)
