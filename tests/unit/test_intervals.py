"""Intervals by hand, against scipy, and their laws."""

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st

from pmbm.intervals import (
    COUNT,
    MEASURED,
    SHARE,
    Counts,
    Equal,
    Scale,
    jackknife,
    jackknife_reach,
    of_mean,
)
from pmbm.study import estimate, metric_scale

counts = st.lists(st.integers(0, 40), min_size=2, max_size=12)


def garwood(total, trials, level=0.95):
    """The exact interval of a Poisson mean (Biometrika 28, 1936)."""
    tail = (1 - level) / 2
    low = scipy.stats.chi2.ppf(tail, 2 * total) / 2 if total else 0.0
    return low / trials, scipy.stats.chi2.ppf(1 - tail, 2 * total + 2) / 2 / trials


@pytest.mark.parametrize("trials", [5, 20])
@pytest.mark.parametrize("level", [0.95, 0.999])
def test_counts_that_never_happened_have_the_bound_of_poisson(trials, level):
    found = of_mean(np.zeros(trials), COUNT)
    assert found.ends(level) == pytest.approx(garwood(0, trials, level))


def test_counts_of_one_a_trial_have_the_interval_of_poisson():
    """In many trials, where Student's t and the normal distribution agree."""
    assert of_mean(np.ones(5000), COUNT).ends() == pytest.approx(garwood(5000, 5000), rel=1e-4)


def test_what_was_not_seen_is_a_burst_where_bursts_were_seen():
    """20 trials, one with 10: the variance a trial is 5, so the dispersion is 10 (t / z)^2."""
    low, high = of_mean(np.array([10.0] + [0.0] * 19), COUNT).ends()
    wider = (scipy.stats.t.ppf(0.975, 19) / scipy.stats.norm.ppf(0.975)) ** 2
    burst = 2 * 10 * wider - 1
    # Mean and variance of 10 + burst and 20 x 5 x wider + burst^2, as those of a gamma.
    mean, variance = 10 + burst, 20 * 5 * wider + burst**2
    gamma = scipy.stats.gamma(mean**2 / variance, scale=variance / mean)
    assert high == pytest.approx(gamma.ppf(0.975) / 20)
    assert 0 < low < 0.1


@given(counts)
def test_a_count_has_no_interval_of_no_width(values):
    found = estimate([float(value) for value in values], COUNT)
    assert 0 <= found.low <= found.mean <= found.high
    assert found.high - found.low > 0.01


@given(counts, counts)
def test_differences_turn_round_with_their_sides(one, other):
    n = min(len(one), len(other))
    values = np.array(one[:n], float) - np.array(other[:n])
    scale = COUNT.of_differences
    found, back = of_mean(values, scale), of_mean(-values, scale)
    assert back.p_value() == pytest.approx(found.p_value())
    if found.ends() is None:
        assert np.ptp(values) == 0 != values[0]
        return
    low, high = found.ends()
    assert back.ends() == pytest.approx((-high, -low), abs=1e-9)
    assert low <= values.mean() <= high
    assert high - low > 0.01


@given(counts)
def test_where_the_interval_reaches_zero_is_the_p_value(values):
    found = of_mean(np.array(values, float), COUNT.of_differences)
    p = found.p_value()
    assert 0 < p <= 1
    if isinstance(found, Counts) and 1e-9 < p < 0.99:
        assert found.ends(1 - 1.01 * p)[0] > 0
        assert found.ends(1 - p / 1.01)[0] < 0


def test_no_difference_in_any_trial_is_a_bound_on_either_side():
    low, high = of_mean(np.zeros(20), COUNT.of_differences).ends()
    assert (low, high) == pytest.approx((-garwood(0, 20)[1], garwood(0, 20)[1]))
    assert of_mean(np.zeros(20), COUNT.of_differences).p_value() == 1


def test_many_large_counts_have_students_interval():
    values = np.random.default_rng(1).normal(1000, 100, 60).round()
    want = scipy.stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert of_mean(values, COUNT).ends() == pytest.approx(tuple(want), rel=0.01)


def test_a_mean_over_settings_is_counted_in_its_own_steps():
    values = np.array([0.0, 1.0, 0.0, 2.0, 0.0])
    low, high = of_mean(values, COUNT).ends()
    assert of_mean(values / 4, COUNT.mean_of(4)).ends() == pytest.approx((low / 4, high / 4))


def test_a_share_that_is_one_in_every_trial_is_bounded_by_what_was_not_seen():
    """Others have a share of at most 1 - .025^(1/20) of the trials, and are no less than 0."""
    found = estimate([1.0] * 20, SHARE)
    assert (found.low, found.high) == pytest.approx((0.025 ** (1 / 20), 1.0))
    low, high = scipy.stats.binomtest(20, 20).proportion_ci(0.95, method="exact")
    assert (found.low, found.high) == pytest.approx((low, high))
    none = estimate([0.0] * 20, SHARE.of_differences)
    assert (none.low, none.high) == pytest.approx((low - 1, 1 - low))


def test_equal_values_without_ends_have_no_interval():
    found = estimate([3.25] * 20)
    assert (found.mean, found.low, found.high, found.n) == (3.25, None, None, 20)


@pytest.mark.parametrize("scale", [MEASURED, SHARE.of_differences, Scale(-np.inf, np.inf, 0.1)])
def test_equal_differences_are_no_proof_in_two_trials_and_are_in_twenty(scale):
    """The p-value of the sign test; rounding makes no difference of it."""
    wobble = np.array([0.1, 0.1 + 1e-17, 0.1 - 1e-17, 0.3 - 0.2])
    for n in (2, 4, 20):
        values = np.resize(wobble, n)
        found = of_mean(values, scale)
        assert isinstance(found, Equal)
        assert found.p_value() == pytest.approx(scipy.stats.binomtest(n, n).pvalue)
        assert found.ends() is None
    assert of_mean(np.zeros(20), scale).p_value() == 1


def test_the_scale_of_a_metric():
    for name in ("id_switches", "misses_observable", "false_tracks"):
        assert metric_scale(name) == COUNT
    assert metric_scale("hota") == SHARE
    assert metric_scale("ospa") == Scale(0, 10)
    for name in ("mota", "gospa", "nees"):
        assert metric_scale(name) == MEASURED
    # A user's own: whole numbers from 0 up are counts.
    assert metric_scale("collisions", [0.0, 2.0, None]) == COUNT
    assert metric_scale("near_misses", [0.5, 2.0]) == MEASURED
    assert metric_scale("own", []) == metric_scale("own", [-1.0]) == MEASURED
    assert Scale(0, 1).of_differences == Scale(-1, 1)


def test_the_jackknife_of_a_mean_is_students():
    values = np.random.default_rng(2).normal(size=9)
    without = (values.sum() - values) / 8
    low, high = scipy.stats.ttest_1samp(values, 0).confidence_interval(0.95)
    assert jackknife_reach(without, [3.0] * 9) == pytest.approx((high - low) / 2)


def test_unequal_lengths_leave_fewer_degrees_of_freedom():
    """Lengths 4 1 1 1 1: 8^2 / 20 - 1 = 2.2, and 20^2 / 260 + .5 = 2.04 is less."""
    _, degrees = jackknife([1.0, 2.0, 3.0, 4.0, 5.0], [4.0, 1.0, 1.0, 1.0, 1.0])
    assert degrees == pytest.approx(400 / 260 + 0.5)
    _, degrees = jackknife([1.0, 2.0, 3.0, 4.0, 5.0], [2.0, 1.0, 1.0, 1.0, 1.0])
    assert degrees == pytest.approx(36 / 8 - 1)
