"""The three estimators of the literature, of a density: rows of its local hypotheses.

After Garcia-Fernandez, Williams, Granstrom and Svensson (2018), Sec. VI.  The tracker itself
reports tracks by their probabilities over all global hypotheses (`estimation.py`).  Clusters are
independent, so the best global hypothesis of the scene is made of the best of each.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from pmbm.filter.density import Density, Index
from pmbm.types import FloatArray


def best_hypothesis(density: Density, threshold: float = 0.4) -> Index:
    """Estimator 1: rows of the Bernoullis above `threshold` in the heaviest global hypothesis."""
    return _of_best(density, density.hypotheses.log_weight, threshold)


def most_certain_hypothesis(density: Density, threshold: float = 0.5) -> Index:
    """Estimator 3: as estimator 1, in the hypothesis of the largest weight times the product of
    max(r, 1 - r)."""
    table, r = density.hypotheses, density.local.existence
    certainty = np.log(np.maximum(r, 1 - r))[table.member]
    value = table.log_weight + np.bincount(table.row_of_member(), certainty, minlength=len(table))
    return _of_best(density, value, threshold)


def _of_best(density: Density, value: FloatArray, threshold: float) -> Index:
    """Members above the threshold of each cluster's row of the largest value."""
    table = density.hypotheses
    order = np.lexsort((-value, table.cluster))
    best = order[np.flatnonzero(np.diff(table.cluster[order], prepend=-1))]
    chosen = np.zeros(len(table), bool)
    chosen[best] = True
    member = table.member[np.repeat(chosen, np.diff(table.start))]
    return member[density.local.existence[member] > threshold]


def cardinality(density: Density) -> FloatArray:
    """P(n detected objects exist), n = 0, 1, ..., (T+1,): convolved over Bernoullis, mixed over
    global hypotheses, convolved over clusters."""
    table, r = density.hypotheses, density.local.existence
    total = np.ones(1)
    bounds = np.searchsorted(table.cluster, np.arange(table.clusters + 1)).tolist()
    for first, last in pairwise(bounds):
        rows = [
            np.exp(table.log_weight[g]) * poisson_binomial(r[_members(density, g)])
            for g in range(first, last)
        ]
        mixed = np.zeros(max(map(len, rows)))
        for row in rows:
            mixed[: len(row)] += row
        total = np.convolve(total, mixed)
    return total


def poisson_binomial(r: FloatArray) -> FloatArray:
    """P(n of these independent events happen), (len(r) + 1,)."""
    total = np.ones(1)
    for one in r.tolist():
        total = np.convolve(total, [1 - one, one])
    return total


def map_cardinality(density: Density) -> Index:
    """Estimator 2: n is the likeliest number of objects; then the n likeliest Bernoullis of the
    global hypothesis that maximises its weight times the product of its top n r times the product
    of 1 - r of the rest.

    Over clusters this is a shortest-path problem: the best split of n among them.
    """
    n = int(np.argmax(cardinality(density)))
    table, r = density.hypotheses, density.local.existence
    bounds = np.searchsorted(table.cluster, np.arange(table.clusters + 1)).tolist()
    value = np.full(n + 1, -np.inf)
    value[0] = 0.0
    trail: list[tuple[Index, Index]] = []
    for first, last in pairwise(bounds):
        rows = np.full((last - first, n + 1), -np.inf)
        for g in range(first, last):
            own = table.log_weight[g] + _top_products(r[_members(density, g)])[: n + 1]
            rows[g - first, : len(own)] = own
        best_row = np.argmax(rows, axis=0)
        gain = rows[best_row, np.arange(n + 1)]
        sums = np.full((n + 1, n + 1), -np.inf)
        for taken in range(n + 1):
            sums[taken:, taken] = value[: n + 1 - taken] + gain[taken]
        taken_at = np.argmax(sums, axis=1)
        value = sums[np.arange(n + 1), taken_at]
        trail.append((taken_at, first + best_row))
    chosen = []
    for taken_at, best_row in reversed(trail):
        here = int(taken_at[n])
        member = _members(density, int(best_row[here]))
        chosen.append(member[np.argsort(-r[member], kind="stable")[:here]])
        n -= here
    return np.concatenate([np.zeros(0, np.intp), *chosen]).astype(np.intp)


def _top_products(r: FloatArray) -> FloatArray:
    """log of (product of the top n of r) (product of 1 - r of the rest), n = 0 .. len(r)."""
    falling = np.sort(r)[::-1]
    with np.errstate(divide="ignore"):
        taken = np.concatenate([[0.0], np.cumsum(np.log(falling))])
        left = np.concatenate([np.cumsum(np.log1p(-falling[::-1]))[::-1], [0.0]])
    return taken + left


def _members(density: Density, row: int) -> Index:
    table = density.hypotheses
    return table.member[table.start[row] : table.start[row + 1]]
