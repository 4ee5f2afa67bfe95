"""Log weights of the global hypotheses of many clusters, sorted by cluster."""

from __future__ import annotations

import math

import numpy as np

from pmbm.filter.density import Index
from pmbm.types import FloatArray


def normalised(log_weight: FloatArray, cluster: Index) -> FloatArray:
    """Log weights (G,) that add up to one within each cluster (G,), which is sorted."""
    if not len(log_weight):
        return log_weight
    first = np.flatnonzero(np.diff(cluster, prepend=-1))
    count = np.diff(first, append=len(cluster))
    top = np.repeat(np.maximum.reduceat(log_weight, first), count)
    total = np.add.reduceat(np.exp(log_weight - top), first)
    return log_weight - top - np.repeat(np.log(total), count)


def likely(log_weight: FloatArray, cluster: Index, log_threshold: float) -> np.ndarray:
    """(G,) whether a log weight exceeds the threshold; the best of a cluster always does."""
    above = log_weight > log_threshold
    if not above.all():
        first = np.flatnonzero(np.diff(cluster, prepend=-1))
        top = np.maximum.reduceat(log_weight, first)
        above |= log_weight == np.repeat(top, np.diff(first, append=len(cluster)))
    return above


def log_of_each(value: FloatArray) -> FloatArray:
    """log of each, and that of 0."""
    with np.errstate(divide="ignore"):
        return np.log(value)


def log_of(value: float) -> float:
    """log, and that of 0."""
    return math.log(value) if value > 0 else -math.inf
