"""The map of undetected objects: its lattice, its shadows, and what bounds it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from unseen_world import (
    DT,
    SHADOW,
    SITE,
    WALL,
    births,
    hidden_share,
    model,
    reference,
    tracked,
)

from pmbm import Detections, InputError, Site
from pmbm.filter import BirthMap, BroadBirth, PMBMConfig, PMBMTracker
from pmbm.filter.density import Density, Mixture
from pmbm.filter.models.occlusion import Shadows
from pmbm.filter.models.undetected_map import WIDEST, MapCells, beyond
from pmbm.filter.models.view import View
from pmbm.filter.tracker import observe
from pmbm.geometry import points_in_polygon
from pmbm.sim import load_scenario
from pmbm.tracking import run

LIT = np.array([[-25, -25], [-5, -25], [-5, 25], [-25, 25]], dtype=float)


def at(x=0.0, y=0.0, yaw=0.0, site=SITE):
    return View.of(site, np.array([x, y, yaw]))


def test_the_count_in_a_shadow_is_that_of_particles():
    """Seconds behind a static wall: free flight, births, deaths and looks, object by object."""
    config = model()
    initial, born = births(config)
    frames = 31
    _, reports = tracked(config, frames)
    state, weight = reference(config, initial, born, frames, np.random.default_rng(0))
    inside = points_in_polygon(state[:, :2], SHADOW)
    want = weight[inside].sum()
    # The standard error of the reference is a small part of what is allowed.
    assert np.sqrt((weight[inside] ** 2).sum()) < 0.01 * want
    assert reports[-1].undetected.expected_count(SHADOW) == pytest.approx(want, rel=0.05)


@pytest.mark.parametrize("detection", [0.9, 0.6, 0.3])
def test_without_the_map_the_count_in_view_is_that_of_particles(detection):
    """Births of seven broad Gaussians that reach over the edge of the view."""
    birth = BroadBirth(rate=6.0, initial=20.0)
    config = model(**{"birth": birth, "sensor.detection.probability": detection})
    site = Site(max_range=52.0)
    frames, turn = 16, np.linspace(0, 2 * np.pi, 128, endpoint=False)
    tracker, reports = tracked(config, frames, site)

    def sees(config, x, y):
        return config.sensor.detection.probability * (np.hypot(x, y) <= site.max_range)

    state, weight = reference(
        config,
        *births(config, site),
        frames,
        np.random.default_rng(4),
        each=20_000,
        sees=sees,
        within=site.max_range,
    )
    inside = np.hypot(*state[:, :2].T) <= site.max_range
    want = weight[inside].sum()
    assert np.sqrt((weight[inside] ** 2).sum()) < 0.01 * want
    assert tracker.inspect().expected_undetected == pytest.approx(want, rel=0.05)
    circle = site.max_range * np.column_stack([np.cos(turn), np.sin(turn)])
    assert reports[-1].undetected.expected_count(circle) == pytest.approx(want, rel=0.05)


def test_what_is_seen_is_swept_out_and_what_is_hidden_stays():
    config = model()
    _, born = births(config)
    _, reports = tracked(config, 30)
    first, last = reports[0].undetected, reports[-1].undetected
    level = born.public().expected_count(LIT)
    # In plain view only what was born or has come in since the last look is left.
    missed = 1 - config.sensor.detection.probability
    assert last.expected_count(LIT) < 1.5 * level * missed * 2
    assert last.expected_count(LIT) > 0.5 * level * missed
    assert last.expected_count(SHADOW) > 0.4 * first.expected_count(SHADOW)
    dark, bright = last.intensity([[25.0, 0.0], [-25.0, 0.0]])
    assert dark > 50 * bright
    _, constant = tracked(model(**{"sensor.occlusion": False}), 30)
    assert constant[-1].undetected.expected_count(SHADOW) < 0.1 * last.expected_count(SHADOW)


def test_births_are_flat_inside_and_denser_at_the_edge():
    site = Site(max_range=60.0)
    config = model(**{"birth.rate": 2.0})
    initial, born = births(config, site)
    assert np.exp(initial.log_weight).sum() == pytest.approx(config.birth.initial)
    assert np.exp(born.log_weight).sum() == pytest.approx(2.0 * DT, rel=0.01)
    grid = np.stack(np.meshgrid(*2 * [np.linspace(-30, 30, 61)]), axis=-1).reshape(-1, 2)
    for mixture in (initial, born):
        flat = mixture.public().intensity(grid)
        assert flat.max() / flat.min() < 1.08
    middle, edge = born.public().intensity([[0.0, 0.0], [56.5, 0.0]])
    assert edge > 3 * middle
    assert np.sqrt(np.linalg.eigvalsh(born.cov[:, :2, :2])).max() <= WIDEST


def test_nothing_is_born_off_the_drivable_area():
    road = np.array([[-200, -6], [200, -6], [200, 6], [-200, 6]], dtype=float)
    site = Site(max_range=60.0, drivable_area=(road,))
    initial, born = births(model(), site)
    for mixture in (initial, born):
        assert (np.abs(mixture.mean[:, 1]) < 6).all()
        assert np.exp(mixture.log_weight).sum() == pytest.approx(
            20.0 if mixture is initial else 0.6, rel=0.01
        )
    assert len(initial) < 200


def test_ground_that_comes_into_view_holds_what_it_held_at_first():
    """The density of a map made later is that of the first, where neither was looked at before."""
    spacing, site = 3.5, Site(max_range=40.0)
    here = MapCells.of(site, at(site=site), spacing)
    there = MapCells.of(site, at(x=7.0, site=site), spacing, here)
    new = there.newly_covered(here)
    assert here.newly_covered(None).sum() == pytest.approx(1)
    assert new.sum() == pytest.approx(there.share[new > 0].sum() / there.share.sum())
    assert 0.05 < new.sum() < 0.2
    assert (there.centre[new > 0, 0] > 0).all()
    assert (there.newly_covered(there) == 0).all()
    fresh = MapCells.of(site, at(x=7.0, site=site), spacing)
    np.testing.assert_array_equal(fresh.centre, there.centre)


def test_cells_keep_their_place_in_the_world_and_their_drivable_part():
    road = np.array([[-200, -5], [200, -5], [200, 6.3], [-200, 6.3]], dtype=float)
    site = Site(max_range=40.0, drivable_area=(road,))
    known = MapCells.of(site, at(site=site), 3.5)
    for x, yaw in [(0.9, 0.1), (8.0, -1.0), (300.0, 2.0)]:
        fresh = MapCells.of(site, at(x, yaw=yaw, site=site), 3.5)
        known = MapCells.of(site, at(x, yaw=yaw, site=site), 3.5, known)
        for name in ("code", "centre", "share", "edge"):
            np.testing.assert_array_equal(getattr(fresh, name), getattr(known, name))
    assert np.diff(known.code).min() > 0


def test_the_distance_from_the_edge_of_a_sector():
    site = Site(max_range=10.0, fov_half_angle=np.pi / 4, fov_centre=np.pi / 2)
    places = np.array([[0, 9], [0, 12], [5, 0], [0, -5], [3, 3], [-1, 3]], dtype=float)
    root = np.sqrt(2)
    want = [-1, 2, 5 / root, 5, 0, -1 * root]
    assert beyond(at(site=site), places) == pytest.approx(want, abs=1e-9)


@pytest.mark.parametrize("place", [(25.0, 0.0), (16.0, 11.5), (30.0, -22.0), (11.0, 0.0)])
def test_the_visible_share_of_an_undetected_object_is_that_of_samples(place):
    """Averaged over where it may stand and over a car's extent."""
    rng = np.random.default_rng(5)
    root = np.array([[1.2, 0.0], [0.5, 0.9]])
    mean, cov = np.zeros((1, 4)), np.eye(4)[None].copy()
    mean[0, :2], cov[0, :2, :2] = place, root @ root.T
    shadows = Shadows.of(Density.initial(Mixture.empty()), np.zeros(3), (WALL,))
    got = shadows.undetected(mean, cov)
    samples = rng.multivariate_normal(mean[0, :2], cov[0, :2, :2], 20_000)
    hidden = hidden_share(*samples.T)
    assert got.share()[0] == pytest.approx(1 - hidden.mean(), abs=0.06)
    after, spread = got.if_missed(mean, cov, np.array([0.9]))
    weight = 1 - 0.9 * (1 - hidden)
    np.testing.assert_allclose(after[0, :2], np.average(samples, axis=0, weights=weight), atol=0.15)
    np.testing.assert_allclose(spread[0, :2, :2], np.cov(samples.T, aweights=weight), atol=0.35)


def test_a_miss_in_the_open_changes_no_shape():
    shadows = Shadows.of(Density.initial(Mixture.empty()), np.zeros(3), (WALL,))
    rng = np.random.default_rng(6)
    root = rng.normal(size=(4, 4, 4))
    cov, mean = root @ root.transpose(0, 2, 1), np.array([[-20.0, 3, 1, 2]] * 4)
    glimpse = shadows.undetected(mean, cov)
    assert glimpse.share() == pytest.approx(np.ones(4))
    after = glimpse.if_missed(mean, cov, np.full(4, 0.9))
    np.testing.assert_allclose(after[0], mean, atol=1e-9)
    np.testing.assert_allclose(after[1], cov, atol=1e-9)


def test_an_object_that_shows_at_the_edge_of_the_shadow_is_believed_sooner():
    """What was preserved behind the wall makes its first detection believable."""
    existence = []
    for birth in (BroadBirth(rate=6.0, initial=20.0), BirthMap(rate=6.0, initial=20.0)):
        tracker, _ = tracked(model(birth=birth, **{"sensor.clutter_rate": 10.0}), 20)
        seen = Detections(
            time=2.0,
            position=[[20.0, 14.0, 0.8]],
            size=[[4.5, 1.9, 1.6]],
            yaw=[0.0],
            score=[0.9],
            label=np.array([1], np.int8),
        )
        tracker.step(seen)
        existence.append(tracker.density.local.existence[-1])
    assert existence[1] > 1.3 * existence[0]


@pytest.mark.slow
def test_components_stay_few_and_narrow_over_a_long_drive():
    """A truck scene of 300 frames, with the sensor moving and tracks coming and going."""
    recording = load_scenario("truck_occlusion").record(0, 0)
    tracker = PMBMTracker(PMBMConfig(birth=BirthMap()), recording.site)
    sizes, mass = [], []
    for report in run(tracker, recording):
        sizes.append(len(report.undetected))
        mass.append(np.exp(report.undetected.log_weight).sum())
    for step in itertools.count():  # On past the end, with nothing to see.
        if len(sizes) >= 300:
            break
        pose = recording.detections[-1].sensor_pose
        time = recording.detections[-1].time + DT * (step + 1)
        sizes.append(len(tracker.step(Detections.empty(time, pose)).undetected))
    # A forgotten track that may be anywhere is spread over the whole map for a moment.
    assert max(sizes) < BirthMap().max_components == 4000
    assert np.quantile(sizes, 0.95) < 1200
    assert np.mean(sizes[250:]) < 1.2 * np.mean(sizes[:200])
    assert max(mass) < 2


def test_components_stay_bounded_without_a_map():
    tracker, reports = tracked(PMBMConfig(birth=BirthMap()), 12, Site(max_range=80.0))
    assert max(len(report.undetected) for report in reports) <= BirthMap().max_components
    assert tracker.trace.removed.undetected_dropped >= 0


@pytest.mark.parametrize("value", [0.0, -1.0, 0.9, 4.1, "3.5", True, np.nan])
def test_a_spacing_that_is_none_is_refused(value):
    with pytest.raises(InputError, match="spacing"):
        BirthMap(spacing=value)


def test_without_the_option_nothing_is_touched():
    """Neither what is hidden nor what is settled: the very arrays go through."""
    tracker, reports = tracked(PMBMConfig(), 3)
    assert len(reports[-1].undetected) == PMBMConfig().birth.components
    config, density = tracker.config, tracker.density
    reduced, dropped = config.birth.reduced(
        density.undetected, at(), config.survival, tracker.state.births, 1e-5
    )
    assert reduced is density.undetected
    assert dropped == 0
    sensor = observe(config, tracker.site, tracker.trace.frame, density)
    mean, cov = density.undetected.mean, density.undetected.cov
    if_missed, if_seen, shape = sensor.of_undetected(mean, cov)
    assert if_seen is if_missed
    assert shape[0] is mean
    assert shape[1] is cov
    np.testing.assert_array_equal(if_missed, np.full(len(mean), sensor.detection.of_undetected()))


CELL = 0.5


@pytest.mark.parametrize("speed", [0.0, 4.0])
def test_the_count_in_a_shadow_is_that_of_a_grid(speed):
    """Undetected objects that stand still, cell by cell of half a metre: born, dying, looked at;
    behind a wall that stands and behind one that moves, which sweeps ground out and hides other."""
    config = model(**{"birth.speed_sd": 0.05, "motion.acceleration_density": 0.01})
    tracker = PMBMTracker(config, SITE)
    initial, born = births(config)
    side = np.arange(8.0, 44.0, CELL) + CELL / 2, np.arange(-44.0, 44.0, CELL) + CELL / 2
    grid = np.stack(np.meshgrid(*side), axis=-1).reshape(-1, 2)
    area, survives = CELL**2, config.survival.over(DT)
    each_frame = born.public().intensity(grid) * area
    in_view = np.hypot(*grid.T) <= SITE.max_range
    count = initial.public().intensity(grid) * area / survives - each_frame / survives
    for frame in range(31):
        wall = WALL + np.array([0.0, speed * DT * frame])
        tracker.site = replace(SITE, occluders=(wall,))
        report = tracker.step(Detections.empty(time=DT * frame))
        seen = (
            config.sensor.detection.probability * in_view * (1 - hidden_share(*grid.T, wall=wall))
        )
        count = (survives * count + each_frame) * (1 - seen)
    low, high = wall[:, 1].min() / 12, wall[:, 1].max() / 12
    shadow = np.array([[14, 14 * low], [30, 30 * low], [30, 30 * high], [14, 14 * high]])
    want = count[points_in_polygon(grid, shadow)].sum()
    assert report.undetected.expected_count(shadow) == pytest.approx(want, rel=0.05)
