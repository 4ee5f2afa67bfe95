"""What the filter expects to see behind other tracks, against the exact shadow test."""

from dataclasses import replace

import numpy as np
import pytest
from filter_problems import KEEP_ALL, bernoullis, plain_sensor, scan_of
from hypothesis import assume, given
from hypothesis import strategies as st

from pmbm import Detections, Site
from pmbm.filter import (
    ConstantVelocity,
    DetectionChain,
    FixedDetection,
    IgnoreScores,
    PMBMConfig,
    PMBMTracker,
    Sensor,
    Survival,
)
from pmbm.filter.association import associate
from pmbm.filter.density import MISSED, Density, Globals, Mixture
from pmbm.filter.models.occlusion import Shadows
from pmbm.filter.models.rays import BEARINGS, box_rays, outline_rays
from pmbm.filter.update import update
from pmbm.geometry import corners, visible_fraction

BEARING = 2 * np.pi / BEARINGS


def density_of(boxes, existence):
    """One hypothesis with one track a box: (x, y, length, width, yaw)."""
    boxes = np.asarray(boxes, dtype=float)
    n = len(boxes)
    local = bernoullis(
        np.arange(n),
        existence,
        np.column_stack([boxes[:, :2], np.zeros((n, 2))]),
        np.tile(1e-12 * np.eye(4), (n, 1, 1)),
        box=np.column_stack([np.zeros(n), boxes[:, 2:4], np.ones(n), boxes[:, 4]]),
        history=np.full((n, 1), MISSED, np.int32),
    )
    table = Globals(np.zeros(1, np.intp), np.zeros(1), np.array([0, n]), np.arange(n))
    return Density(Mixture.empty(), local, table, np.arange(n), n)


def expected(boxes, existence, occluders=()):
    density = density_of(boxes, existence)
    return Shadows.of(density, np.zeros(3), occluders).visible_share(density.local)


def outline(box):
    x, y, length, width, yaw = box
    return corners([[x, y, 0]], [[length, width, 1]], [yaw])


@st.composite
def apart(draw):
    """Boxes that neither meet each other nor surround the sensor."""
    n = draw(st.integers(1, 5))
    boxes = []
    for _ in range(n):
        distance = draw(st.floats(12, 60))
        bearing = draw(st.floats(-np.pi, np.pi))
        boxes.append(
            (
                distance * np.cos(bearing),
                distance * np.sin(bearing),
                draw(st.floats(0.5, 14)),
                draw(st.floats(0.5, 3)),
                draw(st.floats(-np.pi, 3.1)),
            )
        )
    reach = [np.hypot(b[2], b[3]) / 2 for b in boxes]
    for i in range(n):
        for j in range(i):
            gap = np.hypot(boxes[i][0] - boxes[j][0], boxes[i][1] - boxes[j][1])
            assume(gap > reach[i] + reach[j])
    return boxes


@given(apart())
def test_certain_tracks_hide_what_the_exact_shadow_test_says(boxes):
    exact = visible_fraction(np.concatenate([outline(b) for b in boxes]), np.zeros(2))
    extent = [np.diff(box_rays(np.zeros(3), np.array([b[:2]]), box5(b)).first)[0] for b in boxes]
    # Each object's bearings are counted in whole steps: two ends, and two ends of each shadow.
    error = 2 * len(boxes) / np.maximum(extent, 1)
    assert (np.abs(expected(boxes, np.ones(len(boxes))) - exact) <= error).all()


def box5(b):
    return np.array([[0.0, b[2], b[3], 1.0, b[4]]])


@given(apart(), st.data())
def test_doubtful_tracks_hide_in_expectation(boxes, data):
    r = np.array(data.draw(st.lists(st.floats(0.1, 1), min_size=len(boxes), max_size=len(boxes))))
    # By hand: the expectation over who exists, each object looked at as if it exists itself.
    mean = np.zeros(len(boxes))
    for exists in np.ndindex(*(2,) * len(boxes)):
        there = np.array(exists, bool)
        for i in range(len(boxes)):
            others = np.delete(there, i)
            probability = np.prod(np.where(others, np.delete(r, i), 1 - np.delete(r, i)))
            certain = np.where(there, 1.0, 0.0)
            certain[i] = 1.0
            if there[i]:
                mean[i] += probability * expected(boxes, certain)[i]
    assert np.allclose(expected(boxes, r), mean, atol=1e-7)


@given(apart(), st.floats(-np.pi, np.pi))
def test_turning_the_world_changes_nothing_but_the_rounding_of_bearings(boxes, turn):
    steps = round(turn / BEARING)
    turn = steps * BEARING
    cos, sin = np.cos(turn), np.sin(turn)
    turned = [
        (cos * x - sin * y, sin * x + cos * y, length, width, yaw + turn)
        for x, y, length, width, yaw in boxes
    ]
    here, there = expected(boxes, np.ones(len(boxes))), expected(turned, np.ones(len(boxes)))
    extent = [np.diff(box_rays(np.zeros(3), np.array([b[:2]]), box5(b)).first)[0] for b in boxes]
    assert (np.abs(here - there) <= 2 * len(boxes) / np.maximum(extent, 1)).all()


def test_a_car_behind_a_truck_by_hand():
    truck, car = (10.0, 0.0, 2.6, 14.0, 0.0), (30.0, 0.0, 4.5, 1.9, 0.0)
    assert np.allclose(expected([truck, car], [1.0, 1.0]), [1.0, 0.0], atol=1e-8)
    assert np.allclose(expected([truck, car], [0.25, 1.0]), [1.0, 0.75])
    assert np.allclose(expected([truck, car], [0.04, 1.0]), [1.0, 1.0])


def test_a_wall_hides_what_stands_behind_it_and_not_what_stands_before_it():
    wall = np.array([[19.0, -10.0], [20.0, -10.0], [20.0, 10.0], [19.0, 10.0]])
    near, far = (10.0, 0.0, 4.5, 1.9, 0.0), (30.0, 0.0, 4.5, 1.9, 0.0)
    assert np.allclose(expected([near], [1.0], [wall]), [1.0])
    assert np.allclose(expected([far], [1.0], [wall]), [0.0], atol=1e-8)
    beside = (30.0, 40.0, 4.5, 1.9, 0.0)
    assert np.allclose(expected([beside], [1.0], [wall]), [1.0])


def test_a_hypothesis_is_never_hidden_by_its_own_track():
    density = density_of([(20.0, 0.0, 4.5, 1.9, 0.0)], [1.0])
    shadows = Shadows.of(density, np.zeros(3))
    other = density_of([(30.0, 0.0, 4.5, 1.9, 0.0)], [1.0]).local
    assert np.allclose(shadows.visible_share(other), [1.0])


def test_an_uncertain_position_is_hidden_in_part():
    boxes = [(10.0, 0.0, 2.6, 6.0, 0.0), (20.0, 10.0, 4.5, 1.9, 0.0)]
    density = density_of(boxes, [1.0, 1.0])
    shadows = Shadows.of(density, np.zeros(3))
    density.local.cov[1] = np.diag([9.0, 9.0, 1.0, 1.0])
    share = shadows.visible_share(density.local)[1]
    assert 0.3 < share < 0.9
    assert expected(boxes, [1.0, 1.0])[1] == 1.0


def test_rays_of_a_box_and_of_its_outline_agree():
    box = (15.0, 7.0, 8.0, 3.0, 0.4)
    a = box_rays(np.zeros(3), np.array([box[:2]]), box5(box))
    b = outline_rays(np.zeros(3), [outline(box)[0]])
    assert a.bearing.tolist() == b.bearing.tolist()
    assert np.allclose(a.distance, b.distance)


def test_a_sensor_inside_an_outline_sees_through_it():
    around = outline((0.0, 0.0, 10.0, 10.0, 0.2))[0]
    assert len(outline_rays(np.zeros(3), [around]).bearing) == 0
    assert np.allclose(expected([(0.1, 0.0, 5.0, 3.0, 0.1), (9.0, 0, 4, 2, 0)], [1, 1]), 1.0)


def test_turning_the_world_with_the_sensor_in_it_changes_nothing():
    """Bearings are counted from the sensor's yaw, not from the world's."""
    rng = np.random.default_rng(4)
    boxes = np.column_stack(
        [rng.uniform(-40, 40, (12, 2)), np.full(12, 4.5), np.full(12, 1.9), rng.uniform(-3, 3, 12)]
    )
    wall = np.array([[8.0, -9.0], [9.0, -9.0], [9.5, 7.0], [8.0, 7.0]])
    cov = np.diag([9.0, 4.0, 1.0, 2.0])
    cov[0, 1] = cov[1, 0] = 2.0
    results = []
    for turn in (0.0, 0.7, 2.9):
        cos, sin = np.cos(turn), np.sin(turn)
        R = np.kron(np.eye(2), [[cos, -sin], [sin, cos]])
        turned = boxes.copy()
        turned[:, :2] = boxes[:, :2] @ R[:2, :2].T + 5.0
        turned[:, 4] += turn
        density = density_of(turned, np.full(12, 0.8))
        density.local.cov[::2] = R @ cov @ R.T
        pose = np.array([5.0, 5.0, 0.3 + turn])
        shadows = Shadows.of(density, pose, (wall @ R[:2, :2].T + 5.0,))
        visible, rows, glimpse = shadows.of_tracks(density.local)
        mean, spread = glimpse.of_tracks_if_missed(
            density.local.mean[rows], density.local.cov[rows], np.full(len(rows), 0.9)
        )
        unseen = shadows.undetected(density.local.mean, density.local.cov).share()
        results.append((visible, unseen, (mean[:, :2] - 5.0) @ R[:2, :2], R.T @ spread @ R))
    assert (results[0][0] < 0.9).any()
    for turned in results[1:]:
        for here, there in zip(results[0], turned, strict=True):
            np.testing.assert_allclose(there, here, rtol=0, atol=1e-9)


def test_a_missed_track_is_rather_where_it_is_hidden():
    wall = np.array([[19.0, -10.0], [20.0, -10.0], [20.0, 0.0], [19.0, 0.0]])
    density = density_of([(40.0, 0.0, 4.5, 1.9, 0.0)], [0.9])
    density.local.cov[0] = np.diag([9.0, 9.0, 4.0, 4.0])
    density.local.cov[0, 1, 3] = density.local.cov[0, 3, 1] = 3.0
    visible, rows, glimpse = Shadows.of(density, np.zeros(3), (wall,)).of_tracks(density.local)
    assert rows.tolist() == [0]
    assert 0.4 < visible[0] < 0.6
    before = density.local.mean, density.local.cov
    mean, cov = glimpse.of_tracks_if_missed(*before, np.array([0.9]))
    full, _ = glimpse.if_missed(*before, np.array([0.9]))
    # A half-normal lies .8 standard deviations to its side; nine in ten of those seen are out.
    assert -0.8 * 3.2 < mean[0, 1] < -0.8 * 3.0 * 0.7
    np.testing.assert_allclose(mean[0, 2:], 0.0)
    assert full[0, 1] <= mean[0, 1] < 0
    assert full[0, 3] < 0
    assert 0.3 < cov[0, 1, 1] / 9.0 < 0.8
    assert np.linalg.eigvalsh(cov[0]).min() > 0
    # Hidden as a whole, or in the open as a whole, nothing is learnt about where it is.
    for y in (-12.0, 30.0):
        density.local.mean[0, 1] = y
        _, _, glimpse = Shadows.of(density, np.zeros(3), (wall,)).of_tracks(density.local)
        mean, cov = glimpse.of_tracks_if_missed(*before, np.array([0.9]))
        np.testing.assert_allclose(mean, density.local.mean, atol=1e-6)
        np.testing.assert_allclose(cov, density.local.cov, atol=1e-6)


def test_what_leaks_out_of_a_shadow_is_lost_once():
    """A hidden track's existence is that of particles behind the same wall, to a few hundredths."""
    wall = np.array([[19.0, -14.0], [20.0, -14.0], [20.0, 14.0], [19.0, 14.0]])
    config = PMBMConfig(
        motion=ConstantVelocity(acceleration_density=1.0),
        survival=Survival(probability=1.0),
        sensor=Sensor(detection=FixedDetection(probability=0.95), clutter_rate=1.0),
        scores=IgnoreScores(),
    )
    tracker = PMBMTracker(config, Site(occluders=(wall,), max_range=80.0))
    rng = np.random.default_rng(2)
    x = rng.multivariate_normal(np.zeros(4), np.diag([0.04, 0.04, 0.3, 0.3]), 40_000)
    x[:, 0] += 30.0
    start = density_of([(30.0, 0.0, 4.5, 1.9, 0.0)], [0.98])
    start.local.cov[0] = np.diag([0.04, 0.04, 0.3, 0.3])
    tracker.step(Detections.empty(time=0.0))
    undetected = tracker.state.density.undetected
    tracker.state = replace(tracker.state, density=replace(start, undetected=undetected))
    F, Q = config.motion.transition(0.1)
    weight = np.full(len(x), 0.98)
    for frame in range(1, 71):
        tracker.step(Detections.empty(time=0.1 * frame))
        x = x @ F.T + rng.multivariate_normal(np.zeros(4), Q, len(x))
        edge = np.abs(x[:, 1]) / np.maximum(x[:, 0], 1e-9)
        hidden = (x[:, 0] > 20.0) & (edge < 14.0 / 20.0)
        weight *= 1 - config.sensor.detection.probability * ~hidden * (
            np.hypot(x[:, 0], x[:, 1]) < 80
        )
    left = weight.mean() / (weight.mean() + 0.02)
    r = tracker.density.local.existence[0]
    assert r == pytest.approx(left, abs=0.05)


def test_what_hides_a_track_drives_its_detectable_mode():
    """Misses behind a truck say nothing of whether the detector has lost the object; misses in the
    open do."""
    base = FixedDetection(probability=0.95)
    chain = DetectionChain(base=base, undetectable=0.1, stay_detectable=0.97, stay_undetectable=0.8)
    detectable = {}
    for name, truck in (
        ("hidden", (10.0, 0.0, 2.6, 14.0, 0.0)),
        ("open", (-20.0, 0.0, 2.6, 14, 0)),
    ):
        density = density_of([truck, (30.0, 0.0, 4.5, 1.9, 0.0)], [1.0, 0.99])
        marks = replace(density.local.marks, detectable=np.array([0.9, 0.9]))
        density = replace(density, local=replace(density.local, marks=marks))
        sensor = plain_sensor(
            0.25 * np.eye(2), 0.95, 1e-4, shadows=Shadows.of(density, np.zeros(3))
        )
        sensor = replace(sensor, detection=chain)
        scan = scan_of(np.zeros((0, 2)))
        kept = replace(KEEP_ALL, gate=20.0, max_hypotheses=9, clustering=True)
        found = associate(density, scan, sensor, kept)
        after = update(density, scan, found, sensor).local
        detectable[name] = after.marks.detectable[1]
        assert found.detection[1] <= 0.95 * chain.share(np.array([0.9]))[0]
    assert detectable["hidden"] == pytest.approx(0.9, abs=1e-6)
    assert detectable["open"] < 0.6
