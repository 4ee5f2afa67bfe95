"""Moments by range and in time: what the parts of a detector's fit share."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from pmbm.sim.fit.observations import Detected, Observations, Opportunities
from pmbm.types import BoolArray, FloatArray, IntArray

BIN_WIDTH: Final = 10.0
"""m."""
FEWEST: Final = 40
"""On less than so many boxes nothing is fitted."""


@dataclass(frozen=True, eq=False)
class Sample:
    """Opportunities of one label, and hits whose `chance` counts in them."""

    chances: Opportunities
    hits: Detected


def sample(evidence: Observations, keep: BoolArray) -> Sample:
    """The opportunities of a sample, and the hits among them."""
    number = np.cumsum(keep) - 1
    rows = keep[evidence.hits.chance]
    hits = evidence.hits.take(rows)
    return Sample(evidence.chances.take(keep), replace(hits, chance=number[hits.chance]))


def range_bins(distance: FloatArray, fewest: int = FEWEST) -> IntArray:
    """Bins (R,) of range, neighbours joined until each holds `fewest`."""
    number = (distance / BIN_WIDTH).astype(np.int64)
    joined = np.zeros(number.max() + 1, dtype=np.int64)
    current, held = 0, 0
    count = np.bincount(number)
    for index, here in enumerate(count):
        joined[index] = current
        held += here
        if held >= fewest and count[index + 1 :].sum() >= fewest:
            current, held = current + 1, 0
    return joined[number]


def binned(values: FloatArray, bins: IntArray) -> FloatArray:
    """Means of values in each bin."""
    return np.bincount(bins, values) / np.bincount(bins)


def steps(chances: Opportunities, lag: int = 1) -> tuple[IntArray, IntArray]:
    """Rows of the same object in a frame and so many frames later."""
    whose = np.unique(
        np.stack([chances.recording, chances.object_id]), axis=1, return_inverse=True
    )[1]
    key = whose.astype(np.int64) * 2**32 + chances.frame
    order = np.argsort(key)
    at = np.searchsorted(key, key[order] + lag, sorter=order)
    there = at < len(key)
    later = order[np.minimum(at, len(key) - 1)]
    there &= key[later] == key[order] + lag
    return order[there], later[there]


def lag_correlation(standard: FloatArray, chances: Opportunities, lag: int = 1) -> float:
    """Mean correlation of columns of standardised values with those so many frames later."""
    earlier, later = steps(chances, lag)
    if len(earlier) < FEWEST:
        return 0.0
    correlations = [
        np.corrcoef(column[earlier], column[later])[0, 1]
        for column in standard.T
        if np.ptp(column) > 0
    ]
    return float(np.clip(np.mean(correlations), 0.0, 0.99)) if correlations else 0.0


def pair_correlations(columns: FloatArray) -> tuple[float, float, float]:
    """Correlations of three columns: first two, outer two, last two."""
    if len(columns) < FEWEST or (np.ptp(columns, axis=0) == 0).any():
        return 0.0, 0.0, 0.0
    # A little less than measured: what is next to degenerate has no root.
    correlation = 0.99 * np.corrcoef(columns.T).reshape(3, 3)
    first, outer, last = correlation[np.triu_indices(3, 1)]
    return float(first), float(outer), float(last)
