"""What a user sees who asks why."""

from __future__ import annotations

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.filter import PMBMConfig, PMBMTracker, Report
from pmbm.filter.explain.inspection import IN_THE_OPEN, OCCLUDER
from pmbm.filter.explain.story import tell
from pmbm.types import Detections, Site


def frame(when, xy, size=(1.0, 1.0, 1.0)):
    xy = np.reshape(np.asarray(xy, float), (-1, 2))
    n = len(xy)
    return Detections(
        time=when,
        position=np.column_stack([xy, np.ones(n)]),
        size=np.broadcast_to(size, (n, 3)).copy(),
        yaw=np.zeros(n),
        score=np.ones(n),
        label=np.zeros(n, int),
    )


def test_the_tables_add_up_and_tell_the_history():
    tracker = PMBMTracker(PMBMConfig(report=Report(history=4)))
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


def test_pairs_outside_the_gate_are_counted():
    tracker = PMBMTracker()
    tracker.step(frame(0.0, [[5, 0], [30, 0]]))
    assert tracker.inspect().reduced.pairs_gated == 0
    known = len(tracker.density.local)
    tracker.step(frame(0.1, [[5.1, 0], [60, 0], [60, 30]]))
    # Each of the three detections is in the gate of at most one place, two in that of none.
    assert tracker.inspect().reduced.pairs_gated == 3 * known - known // 2


def test_a_story_in_plain_words():
    tracker = PMBMTracker(PMBMConfig(report=Report(history=3)))
    for k in range(4):
        tracker.step(frame(0.1 * k, [[5.0 + k, -0.01]] if k != 2 else []))
    story = tracker.inspect().story(0)
    assert "Track 0 at t = 0.3 s exists with probability" in story
    assert "took 0, missed, took 0" in story
    assert ", 0.0) m" in story
    assert "not in the tracker's mind" in tracker.inspect().story(99)


def life_of(track_id, frames, config=None, site=None):
    """The story, and the tracker at its end."""
    tracker = PMBMTracker(config or PMBMConfig(report=Report(history=4)), site)
    steps, seen = [], []
    for one in frames:
        steps.append(tracker.step(one))
        seen.append(tracker.inspect())
    recycle_below = tracker.config.reduction.recycle_below
    return tell(track_id, seen, steps, frames, recycle_below=recycle_below), tracker


def behind_a_truck(when, *seen):
    """A truck 10 m ahead, and what is seen of a car that stands 10 m behind it."""
    sizes = [[4.0, 12.0, 3.5], *[[2.0, 2.0, 1.5]] * len(seen)]
    return frame(when, [[10.0, 0.0], *seen], sizes)


def test_a_life_from_birth_through_a_shadow_to_its_end():
    frames = [behind_a_truck(0.1 * k, *([[20.0, 0.0]] if k < 3 else [])) for k in range(5)]
    frames += [frame(0.5 + 0.1 * k, []) for k in range(90)]
    story, _ = life_of(1, frames)
    lines = story.splitlines()
    assert lines[0] == "Track 1"
    assert "0 s  born from detection 1 of 2, a car of score 1.00 at (20.0, 0.0) m" in lines[1]
    assert "0.1 to 0.2 s  detected 2 times" in lines[2]
    assert "existence rises" in lines[2]
    assert "missed" in lines[3]
    assert "hidden behind track 0; existence falls" in lines[3]
    assert "not reported" not in lines[3]
    assert any("existence falls" in line and line.endswith("; not reported") for line in lines[4:])
    assert "recycled: what is left" in lines[-2]
    assert lines[-1].strip() == (
        "At 9.4 s it is not reported: it is not in the tracker's mind any more."
    )


def test_a_life_told_while_it_lasts_ends_with_its_hypotheses():
    pair = [[5.0, 0.0], [5.0, 1.6]]
    frames = [frame(0.1 * k, pair) for k in range(6)] + [frame(0.6, [[5.0, 0.8]])]
    story, tracker = life_of(0, frames)
    assert "0.6 s hypotheses compete: " in story
    assert "missed" in story.split("compete: ")[-1].splitlines()[0]
    assert "At 0.6 s it is reported." in story
    now = tracker.inspect().story(0).splitlines()
    assert story.splitlines()[-len(now) :] == [f"  {line}" for line in now]
    told = [line.split(": ", 1) for line in now[1:]]
    assert len({words for _, words in told}) == len(told) > 1


def test_what_leaves_the_view_is_said_to_be_outside():
    frames = [frame(0.1 * k, [[26.0 + 0.5 * k, 0.0]] if k < 9 else []) for k in range(14)]
    story, _ = life_of(0, frames, site=Site(max_range=30.0))
    assert "outside the field of view" in story
    assert "not reported: it is probably outside the field of view" in story.splitlines()[-1]


def test_a_wall_is_named_and_the_open_is_not():
    wall = np.array([[9.0, -6.0], [11.0, -6.0], [11.0, 6.0], [9.0, 6.0]])
    frames = [frame(0.1 * k, [[20.0, 0.0], [0.0, 20.0]] if k < 4 else []) for k in range(6)]
    story, tracker = life_of(0, frames, site=Site(occluders=(wall,)))
    assert "missed 2 times" in story
    assert "hidden behind a static occluder" in story
    looked = tracker.inspect().sensor_view
    named = dict(zip(looked.track_id.tolist(), looked.hidden_by.tolist(), strict=True))
    assert (named[0], named[1]) == (OCCLUDER, IN_THE_OPEN)
    shown = dict(zip(looked.track_id.tolist(), looked.visible.tolist(), strict=True))
    assert shown[0] < 0.1
    assert shown[1] > 0.99


def test_who_hides_a_part_is_named_and_never_the_track_itself():
    frames = [behind_a_truck(0.1 * k, [20.0, 14.5]) for k in range(6)]
    _, tracker = life_of(1, frames)
    looked = tracker.inspect().sensor_view
    row = looked.track_id.tolist().index(1)
    assert 0.2 < looked.visible[row] < 0.8
    assert looked.hidden_by[row] == 0


def test_an_unknown_track_is_met_with_those_that_there_are():
    frames = [frame(0.1 * k, [[5.0, 0.0]]) for k in range(4)]
    with pytest.raises(InputError, match=r"got 77; reported were 0; never reported were"):
        life_of(77, frames)


def test_asking_changes_nothing():
    frames = [behind_a_truck(0.1 * k, *([[20.0, 0.0]] if k % 3 else [])) for k in range(12)]
    asked, left = PMBMTracker(PMBMConfig(report=Report(history=4))), PMBMTracker()
    for one in frames:
        a, b = asked.step(one), left.step(one)
        asked.inspect()
        assert a.id.tolist() == b.id.tolist()
        assert a.position.tobytes() == b.position.tobytes()
        assert a.score.tobytes() == b.score.tobytes()
