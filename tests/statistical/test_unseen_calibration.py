"""S6: the number of objects expected behind a wall, against how many are there."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pmbm import Detections, Site
from pmbm.filter import BroadBirth, PMBMTracker
from pmbm.filter.models.view import View
from pmbm.geometry import points_in_polygon

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
from unseen_world import DT, SHADOW, SITE, WALL, births, draw, hidden_share, model, moved

FRAMES = 30
REPORTING = range(20_000_000, 20_000_120)
"""Worlds that nothing was chosen on; the models that are wrong are shown the first half."""
LOOKS = (9, 19, 29)
CROWDED = {
    "birth.initial": 90.0,
    "birth.rate": 27.0,
    "sensor.clutter_rate": 2.0,
    "reduction.max_hypotheses": 20,
}
PLACES = {
    "shadow": SHADOW,
    "near half of the shadow": np.array([[13, -9.75], [26, -19.5], [26, 19.5], [13, 9.75]]),
    "far half of the shadow": np.array([[26, -19.5], [39, -29.25], [39, 29.25], [26, 19.5]]),
}


def some(mixture, rng):
    """A Poisson number of objects of this intensity."""
    return draw(mixture, rng.poisson(np.exp(mixture.log_weight).sum()), rng)[0]


def lives(config, seed, site, seen_share, *, in_view_alone=False):
    """Objects of the model, frame by frame, looked at by the model's sensor: states (N,4), whether
    each was detected so far (N,), and the positions (M,2) that the frame shows.

    seen_share : of P_D, by frame, x and y.  in_view_alone : whether births that lie beyond the
    sensor's range are no objects.
    """
    rng = np.random.default_rng([6, seed])
    initial, born = births(config, site)

    def appeared(mixture):
        state = some(mixture, rng)
        return state[np.hypot(*state[:, :2].T) <= site.max_range] if in_view_alone else state

    state = appeared(initial)
    known = np.zeros(len(state), bool)
    for frame in range(FRAMES):
        if frame:
            alive = rng.random(len(state)) < config.survival.over(DT)
            state, known = moved(state[alive], DT, config, rng), known[alive]
            new = appeared(born)
            state = np.concatenate([state, new])
            known = np.concatenate([known, np.zeros(len(new), bool)])
        share = seen_share(frame, *state[:, :2].T)
        seen = rng.random(len(state)) < config.sensor.detection.probability * share
        known = known | seen
        z = state[seen, :2] + rng.normal(0, config.sensor.position_sd, (int(seen.sum()), 2))
        yield state, known, np.concatenate([z, draw_clutter(config, site, rng)])


def world(config, seed, *, believed=None, wall_speed=0.0):
    """Per look and region, how many objects were expected that no detection has shown, and how many
    there were.

    believed : what the tracker takes the model to be, where that is another.  wall_speed : of the
    wall along itself, m/s, and of the regions behind it, which the tracker is told.
    """
    tracker = PMBMTracker(believed or config, SITE)

    def moved_by(frame):
        return wall_speed * DT * (frame - FRAMES // 2)

    def wall(frame):
        return WALL + np.array([0.0, moved_by(frame)])

    def seen_share(frame, x, y):
        return in_range(SITE, x, y) * (1 - hidden_share(x, y, wall=wall(frame)))

    counts = []
    for frame, (state, known, z) in enumerate(lives(config, seed, SITE, seen_share)):
        tracker.site = replace(SITE, occluders=(wall(frame),))
        report = tracker.step(detections(DT * frame, z))
        if frame in LOOKS:
            for place in PLACES.values():
                # The shadow's edges are straight lines from the sensor, so it moves with its range.
                slope = np.outer(place[:, 0] / WALL[:, 0].mean(), [0.0, moved_by(frame)])
                inside = points_in_polygon(state[:, :2], place + slope)
                counts.append(
                    (report.undetected.expected_count(place + slope), int((inside & ~known).sum()))
                )
    return np.array(counts).reshape(len(LOOKS), len(PLACES), 2)


def in_range(site, x, y):
    return np.hypot(x, y) <= site.max_range


def draw_clutter(config, site, rng):
    n = rng.poisson(config.sensor.clutter_rate)
    radius, turn = site.max_range * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
    return np.column_stack([radius * np.cos(turn), radius * np.sin(turn)])


def detections(time, z):
    """Boxes too small to hide anything: the wall alone does."""
    n = len(z)
    return Detections(
        time=time,
        position=np.column_stack([z, np.zeros(n)]),
        size=np.full((n, 3), 0.02),
        yaw=np.zeros(n),
        score=np.full(n, 0.9),
        label=np.ones(n, np.int8),
    )


@pytest.mark.slow
def test_the_expected_number_of_hidden_objects_is_calibrated(verified):
    config = model(**CROWDED)
    counts = np.array([world(config, seed) for seed in REPORTING])
    within = []
    for part, name in enumerate(PLACES):
        expected, there = counts[:, -1, part].T
        # Those that are there are Poisson distributed around what is expected, seed by seed.
        low, high = stats.poisson.interval(0.99, expected.sum())
        ok = bool(low <= there.sum() <= high)
        within.append(ok)
        verified(
            "S6",
            f"objects in the {name} of a static wall after {DT * LOOKS[-1]:.1f} s, of "
            f"{len(REPORTING)} worlds: true count (expected {expected.sum():.1f})",
            int(there.sum()),
            [float(low), float(high)],
            ok,
        )
    each = counts[:, :, 0].mean(axis=1)
    gap = each[:, 1] - each[:, 0]
    band = stats.t.ppf(0.995, len(gap) - 1) * gap.std(ddof=1) / np.sqrt(len(gap))
    within.append(bool(abs(gap.mean()) <= band))
    verified(
        "S6",
        f"objects hidden in the shadow of a static wall, mean over {len(LOOKS)} looks and "
        f"{len(gap)} worlds: true minus expected",
        float(gap.mean()),
        [-float(band), float(band)],
        within[-1],
    )
    # Counts are neither wider nor narrower than Poisson: chi-square over the seeds.
    expected, there = counts[:, -1, 0].T
    dispersion = ((there - expected) ** 2 / expected).sum()
    low, high = stats.chi2.interval(0.99, len(there))
    verified(
        "S6",
        "dispersion of hidden counts over worlds",
        float(dispersion),
        [float(low), float(high)],
        bool(low <= dispersion <= high),
    )
    assert low <= dispersion <= high
    assert all(within)


@pytest.mark.slow
@pytest.mark.parametrize(("detection", "clutter"), [(0.9, 2.0), (0.6, 20.0)])
def test_the_expected_number_of_undetected_objects_in_view_is_calibrated(
    detection, clutter, verified
):
    """Without the map: births of seven broad Gaussians that reach over the edge of the view, and
    tracks that were given up, which are not among those never detected."""
    config = model(
        **{
            **CROWDED,
            "birth": BroadBirth(rate=27.0, initial=90.0),
            "sensor.clutter_rate": clutter,
            "sensor.detection.probability": detection,
        }
    )
    site = Site(max_range=SITE.max_range)

    def seen_share(frame, x, y):
        return in_range(site, x, y)

    counts = []
    for seed in REPORTING:
        tracker = PMBMTracker(config, site)
        scene = lives(config, seed, site, seen_share, in_view_alone=True)
        for frame, (state, known, z) in enumerate(scene):
            tracker.step(detections(DT * frame, z))
            if frame in LOOKS:
                there = in_range(site, *state[:, :2].T) & ~known
                counts.append((tracker.inspect().expected_undetected, int(there.sum())))
    expected, there = np.sum(counts, axis=0)
    low, high = stats.poisson.interval(0.99, expected)
    ok = bool(low <= there <= high)
    verified(
        "undetected_edge",
        f"objects in view that were never detected, P_D {detection}, {clutter:g} false detections "
        f"a frame, {len(LOOKS)} looks at {len(REPORTING)} worlds: true count (expected "
        f"{expected:.1f})",
        int(there),
        [float(low), float(high)],
        ok,
    )
    assert ok


DENSE_SITE = Site(max_range=30.0)
DENSE = {
    "birth": BroadBirth(rate=3.0, initial=9.0),
    "survival.probability": 0.995,
    "sensor.occlusion": False,
    "sensor.detection.probability": 0.6,
    "sensor.clutter_rate": 0.0079 * np.pi * 30.0**2,
}
"""Some 22 false detections a frame among half a dozen objects, of which each is often missed."""
REDUCTIONS = {
    "recycled below .01": ({}, False),
    "recycled below .01, 2000 hypotheses": ({"reduction.max_hypotheses": 2000}, False),
    "recycled below .1": ({"reduction.recycle_below": 0.1}, True),
}
"""What the tracker keeps; whether its count is promised."""


@pytest.mark.slow
@pytest.mark.parametrize("name", REDUCTIONS)
def test_the_number_of_objects_in_dense_clutter(name, verified):
    """All objects in view, detected or not, expected and there, on the filter's own model."""
    changes, promised = REDUCTIONS[name]
    truth, believed = model(**DENSE), model(**{**DENSE, **changes})
    view = View.of(DENSE_SITE, np.zeros(3))

    def seen_share(frame, x, y):
        return in_range(DENSE_SITE, x, y)

    counts = []
    for seed in REPORTING[:30]:
        tracker = PMBMTracker(believed, DENSE_SITE)
        scene = lives(truth, seed, DENSE_SITE, seen_share, in_view_alone=True)
        for frame, (state, _, z) in enumerate(scene):
            tracker.step(detections(DT * frame, z))
            if frame in LOOKS:
                local, ppp = tracker.density.local, tracker.density.undetected
                existence = tracker.density.hypothesis_probability() * local.existence
                expected = existence @ view.share_inside(local.mean, local.cov)
                expected += np.exp(ppp.log_weight) @ view.share_inside(ppp.mean, ppp.cov)
                counts.append((expected, seen_share(frame, *state[:, :2].T).sum()))
    expected, there = np.mean(counts, axis=0)
    ok = bool(abs(expected / there - 1) <= 0.1)
    verified(
        "dense_count",
        f"objects in view, P_D .6, .0079 false detections per m2, {name}: expected / true number "
        f"({expected:.2f} / {there:.2f})",
        float(expected / there),
        [0.9, 1.1],
        ok if promised else "report",
    )
    assert ok or not promised


WRONG = {
    "static occluder, the model's own": ({}, 0.0, True),
    "moving occluder": ({}, 4.0, False),
    "objects that hold their course, believed not to": (
        {"motion.acceleration_density": 0.1},
        0.0,
        False,
    ),
    "objects half as fast as believed": ({"birth.speed_sd": 5.0}, 0.0, False),
    "a detector that sees less than believed": ({"sensor.detection.probability": 0.7}, 0.0, False),
}
"""How the world differs from the model; the wall's speed; whether calibration is promised.

All with the same seeds, so that what differs between them is the model."""


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_hidden_counts_where_the_model_is_wrong(name, verified):
    """Totals, deviance and the distribution of PIT values, by region: promised where the model is
    right, reported where it is not."""
    changes, speed, promised = WRONG[name]
    own, truth = model(**CROWDED), model(**{**CROWDED, **changes})
    seeds = REPORTING[: len(REPORTING) // 2]
    counts = np.array([world(truth, seed, believed=own, wall_speed=speed) for seed in seeds])
    holds = True
    for part, place in enumerate(PLACES):
        expected, there = counts[:, -1, part].T
        low, high = stats.poisson.interval(0.99, expected.sum())
        ok = bool(low <= there.sum() <= high)
        holds &= ok
        with np.errstate(divide="ignore", invalid="ignore"):
            terms = np.where(there > 0, there * np.log(there / expected), 0.0)
        deviance = 2 * (terms - (there - expected)).mean()
        # Randomised within each count's step, so that it is uniform where the model is right.
        rng = np.random.default_rng(part)
        below, upto = stats.poisson.cdf(there - 1, expected), stats.poisson.cdf(there, expected)
        pit = below + rng.random(len(there)) * (upto - below)
        uniform = stats.kstest(pit, "uniform").pvalue
        verified(
            "occlusion_hidden_count",
            f"{name}: objects in the {place} after {DT * LOOKS[-1]:.1f} s, of {len(seeds)} worlds: "
            f"true count (expected {expected.sum():.1f}; Poisson deviance a world {deviance:.2f}; "
            f"PIT uniform with p = {uniform:.3f})",
            int(there.sum()),
            [float(low), float(high)],
            ok if promised else "report",
        )
    assert holds or not promised
