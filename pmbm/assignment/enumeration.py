"""All ways in which rows take options, for many small problems at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False, slots=True)
class Problems:
    """Sparse assignment problems: option i lets row[i] take column[i] at cost[i].

    row (n,), column (n,), cost (n,) : sorted by row, then column.
    first_row (P+1,) : problem p owns the rows first_row[p] to first_row[p+1].
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    cost: NDArray[np.float64]
    first_row: NDArray[np.int64]

    def options_per_row(self) -> NDArray[np.int64]:
        """(rows,)"""
        return np.bincount(self.row, minlength=int(self.first_row[-1])).astype(np.int64)

    def combinations(self) -> NDArray[np.float64]:
        """(P,) product over rows of 1 + options: a bound on the number of ways."""
        doublings = np.concatenate([[0.0], np.cumsum(np.log2(1.0 + self.options_per_row()))])
        return np.exp2(
            np.minimum(doublings[self.first_row[1:]] - doublings[self.first_row[:-1]], 1e3)
        )


@dataclass(frozen=True, eq=False, slots=True)
class Ways:
    """N ways through some problems.

    problem (N,); cost (N,); option (N, L) : what each row of the problem takes, -1 for nothing and
    behind the problem's last row.
    """

    problem: NDArray[np.int64]
    cost: NDArray[np.float64]
    option: NDArray[np.int64]

    @staticmethod
    def joined(parts: Sequence[Ways], levels: int) -> Ways:
        """The parts one after another, their `option` widened to `levels`."""
        option = np.full((sum(len(part.cost) for part in parts), levels), -1)
        first = 0
        for part in parts:
            ways, rows = part.option.shape
            option[first : first + ways, :rows] = part.option
            first += ways
        return Ways(
            np.concatenate([part.problem for part in parts]),
            np.concatenate([part.cost for part in parts]),
            option,
        )

    def best(self, ks: NDArray[np.int64], margin: float) -> Ways:
        """The ks[p] cheapest ways of each problem p that cost at most `margin` more than its
        cheapest, sorted by problem, then cost; equal costs stay in their order."""
        order = np.lexsort((self.cost, self.problem))
        problem, cost = self.problem[order], self.cost[order]
        first = np.searchsorted(problem, problem)
        keep = (np.arange(len(order)) - first < ks[problem]) & (cost <= cost[first] + margin)
        return Ways(problem[keep], cost[keep], self.option[order[keep]])


def enumerate_ways(problems: Problems, which: NDArray[np.intp]) -> Ways:
    """Every way of the problems `which`, row by row for all problems at once.

    The ways of a problem come in order of their columns, nothing after every column.
    """
    size = problems.options_per_row()
    first_option = np.cumsum(size) - size
    rows = np.diff(problems.first_row)
    # Option -1, taking nothing, costs nothing and has a column that no option has.
    column = np.append(problems.column, -1)
    price = np.append(problems.cost, 0.0)
    problem = which.astype(np.int64)
    cost = np.zeros(len(which))
    used = np.zeros((len(which), 0), np.int64)
    for level in range(int(rows[which].max(initial=0))):
        has = level < rows[problem]
        row = problems.first_row[problem[has]] + level
        first, options = np.zeros((2, len(problem)), np.int64)
        first[has], options[has] = first_option[row], size[row]
        way = np.repeat(np.arange(len(problem)), options + 1)
        slot = np.arange(len(way)) - np.repeat(np.cumsum(options + 1) - options - 1, options + 1)
        takes = slot < options[way]
        option = np.where(takes, first[way] + slot, -1)
        held = column[used[way]]
        free = ~(takes & (held == column[option][:, None]).any(axis=1))
        way, option = way[free], option[free]
        problem = problem[way]
        cost = cost[way] + price[option]
        used = np.concatenate([used[way], option[:, None]], axis=1)
    return Ways(problem, cost, used)
