"""Sparse problems in a batch: rows take columns or nothing."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from pmbm.assignment import k_best, k_best_choices
from pmbm.errors import InputError
from pmbm.kernels import TWINS

pytestmark = pytest.mark.usefixtures("assignment_kernel")


class Batch:
    """Random sparse problems, numbered through, with the dense matrix of each beside it."""

    def __init__(self, seed, problems, most_rows, most_columns, share, whole=False):
        random = np.random.default_rng(seed)
        rows, columns, costs = [], [], []
        first_row, first_column = [0], [0]
        self.dense = []
        for _ in range(problems):
            r, c = int(random.integers(0, most_rows + 1)), int(random.integers(0, most_columns + 1))
            cost = random.integers(-3, 2, (r, c)) * 1.0 if whole else random.normal(-1, 2, (r, c))
            there = random.random((r, c)) < share
            at = np.nonzero(there)
            rows.append(at[0] + first_row[-1])
            columns.append(at[1] + first_column[-1])
            costs.append(cost[at])
            first_row.append(first_row[-1] + r)
            first_column.append(first_column[-1] + c)
            full = np.full((r, c + r), np.inf)
            full[:, :c][there] = cost[there]
            full[np.arange(r), c + np.arange(r)] = 0.0
            self.dense.append(full)
        self.options = tuple(np.concatenate(part) for part in (rows, columns, costs))
        self.first_row, self.first_column = np.array(first_row), np.array(first_column)
        self.ks = random.integers(1, 60, problems)

    def solve(self, **changes):
        bounds = {"first_row": self.first_row, "first_column": self.first_column, "ks": self.ks}
        return k_best_choices(*self.options, **{**bounds, **changes})

    def expected(self, margin=np.inf):
        """(problem, cost, {row: column}) of every way, from the dense problems."""
        for problem, (cost, k) in enumerate(zip(self.dense, self.ks.tolist(), strict=True)):
            width = cost.shape[1] - len(cost)
            for columns, total in zip(*k_best(cost, k), strict=True):
                if total <= k_best(cost, 1)[1][0] + margin:
                    taken = {r: c for r, c in enumerate(columns.tolist()) if c < width}
                    yield problem, float(total), taken

    def got(self, choices):
        assert (np.diff(choices.way) >= 0).all()
        row, column, _ = self.options
        for way, (problem, cost) in enumerate(zip(choices.problem, choices.cost, strict=True)):
            used = choices.option[choices.way == way]
            assert (np.diff(row[used]) > 0).all()
            taken = zip(
                row[used] - self.first_row[problem],
                column[used] - self.first_column[problem],
                strict=True,
            )
            yield int(problem), float(cost), {int(r): int(c) for r, c in taken}


@pytest.mark.parametrize("margin", [np.inf, 2.0, 0.0])
@pytest.mark.parametrize("seed", range(12))
def test_each_problem_as_its_dense_twin(seed, margin):
    batch = Batch(seed, problems=15, most_rows=7, most_columns=6, share=0.15 + 0.06 * seed)
    assert list(batch.got(batch.solve(margin=margin))) == list(batch.expected(margin))


@pytest.mark.parametrize("seed", range(8))
def test_equal_costs_come_in_order_of_their_columns(seed):
    batch = Batch(seed, problems=12, most_rows=3, most_columns=3, share=0.7, whole=True)
    everything = np.full(len(batch.dense), 1000)
    batch.ks = everything
    assert list(batch.got(batch.solve())) == list(batch.expected())


def test_hand_worked():
    # Two rows want column 7 and one of them column 8; all, none and every mixture that is allowed.
    choices = k_best_choices(
        np.array([3, 3, 4]),
        np.array([7, 8, 7]),
        np.array([-5.0, -1.0, -4.0]),
        first_row=np.array([3, 5]),
        first_column=np.array([7, 9]),
        ks=np.array([10]),
    )
    ways = [choices.option[choices.way == way].tolist() for way in range(len(choices.cost))]
    assert ways == [[0], [1, 2], [2], [1], []]
    assert choices.cost.tolist() == [-5.0, -5.0, -4.0, -1.0, 0.0]


def test_problems_without_rows_or_options_have_one_way():
    empty = np.zeros(0, np.int64)
    choices = k_best_choices(
        empty,
        empty,
        np.zeros(0),
        first_row=np.array([0, 0, 2]),
        first_column=np.array([0, 3, 3]),
        ks=np.array([4, 4]),
    )
    assert choices.problem.tolist() == [0, 1]
    assert choices.cost.tolist() == [0.0, 0.0]
    assert len(choices.way) == len(choices.option) == 0
    none = k_best_choices(
        empty, empty, np.zeros(0), first_row=np.zeros(1, int), first_column=np.zeros(1, int),
        ks=empty,
    )  # fmt: skip
    assert len(none.cost) == 0


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"cost": [0.0, np.nan, 0.0]}, "rows 1.*within"),
        ({"cost": [0.0, 0.0, np.inf]}, "rows 2.*within"),
        ({"row": [1, 0, 1]}, "rows 1.*sorted"),
        ({"column": [1, 0, 0]}, "rows 1.*sorted"),
        ({"column": [0, 0, 0]}, "rows 1.*sorted"),
        ({"column": [0, 2, 0]}, "rows 1.*one problem"),
        ({"column": [-1, 1, 0]}, "rows 0.*one problem"),
        ({"row": [0, 0, 2]}, "rows 2.*one problem"),
        ({"row": [-1, 0, 1]}, "rows 0.*one problem"),
    ],
)
def test_refused_options(change, match):
    given = {"row": [0, 0, 1], "column": [0, 1, 0], "cost": [0.0, 1.0, 2.0], **change}
    with pytest.raises(InputError, match=match):
        k_best_choices(
            *map(np.array, given.values()),
            first_row=np.array([0, 2]),
            first_column=np.array([0, 2]),
            ks=np.array([3]),
        )


def test_kernels_agree_to_the_bit():
    native = pytest.importorskip("pmbm._native", reason="installed without a compiler")
    for seed, (rows, columns) in itertools.product(range(3), [(4, 4), (12, 9), (30, 40)]):
        batch = Batch(seed, problems=6, most_rows=rows, most_columns=columns, share=3 / columns)
        problem = (*batch.options, batch.first_row, batch.first_column, batch.ks)
        for margin in (np.inf, 3.0):
            both = (
                native.k_best_choices(*problem, margin),
                TWINS["k_best_choices"](*problem, margin),
            )
            for fast, plain in zip(*both, strict=True):
                assert fast.dtype == plain.dtype
                assert fast.tolist() == plain.tolist()
