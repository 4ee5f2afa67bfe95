"""The baselines on frames worked out by hand."""

import copy
import tracemalloc

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from pmbm.baselines import (
    ArgoverseConfig,
    ArgoverseTracker,
    ProbabilisticKFTracker,
    WaymoTracker,
    association,
)
from pmbm.errors import InputError
from pmbm.tracking import Tracker
from pmbm.types import Detections, Label

CAR = (4.0, 2.0, 1.5)


def frame(k, *boxes, rate=10.0):
    """Detections at frame `k` of boxes (x, y, yaw, score, label, size), the tail optional."""
    full = [(*box, *(0.0, 0.0, 0.0, 0.9, Label.CAR, CAR)[len(box) :]) for box in boxes]
    return Detections(
        time=k / rate,
        position=np.array([(x, y, 0.75) for x, y, *_ in full]).reshape(-1, 3),
        size=np.array([box[5] for box in full]).reshape(-1, 3),
        yaw=[box[2] for box in full],
        score=[box[3] for box in full],
        label=np.array([box[4] for box in full], dtype=np.int64),
    )


def drive(tracker, frames):
    return [tracker.step(detections) for detections in frames]


def test_is_a_tracker_and_gives_nothing_for_nothing():
    tracker = ArgoverseTracker()
    assert isinstance(tracker, Tracker)
    for k in range(20):
        tracks = tracker.step(frame(k))
        assert len(tracks) == 0
        assert tracks.time == k / 10


def test_birth_shows_at_the_fifth_hit_and_not_before():
    counts = [
        len(tracks) for tracks in drive(ArgoverseTracker(), [frame(k, (0,)) for k in range(7)])
    ]
    assert counts == [0, 0, 0, 0, 1, 1, 1]


def test_hits_count_in_total_across_misses():
    seen = [0, 1, 3, 6, 8, 9]
    frames = [frame(k, *([(0,)] if k in seen else [])) for k in range(10)]
    counts = [len(tracks) for tracks in drive(ArgoverseTracker(), frames)]
    assert counts == [0] * 8 + [1, 1]


def test_coasts_for_fourteen_frames_with_its_last_score_then_dies():
    hits = [frame(k, (0.0, 0.0, 0.0, 0.9 - 0.1 * (k == 4))) for k in range(5)]
    outputs = drive(ArgoverseTracker(), hits + [frame(k) for k in range(5, 25)])
    assert [len(tracks) for tracks in outputs] == [0] * 4 + [1] * 15 + [0] * 6
    for tracks in outputs[4:19]:
        assert tracks.score.tolist() == [0.8]
        assert tracks.id.tolist() == outputs[4].id.tolist()


def test_found_again_in_the_last_possible_frame_keeps_its_id():
    hits = [frame(k, (0,)) for k in range(5)]
    for gap, kept in ((15, True), (16, False)):
        misses = [frame(k) for k in range(5, 4 + gap)]
        again = [frame(k, (0,)) for k in range(4 + gap, 9 + gap)]
        outputs = drive(ArgoverseTracker(), hits + misses + again)
        assert (outputs[-1].id.tolist() == outputs[4].id.tolist()) is kept


def test_ids_are_never_used_again():
    def sighting(start, x):
        return [frame(start + k, (x,)) for k in range(5)] + [frame(start + k) for k in range(5, 25)]

    outputs = drive(ArgoverseTracker(), sighting(0, 0) + sighting(25, 0) + sighting(50, 30))
    spells = [set(t.id.tolist()) for t in (outputs[10], outputs[35], outputs[60])]
    assert all(len(spell) == 1 for spell in spells)
    assert len(set.union(*spells)) == 3


def test_age_is_time_not_steps():
    """The fifteen frames are 1.5 s, at any frame rate and when deliveries are dropped."""
    fast = [frame(k, (0,), rate=20.0) for k in range(5)]
    outputs = drive(ArgoverseTracker(), fast + [frame(k, rate=20.0) for k in range(5, 40)])
    assert sum(len(tracks) for tracks in outputs) == 30
    tracker = ArgoverseTracker()
    drive(tracker, [frame(k, (0,)) for k in range(5)])
    assert len(tracker.step(frame(18))) == 1
    assert len(tracker.step(frame(19))) == 0


def test_velocity_is_per_second_and_carries_through_a_miss():
    frames = [frame(k, (2.0 * k, -0.5 * k)) for k in range(20)]
    tracker = ArgoverseTracker()
    last = drive(tracker, frames)[-1]
    np.testing.assert_allclose(last.velocity, [[20.0, -5.0]], atol=0.05)
    coasted = tracker.step(frame(20))
    np.testing.assert_allclose(coasted.position[0, :2], [40.0, -10.0], atol=0.05)
    assert tracker.step(frame(21, (42.0, -10.5))).id.tolist() == last.id.tolist()


@pytest.mark.parametrize("flips", [{3}, {2, 3, 5}])
def test_flipped_detections_are_turned_back(flips):
    frames = [frame(k, (0, 0, 0.3 + (np.pi if k in flips else 0.0))) for k in range(8)]
    np.testing.assert_allclose(drive(ArgoverseTracker(), frames)[-1].yaw, [0.3], atol=1e-12)


def test_turn_beyond_a_right_angle_is_taken_as_a_flip():
    """From yaw 0 a detection at 1.6 rad reads as 1.6 - pi, one at 1.5 rad as itself; the gain of
    the second update, P = 11 and R = 1, is 11/12."""
    for seen, taken in ((1.5, 1.5), (1.6, 1.6 - np.pi), (-1.6, np.pi - 1.6)):
        tracker = ArgoverseTracker(ArgoverseConfig(min_hits=1, iou_gate=0.01))
        tracks = drive(tracker, [frame(0, (0, 0, 0.0)), frame(1, (0, 0, seen))])[-1]
        np.testing.assert_allclose(tracks.yaw, [taken * 11 / 12])


def test_heading_survives_the_cut_at_pi():
    yaw = np.linspace(3.0, 3.4, 9)
    outputs = drive(ArgoverseTracker(), [frame(k, (0, 0, yaw[k])) for k in range(9)])
    assert all(len(t) == 1 for t in outputs[4:])
    assert abs(np.angle(np.exp(1j * (outputs[-1].yaw[0] - 3.4)))) < 0.15


@pytest.mark.parametrize(("shift", "same"), [(9.0, True), (9.01, False)])
def test_association_at_the_gate(shift, same):
    """Boxes 11 m long and 9 m apart share 2 of 20 m: IoU exactly 0.1."""
    size = (11.0, 1.0, 1.0)
    boxes = [(x, 0.0, 0.0, 0.9, Label.CAR, size) for x in (0.0, shift)]
    tracker = ArgoverseTracker(ArgoverseConfig(min_hits=2))
    tracks = drive(tracker, [frame(0, boxes[0]), frame(1, boxes[1])])[-1]
    assert len(tracks) == (1 if same else 0)


def test_association_is_optimal_not_greedy():
    """Tracks A at (0, 0), B at (1, 0); detections p at (0.55, 0), q at (1, 0.5).  IoU: A-p .758,
    B-p .798, B-q .6, A-q .391.  The best single pair is B-p, the best sum A-p and B-q."""
    tracker = ArgoverseTracker(ArgoverseConfig(min_hits=1))
    first = tracker.step(frame(0, (0.0,), (1.0,)))
    second = tracker.step(frame(1, (0.55, 0.0), (1.0, 0.5)))
    assert second.id.tolist() == first.id.tolist()
    np.testing.assert_allclose(second.position[:, :2], [[0.55, 0.0], [1.0, 0.5]], atol=1e-3)


def test_vertical_distance_does_not_matter_to_a_bird():
    boxes = frame(0, (0,)), frame(1, (0,))
    lifted = Detections(
        time=boxes[1].time,
        position=boxes[1].position + np.array([0, 0, 50.0]),
        size=boxes[1].size,
        yaw=boxes[1].yaw,
        score=boxes[1].score,
        label=boxes[1].label,
    )
    tracker = ArgoverseTracker(ArgoverseConfig(min_hits=2))
    assert len(drive(tracker, [boxes[0], lifted])[-1]) == 1


def test_scores_below_the_threshold_are_not_looked_at():
    for score, shown in ((0.3, 1), (0.2999, 0)):
        outputs = drive(ArgoverseTracker(), [frame(k, (0, 0, 0, score)) for k in range(6)])
        assert len(outputs[-1]) == shown


def test_a_track_is_reported_while_its_last_score_is_high_enough():
    """The weak detection at frame 6 keeps the track alive, but it is not shown until frame 8, when
    it is seen well again: coasting in frame 7 it is as good as its last detection."""
    scores = {6: 0.4, 7: None, 8: 0.9}
    frames = [
        frame(k, *([] if scores.get(k, 0.8) is None else [(0, 0, 0, scores.get(k, 0.8))]))
        for k in range(9)
    ]
    config = ArgoverseConfig(min_score=0.3, report_above=0.5)
    outputs = drive(ArgoverseTracker(config), frames)
    assert [len(tracks) for tracks in outputs] == [0, 0, 0, 0, 1, 1, 0, 0, 1]
    assert outputs[8].id.tolist() == outputs[5].id.tolist()


def test_classes_are_tracked_apart():
    frames = [
        frame(k, (0, 0, 0, 0.9, Label.CAR if k % 2 else Label.TRUCK), (0, 0, 0, 0.8, Label.BUS))
        for k in range(5)
    ]
    last = drive(ArgoverseTracker(), frames)[-1]
    assert last.label.tolist() == [Label.BUS]


def test_two_updates_at_one_time_are_allowed_and_time_never_runs_back():
    tracker = ArgoverseTracker()
    drive(tracker, [frame(k, (0,)) for k in range(5)])
    tracker.step(frame(4, (0,)))
    twin = copy.deepcopy(tracker)
    with pytest.raises(InputError, match="older"):
        tracker.step(frame(3, (0,)))
    after, expected = tracker.step(frame(5, (1.0,))), twin.step(frame(5, (1.0,)))
    for name in ("id", "position", "velocity", "covariance"):
        np.testing.assert_array_equal(getattr(after, name), getattr(expected, name))


def test_the_published_matrices():
    """Three updates against filterpy with the matrices written out."""
    kalman = KalmanFilter(10, 7)
    kalman.x[:7, 0] = [1.0, 2.0, 0.75, 0.1, *CAR]
    kalman.F = np.eye(10)
    kalman.F[0, 7] = kalman.F[1, 8] = kalman.F[2, 9] = 1.0
    kalman.H = np.eye(7, 10)
    kalman.P = np.diag([10.0] * 7 + [1e4] * 3)
    kalman.Q = np.diag([1.0] * 7 + [0.01] * 3)
    kalman.R = np.eye(7)
    tracker = ArgoverseTracker(ArgoverseConfig(min_hits=1))
    tracker.step(frame(0, (1.0, 2.0, 0.1)))
    for k, (x, y, yaw) in enumerate([(1.5, 2.1, 0.15), (2.1, 2.1, 0.12), (2.4, 2.3, 0.2)], 1):
        kalman.predict()
        kalman.update(np.array([x, y, 0.75, yaw, *CAR]))
        tracks = tracker.step(frame(k, (x, y, yaw)))
        state = np.concatenate([tracks.position[0], tracks.yaw, tracks.size[0]])
        np.testing.assert_allclose(state, kalman.x[:7, 0], rtol=1e-12)
        np.testing.assert_allclose(tracks.velocity[0], 10 * kalman.x[7:9, 0], rtol=1e-12)
        np.testing.assert_allclose(tracks.covariance[0, 2, 2], 100 * kalman.P[7, 7])
        np.testing.assert_allclose(tracks.covariance[0, 0, 2], 10 * kalman.P[0, 7])


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("min_score", 1.3),
        ("min_score", -0.1),
        ("iou_gate", 0.0),
        ("min_hits", 0),
        ("min_hits", 2.5),
        ("max_age", np.nan),
        ("measurement_variance", 0.0),
    ],
)
def test_impossible_parameters_are_refused(field, value):
    with pytest.raises(InputError, match=field):
        ArgoverseConfig(**{field: value})


@pytest.mark.parametrize(("frames", "prior"), [(0, 10.0), (1, 10011.0), (2, 40012.0)])
def test_uncertainty_grows_with_time_not_with_steps(frames, prior):
    """P of x before the update is 10 + 1e4 n^2 + n after n frames; R = 1."""
    tracker = ArgoverseTracker(ArgoverseConfig(min_hits=1))
    tracks = drive(tracker, [frame(0, (0,)), frame(frames, (0,))])[-1]
    np.testing.assert_allclose(tracks.covariance[0, 0, 0], prior / (prior + 1))


def crowd(k, count):
    return frame(k, *((x, 50.0) for x in np.arange(count) * 10.0))


@pytest.mark.parametrize("kind", [ArgoverseTracker, WaymoTracker, ProbabilisticKFTracker])
def test_a_frame_too_full_for_memory_is_one_line(kind, monkeypatch):
    """The tracker is left as it was: it goes on as one that never saw the frame."""
    monkeypatch.setattr(association, "MOST_PAIRS", 12)
    tracker, other = kind(), kind()
    for k in range(4):
        for each in (tracker, other):
            each.step(crowd(k, 3))
    with pytest.raises(InputError, match=r"follows 3: expected at most 4, got 5; raise") as refused:
        tracker.step(crowd(4, 5))
    assert "\n" not in str(refused.value)
    after, wanted = tracker.step(crowd(5, 4)), other.step(crowd(5, 4))
    np.testing.assert_array_equal(after.position, wanted.position)
    assert len(after) == 3


@pytest.mark.parametrize("kind", [ArgoverseTracker, WaymoTracker, ProbabilisticKFTracker])
def test_blocks_of_pairs_change_no_bit(kind, monkeypatch):
    rng = np.random.default_rng(5)
    frames = [
        frame(k, *((x + k, y, yaw) for x, y, yaw in rng.uniform(0, 8, (12, 3)))) for k in range(8)
    ]
    whole = drive(kind(), frames)
    monkeypatch.setattr(association, "_BLOCK", 7)
    for one, other in zip(whole, drive(kind(), frames), strict=True):
        assert one.id.tolist() == other.id.tolist()
        np.testing.assert_array_equal(one.position, other.position)


@pytest.mark.parametrize("kind", [ArgoverseTracker, WaymoTracker, ProbabilisticKFTracker])
def test_memory_of_a_full_frame_is_bounded(kind):
    """2000 boxes apart: 4 million pairs, 32 MB of them at once, and what they are computed by."""
    tracker = kind()
    tracker.step(crowd(0, 2000))
    tracemalloc.start()
    try:
        tracker.step(crowd(1, 2000))
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 200e6
