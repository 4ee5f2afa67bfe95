"""Sensors that are not as they are said to be: mounts that do not fit, and one that has gone
blind."""

from __future__ import annotations

import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from mark_builders import delivery

from pmbm import PMBMConfig, PMBMTracker, Site
from pmbm.errors import InputWarning
from pmbm.filter import FixedDetection, Sensor
from pmbm.filter.blindness import Blindness, log_chance_of_none
from pmbm.filter.registration import Look
from pmbm.sim import load_scenario
from pmbm.types import MountedSensor

LIDAR = MountedSensor(name="lidar", mount=np.array([1.0, 0.0, 0.0]), max_range=80.0)
RADAR = MountedSensor(name="radar", mount=np.array([3.0, 0.5, 0.1]), max_range=80.0)
SITE = Site(max_range=80.0, sensors=(LIDAR, RADAR))
TRUSTING = Sensor(align=False, may_fail=False)


def seen_from(pose, places):
    """Places in the frame of a sensor at this pose."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return (places - pose[:2]) @ np.array([[cos, -sin], [sin, cos]])


def put_at(pose, places):
    """The way back."""
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    return pose[:2] + places @ np.array([[cos, sin], [-sin, cos]])


def drive(truly=RADAR, frames=30, seed=0, objects=6):
    """Both sensors' deliveries, ten a second each and one after the other, on a carrier that turns;
    the radar is mounted as `truly` says, and the vehicle believes it to be mounted as `RADAR`."""
    rng = np.random.default_rng(seed)
    start = rng.uniform(-40, 40, (objects, 2))
    velocity = rng.uniform(-8, 8, (objects, 2))
    for k in range(2 * frames):
        time = 0.05 * k
        carrier = np.array([6.0 * time, 0.5 * time**2, 0.15 * time])
        places = start + time * velocity
        places = places[rng.random(objects) < 0.9] + 0.0
        if k % 2:
            local = seen_from(truly.pose_on(carrier), places) + rng.normal(0, 0.3, places.shape)
            believed = RADAR.pose_on(carrier)
            yield delivery(time, put_at(believed, local), "radar", believed)
        else:
            pose = LIDAR.pose_on(carrier)
            yield delivery(time, places + rng.normal(0, 0.3, places.shape), "lidar", pose)


ELSEWHERE = replace(RADAR, mount=RADAR.mount + np.array([-0.4, -1.0, np.deg2rad(-2.0)]))
"""The radar is farther back and to the right than believed, and turned to the right."""


def follow(tracker, deliveries):
    return [tracker.step(one) for one in deliveries]


@pytest.mark.parametrize("seed", range(4))
def test_two_mounts_that_do_not_fit_are_told_and_by_how_much(seed):
    tracker = PMBMTracker(site=SITE)
    with pytest.warns(InputWarning, match="mounts of 'lidar' and 'radar' do not fit") as said:
        reports = follow(tracker, drive(ELSEWHERE, seed=seed))
    assert len(said) == 1
    registration = tracker.state.registration
    x, y, yaw = registration.error[1] - registration.error[0]
    assert (x, y, np.rad2deg(yaw)) == (
        pytest.approx(0.4, abs=0.35),
        pytest.approx(1.0, abs=0.35),
        pytest.approx(2.0, abs=0.5),
    )
    told = registration.told(SITE)
    assert "farther back" in told
    assert "farther right" in told
    assert "degrees to the right" in told
    assert np.mean([len(one) for one in reports[-20:]]) == pytest.approx(6.0, abs=0.5)


@pytest.mark.parametrize("sure", ["lidar", "radar"])
@pytest.mark.filterwarnings("ignore:at .* the mounts")
def test_what_is_delivered_is_moved_to_the_sensor_whose_mount_is_sure(sure):
    config = PMBMConfig(sensors={sure: Sensor(align=False)})
    tracker = PMBMTracker(config, SITE)
    follow(tracker, drive(ELSEWHERE, seed=1))
    error = dict(zip(("lidar", "radar"), tracker.state.registration.error, strict=True))
    assert not error[sure].any()
    (other,) = error.keys() - {sure}
    sign = 1 if other == "radar" else -1
    assert sign * error[other][1] == pytest.approx(1.0, abs=0.35)


@pytest.mark.filterwarnings("ignore:at .* the mounts")
def test_of_three_the_one_that_fits_neither_is_moved():
    """Two against one: without either being sure."""
    rear = MountedSensor(name="rear", mount=np.array([-1.0, 0.2, 0.0]), max_range=80.0)
    site = replace(SITE, sensors=(LIDAR, RADAR, rear))
    tracker = PMBMTracker(site=site)
    rng = np.random.default_rng(3)
    for one in drive(ELSEWHERE, seed=2, frames=40):
        tracker.step(one)
        if one.sensor == "lidar":
            place = one.position[:, :2] + rng.normal(0, 0.3, (len(one), 2))
            pose = rear.pose_on(LIDAR.carrier_of(one.sensor_pose))
            tracker.step(delivery(one.time + 0.02, place, "rear", pose))
    size = np.abs(tracker.state.registration.error[:, 1])
    assert size[1] > 1.5 * max(size[0], size[2])


def test_moving_back_undoes_what_a_wrong_mount_does():
    """Against poses on a carrier: the same boxes by the mount as it is and as it is believed."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        carrier, error = rng.normal(0, 5, 3), rng.normal(0, 0.5, 3)
        truly = MountedSensor(name="radar", mount=RADAR.mount - error)
        places = rng.uniform(-50, 50, (4, 2))
        believed = RADAR.pose_on(carrier)
        given = put_at(believed, seen_from(truly.pose_on(carrier), places))
        back = Look(delivery(0.0, given, "radar", believed), carrier).moved_back(error)
        np.testing.assert_allclose(back.position[:, :2], places, atol=1e-9)
        np.testing.assert_allclose(back.sensor_pose, truly.pose_on(carrier), atol=1e-9)
        # By how much each detection is off, to the first order.
        small = 1e-6 * error
        look = Look(delivery(0.0, places, "radar", believed), carrier)
        shift = np.einsum("xni,i->nx", look.shift(np.arange(4)), small)
        np.testing.assert_allclose(places - look.places(small), shift, atol=1e-9)


@pytest.mark.parametrize("name", ["lidar_radar", "blind_spot"])
def test_sensors_that_are_as_they_are_said_to_be_are_taken_at_their_word(name):
    """To the bit: nothing is moved, and every miss counts."""
    recording = load_scenario(name).record(8)
    watched, trusting = (
        PMBMTracker(PMBMConfig(sensor=sensor), recording.site) for sensor in (Sensor(), TRUSTING)
    )
    for row in recording.handed_over()[:120]:
        one, two = (each.step(recording.detections[row]) for each in (watched, trusting))
        np.testing.assert_array_equal(one.id, two.id)
        np.testing.assert_array_equal(one.position, two.position)
        np.testing.assert_array_equal(one.score, two.score)
    # In blind_spot no three objects are ever seen by both.
    assert (watched.state.registration.comparisons > 0) == (name == "lidar_radar")


def test_two_objects_of_which_each_sensor_sees_one_are_no_misfit():
    tracker = PMBMTracker(site=SITE)
    for k in range(60):
        time, (name, y) = 0.05 * k, (("lidar", 0.0), ("radar", 2.5))[k % 2]
        mounted = SITE.sensor(name)
        tracker.step(delivery(time, [[20.0 + 5 * time, y]], name, mounted.pose_on(np.zeros(3))))
    assert tracker.state.registration.misfit is None
    assert len(tracker.step(delivery(3.0, [[35.0, 0.0]], "lidar", LIDAR.pose_on(np.zeros(3))))) == 2


def test_one_sensor_alone_is_never_compared_nor_taken_for_blind():
    tracker = PMBMTracker(site=replace(SITE, sensors=(LIDAR,)))
    given = [one for one in drive() if one.sensor == "lidar"]
    follow(tracker, given[:20])
    follow(tracker, [one.take(np.zeros(len(one), bool)) for one in given[20:]])
    assert tracker.state.registration is None
    assert not tracker.state.blindness


def blinded(deliveries, since, until=math.inf):
    for one in deliveries:
        gone = one.sensor == "radar" and since <= one.time < until
        yield one.take(np.zeros(len(one), bool)) if gone else one


def test_a_sensor_that_goes_blind_costs_what_one_that_falls_silent_does():
    blind, silent = PMBMTracker(site=SITE), PMBMTracker(site=SITE)
    believing = PMBMTracker(PMBMConfig(sensor=TRUSTING), SITE)
    deliveries = list(blinded(drive(), since=1.0))
    with pytest.warns(InputWarning, match="'radar' is taken for blind: .* since 1"):
        reports = follow(blind, deliveries)
    lower = []
    for one, tracks in zip(deliveries, reports, strict=True):
        lower.append(believing.step(one).score.sum() < tracks.score.sum() - 1e-3)
        if len(one):
            without = silent.step(one)
            assert tracks.id.tolist() == without.id.tolist()
            np.testing.assert_allclose(tracks.score, without.score, atol=2e-3)
    assert any(lower)


@pytest.mark.filterwarnings("ignore:at .* is taken for blind")
def test_a_sensor_is_blind_until_it_detects_again():
    tracker = PMBMTracker(site=SITE)
    blind = []
    for one in blinded(drive(), since=1.0, until=2.0):
        tracker.step(one)
        if one.sensor == "radar":
            blind.append((one.time, tracker.state.blindness["radar"].blind))
    assert [time for time, is_blind in blind if is_blind] == [
        time for time, _ in blind if 1.0 <= time < 2.0
    ]


def test_a_blind_sensor_with_nothing_in_view_is_still_blind():
    """Empty deliveries of which nothing else was to be expected are no sign that it sees again."""
    one = Blindness(0.0).after_none(0.1, -20.0)
    for k in range(2, 600):
        one = one.after_none(0.1 * k, 0.0)
    assert one.blind
    assert one.lasts
    assert one.since == 0.1


def test_a_sensor_with_nothing_in_view_is_not_blind():
    """Its empty deliveries say nothing of it."""
    narrow = replace(RADAR, fov_half_angle=0.05, max_range=10.0)
    tracker = PMBMTracker(site=replace(SITE, sensors=(LIDAR, narrow)))
    for one in blinded(drive(), since=0.0):
        tracker.step(one)
    assert tracker.state.blindness["radar"].probability < 0.1
    assert not tracker.state.blindness["radar"].blind


def test_how_probably_a_sensor_is_blind_is_the_forward_recursion_of_a_markov_chain():
    from scipy.linalg import expm

    rates = np.array([[-1 / 100, 1 / 100], [1 / 10, -1 / 10]])
    belief, one, time = np.array([1.0, 0.0]), Blindness(0.0), 0.0
    for dt, chance in ((0.1, 0.2), (0.05, 0.5), (3.0, 1.0), (0.2, 1e-6)):
        time += dt
        belief = belief @ expm(rates * dt) * [chance, 1.0]
        belief /= belief.sum()
        one = one.after_none(time, math.log(chance))
        assert one.probability == pytest.approx(belief[1], rel=1e-9)
    assert one.blind
    assert not one.after_detections(time).blind


def test_the_chance_of_no_detection_is_the_product_over_tracks():
    """By all subsets of objects that exist, of tracks that are sure of where they are."""
    config = PMBMConfig(sensor=Sensor(detection=FixedDetection(probability=0.7)))
    tracker = PMBMTracker(config)
    for k in range(4):
        tracker.step(delivery(0.1 * k, [[10.0, 0.0], [30.0, 5.0], [-20.0, 9.0]]))
    density = tracker.density
    P_D = np.full(len(density.local), 0.7)
    # Every global hypothesis of every cluster, independent between clusters.
    table, r, expected = density.hypotheses, density.local.existence, 0.0
    for cluster in range(table.clusters):
        rows = np.flatnonzero(table.cluster == cluster)
        chance = 0.0
        for row in rows.tolist():
            members = table.member[table.start[row] : table.start[row + 1]]
            chance += np.exp(table.log_weight[row]) * np.prod(1 - 0.7 * r[members])
        expected += np.log(chance)
    assert log_chance_of_none(density, P_D) == pytest.approx(expected, abs=0.02)


@pytest.mark.filterwarnings("ignore:at .* the mounts")
def test_what_is_known_of_mounts_is_saved_with_the_tracker():
    deliveries = list(drive(ELSEWHERE, seed=1))
    tracker = PMBMTracker(site=SITE)
    follow(tracker, deliveries[:30])
    resumed = pickle.loads(pickle.dumps(tracker))
    for one in deliveries[30:40]:
        np.testing.assert_array_equal(resumed.step(one).position, tracker.step(one).position)


def test_time_that_runs_backwards_leaves_the_tracker_as_it_was():
    from pmbm import InputError

    tracker, deliveries = PMBMTracker(site=SITE), list(drive())
    follow(tracker, deliveries[:10])
    before = tracker.state
    with pytest.raises(InputError, match="out of order"):
        tracker.step(deliveries[3])
    assert tracker.state is before
