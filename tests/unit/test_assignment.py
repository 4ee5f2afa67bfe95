"""K best assignments against plain enumeration, and what the door refuses."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from pmbm.assignment import LARGEST_COST, k_best, k_best_batch, optimal
from pmbm.errors import InputError

pytestmark = pytest.mark.usefixtures("assignment_kernel")

INF = np.inf


def enumerate_assignments(cost):
    """Every assignment with its cost, cheapest first, by trying every permutation."""
    rows, width = cost.shape
    found = []
    for columns in itertools.permutations(range(width), rows):
        total = 0.0
        for row, column in enumerate(columns):
            total += cost[row, column]
        if total < INF:
            found.append((total, columns))
    return sorted(found)


def assert_agrees(cost, k):
    """The k best of `cost` are those of the enumeration; returns how many there were."""
    columns, costs = k_best(cost, k)
    wanted = enumerate_assignments(np.asarray(cost, dtype=np.float64))
    n = min(k, len(wanted))
    assert columns.shape == (n, len(cost))
    assert columns.dtype == np.int32
    assert costs.dtype == np.float64
    np.testing.assert_allclose(costs, [total for total, _ in wanted[:n]], rtol=1e-12, atol=1e-12)
    by_columns = {taken: total for total, taken in wanted}
    got = [tuple(row) for row in columns.tolist()]
    assert len(set(got)) == n, "a solution came twice"
    assert [by_columns[taken] for taken in got] == costs.tolist(), "sums follow the rows' order"
    assert list(zip(costs.tolist(), got, strict=True)) == sorted(
        zip(costs.tolist(), got, strict=True)
    )
    return n


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (2, 2), (3, 3), (3, 6), (4, 5), (5, 5), (5, 7)])
@pytest.mark.parametrize("k", [1, 2, 7, 60, 10_000])
def test_dense(shape, k):
    random = np.random.default_rng([*shape, k])
    assert_agrees(random.normal(scale=10, size=shape), k)


@pytest.mark.parametrize("seed", range(40))
def test_forbidden_pairs(seed):
    random = np.random.default_rng(seed)
    rows = int(random.integers(1, 6))
    cost = random.normal(size=(rows, rows + int(random.integers(0, 3))))
    cost[random.random(cost.shape) < random.uniform(0.1, 0.8)] = INF
    assert_agrees(cost, 500)


@pytest.mark.parametrize("seed", range(20))
def test_gated_problems_with_a_private_column_for_each_row(seed):
    random = np.random.default_rng(seed)
    gated = random.normal(-3, 2, size=(4, 3))
    gated[random.random(gated.shape) < 0.5] = INF
    private = np.full((4, 4), INF)
    np.fill_diagonal(private, random.normal(size=4))
    assert assert_agrees(np.hstack([gated, private]), 30) >= 1


@pytest.mark.parametrize("seed", range(30))
def test_ties_of_whole_costs_are_exact_and_in_order(seed):
    random = np.random.default_rng(seed)
    cost = random.integers(-2, 3, size=(4, 5)).astype(float)
    cost[random.random(cost.shape) < 0.2] = INF
    every = enumerate_assignments(cost)
    assert_agrees(cost, 1000)
    # Up to a k where the cost changes, the answer has no freedom at all.
    for k in [n for n in range(1, len(every)) if every[n - 1][0] < every[n][0]][:12]:
        columns, costs = k_best(cost, k)
        assert [tuple(row) for row in columns.tolist()] == [taken for _, taken in every[:k]]
        assert costs.tolist() == [total for total, _ in every[:k]]


def test_all_equal_costs_give_every_permutation_in_order():
    columns, costs = k_best(np.ones((4, 4)), 100)
    assert columns.tolist() == [list(taken) for taken in itertools.permutations(range(4))]
    assert costs.tolist() == [4.0] * 24


def test_hand_worked():
    # Diagonal 1 + 1, the other way 2 + 4: nothing else exists.
    columns, costs = k_best([[1, 2], [4, 1]], 5)
    assert columns.tolist() == [[0, 1], [1, 0]]
    assert costs.tolist() == [2.0, 6.0]


@pytest.mark.parametrize("width", [0, 3])
def test_no_rows_have_the_empty_assignment(width):
    columns, costs = k_best(np.zeros((0, width)), 5)
    assert columns.shape == (1, 0)
    assert costs.tolist() == [0.0]
    assert optimal(np.zeros((0, width)))[1] == 0.0


@pytest.mark.parametrize(
    "cost",
    [
        np.zeros((3, 2)),
        np.zeros((2, 0)),
        np.full((2, 2), INF),
        np.array([[1.0, 2.0], [INF, INF]]),
        np.array([[1.0, INF], [2.0, INF]]),
    ],
    ids=["tall", "no columns", "all forbidden", "a row forbidden", "two rows, one column"],
)
def test_infeasible(cost):
    columns, costs = k_best(cost, 3)
    assert columns.shape == (0, len(cost))
    assert costs.shape == (0,)
    with pytest.raises(InputError, match="no assignment"):
        optimal(cost)


def test_k_zero_gives_none():
    columns, costs = k_best(np.eye(2), 0)
    assert columns.shape == (0, 2)
    assert costs.shape == (0,)


@pytest.mark.parametrize("shape", [(30, 30), (40, 90), (100, 200)])
def test_optimal_agrees_with_scipy_where_enumeration_cannot_reach(shape):
    cost = np.random.default_rng(5).normal(size=shape)
    columns, total = optimal(cost)
    rows, expected = linear_sum_assignment(cost)
    assert columns.tolist() == expected.tolist()
    assert total == pytest.approx(cost[rows, expected].sum(), rel=1e-12)


def test_batch_is_each_alone():
    random = np.random.default_rng(3)
    costs = [random.normal(size=(r, r + extra)) for r in range(5) for extra in range(3)]
    costs.insert(4, np.full((2, 3), INF))
    ks = [int(k) for k in random.integers(0, 40, size=len(costs))]
    together = k_best_batch(costs, ks)
    assert len(together) == len(costs)
    for (columns, totals), cost, k in zip(together, costs, ks, strict=True):
        alone_columns, alone_totals = k_best(cost, k)
        assert columns.tolist() == alone_columns.tolist()
        assert totals.tolist() == alone_totals.tolist()
    assert k_best_batch([], []) == []


def test_input_is_left_alone_and_may_be_read_only_or_strided():
    cost = np.asfortranarray(np.random.default_rng(1).normal(size=(4, 6)))
    before = cost.copy()
    cost.flags.writeable = False
    columns, _ = k_best(cost, 10)
    np.testing.assert_array_equal(cost, before)
    assert columns.tolist() == k_best(before, 10)[0].tolist()
    assert k_best(cost[::-1, ::2], 3)[0].tolist() == k_best(before[::-1, ::2].copy(), 3)[0].tolist()


@pytest.mark.parametrize(
    ("cost", "match"),
    [
        ([[0.0, np.nan]], "got nan"),
        ([[1.0, 2.0], [3.0, -INF]], r"rows 1.*got -inf"),
        ([[LARGEST_COST * 2]], "2e\\+100"),
        ([[-LARGEST_COST * 2]], "-2e\\+100"),
        ([1.0, 2.0], r"shape \(R, C\)"),
        (np.zeros((1, 2, 3)), r"shape \(1, 2, 3\)"),
        (3.0, r"shape \(R, C\)"),
        ([["a"]], r"shape \(R, C\)"),
        ([[1.0], [2.0, 3.0]], r"shape \(R, C\)"),
        (None, r"shape \(R, C\)"),
    ],
)
def test_refused_costs(cost, match):
    with pytest.raises(InputError, match=match):
        k_best(cost, 1)


@pytest.mark.parametrize("k", [-1, 1.5, True, None, "3"])
def test_refused_k(k):
    with pytest.raises(InputError, match="whole number"):
        k_best(np.eye(2), k)


def test_the_problem_of_a_batch_is_named():
    with pytest.raises(InputError, match="problem 1"):
        k_best_batch([np.eye(2), [[np.nan]]], [1, 1])
    with pytest.raises(InputError, match="one k"):
        k_best_batch([np.eye(2)], [1, 2])


def test_extreme_sizes_of_costs():
    random = np.random.default_rng(0)
    for scale in (LARGEST_COST / 2, 1e-300, 1e15):
        cost = random.uniform(-scale, scale, size=(4, 4))
        columns, costs = k_best(cost, 24)
        assert sorted(map(tuple, columns.tolist())) == sorted(itertools.permutations(range(4)))
        assert (np.diff(costs) >= 0).all()
