"""K best assignments, the plain version: Murty's partition over scipy's assignment solver.

It is the meaning of `pmbm.assignment.k_best` and runs where no compiled kernel is.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmbm.assignment.enumeration import Problems, Ways, enumerate_ways
from pmbm.kernels import twin

_ENUMERATE_UP_TO = 256
"""Ways of one problem; above, the K best are found by assignment instead of listing them all."""

_ROUNDING = 1e-9
"""Slack of a bound, of the largest cost; what it lets through is only looked at in vain."""

Matrix = NDArray[np.float64]


class _Node(NamedTuple):
    """A set of assignments, known by its cheapest member (heap order: cost, then columns).

    The set holds every assignment that agrees with `columns` in the rows before `fixed` and takes
    none of the columns in `forbidden` in row `fixed`.
    """

    cost: float
    columns: tuple[int, ...]
    fixed: int
    forbidden: frozenset[int]


@twin("k_best")
def k_best(
    cost: NDArray[np.float64],
    rows: NDArray[np.int32],
    widths: NDArray[np.int32],
    ks: NDArray[np.int64],
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.int64]]:
    """Solve many problems whose matrices lie one after the other in `cost`.

    Returns their solutions' columns and costs, one after the other, and the number of solutions of
    each problem.  The compiled kernel has the same signature.
    """
    ends = np.cumsum(rows.astype(np.int64) * widths)[:-1]
    solved = [
        murty(part.reshape(height, width), k)
        for part, height, width, k in zip(
            np.split(cost, ends), rows.tolist(), widths.tolist(), ks.tolist(), strict=True
        )
    ]
    return (
        np.concatenate([columns.ravel() for columns, _ in solved]),
        np.concatenate([costs for _, costs in solved]),
        np.array([len(costs) for _, costs in solved], dtype=np.int64),
    )


@twin("k_best_choices")
def k_best_choices(
    row: NDArray[np.int64],
    column: NDArray[np.int64],
    cost: NDArray[np.float64],
    first_row: NDArray[np.int64],
    first_column: NDArray[np.int64],
    ks: NDArray[np.int64],
    margin: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
    """Solve many sparse problems, as `pmbm.assignment.k_best_choices` describes them.

    Returns the number of ways of each problem, their costs, and for every option used the way that
    uses it and the option.  The compiled kernel has the same signature.

    Small problems are listed in full, all of them at once; large ones ranked one by one.
    """
    problems = Problems(row, column, cost, first_row)
    few = problems.combinations() <= _ENUMERATE_UP_TO
    listed = enumerate_ways(problems, np.flatnonzero(few))
    ranked = [
        _rank(problems, problem, first_column, int(ks[problem]), margin)
        for problem in np.flatnonzero(~few).tolist()
    ]
    # Levels are a problem's rows; shorter problems take nothing in those that they lack.
    levels = max([listed.option.shape[1], *(ways.option.shape[1] for ways in ranked)])
    ways = Ways.joined([listed, *ranked], levels).best(ks, margin)
    way, level = np.nonzero(ways.option >= 0)
    return (
        np.bincount(ways.problem, minlength=len(ks)).astype(np.int64),
        ways.cost,
        way.astype(np.int64),
        ways.option[way, level],
    )


def _rank(
    problems: Problems, problem: int, first_column: NDArray[np.int64], k: int, margin: float
) -> Ways:
    """The best ways of one problem as a dense assignment problem: taking nothing is a column of
    the row's own."""
    first, last = problems.first_row[problem : problem + 2]
    rows, columns = last - first, first_column[problem + 1] - first_column[problem]
    options = np.arange(*np.searchsorted(problems.row, [first, last]))
    at = problems.row[options] - first, problems.column[options] - first_column[problem]
    cost = np.full((rows, columns + rows), np.inf)
    cost[:, columns:][np.diag_indices(rows)] = 0.0
    cost[at] = problems.cost[options]
    option = np.full(cost.shape, -1, np.int64)
    option[at] = options
    taken, costs = murty(cost, k, margin)
    return Ways(np.full(len(costs), problem), costs, option[np.arange(rows), taken])


def murty(
    cost: Matrix, k: int, margin: float = np.inf
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The k cheapest assignments (n, R) of a checked (R, C) cost matrix within `margin` of the
    cheapest, and their costs (n,).

    Taking the cheapest assignment out of its set leaves a set that falls into disjoint parts, one
    per row i: agree with it before i, differ from it in i.  Each part's cheapest member is again an
    assignment problem, so the next best of all waits at the head of a queue of parts.  A part is
    not looked into where the reduced costs already say that it lies beyond the margin.

    Source: K. G. Murty, An algorithm for ranking all the assignments in order of increasing cost,
    Operations Research 16(3), 1968.
    """
    rows, table = len(cost), cost.tolist()
    queue: list[_Node] = []
    if rows <= cost.shape[1]:
        _enqueue(queue, cost, table, (), frozenset())
    best: list[_Node] = []
    while queue and k > 0:
        node = heapq.heappop(queue)
        best.append(node)
        if node.cost > best[0].cost + margin:
            best.pop()
            break
        if len(best) == k:
            break
        if len(best) == 1:
            reduced = _reduced(cost, list(node.columns))
        for row in _within(margin, reduced, node):
            inherited = node.forbidden if row == node.fixed else frozenset()
            _enqueue(queue, cost, table, node.columns[:row], inherited | {node.columns[row]})
    # The sums of two assignments may differ by rounding where the partition takes them for equal.
    best.sort()
    columns = np.array([node.columns for node in best], dtype=np.int32).reshape(len(best), rows)
    return columns, np.array([node.cost for node in best], dtype=np.float64)


def _reduced(cost: Matrix, columns: list[int]) -> Matrix:
    """(R,C) by how much taking a pair makes an assignment dearer than the cheapest, `columns`, at
    least: the costs less the dual prices of rows and columns, found by relaxation."""
    rows = np.arange(len(cost))
    slack = _ROUNDING * np.abs(cost[np.isfinite(cost)]).max(initial=0.0)
    price = np.zeros(cost.shape[1])
    row_price = cost[rows, columns]
    for _ in rows:
        lower = np.minimum(price, (cost - row_price[:, None]).min(axis=0))
        if (lower >= price - slack).all():
            break
        price = lower
        row_price = cost[rows, columns] - price[columns]
    return cost - row_price[:, None] - price - slack


def _within(margin: float, reduced: Matrix, node: _Node) -> list[int]:
    """The rows in which a member of the node's set may differ from its cheapest, and first there,
    and cost at most `margin` more than the cheapest assignment of all."""
    first, rows = node.fixed, np.arange(len(reduced))
    columns = list(node.columns)
    taken = reduced[rows, columns]
    other = reduced[first:].copy()
    other[rows[first:] - first, columns[first:]] = np.inf
    other[:1, list(node.forbidden)] = np.inf
    least = (np.cumsum(taken) - taken)[first:] + other.min(axis=1, initial=np.inf)
    return (first + np.flatnonzero(least <= margin)).tolist()


def _enqueue(
    queue: list[_Node],
    cost: Matrix,
    table: list[list[float]],
    prefix: tuple[int, ...],
    forbidden: frozenset[int],
) -> None:
    """Solve one part, and put it into the queue unless it is empty; table : the costs as lists."""
    # Where something is compiled this never runs, and what it needs takes long to load.
    from scipy.optimize import linear_sum_assignment

    # Columns taken are forbidden to the rows that are left; leaving them out would take longer.
    rest = cost[len(prefix) :].copy()
    if prefix:
        rest[:, prefix] = np.inf
    if forbidden:
        rest[0, list(forbidden)] = np.inf
    try:
        _, chosen = linear_sum_assignment(rest)
    except ValueError:
        # scipy's word for "no assignment without a forbidden pair".
        return
    columns = (*prefix, *chosen.tolist())
    # Added in the order of the rows: two equal assignments have equal costs to the bit.
    total = 0.0
    for row, column in zip(table, columns, strict=True):
        total += row[column]
    heapq.heappush(queue, _Node(total, columns, len(prefix), forbidden))
