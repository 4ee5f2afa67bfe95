"""S6: the number of objects expected behind a wall, against how many are there."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pmbm import Detections
from pmbm.filter import PMBMTracker
from pmbm.filter.models import View
from pmbm.geometry import points_in_polygon

sys.path.insert(0, str(Path(__file__).parents[1] / "unit"))
from unseen_world import DT, SHADOW, SITE, draw, model, moved, seen_by

FRAMES = 30
SEEDS = 40
LOOKS = (9, 19, 29)
PLACES = {
    "shadow": SHADOW,
    "near half of the shadow": np.array([[13, -9.75], [26, -19.5], [26, 19.5], [13, 9.75]]),
    "far half of the shadow": np.array([[26, -19.5], [39, -29.25], [39, 29.25], [26, 19.5]]),
}


def some(mixture, rng):
    """A Poisson number of objects of this intensity."""
    return draw(mixture, rng.poisson(np.exp(mixture.log_weight).sum()), rng)[0]


def world(config, seed):
    """Objects of the model, looked at by the model's sensor; per look and region, how many were
    expected that no detection has shown, and how many there were."""
    rng = np.random.default_rng([6, seed])
    tracker = PMBMTracker(config, SITE)
    view = View.of(SITE, np.zeros(3))
    model_of_births = PMBMTracker(config, SITE)
    state = some(model_of_births._first(view), rng)
    born = model_of_births._births(view, DT)
    known = np.zeros(len(state), bool)
    counts = []
    for frame in range(FRAMES):
        if frame:
            alive = rng.random(len(state)) < config.survival ** (DT / config.survival_interval)
            state, known = moved(state[alive], DT, config, rng), known[alive]
            new = some(born, rng)
            state = np.concatenate([state, new])
            known = np.concatenate([known, np.zeros(len(new), bool)])
        seen = rng.random(len(state)) < seen_by(config, *state[:, :2].T)
        known |= seen
        z = state[seen, :2] + rng.normal(0, config.measurement_sd, (int(seen.sum()), 2))
        clutter = draw_clutter(config, rng)
        report = tracker.step(detections(DT * frame, np.concatenate([z, clutter])))
        if frame in LOOKS:
            for place in PLACES.values():
                inside = points_in_polygon(state[:, :2], place)
                counts.append(
                    (report.undetected.expected_count(place), int((inside & ~known).sum()))
                )
    return np.array(counts).reshape(len(LOOKS), len(PLACES), 2)


def draw_clutter(config, rng):
    n = rng.poisson(config.clutter_rate)
    radius, turn = SITE.max_range * np.sqrt(rng.random(n)), rng.uniform(0, 2 * np.pi, n)
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
    config = model(initial_objects=90.0, birth_rate=27.0, clutter_rate=2.0, max_hypotheses=20)
    counts = np.array([world(config, seed) for seed in range(SEEDS)])
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
            f"{SEEDS} worlds: true count (expected {expected.sum():.1f})",
            int(there.sum()),
            [float(low), float(high)],
            ok,
        )
    each = counts[:, :, 0].mean(axis=1)
    gap = each[:, 1] - each[:, 0]
    band = stats.t.ppf(0.995, SEEDS - 1) * gap.std(ddof=1) / np.sqrt(SEEDS)
    within.append(bool(abs(gap.mean()) <= band))
    verified(
        "S6",
        f"objects hidden in the shadow of a static wall, mean over {len(LOOKS)} looks and {SEEDS} "
        "worlds: true minus expected",
        float(gap.mean()),
        [-float(band), float(band)],
        within[-1],
    )
    # Counts are neither wider nor narrower than Poisson: chi-square over the seeds.
    expected, there = counts[:, -1, 0].T
    dispersion = ((there - expected) ** 2 / expected).sum()
    low, high = stats.chi2.interval(0.99, SEEDS)
    verified(
        "S6",
        "dispersion of hidden counts over worlds",
        float(dispersion),
        [float(low), float(high)],
        bool(low <= dispersion <= high),
    )
    assert low <= dispersion <= high
    assert all(within)
