"""Boxes beside the filter: the last detection's, or what all of them say together."""

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker, Sensor
from pmbm.filter.estimation import suppress_overlaps
from pmbm.filter.explain.story import tell
from pmbm.types import Detections


def boxes(gain, seed=0, frames=40):
    """Boxes (F,5) given, and those reported (F,5): z, length, width, height, yaw."""
    rng = np.random.default_rng(seed)
    tracker = PMBMTracker(PMBMConfig(sensor=Sensor(box_gain=gain)))
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
        with pytest.raises(InputError, match="box_gain"):
            Sensor(box_gain=bad)


def standing(*reports, sure=9):
    """Rows that stand of reports (x, y, length, width, yaw), known in this order."""
    x, y, length, width, yaw = np.reshape(reports, (-1, 5)).astype(float).T
    box = np.column_stack([np.full(len(x), 0.8), length, width, np.full(len(x), 1.5), yaw])
    order = np.arange(len(x))
    return suppress_overlaps(np.column_stack([x, y]), box, order, sure).tolist()


def test_two_reports_are_never_at_one_place():
    """The centre of one is not in the box of another: at 2 m along, or 1 m across, of 4 m x 2 m."""
    car = (4.0, 2.0, 0.0)
    assert standing((0, 0, *car), (2.1, 0, *car), (0, 1.1, *car)) == [0, 1, 2]
    assert standing((0, 0, *car), (1.9, 0, *car)) == [0]
    assert standing((0, 0, *car), (0, 0.9, *car)) == [0]
    # Turned by a right angle, its place is 1 m along and 2 m across; the other's is as it was.
    crosswise = (4.0, 2.0, np.pi / 2)
    assert standing((0, 0, *crosswise), (1.9, 0, *crosswise)) == [0, 1]
    assert standing((0, 0, *car), (1.9, 0, *crosswise)) == [0]
    # What is not sure itself is held back, and holds nothing back.
    assert standing((0, 0, *car), (1.9, 0, *car), (3.8, 0, *car), sure=1) == [0, 2]
    assert standing((0, 0, *car), (1.9, 0, *car), sure=0) == [0, 1]
    # Nor does what is held back.
    assert standing((0, 0, *car), (1.9, 0, *car), (3.8, 0, *car)) == [0, 2]
    assert standing() == []


def test_the_whole_is_reported_in_place_of_its_parts():
    truck, half = (12.0, 2.5, 0.0), (6.0, 2.5, 0.0)
    assert standing((-3, 0, *half), (3, 0, *half), (0, 0, *truck)) == [2]
    assert standing((0, 0, *truck), (-3, 0, *half), (3, 0, *half)) == [0]
    # Not so much larger that the others are its parts.
    assert standing((-3, 0, *half), (0, 0, 8.9, 2.5, 0.0)) == [0]
    assert standing((-3, 0, *half), (2, 0, *truck), (6, 0, *truck)) == [1]


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
    for exclusive in (False, True):
        changes = {"report.exclusive": exclusive, "sensor.clutter_rate": 0.1, "report.history": 1}
        tracker = PMBMTracker(PMBMConfig.textbook().changed(changes))
        steps, inspections = [], []
        for one in frames:
            steps.append(tracker.step(one))
            inspections.append(tracker.inspect())
        told[exclusive] = steps[-1].id.tolist()
    assert len(told[False]) == 2
    assert told[True] == steps[10].id.tolist() == [min(told[False])]
    story = tell(max(told[False]), inspections, steps, frames, recycle_below=0.01)
    assert "not reported: another track is reported at its place" in story
