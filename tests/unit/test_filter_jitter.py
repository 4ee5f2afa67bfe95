"""Rounding decides nothing: inputs that differ in their last digits give the same reports.

On a lattice, and in a symmetric world, many quantities are equal or lie on an edge: covariances
that are round, components midway between two cells, weights, distances, boxes of one front.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from filter_problems import bernoullis

from pmbm import Detections, PMBMConfig, PMBMTracker, Site
from pmbm.filter import BirthMap, estimation
from pmbm.filter.density import Density, Globals, Locals, Marks, Mixture
from pmbm.filter.models.occlusion import Shadows
from pmbm.filter.models.rays import BEARINGS, bearing_of
from pmbm.filter.models.undetected_map import WIDEST, capped, merged_by_cell, narrowed
from pmbm.filter.models.view import View
from pmbm.sim import load_scenario

WALL = np.array([[20, -5], [22, -5], [22, 5], [20, 5]], dtype=float)
ROAD = np.array([[-70, -7], [70, -7], [70, 7], [-70, 7]], dtype=float)
CONFIGS = {"plain": PMBMConfig(), "map": PMBMConfig(birth=BirthMap(spacing=3.5))}


def places(kind, k):
    """Where objects are seen in frame k."""
    t = 0.1 * k
    if kind == "cross":
        return [[-10 + 5 * t, 0], [0, -10 + 5 * t], [10 - 5 * t, 0], [0, 10 - 5 * t]]
    if kind == "ahead":
        return [[60, 0], [75, 0], [0, 50], [-60, 0]][:: 1 + k % 2]
    # One detection midway between two tracks, now and then.
    return [[10, 0]] if k > 9 and k % 3 == 0 else [[10, -1], [10, 1]]


def symmetric(kind, frames):
    size = (0.5, 0.5, 1.7) if kind == "ahead" else (4.0, 2.0, 1.5)
    for k in range(frames):
        z = np.array(places(kind, k), float)
        n = len(z)
        yield Detections(
            time=0.1 * k,
            position=np.column_stack([z, np.zeros(n)]),
            size=np.tile(size, (n, 1)),
            yaw=np.zeros(n),
            score=np.full(n, 0.8),
            label=np.ones(n, np.int8),
        )


def reports(config, site, frames, *, times=1.0, noise=0.0, shift=0.0):
    """What the tracker reports when all times are `times` as long, positions are off by a relative
    `noise`, and the whole world is moved by `shift`, m, along both axes."""
    area = site.drivable_area
    site = replace(
        site,
        occluders=tuple(one + shift for one in site.occluders),
        drivable_area=None if area is None else tuple(one + shift for one in area),
    )
    tracker, rng = PMBMTracker(config, site), np.random.default_rng(1)
    for one in frames:
        position, pose = one.position.copy(), one.sensor_pose.copy()
        position *= 1 + noise * rng.uniform(-1, 1, position.shape)
        position[:, :2] += shift
        pose[:2] += shift
        yield tracker.step(replace(one, time=one.time * times, position=position, sensor_pose=pose))


JITTERS = (
    {"times": 1 + 1e-15},
    {"times": 1 + 1e-12},
    {"times": 1 - 1e-12},
    {"noise": 1e-12},
    {"shift": 1e-9},
)


def moved_by(config, site, frames, jitters=JITTERS):
    """Largest difference of a score or a position that any of these makes; infinite where one adds
    or drops a report or gives it another id."""
    frames = list(frames)
    before, largest = list(reports(config, site, frames)), 0.0
    for jitter in jitters:
        after = reports(config, site, frames, **jitter)
        for one, other in zip(before, after, strict=True):
            if one.id.tolist() != other.id.tolist():
                return np.inf
            apart = one.position[:, :2] + jitter.get("shift", 0.0) - other.position[:, :2]
            for difference in (apart, one.score - other.score):
                largest = max(largest, np.abs(difference).max(initial=0.0))
    return largest


@pytest.mark.parametrize("config", CONFIGS)
@pytest.mark.parametrize("kind", ["cross", "ahead", "between"])
@pytest.mark.parametrize("site", ["wall", "road"])
def test_rounding_decides_nothing_in_a_symmetric_world(site, kind, config):
    sites = {
        "wall": Site(max_range=70.0, occluders=(WALL,)),
        "road": Site(max_range=70.0, fov_half_angle=np.pi / 4, drivable_area=(ROAD,)),
    }
    assert moved_by(CONFIGS[config], sites[site], symmetric(kind, 15), JITTERS[2:]) < 1e-6


SCENARIOS = (
    "crossing",
    "intersection_buildings",
    "long_occlusion",
    "merge",
    "occluded_birth",
    "roundabout",
    "truck_occlusion",
)


@pytest.mark.slow
def test_rounding_decides_nothing_in_the_scenarios(verified):
    for name, config in CONFIGS.items():
        largest = {}
        for scenario in SCENARIOS:
            recording = load_scenario(scenario).record(20_260_101, 0)
            largest[scenario] = moved_by(config, recording.site, recording.detections[:60])
        worst = max(largest, key=largest.__getitem__)
        verified(
            "map_jitter",
            f"{name}: times and positions off by 1e-12 of themselves, the world by 1e-9 m, in "
            f"{len(SCENARIOS)} scenarios of 60 frames: largest difference of a score or a position "
            f"({worst})",
            float(largest[worst]),
            1e-6,
            bool(largest[worst] < 1e-6),
        )
        assert largest[worst] < 1e-6


def round_components(places, weight=1.0, variance=4.2):
    mean = np.zeros((len(places), 4))
    mean[:, :2] = places
    cov = np.diag([variance, variance, 90.0, 90.0])
    cov[0, 2] = cov[2, 0] = cov[1, 3] = cov[3, 1] = 8.0
    log_weight = np.log(np.broadcast_to(weight, len(places)))
    return Mixture(log_weight, mean, np.tile(cov, (len(places), 1, 1)))


def blurred(mixture, seed):
    rng = np.random.default_rng(seed)
    tilt = 1e-13 * rng.normal(size=mixture.cov.shape)
    return Mixture(
        mixture.log_weight + 1e-13 * rng.normal(size=len(mixture)),
        mixture.mean + 1e-13 * rng.normal(size=mixture.mean.shape),
        mixture.cov + tilt + tilt.transpose(0, 2, 1),
    )


@pytest.mark.parametrize("seed", range(4))
def test_ties_on_the_lattice_are_settled_alike(seed):
    """Round covariances have no longest axis; cells, weights and distances have ties."""
    corners = 3.5 * np.stack(np.meshgrid(np.arange(4), np.arange(4)), axis=-1).reshape(-1, 2)
    for change in (
        narrowed,
        lambda m: merged_by_cell(m, 3.5, np.inf),
        lambda m: capped(m, 7),
    ):
        one, other = (
            change(round_components(corners)),
            change(blurred(round_components(corners), seed)),
        )
        np.testing.assert_allclose(other.mean, one.mean, atol=1e-9)
        np.testing.assert_allclose(other.cov, one.cov, atol=1e-9)
        np.testing.assert_allclose(other.log_weight, one.log_weight, atol=1e-9)


@pytest.mark.parametrize("tilt", [0.0, 0.05, 0.3])
def test_parts_of_what_is_nearly_round_have_the_moments_of_the_whole(tilt):
    whole = round_components([[1.0, 2.0]], variance=9.0)
    whole.cov[0, 0, 1] = whole.cov[0, 1, 0] = 9.0 * tilt
    parts = narrowed(whole)
    weight = np.exp(parts.log_weight)
    mean = weight @ parts.mean
    apart = parts.mean - mean
    cov = np.einsum("p,pij->ij", weight, parts.cov + apart[:, :, None] * apart[:, None, :])
    assert mean == pytest.approx(whole.mean[0])
    np.testing.assert_allclose(cov, whole.cov[0], atol=1e-9)
    widest = np.linalg.eigvalsh(parts.cov[:, :2, :2]).max()
    assert np.sqrt(widest) < 1.06 * WIDEST


def test_angles_straight_ahead_and_abeam_are_of_one_bearing():
    angle = np.array([0.0, np.pi / 4, np.pi / 2, np.pi, -np.pi / 2])
    for off in (-1e-12, 1e-12):
        np.testing.assert_array_equal(bearing_of(angle + off), bearing_of(angle))
    assert bearing_of(np.array([-1e-12]))[0] == 0
    assert bearing_of(np.array([-0.01]))[0] == BEARINGS - 2


def test_two_boxes_of_one_front_hide_each_other_neither_way():
    mean = np.zeros((2, 4))
    for off in (-1e-12, 0.0, 1e-12):
        mean[:, :2] = [[20.0, 0.0], [20.0 + off, 1.0]]
        local = Locals(
            track=np.arange(2),
            existence=np.full(2, 0.9),
            mean=mean.copy(),
            cov=np.tile(1e-4 * np.eye(4), (2, 1, 1)),
            box=np.array([[0.0, 4.0, 2.0, 1.5, 0.0]] * 2),
            label=np.zeros(2, np.int8),
            newest=np.zeros(2, np.int64),
            shown=np.zeros(2, bool),
            history=np.zeros((2, 0), np.int32),
            marks=Marks.neutral(2),
            record=np.zeros((2, 0)),
        )
        density = replace(Density.initial(Mixture.empty(), local=local), track_id=np.arange(2))
        shares = Shadows.of(together(density), np.zeros(3)).visible_share(local)
        assert shares == pytest.approx([1.0, 1.0], abs=0.05)


def together(density):
    """One hypothesis: that all of the local ones hold."""
    n = len(density.local)
    table = replace(
        density.hypotheses.one_empty(),
        start=np.array([0, n]),
        member=np.arange(n),
    )
    return replace(density, hypotheses=table)


def test_of_states_as_probable_as_each_other_the_first_is_the_best(assignment_kernel):
    track = np.array([1, 0, 1, 0, 1, 2])
    mass = np.array([0.3, 0.5, 0.3 * (1 + 1e-13), 0.4, 0.2, 0.0])
    apart = np.arange(6)
    assert estimation._likeliest(track, apart, mass, 3, 1e-9).tolist() == [1, 0, 5]


def test_hypotheses_that_agree_on_the_newest_detection_are_weighed_together(assignment_kernel):
    # One took detection 7 (.39); three took 4 (.61 in all), and differ in older steps.
    track = np.zeros(4, np.intp)
    newest = np.array([7, 4, 4, 4])
    mass = np.array([0.39, 0.2, 0.21, 0.2])
    assert estimation._likeliest(track, newest, mass, 1, 1e-9).tolist() == [2]


def test_what_was_shown_last_stays_until_something_is_thirty_times_as_likely(assignment_kernel):
    track = np.zeros(2, np.intp)
    apart = bernoullis(track, np.ones(2), np.zeros((2, 4)), np.tile(np.eye(4), (2, 1, 1)))
    apart = replace(apart, newest=np.array([4, 7]), shown=np.array([True, False]))
    for weights, shown in (([0.04, 0.96], 0), ([0.03, 0.97], 1)):
        table = Globals(
            np.zeros(2, np.intp), np.log(weights), np.arange(3), np.arange(2, dtype=np.intp)
        )
        density = replace(
            Density.initial(Mixture.empty(), local=apart),
            hypotheses=table,
            track_id=np.zeros(1, np.int64),
        )
        everywhere = View(np.zeros(3), 0.0, np.pi, 100.0)
        for marginal in (estimation.marginals(density), estimation.in_view(density, everywhere)[0]):
            assert marginal.best.tolist() == [shown]
            assert marginal.shown_as(density.local).tolist() == [shown == 0, shown == 1]
