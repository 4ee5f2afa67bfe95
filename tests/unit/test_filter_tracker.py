"""What the PMBM tracker promises to whoever feeds it detections."""

from __future__ import annotations

import copy
import math
import time
import tracemalloc

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from pmbm.errors import InputError
from pmbm.filter import (
    BroadBirth,
    EveryScore,
    FixedDetection,
    PMBMConfig,
    PMBMTracker,
    Reduction,
    Report,
    Sensor,
    Survival,
)
from pmbm.geometry import wrap_angle
from pmbm.types import Detections, Label, Site, Tracks


def frame(when, xy=(), *, pose=(0.0, 0.0, 0.0), score=0.8, label=Label.CAR, **changes):
    xy = np.reshape(np.asarray(xy, float), (-1, 2))
    n = len(xy)
    values = {
        "time": when,
        "position": np.column_stack([xy, np.full(n, 0.8)]),
        "size": np.tile([4.5, 1.9, 1.6], (n, 1)),
        "yaw": np.zeros(n),
        "score": np.full(n, score),
        "label": np.full(n, int(label)),
        "sensor_pose": np.asarray(pose, float),
    }
    return Detections(**{**values, **changes})


def drive(seed, frames=40, dt=0.1, clutter=2.0, detected=0.9, objects=5):
    """Frames of a few cars that cross a 60 m square, with misses and clutter."""
    rng = np.random.default_rng(seed)
    start, velocity = rng.uniform(-30, 30, (objects, 2)), rng.normal(0, 6, (objects, 2))
    made = []
    for k in range(frames):
        seen = start + k * dt * velocity
        seen = seen[rng.random(objects) < detected]
        z = np.concatenate(
            [
                seen + rng.normal(0, 0.3, seen.shape),
                rng.uniform(-60, 60, (rng.poisson(clutter), 2)),
            ]
        )
        made.append(frame(k * dt, rng.permutation(z)))
    return made


def same(a: Tracks, b: Tracks, **tolerance):
    assert a.id.tolist() == b.id.tolist()
    for name in ("position", "velocity", "score", "covariance", "yaw", "size"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), **tolerance)
    assert a.label.tolist() == b.label.tolist()


def equal(a: Tracks, b: Tracks):
    same(a, b, rtol=0, atol=0)


def run(tracker, frames):
    return [tracker.step(one) for one in frames]


def test_a_lone_object_is_a_kalman_filter():
    """One target, no clutter, certain detection: filterpy's numbers, frame by frame, over
    irregular intervals and an empty stretch."""
    config = PMBMConfig(
        survival=Survival(probability=1.0),
        birth=BroadBirth(rate=0.0, initial=0.7, components=1),
    ).changed(
        {
            "sensor.detection.base.probability": 1.0,
            "sensor.clutter_rate": 0.0,
            "sensor.position_sd": 0.3,
        }
    )
    tracker = PMBMTracker(config)
    rng = np.random.default_rng(4)
    kf = KalmanFilter(dim_x=4, dim_z=2)
    area = np.pi * 100.0**2
    kf.x, kf.H, kf.R = np.array([70.71067811865476, 0, 0, 0]), np.eye(2, 4), 0.09 * np.eye(2)
    kf.x[:2] = 100 * math.sqrt(0.5) * np.array([math.cos(-math.pi), math.sin(-math.pi)])
    kf.P = np.diag([area / 4, area / 4, 100.0, 100.0])
    when = 0.0
    for k in range(30):
        if k:
            dt = float(rng.choice([0.05, 0.1, 0.4]))
            when += dt
            kf.F = np.eye(4)
            kf.F[0, 2] = kf.F[1, 3] = dt
            kf.Q = Q_continuous_white_noise(
                2, dt, spectral_density=2.0, block_size=2, order_by_dim=False
            )
            kf.predict()
        z = np.array([-20.0 + 8 * when, 5 - 2 * when]) + rng.normal(0, 0.3, 2)
        kf.update(z)
        tracks = tracker.step(frame(when, [z]))
        assert tracks.id.tolist() == [0]
        state = np.concatenate([tracks.position[0, :2], tracks.velocity[0]])
        assert state == pytest.approx(kf.x, rel=1e-7, abs=1e-7)
        assert tracks.covariance[0] == pytest.approx(kf.P, rel=1e-6, abs=1e-9)


def test_box_and_label_ride_along_from_the_last_detection():
    tracker = PMBMTracker()
    for k in range(4):
        tracks = tracker.step(
            frame(
                0.1 * k,
                [[5.0 + k, 0.0]],
                label=Label.TRUCK,
                size=np.array([[9.0 + k, 2.5, 3.2]]),
                yaw=np.array([0.1 * k]),
                position=np.array([[5.0 + k, 0.0, 1.5 + k]]),
            )
        )
    assert tracks.size.tolist() == [[12.0, 2.5, 3.2]]
    assert tracks.yaw == pytest.approx([0.3])
    assert tracks.position[0, 2] == 4.5
    assert tracks.label.tolist() == [Label.TRUCK]
    missed = tracker.step(frame(0.4))
    assert missed.size.tolist() == [[12.0, 2.5, 3.2]]
    assert missed.position[0, 0] > tracks.position[0, 0] + 0.5


def test_time_passes_in_frames_without_detections():
    tracker = PMBMTracker()
    for k in range(6):
        tracker.step(frame(0.1 * k, [[2.0 * k, 0.0]]))
    before = tracker.density
    position = tracker.step(frame(0.6)).position[0, 0]
    assert position == pytest.approx(12.0, abs=0.5)
    assert tracker.density.local.existence.max() < before.local.existence.max()
    tracker.step(frame(0.7))
    mean = tracker.density.local.mean
    assert mean[np.argmax(tracker.density.local.existence), 0] == pytest.approx(
        position + 2.0, abs=0.3
    )


def test_an_empty_road_and_one_that_empties_settle_at_the_birth_level():
    """1000 frames without a detection, from the first one on and after traffic."""
    empty, emptied = PMBMTracker(), PMBMTracker()
    for one in drive(1, frames=20):
        emptied.step(one)
    for k in range(1000):
        assert len(empty.step(frame(0.1 * k))) == 0
        tracks = emptied.step(frame(2.0 + 0.1 * k))
    assert len(tracks) == 0
    births = 0.5 * 0.1
    for tracker in (empty, emptied):
        undetected = np.exp(tracker.density.undetected.log_weight).sum()
        assert 0.1 * births < undetected < 3 * births
        assert np.isfinite(tracker.density.undetected.mean).all()
        assert len(tracker.density.undetected) < 100
        assert len(tracker.density.track_id) == 0


def test_ids_are_never_used_again():
    tracker = PMBMTracker(PMBMConfig(scores=EveryScore()))
    seen: set[int] = set()
    for k in range(60):
        born = tracker.step(frame(k * 1.0, [[20.0 * (k % 4), 7.0 * (k % 3)]])).id.tolist()
        tracker.step(frame(k * 1.0 + 0.5))
        started = set(tracker.density.track_id.tolist())
        assert max(started | {0}) <= k
        seen |= set(born)
    assert len(seen) > 3
    # An id names the detection that started the track: it lies there, at that time.
    frames = drive(3)
    first_of = np.cumsum([0] + [len(one) for one in frames])
    tracker, where, ids = PMBMTracker(), {}, set()
    for k, one in enumerate(frames):
        known = set(where)
        for id_, state in zip((t := tracker.step(one)).id.tolist(), t.position, strict=True):
            where.setdefault(id_, (k, state))
        assert all(id_ < first_of[k + 1] for id_ in set(where) - known)
        present = set(tracker.density.track_id.tolist())
        assert all(first_of[k] <= id_ < first_of[k + 1] for id_ in present - ids)
        ids |= present
    for id_, (k, state) in where.items():
        begun = int(np.searchsorted(first_of, id_, side="right")) - 1
        origin = frames[begun].position[id_ - first_of[begun]]
        assert np.hypot(*(origin - state)[:2]) < 1 + 3 * (k - begun)


def test_bad_time_is_refused_and_leaves_the_tracker_as_it_was():
    tracker = PMBMTracker()
    frames = drive(5, frames=12)
    run(tracker, frames[:10])
    twin = copy.deepcopy(tracker)
    with pytest.raises(InputError, match="time"):
        tracker.step(frame(0.2, [[1.0, 1.0]]))
    for bad in ({"position": [[math.nan, 0, 0]]}, {"score": [math.inf]}):
        with pytest.raises(InputError):
            tracker.step(frame(1.0, [[1.0, 1.0]], **bad))
    for one in frames[10:]:
        equal(tracker.step(one), twin.step(one))


def test_two_looks_at_one_moment():
    tracker = PMBMTracker(PMBMConfig(sensor=Sensor(position_sd=0.3)))
    first = tracker.step(frame(1.0, [[5.0, 0.0]]))
    second = tracker.step(frame(1.0, [[5.1, 0.0]]))
    assert len(second) == 1
    assert second.covariance[0, 0, 0] < 0.3**2
    assert len(first) == 0 or second.id.tolist() == first.id.tolist()


def test_a_copy_taken_in_mid_run_goes_on_identically():
    frames = drive(6)
    tracker = PMBMTracker()
    run(tracker, frames[:20])
    twin = copy.deepcopy(tracker)
    for one in frames[20:]:
        equal(tracker.step(one), twin.step(one))


def test_output_of_a_prefix_is_the_prefix_of_the_output():
    frames = drive(7)
    whole = run(PMBMTracker(), frames)
    for a, b in zip(run(PMBMTracker(), frames[:15]), whole, strict=False):
        equal(a, b)


def test_nothing_random_and_nothing_shared():
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    frames = drive(8)
    alone = run(PMBMTracker(), frames)
    other, again = PMBMTracker(), PMBMTracker()
    for one, expected in zip(frames, alone, strict=True):
        other.step(frame(one.time, [[1.0, 1.0]]))
        equal(again.step(one), expected)
    assert np.array_equal(np.random.get_state()[1], state)  # noqa: NPY002


@pytest.mark.parametrize("seed", range(3))
def test_the_order_of_detections_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    frames = drive(seed)
    a, b = PMBMTracker(), PMBMTracker()
    for one in frames:
        order = rng.permutation(len(one))
        x, y = a.step(one), b.step(one.take(order))
        match = np.argsort(x.position[:, 0]), np.argsort(y.position[:, 0])
        x, y = x.take(match[0]), y.take(match[1])
        for name in ("position", "velocity", "score", "covariance"):
            np.testing.assert_allclose(getattr(x, name), getattr(y, name), rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 1.1])
def test_moving_and_turning_the_world_moves_and_turns_the_tracks(turn):
    shift = np.array([3000.0, -800.0])
    rotation = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
    site = Site(fov_centre=0.3, fov_half_angle=2.0, max_range=70.0)
    a, b = PMBMTracker(site=site), PMBMTracker(site=site)
    reported = 0
    for one in drive(9):
        xy = one.position[:, :2] @ rotation.T + shift
        x = a.step(one)
        y = b.step(frame(one.time, xy, pose=(*shift, turn), yaw=one.yaw + turn))
        assert x.id.tolist() == y.id.tolist()
        reported += len(x)
        np.testing.assert_allclose(
            y.position[:, :2], x.position[:, :2] @ rotation.T + shift, rtol=0, atol=1e-6
        )
        np.testing.assert_allclose(y.velocity, x.velocity @ rotation.T, rtol=0, atol=1e-6)
        np.testing.assert_allclose(y.score, x.score, rtol=0, atol=1e-7)
        assert np.abs(wrap_angle(y.yaw - x.yaw - turn)).max(initial=0) < 1e-9
    assert reported > 50


def test_clustering_changes_the_bookkeeping_alone():
    """Where no cap binds; the textbook form keeps everything in one table."""
    config = PMBMConfig(birth=BroadBirth(merge_below=0.0)).changed(
        {
            "reduction.max_hypotheses": 20_000,
            "reduction.prune_hypothesis": 1e-9,
            "reduction.recycle_below": 0.0,
            "reduction.prune_undetected": 0.0,
            "reduction.gate": 30.0,
            "reduction.split_below": 0.0,
        }
    )
    frames = drive(10, frames=5, objects=2, clutter=0.3)
    a = PMBMTracker(config.changed({"reduction.clustering": True}))
    b = PMBMTracker(config.changed({"reduction.clustering": False}))
    for one in frames:
        same(a.step(one), b.step(one), rtol=1e-6, atol=1e-7)
    assert a.density.hypotheses.clusters > 1
    assert b.density.hypotheses.clusters == 1


@pytest.mark.parametrize(
    "changes",
    [
        {"sensor.detection.base.probability": 0.0},
        {"sensor.detection.base.probability": 1.0},
        {"sensor.clutter_rate": 0.0},
        {
            "sensor.clutter_rate": 0.0,
            "sensor.detection.base.probability": 1.0,
            "birth.initial": 0.0,
        },
        {"birth.rate": 0.0, "birth.initial": 0.0},
        {"survival.probability": 0.0},
        {"survival.probability": 1.0},
        {"motion.acceleration_density": 0.0},
        {"reduction.recycle_below": 1.0},
        {"reduction.recycle_below": 0.0},
        {"reduction.max_hypotheses": 1},
        {"reduction.max_tracks": 1, "reduction.max_undetected": 1},
        {"reduction.clustering": False, "reduction.max_hypotheses": 10},
        {"sensor.position_sd": 1e-6},
        {"sensor.position_sd": 1e3},
        {"sensor.clutter_rate": 1e300},
        {"birth.rate": 1e-300},
    ],
)
def test_extreme_beliefs_give_finite_results(changes):
    tracker = PMBMTracker(PMBMConfig().changed(changes))
    for k, one in enumerate(drive(11, frames=15)):
        score = np.resize([0.0, 1.0, 0.5], len(one))
        one = frame(one.time if k < 10 else one.time + 10.0, one.position[:, :2], score=score)
        tracker.step(one)
        density = tracker.density
        assert np.isfinite(density.hypotheses.log_weight).all()
        assert np.isfinite(density.local.mean).all()
        assert ((density.local.existence >= 0) & (density.local.existence <= 1)).all()
        assert np.linalg.eigvalsh(density.local.cov).min(initial=0) >= -1e-9


def test_copies_of_one_detection_and_objects_in_one_place():
    tracker = PMBMTracker()
    for k in range(30):
        tracks = tracker.step(frame(0.1 * k, [[10.0, 5.0]] * 3 + [[10.0, 5.2]] * 3))
        assert np.isfinite(tracks.position).all()
    assert 1 <= len(tracks) <= 8


@pytest.mark.parametrize("gap", [10.0, 3600.0])
def test_a_gap_and_uneven_frames(gap):
    tracker = PMBMTracker()
    frames = drive(12, frames=30)
    for one in frames[:15]:
        tracker.step(one)
    for k, one in enumerate(frames[15:]):
        tracks = tracker.step(frame(gap + one.time + 0.01 * (k % 3), one.position[:, :2]))
    assert len(tracks) >= 3
    assert np.isfinite(tracks.covariance).all()


def test_ten_thousand_detections_in_one_frame():
    rng = np.random.default_rng(0)
    tracker = PMBMTracker(PMBMConfig(sensor=Sensor(clutter_rate=50.0)))
    tracker.step(frame(0.0, rng.uniform(-70, 70, (20, 2))))
    tracemalloc.start()
    start = time.process_time()
    tracker.step(frame(0.1, rng.uniform(-70, 70, (10_000, 2))))
    seconds = time.process_time() - start
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert seconds < 20
    assert peak < 500e6


def test_impossible_configurations_are_refused_by_name():
    for part, field, bad in (
        (FixedDetection, "probability", 1.3),
        (Sensor, "clutter_rate", -1.0),
        (Survival, "probability", math.nan),
        (Reduction, "gate", 0.0),
        (Reduction, "max_hypotheses", 0),
        (Reduction, "max_hypotheses", 2.5),
        (Reduction, "clustering", 1),
        (Sensor, "position_sd", "small"),
        (BroadBirth, "speed_sd", math.inf),
        (Reduction, "recycle_below", True),
        (Reduction, "prune_hypothesis", 1.0),
        (Report, "history", -1),
    ):
        with pytest.raises(InputError, match=field):
            part(**{field: bad})
    assert Sensor(clutter_rate=2).clutter_rate == 2


def test_a_track_out_of_view_is_kept_in_mind_and_not_reported():
    tracker = PMBMTracker(site=Site(max_range=30.0))
    for k in range(10):
        tracks = tracker.step(frame(0.1 * k, [[26.0 + 0.5 * k, 0.0]] if k < 8 else []))
    assert len(tracks) == 0
    assert tracker.density.local.existence.max() > 0.9
    back = tracker.step(frame(1.0, pose=(10.0, 0.0, 0.0)))
    assert len(back) == 1
