"""What the baselines are told by hand elsewhere, chosen by their errors on recordings with labels:
from which score on detections are looked at and tracks reported, and how long a track must have
been seen, and may be lost.
"""

from __future__ import annotations

from itertools import product
from typing import Any, Final

import numpy as np

from pmbm.types import FloatArray, IntArray
from pmbm.wording import four_digits

FITTED: Final = ("argoverse", "waymo", "probabilistic_kf")
"""Trackers that have these parameters."""
_MIN_SCORE: Final = (0.35, 0.6)
_REPORT: Final = (0.0, 0.4, 0.5, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85)
"""Scores by the share of all detections below them, whatever the detector's scale."""
_HITS_AND_AGE: Final = ((2, 12.0), (5, 4.0))
"""Tracks that are soon believed and long kept, or neither: either goes with the other."""


def candidates(scores: FloatArray) -> list[dict[str, Any]]:
    """Parameters to track with, for detections of one class with these scores (N,)."""
    return [
        {"min_score": four_digits(score), "min_hits": hits, "max_age": age}
        for score, (hits, age) in product(np.quantile(scores, _MIN_SCORE), _HITS_AND_AGE)
    ]


def report_thresholds(scores: FloatArray) -> FloatArray:
    """(T,) candidates for `report_above`, which changes no track: what it leaves out can be counted
    afterwards.  The first leaves out nothing."""
    found = [four_digits(score) for score in np.quantile(scores, _REPORT)]
    return np.array([0.0, *found[1:]])


def fewest_errors(errors: IntArray) -> tuple[int, int]:
    """Candidate and threshold of the fewest errors (S,C,T) over all S sequences, so of the best
    MOTA; of equals the first."""
    total = errors.sum(axis=0)
    candidate, threshold = np.unravel_index(int(np.argmin(total)), total.shape)
    return int(candidate), int(threshold)
