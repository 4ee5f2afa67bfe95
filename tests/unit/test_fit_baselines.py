"""The grid of the baselines' thresholds, and the choice."""

import numpy as np
import pytest

from pmbm.baselines import ArgoverseConfig, ProbabilisticKFConfig, WaymoConfig
from pmbm.fitting.baselines import FITTED, candidates, fewest_errors, report_thresholds
from pmbm.tracking import SHIPPED_TRACKERS


def test_the_fewest_errors_are_those_of_all_sequences_together():
    errors = np.random.default_rng(0).integers(0, 50, (5, 6, 4))
    pairs = [(c, t) for c in range(6) for t in range(4)]
    assert fewest_errors(errors) == min(pairs, key=lambda p: errors[:, p[0], p[1]].sum())


def test_of_equals_the_first_is_taken():
    assert fewest_errors(np.zeros((2, 3, 3), int)) == (0, 0)


@pytest.mark.parametrize("config", [ArgoverseConfig, WaymoConfig, ProbabilisticKFConfig])
def test_every_candidate_is_one(config):
    """On any scale, and where there is one detection, or none."""
    for scores in (np.linspace(0, 1, 50), 1e-3 * np.linspace(0, 1, 50), np.zeros(1)):
        for threshold in report_thresholds(scores):
            for table in candidates(scores):
                config(**table, report_above=threshold)


def test_thresholds_follow_the_scale():
    scores = np.random.default_rng(0).random(1000)
    np.testing.assert_allclose(
        report_thresholds(scores / 100), report_thresholds(scores) / 100, rtol=1e-3
    )
    assert report_thresholds(scores)[0] == 0


def test_they_are_shipped():
    assert set(FITTED) < set(SHIPPED_TRACKERS)
