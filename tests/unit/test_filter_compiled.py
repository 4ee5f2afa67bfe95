"""What is compiled in the filter against its plain twins."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from filter_problems import KEEP_ALL, bernoullis, plain_sensor, scan_of

from pmbm import Detections, PMBMConfig, PMBMTracker, Site, kernels
from pmbm.filter import LastingScores
from pmbm.filter.association import associate
from pmbm.filter.density import Density, Globals, Mixture, RecycledFrom, starts
from pmbm.filter.estimation import suppress_overlaps
from pmbm.filter.hypotheses.branching import branch
from pmbm.filter.hypotheses.clusters import factor, merge_equal
from pmbm.filter.hypotheses.gating import first_detections, gate, gated_pairs
from pmbm.filter.hypotheses.gaussian import Innovation
from pmbm.filter.hypotheses.weights import normalised
from pmbm.filter.identity.recycling import ids_of_new
from pmbm.filter.models.rays import box_rays
from pmbm.filter.models.undetected_map import reduce_map
from pmbm.filter.models.view import View
from pmbm.filter.reduction import merge_mixture, pruned, reduce
from pmbm.score import ScoreModel
from pmbm.types import ABSENT

native = pytest.importorskip("pmbm._native", reason="installed without a compiler")


def on_both(monkeypatch, work):
    """What `work()` gives with and without the compiled module."""
    results = []
    for module in (native, None):
        monkeypatch.setattr(kernels, "native", module)
        results.append(work())
    return results


def gaussians(random, n, spread, narrow):
    """Innovations of n Gaussians, some of them as wide as the scene."""
    mean = np.concatenate([random.uniform(-spread, spread, (n, 2)), np.zeros((n, 2))], axis=1)
    root = (
        random.normal(size=(n, 4, 4)) * np.where(np.arange(n) % narrow, 1.0, spread)[:, None, None]
    )
    return Innovation.of(mean, root @ root.transpose(0, 2, 1), 0.09 * np.eye(2))


@pytest.mark.parametrize(
    ("n", "m", "spread"),
    [
        (0, 5, 10),
        (5, 0, 10),
        (1, 1, 1),
        (30, 40, 20),
        (300, 400, 50),
        (300, 400, 2),
        (9, 2000, 500),
    ],
)
def test_gates_to_the_bit(monkeypatch, n, m, spread):
    random = np.random.default_rng([n, m, spread])
    innovation = gaussians(random, n, spread, narrow=7)
    z = random.uniform(-spread, spread, (m, 2))
    fast, plain = on_both(monkeypatch, lambda: gate(innovation, z, 20.0))
    if n and m > 1:
        assert len(fast[0])
    for one, other in zip(fast, plain, strict=True):
        assert one.shape == other.shape
        assert one.tolist() == other.tolist()


@pytest.mark.parametrize(
    "z",
    [
        np.zeros((6, 2)),
        np.stack([np.linspace(-9, 9, 50), np.zeros(50)], axis=1),
        np.stack([np.zeros(50), np.linspace(-9, 9, 50)], axis=1),
        np.array([[1e9, 1e9], [0.1, 0.1], [-1e9, 3.0]]),
    ],
    ids=["one place", "along x", "along y", "far apart"],
)
def test_gates_where_measurements_lie_oddly(monkeypatch, z):
    innovation = gaussians(np.random.default_rng(1), 40, 5, narrow=3)
    fast, plain = on_both(monkeypatch, lambda: gate(innovation, z, 9.0))
    assert len(fast[0])
    for one, other in zip(fast, plain, strict=True):
        assert one.tolist() == other.tolist()


def test_pairs_and_first_detections_are_priced_alike(monkeypatch):
    """Some Gaussians cannot be detected, and some measurements lie in no gate."""
    random = np.random.default_rng(4)
    n = 200
    mean = np.concatenate([random.uniform(-40, 40, (n, 2)), np.zeros((n, 2))], axis=1)
    root = random.normal(size=(n, 4, 4)) * np.where(np.arange(n) % 50, 1.0, 30.0)[:, None, None]
    cov = root @ root.transpose(0, 2, 1)
    weight = np.where(random.random(n) < 0.2, 0.0, random.random(n))
    z = random.uniform(-60, 60, (300, 2))
    z[:30] += 900
    R = np.array([[0.09, 0.02], [0.02, 0.2]])
    fast, plain = on_both(monkeypatch, lambda: gated_pairs(mean, cov, weight, z, R, 9.0))
    possible = np.flatnonzero(weight)
    assert len(np.intersect1d(plain.row, possible)) == len(np.unique(plain.row)) > 100
    for name in ("row", "measurement", "y"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(plain, name))
    np.testing.assert_allclose(fast.log_weight, plain.log_weight, rtol=1e-13)
    for one, other in zip(fast.innovation.columns(), plain.innovation.columns(), strict=True):
        np.testing.assert_array_equal(one, other)

    with np.errstate(divide="ignore"):
        ppp, log_weight = Mixture(np.zeros(n), mean, cov), np.log(weight)
    (priced, log_e), (plainly, log_plainly) = on_both(
        monkeypatch, lambda: first_detections(ppp, log_weight, z, R, 9.0)
    )
    assert 0 < np.isinf(log_e).sum() < 200
    np.testing.assert_allclose(log_e, log_plainly, rtol=1e-12)
    np.testing.assert_allclose(priced.log_height, plainly.log_height, rtol=1e-13)
    for one, other in zip(priced.innovation.columns(), plainly.innovation.columns(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("half_angle", [np.pi, 0.7, 3.0])
def test_shares_in_view_as_plain(monkeypatch, half_angle):
    random = np.random.default_rng(6)
    mean = random.normal(0, 30, (300, 4))
    cov = random.exponential(5, (300, 1, 1)) * np.eye(4)
    cov[::50] = 0
    view = View(np.array([1.0, -2.0, 2.5]), 1.2, half_angle, 50.0)
    fast, plain = on_both(monkeypatch, lambda: view.share_inside(mean, cov))
    assert ((plain > 0.1) & (plain < 0.9)).sum() > 10
    np.testing.assert_allclose(fast, plain, rtol=1e-12, atol=1e-15)


def test_reports_at_one_place_as_plain(monkeypatch):
    """Crowds of boxes of all sizes and headings, some of them at the very same place."""
    held_back = 0
    for seed in range(30):
        random = np.random.default_rng(seed)
        n = int(random.integers(0, 80))
        position = random.normal(0, 2.0 + seed % 3 * 10, (n, 2))
        position[: n // 4] = position[: n // 4].round()
        box = np.column_stack([np.zeros(n), random.uniform(0.2, 12, (n, 2)), np.ones(n)])
        box = np.column_stack([box, random.uniform(-4, 4, n)])
        order = random.permutation(n)
        sure = n - seed % 2 * n // 3
        fast, plain = on_both(monkeypatch, partial(suppress_overlaps, position, box, order, sure))
        assert fast.tolist() == plain.tolist()
        held_back += n - len(plain)
    assert held_back > 300


def test_scores_say_the_same(monkeypatch):
    """At the knots, between and beyond them; of one knot; levels near and far."""
    random = np.random.default_rng(8)
    curve = ScoreModel(
        knot=np.array([-1.0, 0.2, 0.21, 3.0]), log_odds=np.array([-2, 0.5, 0.6, 4]), base_rate=0.3
    )
    score = np.concatenate([curve.knot, random.uniform(-2, 4, 100)])
    for model in (curve, ScoreModel.uninformative(), ScoreModel.trusting()):
        for within in (np.inf, 1.5):
            fast, plain = on_both(
                monkeypatch, partial(model.log_likelihood_ratio, score, within=within)
            )
            np.testing.assert_allclose(fast, plain, rtol=1e-13, atol=1e-15)
    for levels in (LastingScores(), replace(LastingScores(), clutter=np.array([0.5, 0.5, 0.0]))):
        fast, plain = on_both(monkeypatch, partial(levels.evidence, 9 * score))
        np.testing.assert_allclose(fast, plain, rtol=1e-12)


def test_ids_that_go_on_as_plain():
    random = np.random.default_rng(9)
    answers = []
    for _ in range(200):
        ids, reported, candidate = (
            np.unique(random.integers(0, 12, random.integers(0, n))) for n in (4, 12, 6)
        )
        ids = random.permutation(ids)
        plain = kernels.TWINS["known_as_they_are"](ids, reported, candidate)
        assert native.known_as_they_are(ids, reported, candidate) == plain
        answers.append(plain)
    assert 20 < sum(answers) < 180


def test_misses_say_the_same(monkeypatch):
    """Among them what exists for sure and is always seen, and what is never seen."""
    random = np.random.default_rng(7)
    r, P_D = random.random(200), random.random(200)
    r[:40], P_D[20:60], P_D[80:90] = 1.0, 1.0, 0.0
    sensor = plain_sensor(np.eye(2), 0.9, 1e-3)
    fast, plain = on_both(monkeypatch, lambda: sensor.missed(r, P_D))
    for one, other in zip(fast, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-14)


@pytest.mark.parametrize(("H", "n", "M"), [(0, 0, 0), (5, 0, 0), (0, 0, 4), (9, 7, 30)])
def test_candidates_in_use_are_named_alike(H, n, M):
    random = np.random.default_rng(8)
    member = random.integers(0, max(H + n + M, 1), 25 if H + n + M else 0)
    fast, plain = native.used(member, H, n, M), kernels.TWINS["used"](member, H, n, M)
    for one, other in zip(fast, plain, strict=True):
        np.testing.assert_array_equal(one, other)


def frames(seed, count=40, objects=25):
    """Objects that cross each other in clutter, some of them unseen for a while."""
    random = np.random.default_rng(seed)
    position, velocity = random.uniform(-30, 30, (objects, 2)), random.normal(0, 6, (objects, 2))
    for frame in range(count):
        here = position + 0.1 * frame * velocity
        seen = here[random.random(objects) < 0.8]
        clutter = random.uniform(-50, 50, (random.poisson(8), 2))
        z = np.concatenate([seen + random.normal(0, 0.3, seen.shape), clutter])
        n = len(z)
        yield Detections(
            time=0.1 * frame,
            position=np.column_stack([z, np.zeros(n)]),
            size=np.ones((n, 3)),
            yaw=np.zeros(n),
            score=np.full(n, 0.5),
            label=np.zeros(n, np.int8),
        )


@pytest.mark.parametrize("config", [PMBMConfig(), PMBMConfig.paper(), PMBMConfig.textbook()])
def test_the_tracker_says_the_same(monkeypatch, config):
    def work():
        tracker = PMBMTracker(config, Site(max_range=80.0))
        return [tracker.step(frame) for frame in frames(seed=1)]

    fast, plain = on_both(monkeypatch, work)
    assert max(len(tracks) for tracks in fast) > 15
    for one, other in zip(fast, plain, strict=True):
        assert one.id.tolist() == other.id.tolist()
        for name in ("position", "velocity", "score", "covariance"):
            np.testing.assert_allclose(
                getattr(one, name), getattr(other, name), rtol=1e-9, atol=1e-9
            )


@pytest.mark.parametrize("seed", range(4))
def test_ids_are_resumed_alike(monkeypatch, seed):
    """Components of a few origins around two places, some of whose ids are in use."""
    random = np.random.default_rng(seed)
    n, m = 60, 30
    mean = np.concatenate([random.normal(0, 3, (n, 2)), np.zeros((n, 2))], axis=1)
    mean[::2, 0] += 40
    track = random.integers(ABSENT, 8, n)
    share = np.where(track == ABSENT, 0.0, random.uniform(0.6, 1, n))
    ppp = Mixture(
        random.normal(-3, 1, n),
        mean,
        np.tile(np.eye(4), (n, 1, 1)),
        RecycledFrom(track, share, share),
    )
    prior = replace(Density.initial(ppp), track_id=np.arange(2), detections_seen=100)
    z = random.normal(0, 3, (m, 2)) + np.where(random.random(m) < 0.5, 40.0, 0.0)[:, None] * [1, 0]
    sensor, scan = plain_sensor(0.09 * np.eye(2), 0.9, 1e-3), scan_of(z)
    kept = replace(KEEP_ALL, gate=20.0, max_hypotheses=1, clustering=True)

    def work():
        found = associate(prior, scan, sensor, kept)
        return ids_of_new(prior, scan, found, np.arange(0, m, 2)).tolist()

    fast, plain = on_both(monkeypatch, work)
    assert fast == plain
    assert set(fast) & set(range(2, 8))


def random_table(seed):
    """A mixture of a few clusters, in which some tracks move together, and the tracks (H,)."""
    random = np.random.default_rng(seed)
    cluster, weight, rows, track = [], [], [], []
    for c in range(6):
        locals_of = []
        for _ in range(random.integers(1, 6)):
            locals_of.append(len(track) + np.arange(random.integers(1, 4)))
            track += [track[-1] + 1 if track else 0] * len(locals_of[-1])
        count = int(random.integers(1, 30))
        picks = [random.integers(-1, len(own), count) for own in locals_of]
        for one, other in zip(picks[:-1:3], picks[1::3], strict=False):
            other[:] = np.minimum(other, one)
        for row in range(count):
            rows.append(
                [own[p[row]] for own, p in zip(locals_of, picks, strict=True) if p[row] >= 0]
            )
        cluster += [c] * count
        weight.append(random.dirichlet(np.ones(count)))
    member = np.array([m for row in rows for m in row], dtype=np.intp)
    table = Globals(
        np.array(cluster),
        np.log(np.concatenate(weight)),
        starts(np.array([*map(len, rows)])),
        member,
    )
    return table, np.array(track)


REDUCTIONS = {
    "nothing": {},
    "prune": {"prune_hypothesis": 0.02},
    "cap": {"max_hypotheses": 3},
    "recycle": {"recycle_below": 0.4},
    "forget": {"recycle_below": 0.4, "recycle": False},
    "few tracks": {"recycle_below": 0.2, "max_tracks": 7},
    "in one": {"clustering": False, "recycle_below": 0.4, "prune_hypothesis": 0.02},
    "factor a little": {"split_below": 0.02},
    "factor": {"split_below": 0.15, "recycle_below": 0.1},
    "factor all": {"split_below": 10.0},
}
KEEP_MOST = replace(
    KEEP_ALL, max_hypotheses=100, max_tracks=1000, max_undetected=1000, clustering=True
)


@pytest.mark.parametrize("name", REDUCTIONS)
@pytest.mark.parametrize("seed", range(6))
def test_reductions_come_out_the_same(monkeypatch, name, seed):
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.WORTH_FACTORING", 8)
    table, track = random_table(seed)
    random, H = np.random.default_rng(seed), len(track)
    local = bernoullis(
        track, random.random(H), random.normal(size=(H, 4)), np.tile(np.eye(4), (H, 1, 1))
    )
    if name == "in one":
        table = replace(table, cluster=np.zeros_like(table.cluster))
        table = replace(table, log_weight=normalised(table.log_weight, table.cluster))
    ids = 10 * np.arange(track.max() + 1)
    prior = Density(Mixture.empty(), local, table, ids)
    limits = replace(KEEP_MOST, **REDUCTIONS[name])
    (fast, counted), (plain, plainly) = on_both(monkeypatch, lambda: reduce(prior, limits))
    assert counted == plainly
    assert fast.track_id.tolist() == plain.track_id.tolist()
    assert fast.local.mean.tolist() == plain.local.mean.tolist()
    assert fast.local.track.tolist() == plain.local.track.tolist()
    for field in ("cluster", "start", "member"):
        one, other = getattr(fast.hypotheses, field), getattr(plain.hypotheses, field)
        assert one.tolist() == other.tolist()
    np.testing.assert_allclose(fast.hypotheses.log_weight, plain.hypotheses.log_weight, atol=1e-12)
    np.testing.assert_allclose(fast.undetected.log_weight, plain.undetected.log_weight, atol=1e-12)
    assert fast.undetected.mean.tolist() == plain.undetected.mean.tolist()


def test_the_reductions_had_something_to_do():
    table, track = random_table(0)
    merged = merge_equal(table)
    found = [factor(merged, track, tolerance).clusters for tolerance in (1e-9, 0.15, 10.0)]
    assert merged.clusters <= found[0] < found[1] < found[2]


def test_components_are_merged_alike(monkeypatch):
    """Crowds of components at a few places, some of them wide, some apart in velocity alone."""
    for seed in range(5):
        random = np.random.default_rng(seed)
        n = 300
        mean = np.concatenate([random.normal(0, 1, (n, 2)), random.normal(0, 1, (n, 2))], axis=1)
        mean[:, 0] += 20 * random.integers(0, 5, n)
        root = (
            random.normal(0, 0.4, (n, 4, 4))
            + np.eye(4) * random.choice([0.5, 3.0], n)[:, None, None]
        )
        ppp = Mixture(random.normal(-3, 1, n), mean, root @ root.transpose(0, 2, 1))
        fast, plain = on_both(monkeypatch, lambda ppp=ppp: merge_mixture(ppp, 4.0))
        assert 30 < len(fast) < 280
        for field in ("log_weight", "mean", "cov"):
            assert getattr(fast, field).tolist() == getattr(plain, field).tolist()


@pytest.mark.parametrize("half_angle", [np.pi, 0.9])
@pytest.mark.parametrize("fine_above", [np.inf, 0.05, 0.0])
@pytest.mark.parametrize("recycled", [False, True])
def test_maps_are_settled_alike(monkeypatch, half_angle, fine_above, recycled):
    """Components on and off the map, narrow and wide, some of them round, recycled from few."""
    for seed in range(4):
        random = np.random.default_rng(seed)
        n = 200
        root = random.normal(0, 0.5, (n, 4, 4)) * random.uniform(0.1, 12, (n, 4, 1))
        cov = root @ root.transpose(0, 2, 1)
        cov[: n // 4] = random.choice([1.0, 20.0], (n // 4, 1, 1)) * np.eye(4)
        track = random.integers(ABSENT, 6, n)
        share = np.where(track == ABSENT, 0.0, random.random(n))
        ppp = Mixture(
            random.normal(-4, 2, n),
            random.uniform(-55, 55, (n, 4)) * [1, 1, 0.4, 0.4],
            cov,
            RecycledFrom(track, share, random.uniform(share, 1)) if recycled else None,
        )
        view = View(np.array([3.0, -2.0, 0.5]), 0.3, half_angle, 40.0)
        limits = {"most": 10**6, "negligible": 0.01, "fine_above": fine_above}
        (fast, dropped), (plain, plainly) = on_both(
            monkeypatch, partial(reduce_map, ppp, view, 3.5, **limits)
        )
        assert 0 < plainly < np.exp(ppp.log_weight).sum()
        assert dropped == pytest.approx(plainly, rel=1e-9)
        assert len(fast) == len(plain) > 100
        for name in ("log_weight", "mean", "cov"):
            one, other = getattr(fast, name), getattr(plain, name)
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9, err_msg=name)
        assert (fast.recycled_from is None) == (plain.recycled_from is None) == (not recycled)
        if fast.recycled_from is not None and plain.recycled_from is not None:
            np.testing.assert_array_equal(fast.recycled_from.track, plain.recycled_from.track)
            for one, other in zip(
                fast.recycled_from.columns(), plain.recycled_from.columns(), strict=True
            ):
                np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("negligible", [0.0, 0.05])
@pytest.mark.parametrize(
    ("cap", "largest", "search"),
    [(10_000, 10**9, 10**9), (7, 10**9, 10**9), (200, 60, 10**9), (200, 10**9, 25)],
)
@pytest.mark.parametrize("ties", [0, 1, 3, 30])
def test_hypotheses_branch_alike(monkeypatch, cap, largest, search, ties, negligible):
    """Clusters that stay apart, clusters that measurements tie together, and measurements alone."""
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.largest_table", lambda _: largest)
    monkeypatch.setattr("pmbm.filter.hypotheses.branching.LARGEST_SEARCH", search)
    joins = 0
    for seed in range(5):
        table, track = random_table(seed)
        table = merge_equal(pruned(table, -np.inf, np.full(6, 3))[0])
        random = np.random.default_rng([seed, ties])
        row = np.sort(random.choice(np.unique(table.member), min(ties, 12), replace=False))
        measurement = random.integers(0, 9, len(row))
        known = SimpleNamespace(
            row=row, measurement=measurement, log_weight=random.normal(-2, 2, len(row))
        )
        log_missed, log_new = -random.exponential(1, len(track)), -random.exponential(1, 9)

        def work(table=table, problem=(known, log_missed, log_new)):
            limits = {"max_hypotheses": cap, "negligible": negligible}
            apart, dropped = branch(table, *problem, clustering=True, **limits)
            whole = replace(table, cluster=np.zeros_like(table.cluster))
            one, more = branch(whole, *problem, clustering=False, **limits)
            return [*apart.columns(), *one.columns()], (dropped, more)

        (fast, counted), (plain, plainly) = on_both(monkeypatch, work)
        assert counted == plainly
        for one, other in zip(fast, plain, strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)
        apart = table.clusters + 9 - len(np.unique(measurement))
        joins += int(fast[0][-1]) + 1 < apart
    assert joins == 5 or ties < 30


@pytest.mark.parametrize("widened", [False, True])
def test_lines_of_sight_as_plain(monkeypatch, widened):
    """Near and far boxes, a box around the sensor, one too thin to hold a bearing's centre."""
    random = np.random.default_rng(5)
    centre = np.concatenate([random.normal(0, 30, (400, 2)), [[0.5, 0.2], [900.0, 1.0]]])
    box = np.concatenate([np.zeros((402, 1)), random.uniform(0.5, 12, (402, 4))], axis=1)
    box[-2:, 1:3] = [[6.0, 6.0], [0.3, 0.3]]
    widen = random.exponential(1.0, 402) if widened else None
    pose = np.array([0.3, -0.2, 2.0])
    fast, plain = on_both(monkeypatch, lambda: box_rays(pose, centre, box, widen))
    count = np.diff(plain.first)
    assert (count == 0).any()
    assert (count == 1).any()
    assert count.max() > 50
    for name in ("first", "bearing", "margin", "cores"):
        np.testing.assert_array_equal(getattr(fast, name), getattr(plain, name))
    np.testing.assert_allclose(fast.distance, plain.distance, rtol=1e-9)
