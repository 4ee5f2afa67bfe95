"""Levels of scores that drift: a random walk over levels, against scipy and worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mark_builders import frame, levels
from scipy.linalg import expm

from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker


def walking(at, drift):
    even = np.full(len(at), 1 / len(at))
    return levels(
        level=at, drift=drift, birth=even, clutter=even, object=np.linspace(0, 1, len(at))
    )


def shares(draw, count):
    given = np.array(draw(st.lists(st.floats(0.01, 1), min_size=count, max_size=count)))
    return given / given.sum()


@st.composite
def walks(draw):
    gaps = draw(st.lists(st.floats(0.2, 2.0), min_size=1, max_size=7))
    at = np.concatenate([[-3.0], -3.0 + np.cumsum(gaps)])
    return walking(at, draw(st.floats(0.05, 2.0))), shares(draw, len(at))[None]


@given(walks(), st.floats(0, 3), st.floats(0, 3))
def test_two_intervals_are_one_of_both(walk, first, second):
    marks, share = walk
    twice = marks.predicted(marks.predicted(share, first), second)
    assert twice == pytest.approx(marks.predicted(share, first + second), abs=1e-9)
    assert twice.sum() == pytest.approx(1.0, abs=1e-9)
    assert marks.predicted(share, 0.0) == pytest.approx(share, abs=1e-12)


@given(walks(), st.floats(0.01, 2))
def test_the_walk_is_that_of_its_generator(walk, dt):
    """Jumps to the neighbours that keep the mean and raise the variance by drift^2 a second."""
    marks, share = walk
    at, n = marks.level, len(marks.level)
    generator = np.zeros((n, n))
    for k in range(n):
        below = at[k] - at[k - 1] if k else at[k + 1] - at[k]
        above = at[k + 1] - at[k] if k < n - 1 else below
        if k:
            generator[k, k - 1] = marks.drift**2 / (below * (below + above))
        if k < n - 1:
            generator[k, k + 1] = marks.drift**2 / (above * (below + above))
        generator[k, k] = -generator[k].sum()
    assert marks.predicted(share, dt) == pytest.approx(share @ expm(dt * generator), abs=1e-9)


def test_a_level_in_the_middle_spreads_by_the_drift():
    marks = walking(np.linspace(-6, 6, 49), 0.7)
    start = (np.arange(49) == 24)[None].astype(float)
    after = marks.predicted(start, 4.0)[0]
    assert after @ marks.level == pytest.approx(0.0, abs=1e-9)
    assert after @ marks.level**2 == pytest.approx(0.7**2 * 4, rel=0.01)


def test_a_drifting_level_is_learned_by_bayes_rule():
    """P(object) after three detections and a miss, against the chain written out."""
    marks = levels(drift=0.8)
    told = {"scores": marks, "sensor.clutter_rate": 1e-9}
    tracker = PMBMTracker(PMBMConfig.textbook().changed(told))
    raws, times = [1.5, -0.5, 0.7], [0.0, 0.1, 0.6]
    for when, raw in zip(times, raws, strict=True):
        tracks = tracker.step(frame(when, [[5.0, 0.0]], raw))
        if when == 0.1:
            tracker.step(frame(0.3, [], 0.0))
    # Two equal gaps of 2: jumps up and down at the same rate, and inwards alone from the ends.
    rate = 0.8**2 / 8
    generator = rate * np.array([[-1, 1, 0], [1, -2, 1], [0, 1, -1]])
    weight = np.array([0.6, 0.2, 0.2])
    for dt, raw in zip(np.diff(times, prepend=0.0), raws, strict=True):
        weight = weight @ expm(dt * generator)
        weight *= np.exp(-0.5 * (raw - np.array([-2.0, 0.0, 2.0])) ** 2)
    expected = weight @ [0.02, 0.5, 0.98] / weight.sum()
    row = int(np.argmax(tracker.density.hypothesis_probability()))
    assert tracks.score[0] == pytest.approx(tracker.density.local.existence[row] * expected)


def test_what_looks_surer_from_near_is_believed_in_time():
    """A car of low scores for six seconds, then of high ones: a level that lasts is one of the
    whole life, one that drifts is the present one."""
    believed = {}
    for drift in (0.0, 1.0):
        marks = levels(drift=drift, scatter=2.0)
        told = {"scores": marks, "report.above": 0.7}
        tracker = PMBMTracker(PMBMConfig.textbook().changed(told))
        raws = [-2.0] * 60 + [2.0] * 40
        shown = [len(tracker.step(frame(0.1 * k, [[5.0, 0.0]], r))) for k, r in enumerate(raws)]
        assert sum(shown[10:60]) == 0
        believed[drift] = sum(shown[60:])
    assert believed[0.0] == 0
    assert believed[1.0] > 25


@pytest.mark.parametrize("drift", [-0.1, 1e4, np.nan, np.inf, "fast"])
def test_a_drift_is_a_number_within_bounds(drift):
    with pytest.raises(InputError, match="drift"):
        levels(drift=drift)


@pytest.mark.parametrize("drift", [1e-200, 1e-9, 1e3])
def test_the_slowest_and_the_fastest_walk_are_walks(drift):
    start = np.array([[0.6, 0.2, 0.2]])
    after = levels(level=[-2.0, 0.0, 5.0], drift=drift).predicted(start, 10.0)
    assert after.sum() == pytest.approx(1.0)
    if drift < 1:
        assert after == pytest.approx(start, abs=1e-6)


def test_one_level_has_nowhere_to_go():
    alone = levels(level=[0.0], birth=[1.0], clutter=[1.0], object=[0.5], drift=1.0)
    assert alone.predicted(np.ones((3, 1)), 5.0) == pytest.approx(np.ones((3, 1)))
