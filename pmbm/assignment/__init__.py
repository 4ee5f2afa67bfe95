"""Cheapest assignments of rows to columns: one, or the k best, of one problem or of many.

A cost matrix has shape (R, C).  An assignment gives every row a column of its own; its cost is the
sum of the R entries taken, added in the order of the rows.  `inf` forbids a pair.  Columns may stay
free, rows may not: R > C, or a row of `inf`, has no assignment.

Solutions come by cost, equal costs by their columns read from the first row on.  Where equal costs
straddle the k-th place, which of them are returned is fixed but not specified.  Costs nearer to one
another than rounding allows (about 1e-15 of the largest finite cost, times R) count as equal when
it comes to that place.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.assignment import reference
from pmbm.errors import InputError

__all__ = ["LARGEST_COST", "Solutions", "k_best", "k_best_batch", "optimal"]

Solutions = tuple[NDArray[np.int32], NDArray[np.float64]]
"""columns (n, R), the cheapest first, and their costs (n,)."""

LARGEST_COST: Final = 1e100
"""Finite costs lie within +-LARGEST_COST, so that no sum of them overflows."""


def optimal(cost: ArrayLike) -> tuple[NDArray[np.int32], float]:
    """The cheapest assignment of a (R, C) cost matrix: columns (R,) and their total cost.

    Raises
    ------
    InputError : for a matrix that cannot be used, and where no assignment exists.
    """
    columns, costs = k_best(cost, 1)
    if not len(costs):
        raise InputError(
            "no assignment gives every row a column of its own",
            field="cost",
            hint="k_best returns no solution for such a matrix instead of failing",
        )
    return columns[0], float(costs[0])


def k_best(cost: ArrayLike, k: int) -> Solutions:
    """The k cheapest assignments of one cost matrix (Murty, Operations Research 16(3), 1968).

    Parameters
    ----------
    cost : (R, C), finite or `inf` (forbidden).
    k : at most so many; fewer exist for small or sparse matrices.

    Returns
    -------
    columns (n, R) int32 and costs (n,), the cheapest first, 0 <= n <= k.  R = 0 has one assignment,
    the empty one, of cost 0.

    Raises
    ------
    InputError : NaN, -inf or a number beyond `LARGEST_COST`; a wrong shape; k below 0.
    """
    return k_best_batch([cost], [k])[0]


def k_best_batch(costs: Sequence[ArrayLike], ks: Sequence[int]) -> list[Solutions]:
    """`k_best` of many independent problems in one call, in their order."""
    if len(costs) != len(ks):
        raise InputError("one k for each cost matrix", field="ks", expected=len(costs), got=len(ks))
    return [
        reference.k_best(_checked(cost, problem), _checked_k(k, problem))
        for problem, (cost, k) in enumerate(zip(costs, ks, strict=True))
    ]


def _checked(cost: ArrayLike, problem: int) -> NDArray[np.float64]:
    try:
        matrix = np.ascontiguousarray(cost, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.ndim != 2 or np.ndim(cost) != 2:
        raise InputError(
            f"problem {problem}: a cost matrix has rows and columns",
            field="cost",
            expected="numbers of shape (R, C)",
            got=f"shape {np.shape(cost)}" if isinstance(cost, np.ndarray) else cost,
        )
    bad = ~((np.abs(matrix) <= LARGEST_COST) | (matrix == np.inf))
    if bad.any():
        rows = np.flatnonzero(bad.any(axis=1))
        raise InputError(
            f"problem {problem}: a cost that cannot be used",
            field="cost",
            rows=rows,
            expected=f"numbers within +-{LARGEST_COST:g}, or inf for a forbidden pair",
            got=matrix[bad][0],
        )
    return matrix


def _checked_k(k: int, problem: int) -> int:
    if isinstance(k, bool) or not isinstance(k, int | np.integer) or k < 0:
        raise InputError(
            f"problem {problem}: bad k", field="ks", expected="a whole number, 0 or more", got=k
        )
    return int(k)
