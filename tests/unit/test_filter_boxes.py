"""Boxes beside the filter: the last detection's, or what all of them say together."""

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker
from pmbm.filter.estimation import apart
from pmbm.filter.story import tell
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


def boxes_at(*places):
    position = np.reshape(places, (-1, 2)).astype(float)
    return position, np.tile([0.8, 4.0, 2.0, 1.5, 0.0], (len(position), 1))


def test_two_reports_are_never_at_one_place():
    """Boxes of 4 x 2 m in a row: shifted by 2 m they share a third of what they cover."""
    position, box = boxes_at([0, 0], [2, 0], [4, 0], [20, 0], [20.5, 0])
    assert apart(position, box, 0.3).tolist() == [True, False, True, True, False]
    assert apart(position, box, 0.34).tolist() == [True, True, True, True, False]
    assert apart(position, box, 1.0).all()
    turned = box.copy()
    turned[1, 4] = np.pi / 2
    # Crosswise, 2 m on: 1 m x 2 m are shared, of 8 + 8 - 2.
    assert apart(position[:2], turned[:2], 1 / 7 + 1e-6).all()
    assert apart(position[:2], turned[:2], 1 / 7 - 1e-6).tolist() == [True, False]
    assert apart(np.zeros((0, 2)), np.zeros((0, 5)), 0.3).tolist() == []


def test_a_duplicate_that_stays_is_held_back_and_the_story_says_so():
    """The object keeps the id that it was known by first; off, both are reported."""
    places = [[10.0, 0.0], [10.3, 0.0]]
    frames = [
        Detections(
            time=0.1 * k,
            position=np.array([[*place, 0.8] for place in places[: 1 if k < 5 else 2]]),
            size=np.tile([4.0, 2.0, 1.5], (1 if k < 5 else 2, 1)),
            yaw=np.zeros(1 if k < 5 else 2),
            score=np.full(1 if k < 5 else 2, 0.9),
            label=np.zeros(1 if k < 5 else 2, int),
        )
        for k in range(25)
    ]
    told = {}
    for overlap in (1.0, 0.3):
        tracker = PMBMTracker(PMBMConfig.textbook(overlap=overlap, clutter_rate=0.1, history=1))
        steps, inspections = [], []
        for one in frames:
            steps.append(tracker.step(one))
            inspections.append(tracker.inspect())
        told[overlap] = steps[-1].id.tolist()
    assert len(told[1.0]) == 2
    assert told[0.3] == steps[10].id.tolist() == [min(told[1.0])]
    story = tell(max(told[1.0]), inspections, steps, frames, recycle_below=0.01)
    assert "not reported: a track known for longer is reported at its place" in story
