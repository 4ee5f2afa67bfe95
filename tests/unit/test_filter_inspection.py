"""What a user sees who asks why."""

from __future__ import annotations

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker
from pmbm.types import Detections


def frame(when, xy):
    xy = np.reshape(np.asarray(xy, float), (-1, 2))
    n = len(xy)
    return Detections(
        time=when,
        position=np.column_stack([xy, np.ones(n)]),
        size=np.ones((n, 3)),
        yaw=np.zeros(n),
        score=np.ones(n),
        label=np.zeros(n, int),
    )


def test_the_tables_add_up_and_tell_the_history():
    tracker = PMBMTracker(PMBMConfig(history=4))
    with pytest.raises(InputError, match="first step"):
        tracker.inspect()
    for k, xy in enumerate([[[5, 0]], [[5.2, 0]], [], [[5.6, 0], [40, 40]], [[5.7, 0.5]]]):
        tracks = tracker.step(frame(0.1 * k, xy))
    seen = tracker.inspect()
    assert seen.time == 0.4
    assert set(tracks.id) <= set(seen.track_id)
    weight = seen.probability * seen.hypothesis_existence
    total = np.bincount(seen.hypothesis_track, weight, minlength=len(seen.track_id))
    assert total == pytest.approx(seen.existence)
    row = int(np.argmax(weight))
    assert seen.history[row].tolist() == [0, -1, 0, 0]
    assert seen.expected_undetected > 0
    assert set(seen.seconds) == {"predict", "associate", "update", "reduce"}
    assert seen.reduced.undetected_pruned >= 0


def test_a_story_in_plain_words():
    tracker = PMBMTracker(PMBMConfig(history=3))
    for k in range(4):
        tracker.step(frame(0.1 * k, [[5.0 + k, 0]] if k != 2 else []))
    story = tracker.inspect().story(0)
    assert "Track 0 at t = 0.3 s exists with probability" in story
    assert "took 0, missed, took 0" in story
    assert "not in the tracker's mind" in tracker.inspect().story(99)
