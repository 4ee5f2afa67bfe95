"""Is the filter exact?  S1: whole runs against the enumeration of all that can have happened.

Its figure is drawn beside the record of `--verification`.  `PMBM_FRESH_SEEDS=1` draws other worlds.
"""

from __future__ import annotations

import os
from dataclasses import replace

import numpy as np
import pytest
from every_partition import Small, posterior
from filter_problems import KEEP_ALL, plain_sensor, scan_of

from pmbm.filter import ConstantVelocity
from pmbm.filter.association import associate
from pmbm.filter.density import Density, Locals, Mixture
from pmbm.filter.prediction import Transition, predict
from pmbm.filter.reduction import reduce
from pmbm.filter.update import update
from pmbm.reports.posterior_figures import errors_figure

pytestmark = pytest.mark.slow

ENTROPY = None if os.environ.get("PMBM_FRESH_SEEDS") else 20261122
WORLDS = 40


def small_world(rng, still):
    """A world with few frames: still, with births in each; or moving, with none after the first."""
    dt = float(rng.uniform(0.2, 1.5))
    motion = ConstantVelocity(acceleration_density=float(rng.uniform(0.1, 1.0)))
    F, Q = motion.transition(dt)
    return Small(
        F=np.eye(4) if still else F,
        Q=np.zeros((4, 4)) if still else Q,
        R=np.diag(rng.uniform(0.2, 1.0, 2)),
        mean=rng.normal(0, 1, 4),
        cov=np.diag(rng.uniform(1.0, 6.0, 4)),
        detection=float(rng.uniform(0.5, 0.95)),
        survival=float(rng.uniform(0.8, 0.99)),
        clutter=float(rng.uniform(0.005, 0.05)),
        initial=float(rng.uniform(0.5, 2.0)),
        births=float(rng.uniform(0.1, 0.6)) if still else 0.0,
    )


def filtered(world, frames, clustering):
    """The filter's density at the end, everything kept."""
    sensor = plain_sensor(world.R, world.detection, world.clutter)
    kept = replace(KEEP_ALL, max_hypotheses=10**18, clustering=clustering)
    transition = Transition(world.F, world.Q, world.survival)

    def mixture(weight):
        return Mixture(np.log([weight]), world.mean[None], world.cov[None])

    density = Density.initial(
        mixture(world.initial), clustering=clustering, local=Locals.empty(len(frames))
    )
    for k, z in enumerate(frames):
        if k:
            births = mixture(world.births) if world.births else Mixture.empty()
            density = predict(density, transition, births)
        scan = scan_of(z)
        found = associate(density, scan, sensor, kept)
        density, _ = reduce(update(density, scan, found, sensor), kept)
    return density


def from_enumeration(world, frames, exact, cells, clustering):
    """Relative errors of the filter's numbers, by what they are."""
    density = filtered(world, frames, clustering)
    local, table = density.local, density.hypotheses
    row_of = {
        frozenset((k, j) for k, j in enumerate(history) if j >= 0): row
        for row, history in enumerate(local.history.tolist())
    }
    assert len(row_of) == len(local)
    assert row_of.keys() == cells.keys()
    ours = {frozenset(): 0.0}
    for cluster in range(table.clusters):
        rows = np.flatnonzero(table.cluster == cluster)
        cell_of = {row: cell for cell, row in row_of.items()}
        own = [
            (
                frozenset(cell_of[i] for i in table.member[table.start[g] : table.start[g + 1]]),
                table.log_weight[g],
            )
            for g in rows
        ]
        ours = {a | b: wa + wb for a, wa in ours.items() for b, wb in own}
    assert ours.keys() == exact.keys()
    undetected = world.undetected(len(frames))
    errors = {
        "weights": [abs(np.exp(ours[p]) / w - 1) for p, w in exact.items()],
        "existence": [
            abs(local.existence[row_of[c]] - cell.existence) for c, cell in cells.items()
        ],
        "states": [
            np.abs(local.mean[row_of[c]] - cell.mean).max() / max(1, np.abs(cell.mean).max())
            for c, cell in cells.items()
        ],
        "undetected": [
            abs(np.exp(density.undetected.log_weight).sum() / undetected - 1),
        ],
    }
    return {what: np.array(values, float) for what, values in errors.items()}


def worlds(count):
    """Small worlds with their frames and exact posteriors, every other one still."""
    rng = np.random.default_rng(np.random.SeedSequence(ENTROPY, spawn_key=(9,)))
    made = []
    while len(made) < count:
        world = small_world(rng, still=len(made) % 2 == 0)
        counts = rng.permutation([3, 2, 2, int(rng.integers(0, 2))])
        frames = [rng.normal(0, 1, (n, 2)) for n in counts]
        exact, cells = posterior(world, frames)
        # Even the largest number of children leaves too few to a parent less probable.
        if min(exact.values()) >= 1e-11:
            made.append((world, frames, exact, cells))
    return made


@pytest.fixture(autouse=True)
def _no_table_is_too_large(monkeypatch):
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.largest_table", lambda _: 10**9)


def test_s1_exact_against_enumeration(verified, drawn):
    """Every global hypothesis, every Bernoulli and the undetected, over whole runs."""
    found: dict[str, list] = {}
    for number, case in enumerate(worlds(WORLDS)):
        for what, errors in from_enumeration(*case, clustering=number % 4 < 2).items():
            found.setdefault(what, []).append(errors)
    errors = {what: np.concatenate(parts) for what, parts in found.items()}
    drawn("S1", errors_figure(errors, 1e-9))
    count = sum(map(len, errors.values()))
    worst = max(float(values.max()) for values in errors.values())
    verified(
        "S1",
        f"worst relative error of {count} numbers against enumeration, {WORLDS} worlds",
        f"{worst:.1e}",
        1e-9,
        worst < 1e-9,
    )
    assert count > 10_000
    assert worst < 1e-9


@pytest.mark.parametrize("wrong", ["detection", "survival", "clutter", "initial"])
def test_s1_notices_a_belief_that_is_wrong_by_a_millionth(wrong):
    worst = 0.0
    for world, *rest in worlds(4):
        belief = replace(world, **{wrong: getattr(world, wrong) * (1 - 1e-6)})
        errors = from_enumeration(belief, *rest, clustering=False)
        worst = max(worst, *(float(values.max()) for values in errors.values()))
    assert worst > 1e-9
