"""Several sensors in the filter: order, halves that make a whole, and one that sees nothing."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from filter_problems import KEEP_ALL
from filterpy.kalman import KalmanFilter
from mark_builders import delivery
from scipy.stats import multivariate_normal

from pmbm import Detections, InputError, PMBMConfig, PMBMTracker, Site
from pmbm.filter import (
    BroadBirth,
    FixedDetection,
    IgnoreScores,
    Report,
    Sensor,
    State,
    step,
    tracker,
)
from pmbm.filter.density import BEFORE, MISSED, Mixture
from pmbm.filter.hypotheses.gating import gated_pairs
from pmbm.filter.models.radar import RadarScan, log_clutter_velocity, position_covariance
from pmbm.filter.models.view import View
from pmbm.types import MountedSensor

TINY = Path(__file__).parents[1] / "oracle" / "filter" / "tiny_exact.npz"
REACH = 300.0


def exact(sensors, **changes):
    """Nothing reduced, nothing hidden, one Gaussian of undetected objects."""
    return replace(
        PMBMConfig(
            birth=BroadBirth(components=1, initial=3.0, rate=0.0),
            sensor=Sensor(detection=FixedDetection(probability=0.9), occlusion=False),
            sensors=sensors,
            scores=IgnoreScores(),
            reduction=KEEP_ALL,
            report=Report(exclusive=False, history=12),
        ),
        **changes,
    )


def told(density, names):
    """The density as a set of explanations: each a set of objects with the detections that are
    theirs, by sensor and time, whatever the order in which they were taken in.

    names : of the steps.  A track of its own that no detection made does not exist.
    """
    local, table = density.local, density.hypotheses

    def one(row):
        steps = local.history[row][-len(names) :]
        cell = frozenset(
            (name, int(m))
            for name, m in zip(names, steps, strict=True)
            if m not in (MISSED, BEFORE)
        )
        return cell, (local.existence[row], *local.mean[row], *local.cov[row].ravel())

    found = {}
    for row in range(len(table)):
        members = [one(m) for m in table.member[table.start[row] : table.start[row + 1]].tolist()]
        key = frozenset(cell for cell, _ in members)
        assert key not in found
        found[key] = (math.exp(table.log_weight[row]), dict(members))
    return found


def same(one, other, tolerance):
    # A parent of a weight below 1e-15 has its best child alone: what lacks weighs nothing.
    assert all((one | other)[key][0] < 1e-12 for key in one.keys() ^ other.keys())
    for key in one.keys() & other.keys():
        (weight, objects), (again, others) = one[key], other[key]
        assert weight == pytest.approx(again, rel=tolerance, abs=tolerance)
        for cell, values in objects.items():
            np.testing.assert_allclose(values, others[cell], rtol=tolerance, atol=tolerance)


LIDAR = Sensor(
    position_sd=0.4,
    clutter_rate=3.0,
    detection=FixedDetection(probability=0.9),
    occlusion=False,
)
RADAR = Sensor(
    range_sd=0.2,
    azimuth_sd=0.03,
    clutter_rate=8.0,
    detection=FixedDetection(probability=0.6),
    occlusion=False,
    describes=False,
)


OTHERS = {
    "lidar": replace(LIDAR, position_sd=0.9, clutter_rate=9.0),
    "radar": RADAR,
    "radar with radial velocities": replace(RADAR, radial_velocity_sd=0.3),
}


def in_both_orders(other, seed):
    """What the filter says of two times two deliveries in all orders, nothing pruned: the
    explanations, and the weights of undetected objects."""
    mounted = (
        MountedSensor(name="first", max_range=REACH),
        MountedSensor(name="second", mount=np.array([2.0, -1.0, 0.5]), max_range=REACH),
    )
    site = Site(max_range=REACH, sensors=mounted)
    config = exact({"first": LIDAR, "second": other})
    rng = np.random.default_rng(seed)
    has_velocity = other.radial_velocity_sd is not None
    pose = {one.name: one.pose_on(np.zeros(3)) for one in mounted}
    frames = [
        {
            name: delivery(
                0.5 * k,
                np.array([[20.0 + 2 * k, 5.0], [24.0, -3.0 + k]])[: 2 - k]
                + rng.normal(0, 0.5, (2 - k, 2)),
                name,
                pose[name],
                *((rng.normal(-3, 2, 2 - k), np.array([9.0, -1.0])) if has_velocity else ()),
            )
            for name in ("first", "second")
        }
        for k in range(2)
    ]
    posterior = []
    for orders in (("first", "second"), ("second", "first")):
        state, names = State.initial(config), []
        for k, frame in enumerate(frames):
            # The other way round in the second frame, so that all orders mix.
            for name in orders if k == 0 else orders[::-1]:
                state, _, _ = step(config, site, state, frame[name])
                names.append((name, k))
        posterior.append((told(state.density, names), state.density.undetected.log_weight))
    return posterior


@pytest.mark.parametrize("other", OTHERS.values(), ids=OTHERS)
def test_deliveries_of_one_time_in_any_order_give_the_same_posterior(other):
    """With nothing pruned; a radar has R of its own for each measurement."""
    (one, left), (two, left_again) = in_both_orders(other, 4)
    same(one, two, 1e-9)
    np.testing.assert_allclose(left, left_again, rtol=1e-9)
    assert len(one) > 50


@pytest.mark.slow
def test_no_order_of_deliveries_makes_a_difference(verified):
    worst, numbers = 0.0, 0
    for seed in range(20):
        for other in OTHERS.values():
            (one, _), (two, _) = in_both_orders(other, seed)
            # A parent of a weight below 1e-15 has its best child alone: what lacks weighs nothing.
            lacking = [(one | two)[key][0] for key in one.keys() ^ two.keys()]
            worst = max([worst, *lacking])
            for key in one.keys() & two.keys():
                (weight, objects), (again, others) = one[key], two[key]
                pairs = [((weight,), (again,))]
                pairs += [(values, others[cell]) for cell, values in objects.items()]
                for got, expected in pairs:
                    difference = np.abs(np.subtract(got, expected))
                    worst = max(worst, (difference / (1 + np.abs(expected))).max())
                    numbers += len(got)
    what = (
        f"worst difference of {numbers} numbers of posteriors by the order of two sensors' "
        "deliveries of one time, nothing pruned: two lidars, a lidar and a radar, and the same "
        "with radial velocities, 20 worlds each"
    )
    verified("sensors_order", what, f"{worst:.1e}", 1e-9, bool(worst < 1e-9))
    assert worst < 1e-9


@dataclass(frozen=True)
class _OracleBirth:
    """The reference's births, at two places far apart."""

    first: Mixture
    later: Mixture

    @property
    def place_by_place(self):
        return False

    def births(self, site, view, dt, survival, memory):
        if dt == 0:
            return Mixture.empty(), None
        return (self.first if dt is None else self.later), None

    def joined(self, survivors, births):
        return Mixture.joined(survivors, births)

    def reduced(self, predicted, view, survival, memory, prune):
        return predicted, 0.0

    def thresholds(self, prune):
        return 0.0, 0.0


@dataclass(frozen=True)
class _OracleMotion:
    F: np.ndarray
    Q: np.ndarray

    def transition(self, dt):
        return (np.eye(4), np.zeros((4, 4))) if dt == 0 else (self.F, self.Q)


def oracle_halves():
    """The reference's problem at 5000 m to the left of the origin and as far to the right."""
    given = np.load(TINY)
    order = np.ix_([0, 2, 1, 3], [0, 2, 1, 3])
    halves = (-5000.0, 5000.0)

    def mixture(weight):
        mean = np.concatenate([given["birth_mean"][:, [0, 2, 1, 3]] + [x, 0, 0, 0] for x in halves])
        cov = np.tile(np.stack([one[order] for one in given["birth_cov"]]), (2, 1, 1))
        return Mixture(np.log(np.tile(weight, 2)), mean, cov)

    scans = [[given[f"z{k:02d}"] + [x, 0.0] for x in halves] for k in (1, 2, 3)]
    area = math.pi * 1e8
    config = exact(
        {},
        birth=_OracleBirth(mixture(given["init_w"]), mixture(given["birth_w"])),
        motion=_OracleMotion(given["F"][order], given["Q"][order]),
        # Halves are 10 km apart: nothing is in the gate of the other's.
        reduction=replace(KEEP_ALL, gate=1e5),
        survival=replace(PMBMConfig().survival, probability=float(given["p_S"]), interval=1.0),
        sensor=Sensor(
            position_sd=1.0,
            clutter_rate=float(given["clutter_intensity"]) * area,
            detection=FixedDetection(probability=float(given["p_D"])),
            occlusion=False,
        ),
    )
    half = replace(config.sensor, clutter_rate=config.sensor.clutter_rate / 2)
    return given, scans, replace(config, sensors={"left": half, "right": half})


def test_two_half_blind_sensors_equal_one_that_sees_all():
    """The reference's problem twice, each half seen by one sensor; and each half is the reference's
    own posterior."""
    given, scans, config = oracle_halves()
    whole_site = Site(max_range=10_000.0)
    halves = tuple(
        MountedSensor(
            name=name, mount=np.array([0.0, 0.0, yaw]), fov_half_angle=np.pi / 2, max_range=10_000.0
        )
        for name, yaw in (("left", np.pi), ("right", 0.0))
    )
    site = replace(whole_site, sensors=halves)
    whole, parts = State.initial(config), State.initial(config)
    for k, (left, right) in enumerate(scans):
        whole, _, _ = step(
            config, whole_site, whole, delivery(float(k), np.concatenate([left, right]))
        )
        for one, z in zip(halves, (left, right), strict=True):
            parts, _, _ = step(
                config, site, parts, delivery(float(k), z, one.name, one.pose_on(np.zeros(3)))
            )
    # The reference lists 87 explanations of each half.
    assert len(parts.density.hypotheses) == len(whole.density.hypotheses) == 87**2
    one, other = (
        sorted(
            (
                math.exp(weight),
                round(float(state.density.local.existence[member].sum()), 9),
                *np.round(np.sort(state.density.local.mean[member, 0]), 7),
            )
            for weight, member in zip(
                state.density.hypotheses.log_weight,
                np.split(state.density.hypotheses.member, state.density.hypotheses.start[1:-1]),
                strict=True,
            )
        )
        for state in (whole, parts)
    )
    # Compared as sets: in order of what they say, weights last.
    one, other = (sorted(rows, key=lambda row: (*row[1:], row[0])) for rows in (one, other))
    np.testing.assert_allclose(
        [row[0] for row in one], [row[0] for row in other], rtol=1e-9, atol=1e-15
    )
    assert [row[1:] for row in one] == [row[1:] for row in other]
    undetected = [np.sort(np.exp(state.density.undetected.log_weight)) for state in (whole, parts)]
    np.testing.assert_allclose(undetected[0], undetected[1], rtol=1e-9)
    reference = np.sort(np.tile(given["upd03_ppp_w"], 2))
    np.testing.assert_allclose(undetected[1], reference, rtol=1e-9)
    weight = np.exp(parts.density.hypotheses.log_weight)
    pair = np.sort(np.multiply.outer(given["upd03_glob_w"], given["upd03_glob_w"]).ravel())
    np.testing.assert_allclose(np.sort(weight), pair, rtol=1e-8, atol=1e-14)


def crossing_pair(seed=3, frames=30):
    """Two objects that come into view one after the other, with misses and clutter."""
    rng = np.random.default_rng(seed)
    for k in range(frames):
        time = 0.1 * k
        places = [(-20 + 8 * time, 3.0)]
        if k >= 8:
            places.append((15 - 6 * time, -4.0))
        seen = [np.add(p, rng.normal(0, 0.3, 2)) for p in places if rng.random() < 0.9]
        seen += list(rng.uniform(-60, 60, (rng.poisson(2), 2)))
        yield delivery(time, seen)


@pytest.mark.parametrize("native", [True, False])
def test_a_sensor_that_sees_nothing_changes_nothing(native, monkeypatch):
    """Neither what exists, nor when it is first reported."""
    if not native:
        monkeypatch.setattr(tracker.kernels, "native", None)
    blind = Sensor(detection=FixedDetection(probability=1e-9), clutter_rate=1e-6)
    mounted = (MountedSensor(name="eye", max_range=100.0), MountedSensor(name="blind"))
    config = PMBMConfig(sensors={"blind": blind})
    alone = PMBMTracker()
    both = PMBMTracker(config, Site(sensors=mounted))
    reported = 0
    for frame in crossing_pair():
        one = alone.step(frame)
        both.step(Detections.empty(frame.time, sensor="blind"))
        both.step(replace(frame, sensor="eye"))
        two = both.step(Detections.empty(frame.time, sensor="blind"))
        assert one.id.tolist() == two.id.tolist()
        np.testing.assert_allclose(one.score, two.score, atol=1e-6)
        np.testing.assert_allclose(one.position, two.position, atol=1e-6)
        reported += len(one)
    assert reported > 40


def test_a_sensor_that_sees_nothing_in_between_delays_nothing():
    """Its deliveries come at times of their own, so that motion and births are taken in more
    steps."""
    blind = Sensor(detection=FixedDetection(probability=1e-9), clutter_rate=1e-6)
    config = PMBMConfig(sensors={"blind": blind})
    site = Site(sensors=(MountedSensor(name="eye"), MountedSensor(name="blind")))
    alone, both = PMBMTracker(), PMBMTracker(config, site)
    for frame in crossing_pair():
        one, two = alone.step(frame), both.step(replace(frame, sensor="eye"))
        assert one.id.tolist() == two.id.tolist()
        np.testing.assert_allclose(one.score, two.score, atol=2e-3)
        both.step(Detections.empty(frame.time + 0.03, sensor="blind"))


def test_what_a_sensor_cannot_see_it_does_not_sweep_out():
    """Undetected objects behind stay if a sensor looks ahead, and go if it looks all round."""
    config = PMBMConfig(birth=BroadBirth(components=40, rate=0.0, initial=10.0))
    ahead = MountedSensor(name="ahead", fov_half_angle=np.pi / 2)
    square = [[-80, -50], [-30, -50], [-30, 50], [-80, 50]]
    left = {}
    for name, site in (("all", Site()), ("ahead", Site(sensors=(ahead,)))):
        one = PMBMTracker(config, site)
        for k in range(5):
            tracks = one.step(Detections.empty(0.1 * k, sensor="ahead" if site.sensors else ""))
        left[name] = tracks.undetected.expected_count(square)
    view = View.of(Site(), np.zeros(3))
    born, _ = config.birth.births(Site(), view, None, config.survival, None)
    before = born.public().expected_count(square)
    assert left["all"] < 0.01 * before
    assert left["ahead"] == pytest.approx(before, rel=0.1)


@pytest.mark.parametrize("birth", ["broad", "map"])
def test_an_object_that_one_sensor_alone_can_see_is_found_at_once(birth):
    """Though most of the broad births lie where that sensor does not look."""
    from pmbm.filter import BirthMap

    narrow = MountedSensor(name="narrow", fov_half_angle=0.2, max_range=60.0)
    config = PMBMConfig() if birth == "broad" else PMBMConfig(birth=BirthMap())
    share = 0.2 * 60.0**2 / (np.pi * 100.0**2)
    # As much clutter a square metre.
    of_narrow = replace(config, sensors={"narrow": Sensor(clutter_rate=5.0 * share)})
    both = {}
    for name, one in (
        ("narrow", PMBMTracker(of_narrow, Site(sensors=(narrow,)))),
        ("", PMBMTracker(config)),
    ):
        found = [len(one.step(delivery(0.1 * k, [[40.0 + k, 1.0]], name))) for k in range(6)]
        both[name] = found.index(1)
    assert both["narrow"] <= both[""]


def test_the_covariance_of_a_radar_lies_along_its_line_of_sight():
    """Against samples of range and azimuth."""
    sensor = Sensor(range_sd=0.2, azimuth_sd=0.01)
    frame = delivery(0.0, [[30.0, 40.0]], pose=(0.0, 0.0, 1.0))
    (R,) = position_covariance(sensor, frame)
    rng = np.random.default_rng(0)
    r, a = 50 + rng.normal(0, 0.2, 200_000), np.arctan2(40, 30) + rng.normal(0, 0.01, 200_000)
    sampled = np.cov(r * np.cos(a), r * np.sin(a))
    np.testing.assert_allclose(R, sampled, rtol=0.03)


def test_position_and_radial_velocity_are_one_measurement_of_three_components():
    """The update and its weight against filterpy's, of a velocity along the line of sight."""
    mean = np.array([20.0, 12.0, -4.0, 6.0])
    cov = np.diag([0.5, 0.4, 3.0, 2.0]) + 0.1
    velocity, place = np.array([9.0, -1.0]), np.array([1.0, 2.0])
    z, radial = np.array([20.3, 11.8]), -7.0
    sensor = Sensor(range_sd=0.2, azimuth_sd=0.01, radial_velocity_sd=0.15)
    frame = delivery(0.0, [z], pose=(*place, 0.3), radial=np.array([radial]), velocity=velocity)
    radar = RadarScan.of(sensor, frame)
    pairs = gated_pairs(mean[None], cov[None], np.zeros(1), z[None], radar.R, 100.0, radar)

    sight = (z - place) / np.hypot(*(z - place))
    across = sight[0] * velocity[1] - sight[1] * velocity[0]
    kalman = KalmanFilter(dim_x=4, dim_z=3)
    kalman.x, kalman.P = mean.copy(), cov.copy()
    kalman.H = np.eye(3, 4)
    kalman.H[2] = [0, 0, *sight]
    kalman.R = np.zeros((3, 3))
    kalman.R[:2, :2] = radar.R[0]
    kalman.R[2, 2] = 0.15**2 + (0.01 * across) ** 2
    kalman.update(np.array([*z, radial + sight @ velocity]))
    np.testing.assert_allclose(pairs.mean[0], kalman.x, rtol=1e-9)
    np.testing.assert_allclose(pairs.cov[0], kalman.P, rtol=1e-9, atol=1e-12)
    assert pairs.log_weight[0] == pytest.approx(kalman.log_likelihood, abs=1e-9)
    # Clutter: over the ground, along the line of sight, normal.
    expected = multivariate_normal.logpdf(radial + sight @ velocity, 0.0, 25.0 + 0.15**2)
    assert log_clutter_velocity(sensor, frame)[0] == pytest.approx(expected)


def test_a_radial_velocity_is_as_sure_as_the_radar_says():
    """Of objects whose place is measured and whose velocity is known but along the line of sight,
    normalised errors have unit variance: the error of the bearing, which turns the line of sight,
    is accounted for where the radar's own motion is most of what moves."""
    rng = np.random.default_rng(1)
    n, sensor = 4000, Sensor(range_sd=0.3, azimuth_sd=0.03, radial_velocity_sd=0.1)
    bearing = rng.uniform(-np.pi, np.pi, n)
    true_sight = np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    velocity = np.array([20.0, 0.0])
    place = (30.0 + rng.normal(0, 0.3, n))[:, None] * np.stack(
        [np.cos(found := bearing + rng.normal(0, 0.03, n)), np.sin(found)], axis=1
    )
    radial = -true_sight @ velocity + rng.normal(0, 0.1, n)
    radar = RadarScan.of(sensor, delivery(0.0, place, radial=radial, velocity=velocity))
    normalised = radar.radial_speed / np.sqrt(radar.radial_variance)
    assert normalised.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * n))


def test_a_radar_without_its_own_noise_is_a_lidar():
    """Where R is the same for all measurements, and radial velocities say next to nothing."""
    lidar = PMBMTracker(PMBMConfig(sensor=Sensor(position_sd=0.5)))
    radar = PMBMTracker(PMBMConfig(sensor=Sensor(position_sd=0.5, radial_velocity_sd=1e6,
                                                 clutter_speed_sd=1e-3)))  # fmt: skip
    for frame in crossing_pair():
        n = len(frame)
        one = lidar.step(frame)
        two = radar.step(replace(frame, radial_velocity=np.zeros(n), sensor_velocity=np.zeros(2)))
        assert one.id.tolist() == two.id.tolist()
        np.testing.assert_allclose(one.score, two.score, atol=1e-6)
        np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-6, atol=1e-7)


def test_a_radar_leaves_box_and_label_to_others():
    site = Site(sensors=(MountedSensor(name="lidar"), MountedSensor(name="radar")))
    one = PMBMTracker(PMBMConfig(sensors={"radar": replace(RADAR, clutter_rate=1.0)}), site)
    for k in range(5):
        one.step(delivery(0.1 * k, [[20.0, 0.0]], "lidar"))
        seen = delivery(0.1 * k, [[20.0, 0.0]], "radar")
        tracks = one.step(
            replace(seen, label=np.full(1, 6, np.int8), size=np.full((1, 3), 9.0), yaw=np.ones(1))
        )
    assert tracks.label.tolist() == [0]
    np.testing.assert_allclose(tracks.size, [[4.0, 2.0, 1.5]])
    np.testing.assert_allclose(tracks.yaw, 0.0)


def test_scores_of_a_sensor_are_read_by_its_own_model():
    site = Site(sensors=(MountedSensor(name="a"), MountedSensor(name="b")))
    deaf = PMBMConfig(sensors={"b": Sensor(scores=IgnoreScores())})
    same_words = PMBMConfig()
    found = []
    for config in (deaf, same_words):
        one = PMBMTracker(config, site)
        for k in range(3):
            frame = delivery(0.1 * k, [[20.0, 0.0]], "b")
            one.step(replace(frame, score=np.full(1, 0.05)))
        found.append(one.inspect().object)
    assert found[0][0] > found[1][0]


def test_names_that_are_none_of_the_site_are_refused():
    site = Site(sensors=(MountedSensor(name="radar"), MountedSensor(name="lidar")))
    with pytest.raises(InputError, match="radar") as error:
        PMBMTracker(PMBMConfig(sensors={"rader": Sensor()}), site)
    assert "'radar'" in str(error.value)
    one = PMBMTracker(PMBMConfig(), site)
    with pytest.raises(InputError, match="no sensor 'lidr'"):
        one.step(Detections.empty(0.0, sensor="lidr"))
    with pytest.raises(InputError, match="no sensor ''"):
        one.step(Detections.empty(0.0))
    with pytest.raises(InputError, match=r"names no sensors .*sensor\.KEY"):
        PMBMTracker(PMBMConfig(sensors={"radar": Sensor()}))


def test_a_configuration_names_its_sensors_in_tables_and_by_dotted_names():
    from pmbm.study.configured import ConfiguredTracker

    table = {"radar": {"range_sd": 0.2, "azimuth_sd": 0.01, "scores": {"kind": "ignore"}}}
    made = ConfiguredTracker("pmbm", (("sensors", table), ("sensors.radar.gate", 12.0)))
    config = made(Site(sensors=(MountedSensor(name="radar"),))).config
    expected = Sensor(range_sd=0.2, azimuth_sd=0.01, scores=IgnoreScores(), gate=12.0)
    assert config.sensors == {"radar": expected}
    assert config.changed({"sensors.radar.clutter_rate": 7}).sensors["radar"].clutter_rate == 7
    assert config.changed({"sensors.lidar.position_sd": 0.2}).sensors["lidar"].position_sd == 0.2
    for given, field in (
        ({"radar": {"range_sd": 0.2}}, "sensors.radar.azimuth_sd"),
        ({"radar": {"rang_sd": 0.2}}, "sensors.radar.rang_sd"),
    ):
        with pytest.raises(InputError) as error:
            ConfiguredTracker("pmbm", (("sensors", given),))(Site())
        assert error.value.field == field
