"""Cheapest assignments of rows to columns: one, or the k best, of one problem or of many.

A cost matrix has shape (R, C).  An assignment gives every row a column of its own; its cost is the
sum of the R entries taken, added in the order of the rows.  `inf` forbids a pair.  Columns may stay
free, rows may not: R > C, or a row of `inf`, has no assignment.

Solutions come by cost, equal costs by their columns read from the first row on.  Where equal costs
straddle the k-th place, which of them are returned is fixed but not specified.  Costs nearer to one
another than rounding allows (about 1e-15 of the largest finite cost, times R) count as equal when
it comes to that place.

Two kernels do the work: a compiled one, `pmbm._native`, where the install could build it, and the
plain one of `pmbm.assignment.reference`.  They take the same problems and give the same answers up
to what is said above about equal costs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm import kernels
from pmbm.assignment import reference
from pmbm.errors import InputError

__all__ = [
    "LARGEST_COST",
    "Choices",
    "Solutions",
    "k_best",
    "k_best_batch",
    "k_best_choices",
    "kernel",
    "optimal",
]

Solutions = tuple[NDArray[np.int32], NDArray[np.float64]]
"""columns (n, R), the cheapest first, and their costs (n,)."""

LARGEST_COST: Final = 1e100
"""Finite costs lie within +-LARGEST_COST, so that no sum of them overflows."""

_LARGEST_K: Final = 2**62


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
    if not len(costs):
        return []
    matrices = [_matrix(cost, problem) for problem, cost in enumerate(costs)]
    flat = np.concatenate([matrix.ravel() for matrix in matrices])
    _check_costs(flat, matrices)
    rows, widths = np.array([matrix.shape for matrix in matrices], dtype=np.int32).T.copy()
    wanted = np.array([_checked_k(k, problem) for problem, k in enumerate(ks)], dtype=np.int64)
    columns, totals, counts = reference.k_best(flat, rows, widths, wanted)
    solutions = []
    column, total = 0, 0
    for height, count in zip(rows.tolist(), counts.tolist(), strict=True):
        taken = columns[column : column + count * height].reshape(count, height)
        solutions.append((taken, totals[total : total + count]))
        column += count * height
        total += count
    return solutions


@dataclass(frozen=True, eq=False, slots=True)
class Choices:
    """Ways through sparse problems, sorted by problem, then cost, then columns.

    problem (N,), cost (N,) : of each way.
    way (t,), option (t,) : way `way[i]` uses option `option[i]`; sorted by way, then row.
    """

    problem: NDArray[np.int64]
    cost: NDArray[np.float64]
    way: NDArray[np.int64]
    option: NDArray[np.int64]


def k_best_choices(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    cost: NDArray[np.float64],
    *,
    first_row: NDArray[np.int64],
    first_column: NDArray[np.int64],
    ks: NDArray[np.int64],
    margin: float = math.inf,
) -> Choices:
    """The k cheapest ways in which rows take columns or nothing, for many sparse problems at once.

    Option i lets row[i] take column[i] at cost[i]; a row may also take nothing, at cost 0.  Rows
    and columns are numbered through over all problems.  As a cost matrix, such a problem would have
    one more column for each row, forbidden to the others.

    Parameters
    ----------
    row (n,), column (n,), cost (n,) : the options, sorted by row, then column; finite costs.
    first_row, first_column (P+1,) : problem p owns rows first_row[p] to first_row[p+1], and
        columns likewise.
    ks (P,) : at most so many ways of each problem, 1 or more.
    margin : ways that cost over this more than their problem's cheapest are not looked for, >= 0.

    Raises
    ------
    InputError : a cost that is not finite or beyond `LARGEST_COST`; options out of order or outside
    their problem.
    """
    _check_options(row, column, cost, first_row, first_column)
    count, total, way, option = reference.k_best_choices(
        row, column, cost, first_row, first_column, ks, margin
    )
    return Choices(np.repeat(np.arange(len(ks)), count), total, way, option)


def _check_options(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    cost: NDArray[np.float64],
    first_row: NDArray[np.int64],
    first_column: NDArray[np.int64],
) -> None:
    problem = np.searchsorted(first_row, row, side="right") - 1
    inside = (
        (problem >= 0)
        & (problem < len(first_row) - 1)
        & (column >= first_column[problem])
        & (column < first_column[np.minimum(problem + 1, len(first_column) - 1)])
    )
    ordered = np.ones(len(row), bool)
    ordered[1:] = (row[1:] > row[:-1]) | ((row[1:] == row[:-1]) & (column[1:] > column[:-1]))
    for field, good, expected in (
        ("cost", np.abs(cost) <= LARGEST_COST, f"numbers within +-{LARGEST_COST:g}"),
        ("row", ordered, "options sorted by row, then column, each once"),
        ("column", inside, "rows and columns of one problem"),
    ):
        if not good.all():
            bad = np.flatnonzero(~good)
            got = (int(row[bad[0]]), int(column[bad[0]]), float(cost[bad[0]]))
            raise InputError(
                "an option that cannot be used", field=field, rows=bad, expected=expected, got=got
            )


def kernel() -> Literal["compiled", "reference"]:
    """The name of the kernel that runs."""
    return "reference" if kernels.native is None else "compiled"


def _matrix(cost: ArrayLike, problem: int) -> NDArray[np.float64]:
    try:
        matrix = np.asarray(cost, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.ndim != 2:
        raise InputError(
            f"problem {problem}: a cost matrix has rows and columns",
            field="cost",
            expected="numbers of shape (R, C)",
            got=f"shape {np.shape(cost)}" if isinstance(cost, np.ndarray) else cost,
        )
    return matrix


def _check_costs(flat: NDArray[np.float64], matrices: Sequence[NDArray[np.float64]]) -> None:
    if _usable(flat).all():
        return
    for problem, matrix in enumerate(matrices):
        bad = ~_usable(matrix)
        if bad.any():
            raise InputError(
                f"problem {problem}: a cost that cannot be used",
                field="cost",
                rows=np.flatnonzero(bad.any(axis=1)),
                expected=f"numbers within +-{LARGEST_COST:g}, or inf for a forbidden pair",
                got=matrix[bad][0],
            )


def _usable(costs: NDArray[np.float64]) -> NDArray[np.bool_]:
    return (np.abs(costs) <= LARGEST_COST) | (costs == np.inf)


def _checked_k(k: int, problem: int) -> int:
    if isinstance(k, bool) or not isinstance(k, int | np.integer) or k < 0:
        raise InputError(
            f"problem {problem}: bad k", field="ks", expected="a whole number, 0 or more", got=k
        )
    return min(int(k), _LARGEST_K)
