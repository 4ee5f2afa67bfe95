"""Calibration of probabilities, consistency of covariances, SIAP: by hand and by simulation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scipy.stats
from metric_builders import run_of

from pmbm.errors import InputError
from pmbm.metrics import combine, evaluate
from pmbm.metrics.families.consistency import chi2_bounds, consistency, normalised_squares
from pmbm.metrics.families.existence import reliability


def test_reliability_by_hand():
    result = reliability([0.05, 0.15, 0.15, 1.0], [False, True, False, True], bins=10)
    assert result.count.tolist() == [1, 2, 0, 0, 0, 0, 0, 0, 0, 1]
    assert result.hits.tolist() == [0, 1, 0, 0, 0, 0, 0, 0, 0, 1]
    assert result.square_sum == pytest.approx(0.05**2 + 0.85**2 + 0.15**2)
    assert result.expected_error == pytest.approx((0.05 + 2 * (0.5 - 0.15)) / 4)
    said, real = result.curve
    np.testing.assert_allclose(said, [0.05, 0.15, 1.0])
    np.testing.assert_allclose(real, [0, 0.5, 1])


def test_reliability_of_several_runs_adds_up():
    rng = np.random.default_rng(1)
    p, hit = rng.random(200), rng.random(200) < 0.5
    whole = reliability(p, hit)
    parts = reliability(p[:50], hit[:50]) + reliability(p[50:], hit[50:])
    assert parts.square_sum == pytest.approx(whole.square_sum)
    assert parts.expected_error == pytest.approx(whole.expected_error)


def test_honest_probabilities_are_calibrated_and_boasts_are_not():
    rng = np.random.default_rng(2)
    p = rng.random(20_000)
    hit = rng.random(20_000) < p
    # The error of a bin of n reports is about sqrt(p (1 - p) / n), at most 0.012 here.
    assert reliability(p, hit).expected_error < 0.02
    assert reliability(np.sqrt(p), hit).expected_error > 0.1
    assert reliability(p, hit).square_sum / len(p) == pytest.approx(1 / 6, abs=0.01)


def test_nothing_reported_has_no_calibration():
    nothing = reliability([], [])
    assert nothing.count.sum() == nothing.square_sum == 0
    assert nothing.expected_error is None


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        (([0.5, 1.2], [True, False]), "probability"),
        (([0.5, np.nan], [True, False]), "probability"),
        (([0.5], [True, False]), "true"),
    ],
)
def test_reports_are_checked(arguments, field):
    with pytest.raises(InputError) as caught:
        reliability(*arguments)
    assert caught.value.field == field


def test_squares_of_consistent_errors_lie_inside_their_bounds():
    rng = np.random.default_rng(3)
    covariance = np.array([[2.0, 0.6], [0.6, 0.5]])
    errors = rng.multivariate_normal([0, 0], covariance, size=(50, 200))
    result = consistency(normalised_squares(errors, covariance), 2)
    assert result.anees == pytest.approx(1, abs=0.05)
    assert 0.9 <= result.fraction_inside <= 0.99
    assert result.bounds[0] < result.mean < result.bounds[1]
    boast = consistency(normalised_squares(errors, covariance / 2), 2)
    assert boast.anees == pytest.approx(2, abs=0.1)
    assert boast.mean > boast.bounds[1]


def test_runs_that_differ_widen_the_bounds_of_nees():
    """Five runs of two frames, of NEES 1 to 5 at every frame: Student's t of the runs' means."""
    runs = []
    for nees in range(1, 6):
        covariance = np.tile(np.eye(4), (1, 1, 1)) / nees
        truth, tracks = [{1: (0, 0)}] * 2, [{1: (1, 0)}] * 2
        recording, reports = run_of(truth, tracks)
        reports = [dataclasses.replace(each, covariance=covariance) for each in reports]
        runs.append(evaluate(recording, reports, ["nees", "anees"]))
    assert dict(runs[0]["nees"].components) == {"n": 2.0, "runs": 1.0}
    assert "low" not in combine(runs[:4])["nees"].components
    whole = combine(runs)
    assert whole["nees"].value == pytest.approx(3.0)
    reach = scipy.stats.t.ppf(0.975, 4) * np.sqrt(2.5 / 5)
    want = {"n": 10, "runs": 5, "low": 4 - reach, "high": 4 + reach}
    assert dict(whole["nees"].components) == pytest.approx(want)
    want |= {"low": 1 - reach / 4, "high": 1 + reach / 4}
    assert dict(whole["anees"].components) == pytest.approx(want)
    squares = np.tile(np.arange(1.0, 6.0)[:, None], (1, 2))
    assert consistency(squares, 4).bounds == pytest.approx((4 - reach, 4 + reach))
    assert consistency(squares[:4], 4).bounds is None


def test_angles_are_wrapped():
    squares = normalised_squares([[2 * np.pi + 0.1]], [[0.01]], angles=(0,))
    assert squares[0] == pytest.approx(1.0)


def test_a_covariance_that_is_not_positive_definite_is_named():
    good, bad = np.eye(2), np.diag([1.0, 0.0])
    with pytest.raises(InputError, match="singular covariance") as caught:
        normalised_squares(np.zeros((3, 2)), [good, bad, good])
    assert caught.value.rows == (1,)


def test_bounds_close_in_on_the_dimension():
    low, high = chi2_bounds(4, 1)
    assert low == pytest.approx(0.4844, abs=1e-4)
    assert high == pytest.approx(11.1433, abs=1e-4)
    low, high = chi2_bounds(4, 10_000)
    assert 3.9 < low < 4 < high < 4.1


def test_siap_by_hand():
    """Object 1 is followed by track 7, then 8; track 9 follows nothing in the last two frames."""
    truth = [{1: (0, 0), 2: (0, 50)}] * 4
    tracks = [{7: (1, 0)}, {7: (1, 0)}, {8: (0, 0), 9: (40, 0)}, {8: (0, 0), 9: (40, 0)}]
    recording, reports = run_of(truth, tracks, dt=1.0)
    names = [
        "siap_completeness",
        "siap_ambiguity",
        "siap_spuriousness",
        "siap_position_accuracy",
        "siap_track_changes",
        "siap_longest_segment",
    ]
    scores = evaluate(recording, reports, names).scalars()
    assert scores["siap_completeness"] == pytest.approx(4 / 8)
    assert scores["siap_ambiguity"] == 1
    assert scores["siap_spuriousness"] == pytest.approx(2 / 6)
    assert scores["siap_position_accuracy"] == pytest.approx(0.5)
    # One change in the two seconds that a single track bridges; each spell lasts one of three.
    assert scores["siap_track_changes"] == pytest.approx(1 / 2)
    assert scores["siap_longest_segment"] == pytest.approx(1 / 6)
