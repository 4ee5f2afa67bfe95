"""What the tracker promises to stand, where no other test shows it.

In test_filter_tracker.py: bad numbers and bad times refused, two looks at one moment, 1000 empty
frames, copies of detections, objects in one place, extreme beliefs (P_D and scores of 0 and 1, no
clutter), gaps, uneven frames, 10,000 detections in one frame, order, moved and turned worlds,
causality, nothing random, copies in mid-run.  In test_filter_crowds.py: 10,000 detections on tracks
that share their gates, long runs.
"""

from __future__ import annotations

import copy
import math
from dataclasses import replace

import numpy as np
import pytest
from test_filter_tracker import drive, equal, frame

from pmbm.filter import (
    BirthMap,
    BroadBirth,
    DetectionChain,
    DetectionFromScores,
    EveryScore,
    FixedDetection,
    ObjectClasses,
    PMBMConfig,
    PMBMTracker,
    Reduction,
    Report,
    Sensor,
)
from pmbm.score import ScoreModel
from pmbm.types import Site


def wellformed(tracker):
    """Every number of the density is one, and covariances are covariances."""
    density = tracker.density
    local = density.local
    for values in (local.existence, local.mean, local.cov, density.hypotheses.log_weight):
        assert np.isfinite(values).all()
    assert ((local.existence >= 0) & (local.existence <= 1)).all()
    assert not np.isnan(density.undetected.log_weight).any()
    for cov in (local.cov, density.undetected.cov):
        np.testing.assert_allclose(cov, cov.transpose(0, 2, 1), rtol=1e-12, atol=1e-12)
        assert np.linalg.eigvalsh(cov).min(initial=0) >= -1e-9
    probability = density.hypothesis_probability()
    assert ((probability >= 0) & (probability <= 1 + 1e-9)).all()
    return density


@pytest.mark.parametrize("gate", [20.0, 1e9])
@pytest.mark.parametrize("clutter", [5.0, 0.0])
def test_likelihoods_of_1e_minus_400(gate, clutter):
    """A detection 60 sd from the only track: its likelihood is below the smallest number there is.
    It is a new object or clutter, whatever the gate lets through, and the track stays."""
    config = PMBMConfig().changed(
        {
            "reduction.gate": gate,
            "sensor.clutter_rate": clutter,
            "sensor.position_sd": 0.05,
            "motion.acceleration_density": 0.01,
        }
    )
    tracker = PMBMTracker(config)
    for k in range(20):
        tracks = tracker.step(frame(0.1 * k, [[5.0, 0.0]]))
    assert len(tracks) == 1
    sd = math.sqrt(tracks.covariance[0, 0, 0] + 0.05**2)
    far = 5.0 + 60 * sd
    assert 0.5 * 60**2 / math.log(10) > 400
    after = tracker.step(frame(2.0, [[far, 0.0]]))
    density = wellformed(tracker)
    at = after.position[after.id == tracks.id[0]]
    assert len(at) == 1
    assert at[0, 0] == pytest.approx(5.0, abs=0.2)
    assert density.local.existence.max() > 0.9
    # So far away that neither births nor, where there is none, clutter explain it.
    for k in range(3):
        tracker.step(frame(2.1 + 0.1 * k, [[5.0, 0.0], [1e5, 0.0]]))
        density = wellformed(tracker)
    assert density.local.existence.max() > 0.99


SCORES = ScoreModel(knot=[0.0, 1.0], log_odds=[-8.0, 8.0], base_rate=0.5)
WHERE_SCORES_COUNT = {
    "paper": PMBMConfig.paper(),
    "rising": PMBMConfig.paper().changed({"sensor.detection.rising": True}),
    "everywhere": PMBMConfig(scores=EveryScore()),
    "classes": PMBMConfig(scores=ObjectClasses.simple(persistent_clutter=0.3, score=SCORES)),
    "never while undetectable": PMBMConfig(
        sensor=Sensor(
            detection=DetectionChain(undetectable=0.0, stay_detectable=0.9, stay_undetectable=0.9)
        )
    ),
}


def believing(config, P_D=None, clutter=None):
    """The configuration with another P_D, of objects never detected where tracks have their own,
    and another clutter rate."""
    sensor = config.sensor
    if P_D is not None:
        detection = (
            replace(sensor.detection, undetected=P_D)
            if isinstance(sensor.detection, DetectionFromScores)
            else replace(sensor.detection, base=FixedDetection(probability=P_D))
        )
        sensor = replace(sensor, detection=detection)
    if clutter is not None:
        sensor = replace(sensor, clutter_rate=clutter)
    return replace(config, sensor=sensor)


@pytest.mark.parametrize("name", WHERE_SCORES_COUNT)
@pytest.mark.parametrize(
    "known",
    [
        {},
        {"P_D": 0.0},
        {"P_D": 1.0},
        {"clutter": 0.0},
        {"clutter": 0.0, "P_D": 1.0},
    ],
    ids=lambda known: ", ".join(f"{what} {value:g}" for what, value in known.items()) or "usual",
)
def test_certain_scores_under_certain_beliefs(name, known):
    """Scores of exactly 0 and 1, alone and in turn, through frames, misses and a gap of 10 s."""
    for scores in ([0.0], [1.0], [0.0, 1.0]):
        tracker = PMBMTracker(believing(WHERE_SCORES_COUNT[name], **known))
        for k, one in enumerate(drive(3, frames=14, objects=3, clutter=1.0)):
            z = one.position[:, :2] if k % 5 else np.zeros((0, 2))
            when = one.time if k < 10 else one.time + 10.0
            tracks = tracker.step(frame(when, z, score=np.resize(scores, len(z))))
            wellformed(tracker)
            for values in (tracks.position, tracks.covariance, tracks.score):
                assert np.isfinite(values).all()


def test_covariances_that_are_nearly_singular():
    """Micrometre measurements of objects that may move at 1000 m/s, over steps of a microsecond."""
    config = PMBMConfig().changed(
        {
            "sensor.position_sd": 1e-6,
            "birth.speed_sd": 1e3,
            "motion.acceleration_density": 1e-12,
        }
    )
    tracker = PMBMTracker(config)
    rng = np.random.default_rng(1)
    for k in range(30):
        z = rng.normal([[1.0, 2.0], [1.0 + 1e-5, 2.0]], 1e-6)
        tracker.step(frame(1e-6 * k if k < 15 else 10.0 + k, z))
        wellformed(tracker)


def test_objects_that_coincide_are_bounded_work_and_the_caps_are_told(monkeypatch):
    """A dozen detections in one place, again and again: more hypotheses than are to be kept."""
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.largest_table", lambda _: 400)
    config = PMBMConfig(
        birth=BroadBirth(initial=20.0),
        reduction=Reduction(max_hypotheses=20, prune_hypothesis=0.0),
    )
    tracker = PMBMTracker(config)
    rng = np.random.default_rng(0)
    capped = 0
    for k in range(4):
        tracker.step(frame(0.1 * k, rng.normal([10.0, 5.0], 0.3, (12, 2))))
        density = wellformed(tracker)
        seen = tracker.inspect().reduced
        capped += seen.hypotheses_capped
        assert np.bincount(density.hypotheses.cluster).max(initial=0) <= 20
    assert capped > 0


@pytest.mark.parametrize("clustering", [True, False])
def test_as_many_hypotheses_are_kept_as_the_configuration_says(clustering):
    """Ten objects in one place: a cluster of many tracks, and of more than 6000 entries."""
    config = PMBMConfig(
        reduction=Reduction(
            max_hypotheses=2000, prune_hypothesis=0.0, split_below=0.0, clustering=clustering
        )
    )
    tracker = PMBMTracker(config)
    rng = np.random.default_rng(0)
    for k in range(2):
        tracker.step(frame(0.1 * k, rng.normal([10.0, 5.0], 0.3, (10, 2))))
    assert np.bincount(tracker.density.hypotheses.cluster).max() == 2000


def test_more_tracks_than_may_be_kept_is_told():
    rng = np.random.default_rng(0)
    config = PMBMConfig(
        sensor=Sensor(clutter_rate=50.0), reduction=Reduction(max_tracks=50, recycle_below=0.0)
    )
    tracker = PMBMTracker(config)
    tracker.step(frame(0.0, rng.uniform(-70, 70, (300, 2))))
    assert tracker.inspect().reduced.tracks_capped > 100
    assert len(np.unique(tracker.density.local.track)) <= 50
    wellformed(tracker)


@pytest.mark.parametrize("turn", [0.0, 0.7, -2.4])
def test_a_moved_and_turned_world_hides_the_same(turn):
    """Objects behind each other and behind a wall."""
    shift = np.array([400.0, -150.0])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    wall = np.array([[12.0, -6.0], [14.0, -6.0], [14.0, 2.0], [12.0, 2.0]])
    config = PMBMConfig(sensor=Sensor(occlusion=True))
    here = PMBMTracker(config, Site(max_range=70.0, occluders=(wall,)))
    there = PMBMTracker(config, Site(max_range=70.0, occluders=(wall @ rotation.T + shift,)))
    reported = 0
    for one in drive(9, frames=30, objects=8):
        n = len(one)
        x = here.step(one)
        xy = one.position[:, :2] @ rotation.T + shift
        y = there.step(frame(one.time, xy, yaw=np.full(n, turn), pose=(*shift, turn)))
        assert x.id.tolist() == y.id.tolist()
        reported += len(x)
        np.testing.assert_allclose(
            y.position[:, :2], x.position[:, :2] @ rotation.T + shift, rtol=0, atol=1e-6
        )
        np.testing.assert_allclose(y.score, x.score, rtol=0, atol=1e-6)
    assert reported > 50
    seen = here.inspect().sensor_view.visible
    assert (seen < 0.9).any()


def test_a_tracker_that_was_asked_is_copied_like_any_other():
    """Also with the map of undetected objects, whose ground is kept between steps."""
    frames = drive(6, frames=8)
    config = PMBMConfig(birth=BirthMap(spacing=4.0), report=Report(history=3))
    tracker = PMBMTracker(config, Site(max_range=40.0))
    for one in frames[:4]:
        tracker.step(one)
        tracker.inspect()
    twin = copy.deepcopy(tracker)
    for one in frames[4:]:
        equal(tracker.step(one), twin.step(one))
