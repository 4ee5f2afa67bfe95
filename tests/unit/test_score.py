"""The score model against samples with known odds, and through a file and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mark_builders import fit_logistic

from pmbm.errors import InputError
from pmbm.score import ScoreModel


def sample(seed, n=20_000):
    """Scores whose true odds are known: P(true | x) = logistic(3 x - 1)."""
    rng = np.random.default_rng(seed)
    x = rng.normal(0.3, 0.7, n)
    return x, rng.random(n) < 1 / (1 + np.exp(1 - 3 * x))


@pytest.mark.parametrize("fit", [fit_logistic, ScoreModel.fit_isotonic])
def test_a_fit_finds_the_odds(fit):
    x, true = sample(0)
    model = fit(x, true, scale="raw_score")
    at = np.array([-0.5, 0.0, 0.3, 0.6, 1.0])
    assert model.probability(at) == pytest.approx(1 / (1 + np.exp(1 - 3 * at)), abs=0.04)
    assert model.base_rate == pytest.approx(true.mean())
    assert model.scale == "raw_score"


@pytest.mark.parametrize("fit", [fit_logistic, ScoreModel.fit_isotonic])
def test_likelihood_ratios_follow_bayes(fit):
    """Posterior odds = ratio times prior odds; the ratio averages to one over clutter."""
    x, true = sample(1)
    model = fit(x, true)
    ratio = np.exp(model.log_likelihood_ratio(x))
    odds = model.probability(x) / (1 - model.probability(x))
    prior = model.base_rate / (1 - model.base_rate)
    assert ratio * prior == pytest.approx(odds, rel=1e-9)
    assert ratio[~true].mean() == pytest.approx(1.0, abs=0.05)


@given(st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=60))
def test_any_sample_gives_a_finite_rising_model(pairs):
    score, true = np.array([p[0] for p in pairs]), np.array([p[1] for p in pairs])
    for fit in (fit_logistic, ScoreModel.fit_isotonic):
        model = fit(score, true)
        q = model.probability(np.linspace(0, 1, 11))
        assert ((q > 0) & (q < 1)).all()
        if fit == ScoreModel.fit_isotonic:
            assert (np.diff(q) >= 0).all()
        assert np.isfinite(model.log_likelihood_ratio([0.0, 1.0])).all()


def test_perfectly_separated_scores_stay_finite():
    score = np.linspace(0, 1, 40)
    model = fit_logistic(score, score > 0.5)
    assert model.probability([0.0])[0] < 0.05
    assert model.probability([1.0])[0] > 0.95


def test_simple_models():
    trusting = ScoreModel.trusting()
    score = np.array([0.0, 0.01, 0.5, 0.97, 1.0])
    assert trusting.probability(score) == pytest.approx(score, abs=2e-4)
    assert trusting.evidence([0.5])[0] == 0.5
    assert ScoreModel.trusting(0.8).evidence([0.8])[0] == pytest.approx(0.5, abs=1e-6)
    assert (ScoreModel.uninformative().evidence(score) == 0.5).all()


def test_a_model_survives_its_file(tmp_path):
    model = ScoreModel.fit_isotonic(*sample(2, 500))
    model.save(tmp_path / "scores.toml")
    again = ScoreModel.load(tmp_path / "scores.toml")
    assert np.array_equal(again.knot, model.knot)
    assert np.array_equal(again.log_odds, model.log_odds)
    assert (again.base_rate, again.scale) == (model.base_rate, model.scale)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("base_rate = 0.5\nknots = [0.0]\nlog_odds = [0.0]", ["knots", "did you mean 'knot'"]),
        ("base_rate = 0.5\nknot = [0.0]", ["missing", "log_odds"]),
        ("base_rate = 1.5\nknot = [0.0]\nlog_odds = [0.0]", ["base_rate", "1.5"]),
        ("base_rate = 0.5\nknot = [1.0, 0.0]\nlog_odds = [0.0, 1.0]", ["knot", "rising"]),
        ("base_rate = 0.5\nknot = [0.0]\nlog_odds = [nan]", ["log_odds"]),
        ("base_rate = 0.5\nknot = ['a']\nlog_odds = [0.0]", ["knot"]),
        ("base_rate = 0.5\nknot = 3\nlog_odds = [0.0]", ["knot"]),
        ("base_rate = 0.5\nknot = [0.0]\nlog_odds = [0.0]\nscale = 'row_score'", ["raw_score"]),
        ("base_rate = ", ["read"]),
    ],
)
def test_a_broken_file_is_refused_by_name(tmp_path, text, words):
    path = tmp_path / "scores.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        ScoreModel.load(path)
    for word in [*words, "scores.toml"]:
        assert word in str(caught.value)


def test_a_missing_file_and_a_bad_sample_are_refused(tmp_path):
    with pytest.raises(InputError, match="read"):
        ScoreModel.load(tmp_path / "none.toml")
    with pytest.raises(InputError, match="score"):
        ScoreModel.fit_isotonic([], [])
    with pytest.raises(InputError, match="true"):
        ScoreModel.fit_isotonic([0.1, 0.2], [0, 2])
