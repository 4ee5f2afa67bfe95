"""Is the posterior true?  Worlds drawn from the filter's own prior, posteriors held against them.

S2 the number of objects, S3 the existence of tracks, S4 states and innovations, S5 what pruning,
capping and gating cost; S1, equality with exact enumeration, is in test_filter_enumeration.py.
Seeds are fixed here; `PMBM_FRESH_SEEDS=1` draws others.  Each draws its figure beside the record of
`--verification`.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace

import numpy as np
import pytest
from filter_problems import KEEP_ALL, plain_sensor, scan_of
from scipy.stats import chi2

from pmbm.filter import BroadBirth, ConstantVelocity, Reduction
from pmbm.filter.association import associate
from pmbm.filter.density import Density, Mixture
from pmbm.filter.estimation import marginals
from pmbm.filter.estimators import cardinality
from pmbm.filter.prediction import Transition, predict
from pmbm.filter.reduction import reduce
from pmbm.filter.update import update
from pmbm.metrics.families import existence
from pmbm.reports.posterior_figures import (
    cost_figure,
    reliability_figure,
    squares_figure,
    transform_figure,
)

pytestmark = pytest.mark.slow

WORLDS = 1000
STEPS = 12
ENTROPY = None if os.environ.get("PMBM_FRESH_SEEDS") else 20261122


LIMITS = replace(
    KEEP_ALL,
    gate=30.0,
    max_hypotheses=300,
    prune_hypothesis=1e-4,
    recycle_below=1e-3,
    prune_undetected=1e-6,
    clustering=True,
)


@dataclass(frozen=True)
class World:
    """Everything that both the world and the filter believe."""

    detection: float = 0.85
    survival: float = 0.95
    birth: float = 0.25
    initial: float = 2.0
    clutter: float = 3.0
    half_width: float = 120.0
    spread: float = 20.0
    speed: float = 2.0
    dt: float = 1.0
    noise: float = 1.0
    merge_below: float = 0.1
    limits: Reduction = LIMITS

    def mixture(self, weight):
        cov = np.diag([self.spread**2, self.spread**2, self.speed**2, self.speed**2])
        return Mixture(np.log([weight]), np.zeros((1, 4)), cov[None])

    @property
    def sensor(self):
        density = self.clutter / (2 * self.half_width) ** 2
        return plain_sensor(self.noise**2 * np.eye(2), self.detection, density)

    @property
    def transition(self):
        F, Q = ConstantVelocity(acceleration_density=0.05).transition(self.dt)
        return Transition(F, Q, self.survival)


@dataclass
class Run:
    """One world and the filter's posterior at its end."""

    density: Density
    objects: int
    alive: dict
    nis: list


def draw(world, belief, rng, steps=STEPS):
    """Draw a world step by step and filter it under `belief`.

    alive maps a detection's running number to whether the object, first detected by it, lives; a
    track of that id exists exactly then.
    """
    F, Q = world.transition.F, world.transition.Q
    root = np.linalg.cholesky(Q)

    def born(mean):
        n = rng.poisson(mean)
        sd = [world.spread, world.spread, world.speed, world.speed]
        return [{"x": rng.normal(0, sd), "first": None} for _ in range(n)]

    objects = born(world.initial)
    density = Density.initial(belief.mixture(belief.initial))
    first_of, number, nis = {}, 0, []
    for k in range(steps):
        if k:
            objects = [o for o in objects if rng.random() < world.survival]
            for o in objects:
                o["x"] = F @ o["x"] + root @ rng.normal(size=4)
            objects += born(world.birth)
            density = predict(density, belief.transition, belief.mixture(belief.birth))
        found = [o for o in objects if rng.random() < world.detection]
        clutter = rng.uniform(-world.half_width, world.half_width, (rng.poisson(world.clutter), 2))
        z = [o["x"][:2] + rng.normal(0, world.noise, 2) for o in found]
        z, origin = np.concatenate([np.reshape(z, (-1, 2)), clutter]), found + [None] * len(clutter)
        order = rng.permutation(len(z))
        for place, i in enumerate(order):
            o = origin[i]
            if o is not None and o["first"] is None:
                o["first"] = number + place
                first_of[number + place] = o
        scan = scan_of(z[order])
        unpruned = replace(belief.limits, prune_hypothesis=0.0)
        found_pairs = associate(density, scan, belief.sensor, unpruned)
        nis += (found_pairs.known.y**2).sum(axis=1).tolist()
        updated = update(density, scan, found_pairs, belief.sensor)
        merging = BroadBirth(merge_below=belief.merge_below)
        density, _ = reduce(updated, belief.limits, merging)
        number += len(z)
    living = {id(o) for o in objects}
    alive = {first: id(o) in living for first, o in first_of.items()}
    return Run(density, len(objects), alive, nis), objects


def runs(world, belief=None, count=WORLDS, salt=0):
    seeds = np.random.SeedSequence(ENTROPY, spawn_key=(salt,)).spawn(count)
    return [draw(world, belief or world, np.random.default_rng(seed)) for seed in seeds]


def poisson(mean, top):
    n = np.arange(top + 1)
    from scipy.stats import poisson as law

    return law.pmf(n, mean)


def transform(run, rng):
    """Randomised probability integral transform of the true number of objects."""
    undetected = np.exp(run.density.undetected.log_weight).sum()
    p = np.convolve(cardinality(run.density), poisson(undetected, 40))
    below = p[: run.objects].sum()
    here = p[run.objects] if run.objects < len(p) else 0.0
    return below + rng.random() * here


def worst_gap(values):
    """Largest distance between the values' distribution function and the uniform one."""
    u = np.sort(values)
    n = len(u)
    return max((np.arange(1, n + 1) / n - u).max(), (u - np.arange(n) / n).max())


def band(n, alpha=0.01):
    """Simultaneous band of the empirical distribution function (Massart 1990)."""
    return float(np.sqrt(np.log(2 / alpha) / (2 * n)))


@dataclass(frozen=True)
class Reliability:
    """Per bin of claimed existence, its mean, the share that exists, and that share's standard
    error by trials; the z-score of the difference; over all tracks the Brier score, the expected
    calibration error and their number."""

    claimed: np.ndarray
    true: np.ndarray
    error: np.ndarray
    z: np.ndarray
    brier: float
    ece: float
    tracks: int


def reliability(outcomes, bins=10):
    edges = np.linspace(0, 1, bins + 1)
    sums = np.zeros((len(outcomes), bins))
    claimed, true = [], []
    for trial, (run, _) in enumerate(outcomes):
        claims = marginals(run.density).existence
        for number, p in zip(run.density.track_id.tolist(), claims, strict=True):
            fact = float(run.alive.get(number, False))
            sums[trial, min(np.searchsorted(edges, p, side="right") - 1, bins - 1)] += fact - p
            claimed.append(p)
            true.append(fact)
    scale = np.sqrt((sums**2).sum(axis=0))
    found = existence.reliability(claimed, true, bins)
    z = np.divide(sums.sum(axis=0), scale, out=np.zeros(bins), where=scale > 0)
    filled = np.maximum(found.count, 1)
    return Reliability(
        claimed=found.probability_sum / filled,
        true=found.hits / filled,
        error=scale / filled,
        z=z,
        brier=found.square_sum / len(claimed),
        ece=found.expected_error,
        tracks=len(claimed),
    )


@pytest.fixture(scope="module")
def own_worlds():
    return runs(World())


def test_s2_number_of_objects(own_worlds, verified, drawn):
    rng = np.random.default_rng(1)
    values = [transform(run, rng) for run, _ in own_worlds]
    gap, bound = worst_gap(values), band(len(own_worlds))
    drawn("S2", transform_figure(values, bound))
    ok = bool(gap < bound)
    verified("S2", "PIT of the true number of objects", round(float(gap), 4), round(bound, 4), ok)
    assert gap < bound


def test_s3_existence_of_tracks(own_worlds, verified, drawn):
    found = reliability(own_worlds)
    drawn("S3", reliability_figure(found.claimed, found.true, 3.29 * found.error))
    verified(
        "S3",
        f"existence of {found.tracks} tracks, worst bin's z",
        round(float(np.abs(found.z).max()), 2),
        3.29,
        bool((np.abs(found.z) < 3.29).all()),
    )
    verified("S3", "Brier score of existence", round(found.brier, 4))
    verified("S3", "expected calibration error of existence", round(found.ece, 4))
    assert found.tracks > 1000
    assert (np.abs(found.z) < 3.29).all(), found.z


@pytest.mark.parametrize(
    "wrong",
    [{"survival": 0.85}, {"detection": 0.7}, {"clutter": 6.0}, {"birth": 0.6}],
    ids=lambda wrong: next(iter(wrong)),
)
def test_s2_and_s3_notice_a_wrong_belief(wrong):
    world = World()
    outcomes = runs(world, replace(world, **wrong), salt=1)
    rng = np.random.default_rng(1)
    gap = worst_gap([transform(run, rng) for run, _ in outcomes])
    z = reliability(outcomes).z
    assert gap > band(len(outcomes)) or np.abs(z).max() > 3.29


def test_s4_states_and_innovations(verified, drawn):
    """Certain detection, no clutter, one object: chi-square to the letter."""
    found = squares(LONE, LONE)
    drawn("S4", squares_figure(found))
    for what, (values, dof) in found.items():
        low, mean, high = within(values, dof)
        verified(
            "S4",
            f"mean {what} of {len(values)}",
            round(mean, 3),
            f"{low:.3f} to {high:.3f}",
            bool(low < mean < high),
        )
        assert low < mean < high


@pytest.mark.parametrize("wrong", [{"noise": 1.15}, {"spread": 140.0, "speed": 1.4}])
def test_s4_notices_a_wrong_belief(wrong):
    found = squares(LONE, replace(LONE, **wrong))
    outside = []
    for values, dof in found.values():
        low, mean, high = within(values, dof)
        outside.append(not low < mean < high)
    assert any(outside)


def test_s4_where_nothing_is_promised(own_worlds, verified):
    """In clutter, with misses: tracks that are probably there and whose object is."""
    nees = []
    for run, objects in own_worlds:
        best, existence = marginals(run.density).best, marginals(run.density).existence
        state = {o["first"]: o["x"] for o in objects}
        for number, p, row in zip(run.density.track_id.tolist(), existence, best, strict=True):
            if p > 0.5 and number in state:
                error = run.density.local.mean[row] - state[number]
                nees.append(error @ np.linalg.solve(run.density.local.cov[row], error))
    verified("S4", f"mean NEES of {len(nees)} tracks in clutter", round(float(np.mean(nees)), 3))
    verified("S4", "their median NEES", round(float(np.median(nees)), 3))
    assert len(nees) > 1000


LONE = World(
    detection=1.0,
    survival=1.0,
    birth=1e-9,
    initial=1.0,
    clutter=0.0,
    spread=200.0,
    limits=replace(LIMITS, gate=1e6),
)


def squares(world, belief):
    """NEES at the end of each of 600 worlds that hold one object, and NIS of every step."""
    nees, nis = [], []
    for run, objects in runs(world, belief, count=600, salt=2):
        if len(objects) != 1:
            continue
        best = marginals(run.density).best
        assert len(best) == 1
        error = run.density.local.mean[best[0]] - objects[0]["x"]
        nees.append(error @ np.linalg.solve(run.density.local.cov[best[0]], error))
        nis += run.nis
    return {"NEES": (nees, 4), "NIS": (nis, 2)}


def within(values, dof):
    """The mean, between the bounds that it keeps to in 99.9 % of all samples."""
    low, high = chi2.ppf([0.0005, 0.9995], dof * len(values)) / len(values)
    return low, float(np.mean(values)), high


def test_s5_what_the_reductions_cost(verified, drawn):
    """Expected number of objects under hard reductions against hardly any, same worlds."""
    world = World()
    free = replace(
        world,
        merge_below=0.0,
        limits=replace(
            world.limits,
            gate=60.0,
            prune_hypothesis=1e-7,
            max_hypotheses=3000,
            recycle_below=1e-5,
            prune_undetected=1e-9,
        ),
    )

    def expected(run):
        density = run.density
        return np.exp(density.undetected.log_weight).sum() + marginals(density).existence.sum()

    exact = [expected(run) for run, _ in runs(world, free, 60, salt=3)]
    found = {}
    for what, belief in {
        "the defaults": replace(
            world,
            merge_below=1.0,
            limits=replace(
                world.limits,
                gate=20.0,
                prune_hypothesis=1e-3,
                max_hypotheses=200,
                recycle_below=0.01,
                prune_undetected=1e-5,
                split_below=1e-3,
            ),
        ),
        "a gate of 9": replace(world, limits=replace(world.limits, gate=9.0)),
        "one global hypothesis": replace(world, limits=replace(world.limits, max_hypotheses=1)),
    }.items():
        reduced = [expected(run) for run, _ in runs(world, belief, 60, salt=3)]
        found[what] = exact, reduced
        difference = np.subtract(reduced, exact)
        verified(
            "S5",
            f"bias and mean error of the expected number under {what}",
            f"{difference.mean():+.4f}, {np.abs(difference).mean():.4f}",
        )
        assert abs(difference.mean()) < 0.5
    drawn("S5", cost_figure(found))
