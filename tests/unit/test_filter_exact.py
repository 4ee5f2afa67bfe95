"""One update of the filter against a plain enumeration of all data associations, and the cases in
which public implementations of this filter have been found wrong."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from filter_problems import KEEP_ALL, bernoullis, plain_sensor, scan_of
from scipy.stats import multivariate_normal

from pmbm.filter import ConstantVelocity
from pmbm.filter.association import associate
from pmbm.filter.density import Density, Globals, Mixture
from pmbm.filter.estimation import marginals
from pmbm.filter.hypotheses.branching import best_children
from pmbm.filter.hypotheses.clusters import joined, merge_equal
from pmbm.filter.prediction import Transition, predict
from pmbm.filter.reduction import reduce
from pmbm.filter.update import update

H = np.eye(2, 4)
SENSOR = plain_sensor(np.diag([0.2, 0.3]), 0.8, 0.01)
P1 = np.diag([2.0, 1.0, 3.0, 4.0])


def limits(**changes):
    return replace(KEEP_ALL, **changes)


def mixture(weight, mean, cov):
    return Mixture(np.log(np.asarray(weight, float)), np.asarray(mean, float), np.asarray(cov))


def density(ppp, tracks, hypotheses, clusters=None):
    """tracks: per track a list of (r, mean, cov); hypotheses: (weight, {track: which of them})."""
    rows = [(t, n) for t, options in enumerate(tracks) for n in range(len(options))]
    row_of = {key: i for i, key in enumerate(rows)}
    start, member = [0], []
    for _, chosen in hypotheses:
        member += [row_of[item] for item in sorted(chosen.items())]
        start.append(len(member))
    values = [tracks[t][n] for t, n in rows]
    return Density(
        undetected=ppp,
        local=bernoullis(
            [t for t, _ in rows],
            [v[0] for v in values],
            [v[1] for v in values],
            [v[2] for v in values],
        ),
        hypotheses=Globals(
            np.array(clusters if clusters else [0] * len(hypotheses), np.intp),
            np.log([w for w, _ in hypotheses]),
            np.array(start, np.intp),
            np.array(member, np.intp),
        ),
        track_id=np.arange(len(tracks), dtype=np.int64),
        detections_seen=len(tracks),
    )


def step(prior, z, sensor=SENSOR, gate=1e12, k=10**15, clustering=False):
    scan = scan_of(z)
    kept = limits(gate=gate, max_hypotheses=k, clustering=clustering)
    found = associate(prior, scan, sensor, kept)
    return update(prior, scan, found, sensor)


def as_sets(density, digits=9):
    """{global hypothesis: weight}, each a set of (track id, r, mean, cov) rounded; clusters are
    multiplied out."""
    local, table = density.local, density.hypotheses

    def key(row):
        numbers = (local.existence[row], *local.mean[row], *local.cov[row].ravel())
        return (int(density.track_id[local.track[row]]), *np.round(numbers, digits) + 0.0)

    result = {frozenset(): 1.0}
    for cluster in range(table.clusters):
        rows = np.flatnonzero(table.cluster == cluster)
        own = [
            (
                frozenset(key(i) for i in table.member[table.start[g] : table.start[g + 1]]),
                math.exp(table.log_weight[g]),
            )
            for g in rows
        ]
        product = {}
        for (a, wa), (b, wb) in itertools.product(result.items(), own):
            product[a | b] = product.get(a | b, 0.0) + wa * wb
        result = product
    return result


def enumerate_all(ppp, tracks, hypotheses, z, sensor, digits=9):
    """Bayes' rule by listing, for every parent, every assignment of measurements to its tracks or
    to nothing: the equations of the update, one at a time, with scipy's densities."""
    P_D, R = sensor.detection.probability, sensor.R
    new = []
    for j, one in enumerate(z):
        parts = []
        for w, m, P in zip(np.exp(ppp.log_weight), ppp.mean, ppp.cov, strict=True):
            S = H @ P @ H.T + R
            K = P @ H.T @ np.linalg.inv(S)
            parts.append(
                (
                    w * P_D * multivariate_normal.pdf(one, H @ m, S),
                    m + K @ (one - H @ m),
                    P - K @ S @ K.T,
                )
            )
        e = sum(p[0] for p in parts)
        mean = sum(p[0] * p[1] for p in parts) / e
        cov = sum(p[0] * (p[2] + np.outer(p[1] - mean, p[1] - mean)) for p in parts) / e
        new.append((e + sensor.clutter, (len(tracks) + j, e / (e + sensor.clutter), mean, cov)))

    def key(item):
        track, r, mean, cov = item
        return (track, *np.round((r, *mean, *np.asarray(cov).ravel()), digits) + 0.0)

    result = {}
    for weight, chosen in hypotheses:
        names = sorted(chosen)
        for taken in itertools.product([None, *names], repeat=len(z)):
            used = [t for t in taken if t is not None]
            if len(set(used)) < len(used):
                continue
            w, rows = weight, []
            for track in names:
                r, m, P = tracks[track][chosen[track]]
                m, P = np.asarray(m, float), np.asarray(P, float)
                if track in used:
                    one = z[taken.index(track)]
                    S = H @ P @ H.T + R
                    K = P @ H.T @ np.linalg.inv(S)
                    w *= r * P_D * multivariate_normal.pdf(one, H @ m, S)
                    rows.append((track, 1.0, m + K @ (one - H @ m), P - K @ S @ K.T))
                else:
                    w *= 1 - r * P_D
                    rows.append((track, r * (1 - P_D) / (1 - r * P_D), m, P))
            for j, track in enumerate(taken):
                if track is None:
                    w *= new[j][0]
                    rows.append(new[j][1])
            result[frozenset(map(key, rows))] = w
    total = sum(result.values())
    return {rows: w / total for rows, w in result.items()}


def random_problem(seed, tracks=3, parents=3, measurements=3):
    rng = np.random.default_rng(seed)

    def covariance():
        A = rng.normal(size=(4, 4))
        return A @ A.T / 4 + 0.3 * np.eye(4)

    made = [
        [(rng.uniform(0.2, 1.0), rng.normal(0, 1.5, 4), covariance()) for _ in range(2)]
        for _ in range(tracks)
    ]
    rows = {}
    while len(rows) < parents:
        chosen = {t: int(rng.integers(2)) for t in range(tracks) if rng.random() < 0.8}
        rows[tuple(sorted(chosen.items()))] = chosen
    weights = rng.dirichlet(np.ones(parents))
    ppp = mixture(
        rng.uniform(0.1, 1, 2), rng.normal(0, 2, (2, 4)), [covariance() * 4 for _ in range(2)]
    )
    hypotheses = list(zip(weights, rows.values(), strict=True))
    return ppp, made, hypotheses, rng.normal(0, 1.5, (measurements, 2))


def assert_same(got, expected):
    assert got.keys() == expected.keys()
    for rows in expected:
        assert got[rows] == pytest.approx(expected[rows], rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("seed", range(8))
def test_an_update_is_bayes_rule_over_all_associations(seed):
    """Several parents of unequal existence: weights between parents are right only if each keeps
    the product of 1 - r P_D of its own missed tracks."""
    ppp, tracks, hypotheses, z = random_problem(seed)
    expected = enumerate_all(ppp, tracks, hypotheses, z, SENSOR)
    assert_same(as_sets(step(density(ppp, tracks, hypotheses), z)), expected)


@pytest.mark.parametrize("seed", range(4))
def test_the_best_children_are_the_best_of_all(seed, assignment_kernel):
    ppp, tracks, hypotheses, z = random_problem(seed, parents=1)
    expected = enumerate_all(ppp, tracks, hypotheses, z, SENSOR)
    prior = density(ppp, tracks, hypotheses)
    best = sorted(expected.values(), reverse=True)[:7]
    kept = as_sets(step(prior, z, k=7))
    assert sorted(kept.values(), reverse=True) == pytest.approx(np.array(best) / sum(best))
    assert kept.keys() <= expected.keys()


def test_a_parent_gets_children_in_proportion_to_its_weight():
    ppp, tracks, hypotheses, z = random_problem(3)
    prior = density(ppp, tracks, hypotheses)
    found = associate(prior, scan_of(z), SENSOR, limits(max_hypotheses=10, clustering=True))
    weights = found.known, found.log_missed, found.log_new
    one_cluster, allowed = np.zeros(len(z), np.intp), np.array([10])
    children = best_children(prior.hypotheses, one_cluster, *weights, allowed, -np.inf)
    count = np.bincount(children.parent, minlength=3)
    quota = [math.ceil(10 * w) for w, _ in hypotheses]
    assert (count <= quota).all()
    assert count.sum() > 3


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_clusters_on_and_off_give_the_same_density(seed, monkeypatch):
    """Four steps of two groups that stay apart and one that comes and goes, caps inactive."""
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.largest_table", lambda _: 10**12)
    rng = np.random.default_rng(seed)
    ppp = mixture([0.5], np.zeros((1, 4)), np.diag([900.0, 900.0, 4.0, 4.0])[None])
    starts = {False: Density.initial(ppp, clustering=False), True: Density.initial(ppp)}
    F, Q = ConstantVelocity(acceleration_density=0.1).transition(0.5)
    outcomes = {}
    scans = []
    for _ in range(4):
        z = np.array([[-20, 0], [20, 0]]) + rng.normal(0, 0.4, (2, 2))
        if rng.random() < 0.6:
            z = np.concatenate([z, np.array([[-20, 1.2]]) + rng.normal(0, 0.3, (1, 2))])
        scans.append(rng.permutation(z))
    for clustering, now in starts.items():
        for number, z in enumerate(scans):
            if number:
                birth = mixture([0.1], np.zeros((1, 4)), np.diag([900.0, 900.0, 4.0, 4.0])[None])
                now = predict(now, Transition(F, Q, 0.97), birth)
            now = step(now, z, gate=20.0, clustering=clustering)
            now, _ = reduce(now, limits(clustering=clustering))
        outcomes[clustering] = now
    assert outcomes[True].hypotheses.clusters > 1
    assert_same(as_sets(outcomes[True]), as_sets(outcomes[False]))
    assert np.allclose(
        marginals(outcomes[True]).existence, marginals(outcomes[False]).existence, atol=1e-12
    )


def test_a_measurement_joins_clusters_and_a_clear_one_lets_them_part():
    ppp = mixture([0.1], np.zeros((1, 4)), np.diag([100.0, 100, 1, 1])[None])
    P = np.diag([0.5, 0.5, 1.0, 1.0])
    tracks = [[(0.9, [-1.5, 0, 0, 0], P)], [(0.8, [1.5, 0, 0, 0], P)]]
    prior = density(ppp, tracks, [(1.0, {0: 0}), (1.0, {1: 0})], clusters=[0, 1])
    after = step(prior, [[0.0, 0.0]], gate=20.0, clustering=True)
    assert after.hypotheses.clusters == 1
    assert len(after.hypotheses) == 3
    expected = enumerate_all(ppp, tracks, [(1.0, {0: 0, 1: 0})], np.zeros((1, 2)), SENSOR)
    assert_same(as_sets(after), expected)
    sure, _ = reduce(after, limits(clustering=True, prune_hypothesis=0.6))
    assert sure.hypotheses.clusters == len(sure.track_id) >= 2


def product_of(*tables):
    """A mixture over several groups of tracks as one table: every combination of their rows."""
    return [
        (math.prod(w for w, _ in rows), {t: n for _, chosen in rows for t, n in chosen.items()})
        for rows in itertools.product(*tables)
    ]


def test_a_table_that_factors_is_taken_apart_exactly():
    """Two groups of two tracks, dependent inside and independent of each other, and a group whose
    tracks exclude each other: three clusters, the same mixture."""
    tracks = [[(0.5 + 0.1 * n, [t, n, 0, 0], P1) for n in range(3)] for t in range(6)]
    one = [(0.5, {0: 0, 1: 0}), (0.3, {0: 1, 1: 1}), (0.2, {0: 2})]
    two = [(0.6, {2: 0, 3: 1}), (0.4, {2: 1, 3: 0})]
    three = [(0.7, {4: 0}), (0.3, {5: 1})]
    prior = density(Mixture.empty(), tracks, product_of(one, two, three))
    after, _ = reduce(prior, limits(clustering=True, split_below=1e-9))
    assert after.hypotheses.clusters == 3
    assert len(after.hypotheses) == 3 + 2 + 2
    assert_same(as_sets(after), as_sets(prior))
    kept, _ = reduce(prior, limits(clustering=True, split_below=0.0))
    assert kept.hypotheses.clusters == 1
    tied = [(w * (1.5 if c[0] == 0 and 4 in c else 0.8), c) for w, c in product_of(one, two, three)]
    total = sum(w for w, _ in tied)
    whole, _ = reduce(
        density(Mixture.empty(), tracks, [(w / total, c) for w, c in tied]),
        limits(clustering=True, split_below=1e-3),
    )
    assert whole.hypotheses.clusters == 2


def test_a_crowd_in_one_cluster_does_bounded_work(monkeypatch):
    monkeypatch.setattr("pmbm.filter.hypotheses.clusters.largest_table", lambda _: 60)
    rng = np.random.default_rng(0)
    tracks = [[(0.6, [x, 0, 0, 0], P1)] for x in range(12)]
    prior = density(Mixture.empty(), tracks, [(1.0, dict.fromkeys(range(12), 0))])
    z = np.column_stack([rng.uniform(0, 11, 12), rng.normal(0, 1, 12)])
    after = step(prior, z, gate=20.0, k=1000, clustering=True)
    assert len(after.hypotheses) <= 6
    reduced, _ = reduce(after, limits(clustering=True, max_hypotheses=1000))
    assert len(reduced.hypotheses.member) <= 60


@pytest.mark.parametrize("limit", [5, 35, 36, 100])
def test_joining_large_clusters_keeps_the_best_of_their_product(limit):
    rng = np.random.default_rng(5)
    P = np.diag([0.5, 0.5, 1.0, 1.0])
    tracks = [[(0.5 + 0.01 * n, [s, 0, 0, 0], P) for n in range(6)] for s in (-1.0, 1.0)]
    weights = rng.dirichlet(np.ones(6), 2)
    hypotheses = [(weights[t, n], {t: n}) for t in range(2) for n in range(6)]
    prior = density(Mixture.empty(), tracks, hypotheses, clusters=[0] * 6 + [1] * 6)
    kept = limits(gate=50.0, max_hypotheses=limit, clustering=True)
    found = associate(prior, scan_of([0.0, 0.0]), SENSOR, kept)
    expected = np.sort(np.outer(*weights).ravel())[::-1][:limit]
    pairs = found.known.row, found.known.measurement
    parents, _ = joined(prior.hypotheses, len(prior.local), *pairs, 1, limit)
    assert np.allclose(np.sort(np.exp(parents.log_weight))[::-1], expected, rtol=1e-12)


# --- mistakes found in public implementations -----------------------------------------------------


def test_likelihood_is_taken_at_the_predicted_mean():
    prior = density(Mixture.empty(), [[(0.7, [1.0, 2.0, 0, 0], P1)]], [(1.0, {0: 0})])
    z = np.array([[2.5, 1.0]])
    found = associate(
        prior, scan_of(z), SENSOR, limits(gate=99.0, max_hypotheses=9, clustering=True)
    )
    S = np.diag([2.2, 1.3])
    expected = math.log(0.7 * 0.8) + multivariate_normal.logpdf(z[0], [1, 2], S)
    assert found.known.log_weight == pytest.approx([expected], abs=1e-12)


def test_undetected_intensity_shrinks_by_the_missed_share():
    ppp = mixture([0.5, 2.0], np.zeros((2, 4)), np.stack([P1, P1]))
    after = step(density(ppp, [], [(1.0, {})]), [[0.0, 0.0]])
    assert np.exp(after.undetected.log_weight) == pytest.approx([0.1, 0.4])


def test_a_measurement_far_from_all_births_may_still_be_clutter():
    far = mixture([0.5], [[500.0, 0, 0, 0]], P1[None])
    prior = density(far, [[(0.7, [1.0, 2.0, 0, 0], P1)]], [(1.0, {0: 0})])
    after = step(prior, [[1.5, 2.0]], gate=20.0)
    weights = np.exp(after.hypotheses.log_weight)
    S = np.diag([2.2, 1.3])
    taken = 0.7 * 0.8 * multivariate_normal.pdf([0.5, 0.0], [0, 0], S)
    clutter = (1 - 0.7 * 0.8) * 0.01
    assert sorted(weights) == pytest.approx(sorted([taken, clutter] / (taken + clutter)))


def test_a_measurement_in_one_gate_alone_may_be_a_new_object_or_clutter():
    ppp = mixture([0.2], np.zeros((1, 4)), np.diag([100.0, 100, 1, 1])[None])
    prior = density(ppp, [[(1.0, [1.0, 2.0, 0, 0], P1)]], [(1.0, {0: 0})])
    for clustering in (False, True):
        after = step(prior, [[1.5, 2.0]], gate=20.0, clustering=clustering)
        assert len(after.hypotheses) == 2
        assert {len(rows) for rows in as_sets(after)} == {1, 2}


@pytest.mark.parametrize("recycle", [True, False])
def test_recycling_keeps_the_expected_number_of_objects(recycle):
    tracks = [
        [(0.004, [0, 0, 0, 0], P1), (0.9, [0, 0, 1, 0], P1)],
        [(0.5, [5, 0, 0, 0], P1), (0.002, [5, 0, 1, 0], P1)],
    ]
    hypotheses = [(0.6, {0: 0, 1: 0}), (0.3, {0: 1, 1: 1}), (0.1, {0: 0, 1: 1})]
    prior = density(mixture([0.3], np.zeros((1, 4)), P1[None]), tracks, hypotheses)

    def expected_objects(density):
        ppp = np.exp(density.undetected.log_weight).sum()
        return ppp + (density.hypothesis_probability() * density.local.existence).sum()

    after, counted = reduce(prior, limits(recycle_below=0.01, recycle=recycle))
    assert counted.locals_recycled == 2
    assert set(np.round(after.local.existence, 3)) == {0.9, 0.5}
    moved = 0.7 * 0.004 + 0.4 * 0.002
    lost = 0.0 if recycle else moved
    assert expected_objects(after) == pytest.approx(expected_objects(prior) - lost, rel=1e-12)
    if recycle:
        weights = np.exp(after.undetected.log_weight)
        assert weights == pytest.approx([0.3, 0.7 * 0.004, 0.4 * 0.002])


@pytest.mark.parametrize("other", [{0: 0, 1: 1}, {1: 1}], ids=["all", "one"])
def test_a_pruned_bernoulli_leaves_its_global_hypotheses_standing(other):
    tracks = [[(0.004, [0, 0, 0, 0], P1)], [(0.5, [5, 0, 0, 0], P1), (0.8, [5, 0, 1, 0], P1)]]
    hypotheses = [(0.6, {0: 0, 1: 0}), (0.4, other)]
    after, _ = reduce(density(Mixture.empty(), tracks, hypotheses), limits(recycle_below=0.01))
    assert np.exp(after.hypotheses.log_weight) == pytest.approx([0.6, 0.4])
    assert after.track_id.tolist() == [1]


def test_hypotheses_that_become_equal_add_their_weights():
    tracks = [[(0.004, [0, 0, 0, 0], P1), (0.003, [0, 0, 1, 0], P1)], [(0.5, [5, 0, 0, 0], P1)]]
    hypotheses = [(0.5, {0: 0, 1: 0}), (0.3, {0: 1, 1: 0}), (0.2, {1: 0})]
    after, counted = reduce(
        density(Mixture.empty(), tracks, hypotheses), limits(recycle_below=0.01)
    )
    assert counted.hypotheses_merged == 2
    assert np.exp(after.hypotheses.log_weight) == pytest.approx([1.0])


def test_rows_that_differ_by_any_one_member_are_not_equal():
    tracks = [[(0.9, [t, 0, 0, 0], P1)] for t in range(6)]
    subsets = [dict.fromkeys(s, 0) for n in range(7) for s in itertools.combinations(range(6), n)]
    prior = density(Mixture.empty(), tracks, [(1 / len(subsets), s) for s in subsets])
    after, counted = reduce(prior, KEEP_ALL)
    assert counted.hypotheses_merged == 0
    assert len(after.hypotheses) == 64
    # Nothing was taken out, so the reduction had no reason to look; looked at, they still differ.
    assert len(merge_equal(prior.hypotheses)) == 64


def test_pruning_and_capping_share_out_the_weight():
    tracks = [[(0.9, [n, 0, 0, 0], P1) for n in range(5)]]
    weights = [0.4, 0.3, 0.2, 0.06, 0.04]
    prior = density(Mixture.empty(), tracks, [(w, {0: n}) for n, w in enumerate(weights)])
    after, counted = reduce(prior, limits(prune_hypothesis=0.05, max_hypotheses=3))
    assert (counted.hypotheses_pruned, counted.hypotheses_capped) == (1, 1)
    assert np.exp(after.hypotheses.log_weight) == pytest.approx(np.array(weights[:3]) / 0.9)
    best, _ = reduce(prior, limits(prune_hypothesis=0.5))
    assert np.exp(best.hypotheses.log_weight) == pytest.approx([1.0])


def test_too_many_tracks_are_moved_back_the_weakest_first():
    tracks = [[(r, [n, 0, 0, 0], P1)] for n, r in enumerate([0.9, 0.2, 0.7, 0.4])]
    prior = density(Mixture.empty(), tracks, [(1.0, dict.fromkeys(range(4), 0))])
    after, counted = reduce(prior, limits(max_tracks=2))
    assert counted.tracks_capped == 2
    assert after.track_id.tolist() == [0, 2]
    assert np.exp(after.undetected.log_weight) == pytest.approx([0.2, 0.4])


def test_existence_and_weight_of_a_miss_come_from_the_same_prior():
    prior = density(
        Mixture.empty(),
        [[(0.5, [0, 0, 0, 0], P1), (0.9, [0, 0, 1, 0], P1)]],
        [(0.5, {0: 0}), (0.5, {0: 1})],
    )
    after = step(prior, np.zeros((0, 2)))
    assert after.local.existence == pytest.approx([0.5 * 0.2 / 0.6, 0.9 * 0.2 / 0.28])
    assert np.exp(after.hypotheses.log_weight) == pytest.approx([0.6 / 0.88, 0.28 / 0.88])


def test_no_detection_possible_leaves_weights_and_existence():
    ppp, tracks, hypotheses, z = random_problem(1)
    blind = plain_sensor(SENSOR.R, 0.0, SENSOR.clutter)
    prior = density(ppp, tracks, hypotheses)
    after = step(prior, z, blind)
    assert after.hypotheses.log_weight == pytest.approx(prior.hypotheses.log_weight, abs=1e-12)
    old = after.track_id[after.local.track] < len(tracks)
    used = np.unique(prior.hypotheses.member)
    assert after.local.existence[old] == pytest.approx(prior.local.existence[used], abs=0)
    assert (after.local.existence[~old] == 0).all()
    assert after.undetected.log_weight == pytest.approx(ppp.log_weight, abs=0)


def test_certain_detection_that_fails_to_come_ends_a_track():
    prior = density(Mixture.empty(), [[(1.0, [0, 0, 0, 0], P1)]], [(1.0, {0: 0})])
    after = step(prior, np.zeros((0, 2)), plain_sensor(SENSOR.R, 1.0, 0.0))
    assert np.isfinite(after.hypotheses.log_weight).all()
    assert after.local.existence.tolist() == [0.0]


def test_without_clutter_and_births_an_unexplained_measurement_does_no_harm():
    prior = density(Mixture.empty(), [[(0.9, [0, 0, 0, 0], P1)]], [(1.0, {0: 0})])
    quiet = plain_sensor(SENSOR.R, 0.9, 0.0)
    after = step(prior, [[300.0, 0.0]], quiet, gate=20.0, clustering=True)
    assert np.isfinite(after.hypotheses.log_weight).all()
    assert (after.local.existence <= 1).all()
    reduced, _ = reduce(after, limits(recycle_below=1e-3, clustering=True))
    assert reduced.track_id.tolist() == [0]


def test_a_sole_object_in_clutter_is_followed_as_by_ipda():
    """Musicki, Evans & Stankovic, IEEE TAC 39(6) 1994, with a gate that holds everything."""
    r, P_D, clutter = 0.6, 0.8, 0.05
    mean, P = np.array([1.0, -1.0, 0.5, 0.0]), np.diag([1.0, 2.0, 0.5, 0.5])
    z = np.array([[1.3, -0.5], [3.0, -2.0], [0.0, 0.5]])
    S = H @ P @ H.T + SENSOR.R
    ratio = P_D * multivariate_normal.pdf(z, H @ mean, S) / clutter
    evidence = 1 - P_D + ratio.sum()
    expected_r = evidence * r / (1 - r + evidence * r)
    beta = np.array([1 - P_D, *ratio]) / evidence
    K = P @ H.T @ np.linalg.inv(S)
    expected_mean = mean + K @ (beta[1:] @ (z - H @ mean))

    prior = density(Mixture.empty(), [[(r, mean, P)]], [(1.0, {0: 0})])
    after = step(prior, z, plain_sensor(SENSOR.R, P_D, clutter))
    mass = after.hypothesis_probability() * after.local.existence
    own = after.local.track == 0
    assert mass[own].sum() == pytest.approx(expected_r, rel=1e-12)
    fused = (mass[own, None] * after.local.mean[own]).sum(axis=0) / mass[own].sum()
    assert fused == pytest.approx(expected_mean, rel=1e-12)
    assert mass[~own].sum() == 0
