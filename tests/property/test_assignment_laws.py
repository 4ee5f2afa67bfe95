"""Laws of the k best assignments, on matrices that hypothesis chooses."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmbm.assignment import k_best

pytestmark = pytest.mark.usefixtures("assignment_kernel")

WHOLE = st.integers(-6, 6).map(float)


@st.composite
def matrices(draw, entries=WHOLE, most_rows=6):
    """(R, C) cost matrices with forbidden pairs and, of whole numbers, many ties."""
    rows = draw(st.integers(0, most_rows))
    width = draw(st.integers(0, 8))
    entry = st.one_of(entries, st.just(np.inf))
    cells = draw(st.lists(entry, min_size=rows * width, max_size=rows * width))
    return np.array(cells, dtype=float).reshape(rows, width)


any_k = st.integers(0, 60)


@given(matrices(), any_k)
def test_solutions_are_assignments_in_order(cost, k):
    columns, costs = k_best(cost, k)
    assert len(columns) == len(costs) <= k
    for taken, total in zip(columns, costs, strict=True):
        assert len(set(taken.tolist())) == len(cost)
        assert cost[np.arange(len(cost)), taken].sum() == total < np.inf
    solutions = list(zip(costs.tolist(), columns.tolist(), strict=True))
    assert solutions == sorted(solutions)
    assert len({tuple(taken) for taken in columns.tolist()}) == len(columns)


@given(matrices(), any_k, st.randoms(use_true_random=False))
def test_order_of_rows_and_columns_does_not_matter(cost, k, random):
    rows = random.sample(range(cost.shape[0]), cost.shape[0])
    width = random.sample(range(cost.shape[1]), cost.shape[1])
    # Whole numbers add up exactly in any order, so the costs must be equal and not just close.
    assert k_best(cost[rows][:, width], k)[1].tolist() == k_best(cost, k)[1].tolist()


@given(matrices(), any_k, st.integers(0, 5), WHOLE)
def test_a_constant_on_a_row_shifts_every_cost(cost, k, row, shift):
    if row < len(cost):
        shifted = cost.copy()
        shifted[row] += shift
        assert k_best(shifted, k)[1].tolist() == (k_best(cost, k)[1] + shift).tolist()


@given(matrices(), any_k, st.integers(0, 60))
def test_fewer_are_a_prefix_in_cost(cost, k, fewer):
    fewer = min(k, fewer)
    assert k_best(cost, k)[1][:fewer].tolist() == k_best(cost, fewer)[1].tolist()


@given(matrices(most_rows=4))
def test_forbidding_a_pair_leaves_the_others(cost):
    """All but the solutions that use the best one's first pair survive forbidding that pair."""
    columns, _ = k_best(cost, 10_000)
    if not len(cost) or not len(columns):
        return
    first = columns[0, 0]
    without = cost.copy()
    without[0, first] = np.inf
    keep = columns[:, 0] != first
    assert k_best(without, 10_000)[0].tolist() == columns[keep].tolist()


@given(matrices(st.floats(-1e6, 1e6, width=32)), any_k)
def test_rounding_never_costs_a_solution(cost, k):
    """With any floats there are as many solutions as with all finite costs set to zero."""
    pattern = np.where(np.isfinite(cost), 0.0, np.inf)
    assert len(k_best(cost, k)[1]) == len(k_best(pattern, k)[1])
