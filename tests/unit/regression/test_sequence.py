"""The confidence sequence against exact products of its bets, and its laws."""

import math
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmbm.regression.sequence import (
    BETS,
    WEIGHTS,
    evidence,
    fewest_trials,
    hidden_rate,
    log_wealth,
    trials_without_change,
    upper_bound,
)

ALPHA = 0.01
LOSSES = st.lists(st.integers(-64, 64), min_size=1, max_size=40)
"""Numerators of losses in 64ths of the range."""


def direct(values, ceiling, mean):
    """The wealth after each value in exact fractions, bet by bet."""
    shares = [Fraction(1, 2**k) for k in range(8)]
    weights = [Fraction(1, 2)] + [Fraction(1, 14)] * 7
    wealth, after = list(weights), []
    for value in values:
        wealth = [
            w * (1 - c * (value - mean) / (ceiling - mean))
            for c, w in zip(shares, wealth, strict=True)
        ]
        assert min(wealth) >= 0
        after.append(sum(wealth))
    return after


@given(LOSSES, st.integers(-63, 63))
def test_wealth_is_the_product_of_the_bets(numerators, at):
    values, mean = [Fraction(k, 64) for k in numerators], Fraction(at, 64)
    ours = log_wealth(np.array(numerators) / 64, 1.0, at / 64)
    theirs = [math.log(w) for w in direct(values, Fraction(1), mean)]
    np.testing.assert_allclose(ours, theirs, rtol=1e-11, atol=1e-11)


def test_what_a_gambler_starts_with_is_one():
    assert WEIGHTS.sum() == pytest.approx(1.0, abs=1e-15)
    assert WEIGHTS.min() > 0
    assert BETS.max() == 1.0
    assert BETS.min() > 0


@given(
    st.lists(st.tuples(st.integers(-64, 64), st.integers(1, 9)), min_size=2, max_size=5),
    st.integers(0, 64),
)
def test_wealth_is_expected_to_fall_under_the_hypothesis(points, above):
    # One step over any distribution within the range, whose mean is at least what is bet against.
    total = sum(weight for _, weight in points)
    mean = sum(Fraction(value, 64) * weight for value, weight in points) / total
    against = max(mean - Fraction(above, 64), Fraction(-1))
    if against < 1:
        expected = sum(
            direct([Fraction(value, 64)], Fraction(1), against)[0] * weight
            for value, weight in points
        )
        assert expected <= total


def test_evidence_is_one_over_both_wealths():
    loss = np.random.default_rng(3).uniform(-1, 1, (4, 60))
    found = evidence(loss, loss - 0.05, value_range=1.0, ceiling=0.95)
    for row in range(4):
        exact = [Fraction(x) for x in loss[row].tolist()]
        against_margin = direct([x - Fraction(0.05) for x in exact], Fraction(0.95), 0)
        against_nothing = direct([-x for x in exact], Fraction(1), 0)
        for ours, wealths in ((found.margin, against_margin), (found.fail, against_nothing)):
            p_values = [min(1.0, float(1 / w)) for w in wealths]
            np.testing.assert_allclose(ours[row], p_values, rtol=1e-9)


def test_a_trial_at_the_ceiling_ruins_the_largest_bet_and_no_other():
    for range_ in (1.0, 0.1, 3.7, 1e-9, 1e9):
        margin = 0.03 * range_
        losses = np.array([0.0, range_, 0.0, 0.0])
        wealth = np.exp(log_wealth(losses - margin, range_ - margin))
        exact = direct([Fraction(0), Fraction(1), Fraction(0), Fraction(0)], 1, Fraction(3, 100))
        np.testing.assert_allclose(wealth, [float(w) for w in exact], rtol=1e-9)


@given(LOSSES, st.sampled_from([0.2, 0.01, 1e-4]))
def test_the_bound_is_where_the_wealth_reaches_one_over_the_level(numerators, level):
    values = np.array(numerators) / 64
    high = upper_bound(values, 1.0, level)
    low = -upper_bound(-values, 1.0, level)
    assert -1.0 <= low < high <= 1.0
    assert low <= values.mean() <= high
    if high < 1.0:
        assert log_wealth(values, 1.0, high)[-1] == pytest.approx(-math.log(level), abs=1e-6)
        assert log_wealth(values, 1.0, 0.5 * (values.mean() + high))[-1] < -math.log(level)
        assert log_wealth(values, 1.0, 0.5 * (high + 1.0))[-1] > -math.log(level)


def test_the_bound_of_the_worst_values_is_the_ceiling():
    assert upper_bound(np.full(500, 1.0), 1.0, ALPHA) == 1.0
    assert 0.97 < -upper_bound(np.full(500, -1.0), 1.0, ALPHA) < 1.0


def test_bounds_and_evidence_say_the_same():
    loss = np.random.default_rng(3).normal(0.02, 0.2, (5, 200)).clip(-1, 1)
    found = evidence(loss, loss - 0.08, value_range=1.0, ceiling=0.92)
    for row in range(5):
        for n in range(1, 200, 19):
            high = 0.08 + upper_bound(loss[row, :n] - 0.08, 0.92, ALPHA)
            assert high == pytest.approx(upper_bound(loss[row, :n], 1.0, ALPHA), abs=1e-9)
            assert (high < 0.08) == (found.margin[row, n - 1] < ALPHA)
            low = -upper_bound(-loss[row, :n], 1.0, ALPHA)
            assert (low > 0) == (found.fail[row, n - 1] < ALPHA)


def test_trials_for_rare_disasters():
    assert fewest_trials(0.01, 0.05) == 90
    assert fewest_trials(0.05, 0.05) == 59
    assert (1 - 0.05) ** 90 <= 0.01 < (1 - 0.05) ** 89
    assert hidden_rate(0.01, 90) == pytest.approx(1 - 0.01 ** (1 / 90))
    assert hidden_rate(0.01, 90) < 0.05 < hidden_rate(0.01, 89)


@pytest.mark.parametrize("margin", [0.3, 0.05, 0.03, 0.02, 0.01, 0.001])
@pytest.mark.parametrize("level", [0.01, 0.01 / 3])
def test_equal_values_take_an_eighth_more_than_any_method_could(margin, level):
    # No method passes equal values sooner: they may be all that was seen of a disaster that costs
    # the whole range in a share margin / B of trials.
    bound = math.ceil(math.log(level) / math.log1p(-margin))
    needed = trials_without_change(margin, ceiling=1.0 - margin, level=level)
    assert bound <= needed <= 1.16 * bound + 1
    found = evidence(
        np.zeros(needed), np.full(needed, -margin), value_range=1.0, ceiling=1.0 - margin
    )
    assert (found.margin[:-1] > level).all()
    assert found.margin[-1] <= level
    assert (found.fail == 1.0).all()


def test_a_margin_that_rounds_to_nothing_takes_for_ever():
    assert trials_without_change(1e-308, ceiling=1.0, level=ALPHA) == 10**15
