"""The batch smoother against filterpy's, and what it adds to the online output."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from pmbm.errors import InputError
from pmbm.filter import (
    BroadBirth,
    FixedDetection,
    IgnoreScores,
    PMBMConfig,
    PMBMTracker,
    RecordWeights,
    Reduction,
    Report,
    ScoreLevels,
    ScoreRecord,
    Survival,
    smooth,
)
from pmbm.geometry import wrap_angle
from pmbm.score import Calibration
from pmbm.types import Detections

ALONE = PMBMConfig.textbook().changed({"sensor.clutter_rate": 1e-6})


def frame(when, xy, length=4.0):
    xy = np.reshape(np.asarray(xy, float), (-1, 2))
    n = len(xy)
    return Detections(
        time=when,
        position=np.column_stack([xy, np.ones(n)]),
        size=np.tile([length, 2.0, 1.5], (n, 1)),
        yaw=np.zeros(n),
        score=np.ones(n),
        label=np.zeros(n, int),
    )


def drive(seed, frames=60, gap=()):
    """One car's true path and its detections; none in the frames of `gap`."""
    rng = np.random.default_rng(seed)
    x, v, made, truth = np.array([-20.0, 3.0]), np.array([8.0, 0.5]), [], []
    for k in range(frames):
        v = v + rng.normal(0, 0.4, 2)
        x = x + 0.1 * v
        truth.append(x)
        z = [] if k in gap else [x + rng.normal(0, 0.3, 2)]
        made.append(frame(0.1 * k, z, length=4.0 + rng.normal(0, 0.3)))
    return np.array(truth), made


def test_it_is_the_rauch_tung_striebel_smoother():
    _, frames = drive(0, gap=(20, 33))
    steps = [PMBMTracker.step(t, one) for t in [PMBMTracker(ALONE)] for one in frames]
    after = smooth(steps, ALONE)
    begun = next(k for k, one in enumerate(steps) if len(one))
    kf = KalmanFilter(dim_x=4, dim_z=2)
    Q = Q_continuous_white_noise(2, 0.1, spectral_density=2.0, block_size=2, order_by_dim=False)
    kf.F, kf.Q = np.eye(4), Q
    kf.F[0, 2] = kf.F[1, 3] = 0.1
    n = len(steps) - begun
    means = np.array([[*s.position[0, :2], *s.velocity[0]] for s in steps[begun:]])
    covs = np.array([s.covariance[0] for s in steps[begun:]])
    xs, ps, _, _ = kf.rts_smoother(means, covs, Fs=[kf.F] * n, Qs=[Q] * n)
    got = np.array([[*s.position[0, :2], *s.velocity[0]] for s in after[begun:]])
    assert got == pytest.approx(xs, rel=1e-9, abs=1e-9)
    assert np.array([s.covariance[0] for s in after[begun:]]) == pytest.approx(ps, abs=1e-9)


def test_later_frames_make_earlier_ones_better():
    before, behind = [], []
    for seed in range(5):
        truth, frames = drive(seed)
        tracker = PMBMTracker()
        steps = [tracker.step(one) for one in frames]
        for one, two, x in zip(steps, smooth(steps), truth, strict=True):
            if len(one):
                before.append(np.hypot(*(one.position[0, :2] - x)))
                behind.append(np.hypot(*(two.position[0, :2] - x)))
                assert two.size[0, 0] == pytest.approx(4.0, abs=0.25)
    assert np.mean(behind) < 0.85 * np.mean(before)


def test_gaps_are_filled_and_tracks_reach_back():
    truth, frames = drive(1, gap=(26, 27))
    early = PMBMConfig.textbook().changed(
        {
            "report.above": 0.01,
            "birth.initial": 0.0,
            "sensor.position_sd": 0.3,
            "sensor.clutter_rate": 2.0,
        }
    )
    tracker = PMBMTracker(early)
    steps = [tracker.step(one) for one in frames]
    online = [one.take(one.score > 0.5) for one in steps]
    after = smooth([*steps[:27], steps[27].take([]), *steps[28:]], early)
    assert len(after[27]) == 1
    assert np.hypot(*(after[27].position[0, :2] - truth[27])) < 1.0
    first = next(k for k, one in enumerate(online) if len(one))
    assert first > 0
    assert len(after[first - 1]) == 1
    assert after[first - 1].id[0] == after[first].id[0]


def test_what_never_was_probable_is_not_reported():
    tracker = PMBMTracker(
        PMBMConfig(
            birth=BroadBirth(initial=0.0),
            scores=IgnoreScores(),
            reduction=Reduction(recycle_below=1e-4),
            report=Report(above=0.001),
        )
    )
    steps = [tracker.step(frame(0.1 * k, [[10, 10]] if k == 3 else [])) for k in range(8)]
    assert sum(map(len, steps)) > 0
    assert sum(map(len, smooth(steps))) == 0
    assert smooth([]) == ()


def test_the_whole_life_decides():
    """A source that looked like an object once, and in the end does not, is reported nowhere."""
    marks = ScoreLevels(
        label=0,
        calibration=Calibration(offset=np.zeros(7), slope=np.ones(7), per_metre=np.zeros(7)),
        level=[-3.0, 3.0],
        scatter=3.0,
        birth=[0.5, 0.5],
        object=[0.0, 1.0],
        clutter=[0.9, 0.1],
    )
    config = PMBMConfig.textbook().changed({"scores": marks, "report.above": 0.1})
    shown = {}
    for name, late in (("pole", -4.0), ("car", 4.0)):
        tracker = PMBMTracker(config)
        scores = [3.0] * 4 + [late] * 12
        steps = [
            tracker.step(replace(frame(0.1 * k, [[5.0, 1.0]]), raw_score=np.array([raw])))
            for k, raw in enumerate(scores)
        ]
        assert max(one.score.max(initial=0) for one in steps[:5]) > 0.9
        shown[name] = sum(map(len, smooth(steps, config)))
    assert shown["pole"] == 0
    assert shown["car"] >= 15


def test_where_each_step_is_told_by_the_whole_life_it_lasts_as_long_as_that_is_probable():
    """Scores that are low, high for long, low again: recent ones, centred, say where the life
    begins and ends, and the mean over it is its score."""
    _, frames = drive(3, frames=40)
    raw = [-2.0] * 10 + [2.0] * 20 + [-2.0] * 10
    frames = [
        replace(one, raw_score=np.full(len(one), score))
        for one, score in zip(frames, raw, strict=True)
    ]
    weights = RecordWeights(offset=0.0, score=1.0)
    scores = ScoreRecord(
        label=0, middle=np.zeros(7), spread=np.r_[1.0, np.zeros(6)], online=weights, memory=0.2
    )
    config = replace(ALONE, scores=scores)
    tracker = PMBMTracker(replace(config, scores=scores.of_all_sources()))
    steps, inspections = [], []
    for one in frames:
        steps.append(tracker.step(one))
        inspections.append(tracker.inspect())
    kept = smooth(steps, config, inspections)
    there = [k for k, one in enumerate(kept) if len(one)]
    assert there == list(range(there[0], there[-1] + 1))
    assert there[0] == pytest.approx(10, abs=1)
    assert there[-1] == pytest.approx(29, abs=1)
    (score,) = {float(one.score[0]) for one in kept if len(one)}
    assert 0.8 < score < 1 / (1 + np.exp(-2.0))
    hopeless = replace(weights, offset=-3.0)
    assert not any(
        map(
            len,
            smooth(steps, replace(config, scores=replace(scores, online=hopeless)), inspections),
        )
    )


def test_a_detection_that_is_rather_anothers_does_not_decide():
    """A track that ends beside another, whose detection was probably not its own, was an object
    all the same; inspections tell that from a source that is no object."""
    _, frames = drive(4)
    tracker = PMBMTracker(ALONE)
    steps, inspections = [], []
    for one in frames:
        steps.append(tracker.step(one))
        inspections.append(tracker.inspect())
    doubtful = replace(steps[-1], score=np.array([0.2]))
    told = replace(inspections[-1], existence=np.array([0.2]))
    lives = smooth([*steps[:-1], doubtful], ALONE, [*inspections[:-1], told])
    assert [len(one) for one in lives[5:]] == [1] * (len(steps) - 6) + [0]
    no_object = smooth([*steps[:-1], doubtful], ALONE, inspections)
    assert sum(map(len, no_object)) == 0


def test_the_life_of_more_detections_is_at_a_place():
    """A second box beside a car, there first: the car's track is the longer one in the end."""
    tracker = PMBMTracker(ALONE)
    steps = []
    for k in range(40):
        x = 5.0 + 0.4 * k
        boxes = [[x + 1, 0.5]] if k < 3 else [[x + 1, 0.5], [x, 0]] if k < 12 else [[x, 0]]
        steps.append(tracker.step(frame(0.1 * k, boxes)))
    assert max(map(len, steps)) == 2
    own = steps[-1].id.tolist()
    assert steps[0].id.tolist() not in ([], own)
    beside = smooth(steps, ALONE)
    alone = smooth(steps, ALONE.changed({"report.exclusive": True}))
    begun = next(k for k, one in enumerate(alone) if own[0] in one.id.tolist())
    assert [one.id.tolist() for one in alone[begun:]] == [own] * (40 - begun)
    assert max(map(len, beside)) == 2
    # Before it, the other stands.
    assert [len(one) for one in alone[:begun]] == [len(one) for one in beside[:begun]]


def test_a_life_ends_with_its_last_detection_and_long_gaps_stay_open():
    config = ALONE.changed(
        {
            "sensor.detection": FixedDetection(probability=0.1),
            "survival": Survival(probability=0.9999),
            "report.above": 0.001,
        }
    )
    _, frames = drive(2, frames=80, gap=(*range(20, 30), *range(40, 66), *range(75, 80)))
    tracker = PMBMTracker(config)
    steps = [tracker.step(one) for one in frames]
    assert len({one.id[0] for one in steps[5:]}) == 1
    shown = [len(one) for one in smooth(steps, config)]
    assert shown[75:] == [0] * 5
    assert shown[40:65] == [0] * 25
    assert shown[5:40] == [1] * 35


def test_boxes_are_made_of_the_whole_life():
    """Half turns are turned back, by motion or by the majority; one size; heights averaged."""
    _, frames = drive(3)
    rng = np.random.default_rng(0)
    course = 2.5
    world = np.array(
        [[np.cos(course), np.sin(course), 0], [-np.sin(course), np.cos(course), 0], [0, 0, 1]]
    )
    made = []
    for one in frames:
        turned = rng.random() < 0.6
        made.append(
            replace(
                one,
                yaw=np.array([course + rng.normal(0, 0.1) + np.pi * turned]),
                position=one.position @ world + np.array([0, 0, rng.normal(0, 0.2)]),
            )
        )
    tracker = PMBMTracker(ALONE)
    after = smooth([tracker.step(one) for one in made], ALONE)
    told = [one for one in after if len(one)]
    assert np.abs(wrap_angle(np.array([one.yaw[0] for one in told]) - course)).max() < 0.15
    assert np.std([one.position[0, 2] for one in told]) < 0.1
    assert np.ptp([one.size[0, 0] for one in told]) == 0
    assert told[0].size[0, 0] == pytest.approx(np.mean([one.size[0, 0] for one in made]), abs=0.05)


def test_what_cannot_be_smoothed_is_refused():
    tracker = PMBMTracker()
    steps = [tracker.step(frame(0.1 * k, [[1.0, 1.0]])) for k in range(3)]
    with pytest.raises(InputError, match="order"):
        smooth(steps[::-1])
    with pytest.raises(InputError, match="covariance"):
        smooth([replace(steps[0], covariance=None)])
    with pytest.raises(InputError, match="inspections"):
        smooth(steps, None, [tracker.inspect()])
