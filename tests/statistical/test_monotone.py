"""Harder levels of a scenario are not easier: what a catalogue of difficulties must not betray.

For each pair of neighbouring levels, trials are paired by seed (one random world under both), and
a one-sided t-test asks whether the harder level is better, for the PMBM tracker and for a baseline
that shares none of its code.  Holm's step-down over the pairs of a scenario, at 1e-3 over the whole
catalogue and both trackers.  `PMBM_MONOTONE_SEEDS` sets another number of seeds than 50.  One
scenario by name, in minutes:

    pytest -m slow "tests/statistical/test_monotone.py::test_no_harder_level_is_easier[crossing]"
"""

import itertools
import os

import numpy as np
import pytest
from scipy import stats

from pmbm.sim import load_scenario, scenario_names
from pmbm.sim.scenario.scenario import Scenario

SEEDS = int(os.environ.get("PMBM_MONOTONE_SEEDS", "50"))
ALPHA = 1e-3
SECONDS = {
    "density": 3.0,
    "density_scripted": 2.0,
    "long_occlusion": 40.0,
    "sector_loss": 14.0,
    "sensor_dropout": 14.0,
}
"""How much of a scenario is run, where not the first ten seconds."""
LARGEST = {"density": 50, "density_scripted": 100}
METRIC = {"heading_flip": "yaw_flips"}
"""What is measured where GOSPA, a matter of positions, does not feel the factor."""
TRACKERS = ("pmbm", "argoverse")
LOST = {"small_agents": ("argoverse",)}
"""Trackers that a scenario's null level defeats already: people 2 m apart are too many for boxes
matched by overlap, and the nearer together, the nearer a wrong track is to somebody."""

MONOTONE = [
    name
    for name in scenario_names()
    if (form := load_scenario(name).form).sweep is not None and form.check.monotone
]


def improved(errors, alpha):
    """Pairs (k, k + 1) of rows of errors (levels, trials) in which the later is better.

    Paired one-sided t-tests, Holm-adjusted over the pairs.
    """
    gains = [earlier - later for earlier, later in itertools.pairwise(errors)]
    p = []
    for gain in gains:
        spread = gain.std(ddof=1)
        if spread == 0:
            p.append(0.0 if gain.mean() > 0 else 1.0)
        else:
            t = gain.mean() / (spread / np.sqrt(len(gain)))
            p.append(float(stats.t.sf(t, len(gain) - 1)))
    found = []
    for rank, pair in enumerate(np.argsort(p).tolist()):
        if p[pair] >= alpha / (len(p) - rank):
            break
        found.append((pair, pair + 1))
    return found


def test_an_improvement_is_found_and_noise_is_not():
    rng = np.random.default_rng(0)
    world = rng.normal(5.0, 1.0, 50)
    harder = np.stack([world + 0.2 * k + rng.normal(0, 0.1, 50) for k in range(4)])
    assert improved(harder, ALPHA) == []
    assert improved(harder[[0, 1, 3, 2]], ALPHA) == [(2, 3)]
    assert improved(np.stack([world, world, world - 0.01]), ALPHA) == [(1, 2)]
    false_alarms = sum(bool(improved(rng.normal(size=(4, 50)), 0.05)) for _ in range(400))
    assert stats.binom.sf(false_alarms - 1, 400, 0.05) > 1e-4
    assert false_alarms > 2  # the test has power over nothing but chance


@pytest.mark.slow
@pytest.mark.parametrize("name", MONOTONE)
def test_no_harder_level_is_easier(name, verified):
    from pmbm import evaluate, run
    from pmbm.tracking import make_tracker, tracker_factory

    whole = load_scenario(name)
    seconds = min(whole.form.duration, SECONDS.get(name, 10.0))
    scenario = Scenario({**whole.document, "duration": seconds}, whole.file)
    levels = [level for level in scenario.levels if level <= LARGEST.get(name, np.inf)]
    metric = METRIC.get(name, "gospa")
    trackers = [one for one in TRACKERS if one not in LOST.get(name, ())]
    errors = np.zeros((len(trackers), len(levels), SEEDS))
    for row, level in enumerate(levels):
        for seed in range(SEEDS):
            recording = scenario.record(seed, level=level)
            for which, tracker in enumerate(trackers):
                tracks = run(make_tracker(tracker_factory(tracker), recording.site), recording)
                errors[which, row, seed] = evaluate(recording, tracks)[metric].value
    easier = {
        tracker: improved(of_tracker, ALPHA / len(MONOTONE) / len(TRACKERS))
        for tracker, of_tracker in zip(trackers, errors, strict=True)
    }
    means = "; ".join(
        f"{tracker} "
        + ", ".join(f"{level:g}: {m:.3f}" for level, m in zip(levels, of, strict=True))
        for tracker, of in zip(trackers, errors.mean(axis=2), strict=True)
    )
    verified(
        f"monotone_{name}",
        f"pairs of levels, of {len(levels) - 1}, whose harder one is easier ({metric} over "
        f"{SEEDS} seeds: {means})",
        sum(map(len, easier.values())),
        0,
        not any(easier.values()),
    )
    assert not any(easier.values()), f"easier at a harder level: pairs {easier} of {means}"
