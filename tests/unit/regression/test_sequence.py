"""The confidence sequence against quadrature, closed forms and hand-worked rules."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq
from scipy.stats import norm

from pmbm.regression.sequence import (
    _log_e_value,
    _reach,
    _spread,
    evidence,
    fewest_trials,
    hidden_rate,
    trials_without_change,
)

ALPHA = 0.01
SPREAD = _spread(ALPHA, 90)
RULES = {"value_range": 1.0, "alpha": ALPHA, "rarest": 0.05}


def mixture(total, n, spread):
    """E over |N(0, spread)| of the likelihood ratio exp(x S - x^2 n / 2), by quadrature."""
    sd = math.sqrt(spread)
    peak = max(total / n, sd)

    def integrand(x):
        return 2 * norm.pdf(x, scale=sd) * math.exp(x * total - x * x * n / 2)

    return quad(integrand, 0, peak + 30 / math.sqrt(n), points=[peak], limit=400)[0]


@pytest.mark.parametrize("n", [1, 7, 90, 600])
@pytest.mark.parametrize("z", [-1.0, 0.0, 2.0, 4.0])
def test_the_e_value_is_the_mixture(n, z):
    total = z * math.sqrt(n)
    found = _log_e_value(np.array([total / n]), np.array([float(n)]), SPREAD)[0]
    assert found == pytest.approx(math.log(mixture(total, n, SPREAD)), abs=1e-8)


@pytest.mark.parametrize("level", [0.05, 0.01, 1e-4])
@pytest.mark.parametrize("n", [1.0, 90.0, 1e4, 1e6])
def test_the_reach_is_where_the_e_value_is_one_over_alpha(n, level):
    def above(score):
        return _log_e_value(np.array([score]), np.array([n]), SPREAD)[0] - math.log(1 / level)

    assert _reach(np.array([n]), SPREAD, level)[0] == pytest.approx(
        brentq(above, 0.0, 60.0, xtol=1e-15), rel=1e-9
    )


def test_the_published_bound_is_a_little_wider():
    # Waudby-Smith et al., one-sided: sqrt(2 (n r + 1) / (n^2 r) log(1 + sqrt(n r + 1) / (2 a))).
    n = np.arange(10.0, 1000.0)
    published = np.sqrt(
        2 * (n * SPREAD + 1) / (n**2 * SPREAD) * np.log1p(np.sqrt(n * SPREAD + 1) / (2 * ALPHA))
    )
    ours = _reach(n, SPREAD, ALPHA)
    assert np.all(ours <= published)
    assert np.all(ours >= 0.93 * published)


def test_trials_for_rare_disasters():
    assert fewest_trials(0.01, 0.05) == 90
    assert fewest_trials(0.05, 0.05) == 59
    assert (1 - 0.05) ** 90 <= 0.01 < (1 - 0.05) ** 89
    assert hidden_rate(0.01, 90) == pytest.approx(1 - 0.01 ** (1 / 90))
    assert hidden_rate(0.01, 90) < 0.05 < hidden_rate(0.01, 89)


def test_equal_values_pass_when_disasters_would_have_been_seen():
    proof = evidence(np.zeros(120), 1e-6, **RULES)
    assert np.flatnonzero(proof.p_pass <= ALPHA)[0] + 1 == 90
    assert proof.p_fail.min() > 0.4


def test_one_last_bit_of_difference_makes_the_floor_count():
    loss = np.zeros(600)
    loss[0] = 1e-16
    proof = evidence(loss, 0.01, **RULES)
    first = np.flatnonzero(proof.p_pass <= ALPHA)[0] + 1
    assert first == trials_without_change(0.01, **RULES) > 300


def test_the_variance_never_falls_below_the_floor():
    proof = evidence(np.full(400, 0.003), 0.5, **RULES)
    n = np.arange(1, 401)
    half = _reach(n.astype(float), SPREAD, ALPHA) / np.sqrt(n)
    np.testing.assert_allclose(proof.high - 0.003, half, rtol=1e-9)
    np.testing.assert_allclose(0.003 - proof.low, half, rtol=1e-9)
    noisy = np.random.default_rng(1).normal(0.0, 2.0, 400)
    wide = evidence(noisy, 0.5, **RULES)
    running_sd = np.array([noisy[:k].std(ddof=1) for k in range(2, 401)])
    np.testing.assert_allclose(
        (wide.high - wide.loss)[1:],
        _reach(n[1:].astype(float), SPREAD, ALPHA) * np.maximum(running_sd, 1 / np.sqrt(n[1:])),
        rtol=1e-9,
    )


def test_bounds_and_p_values_say_the_same():
    rng = np.random.default_rng(3)
    loss = rng.normal(0.02, 0.2, (40, 300))
    proof = evidence(loss, 0.08, **RULES)
    np.testing.assert_array_equal(proof.low > 0, proof.p_fail < ALPHA)
    late = np.arange(1, 301) >= 90
    np.testing.assert_array_equal((proof.high < 0.08)[:, late], (proof.p_pass < ALPHA)[:, late])
    assert (proof.p_pass[:, ~late] > ALPHA).all()


def test_a_level_narrows_the_bounds_and_not_the_p_values():
    loss = np.random.default_rng(5).normal(0.0, 0.1, 200)
    wide = evidence(loss, 0.05, **RULES, level=ALPHA / 10)
    narrow = evidence(loss, 0.05, **RULES)
    assert np.all(wide.high > narrow.high)
    assert np.all(wide.low < narrow.low)
    np.testing.assert_array_equal(wide.p_pass, narrow.p_pass)


def test_the_least_cost_of_a_margin():
    # One fewer trial would not do, and the floor alone decides it.
    for margin in (0.5, 0.05, 0.01, 0.002):
        n = trials_without_change(margin, **RULES)
        half = _reach(np.array([float(n)]), SPREAD, ALPHA)[0] / math.sqrt(n)
        assert half < margin
        if n > 90:
            fewer = _reach(np.array([n - 1.0]), SPREAD, ALPHA)[0] / math.sqrt(n - 1)
            assert fewer >= margin
    assert trials_without_change(0.5, **RULES) == 90
    assert trials_without_change(1e-9, **RULES, at_most=1000) == 1000
