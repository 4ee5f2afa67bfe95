"""Boxes beside the filter: the last detection's, or what all of them say together."""

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker
from pmbm.types import Detections


def boxes(newest, seed=0, frames=40):
    """Boxes (F,5) given, and those reported (F,5): z, length, width, height, yaw."""
    rng = np.random.default_rng(seed)
    tracker = PMBMTracker(PMBMConfig(newest_box=newest))
    given, told = [], []
    for k in range(frames):
        one = np.array([1.0, 4.0, 1.8, 1.5, 0.4]) + rng.normal(0, 0.1, 5)
        tracks = tracker.step(
            Detections(
                time=0.1 * k,
                position=np.array([[10.0, 2.0, one[0]]]),
                size=one[None, 1:4],
                yaw=one[4:],
                score=np.ones(1),
                label=np.zeros(1, int),
            )
        )
        given.append(one)
        told.append([tracks.position[0, 2], *tracks.size[0], tracks.yaw[0]])
    return np.array(given), np.array(told)


def test_the_last_detection_is_copied():
    given, told = boxes(1.0)
    np.testing.assert_array_equal(told, given)


def test_heights_and_sizes_are_averaged_and_headings_are_not():
    given, told = boxes(0.3)
    expected = given[0]
    for one, shown in zip(given[1:], told[1:], strict=True):
        expected = expected + 0.3 * (one - expected)
        assert shown[:4] == pytest.approx(expected[:4], rel=1e-9)
    np.testing.assert_array_equal(told[:, 4], given[:, 4])
    truth = np.array([1.0, 4.0, 1.8, 1.5])
    error, raw = (np.abs(one[10:, :4] - truth).mean() for one in (told, given))
    assert error < 0.6 * raw


def test_a_weight_out_of_bounds_is_refused():
    for bad in (0.0, 1.1):
        with pytest.raises(InputError, match="newest_box"):
            PMBMConfig(newest_box=bad)
