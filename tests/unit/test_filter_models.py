"""Motion, births, view, Gaussian algebra and the counting of objects, each by a second route."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from filter_problems import bernoullis
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.stats import ncx2

from pmbm.filter import ConstantVelocity, Survival
from pmbm.filter.density import Density, Globals, Mixture
from pmbm.filter.estimation import marginals
from pmbm.filter.estimators import (
    best_hypothesis,
    cardinality,
    map_cardinality,
    most_certain_hypothesis,
    poisson_binomial,
)
from pmbm.filter.hypotheses.clusters import components
from pmbm.filter.hypotheses.gating import gated_pairs, near
from pmbm.filter.hypotheses.gaussian import Innovation, corrected_cov, corrected_mean, gain, moments
from pmbm.filter.models.birth import spread_over
from pmbm.filter.models.view import View
from pmbm.filter.prediction import Transition, predict
from pmbm.filter.reduction import merge_mixture

seconds = st.floats(0.001, 20.0)


def covariances(seed, n=1, scale=1.0):
    A = np.random.default_rng(seed).normal(size=(n, 4, 4)) * scale
    return A @ A.transpose(0, 2, 1) + 0.1 * np.eye(4)


@pytest.mark.parametrize("dt", [0.05, 0.1, 1.0, 7.0])
def test_process_noise_is_the_continuous_one(dt):
    F, Q = ConstantVelocity(acceleration_density=2.5).transition(dt)
    expected = Q_continuous_white_noise(
        2, dt, spectral_density=2.5, block_size=2, order_by_dim=False
    )
    assert pytest.approx(expected, rel=1e-14) == Q
    assert np.array([1.0, 2.0, 3.0, 4.0]) @ F.T == pytest.approx([1 + 3 * dt, 2 + 4 * dt, 3, 4])


@given(seconds, seconds, st.floats(0.5, 1.0), st.integers(0, 99))
def test_predicting_twice_is_predicting_once(a, b, survival, seed):
    life = Survival(probability=survival, interval=0.1)

    def over(density, dt):
        F, Q = ConstantVelocity(acceleration_density=2.0).transition(dt)
        births = life.alive(dt, 0.7)
        birth = Mixture(np.array([math.log(births)]), np.zeros((1, 4)), np.eye(4)[None])
        return predict(density, Transition(F, Q, life.over(dt)), birth)

    rng = np.random.default_rng(seed)
    start = Density(
        Mixture(np.log([0.4]), rng.normal(size=(1, 4)), covariances(seed)),
        bernoullis([0], [0.8], rng.normal(size=(1, 4)), covariances(seed + 1)),
        Globals(np.zeros(1, np.intp), np.zeros(1), np.array([0, 1]), np.zeros(1, np.intp)),
        np.zeros(1, np.int64),
    )
    twice, once = over(over(start, a), b), over(start, a + b)
    assert twice.local.mean == pytest.approx(once.local.mean, rel=1e-12, abs=1e-12)
    assert twice.local.cov == pytest.approx(once.local.cov, rel=1e-12, abs=1e-12)
    assert twice.local.existence == pytest.approx(once.local.existence, rel=1e-12)
    totals = [np.exp(density.undetected.log_weight).sum() for density in (twice, once)]
    assert totals[0] == pytest.approx(totals[1], rel=1e-12)


def test_births_without_deaths_grow_with_time():
    assert Survival(probability=1.0).alive(2.0, 0.5) == 1.0
    assert Survival(probability=0.9).alive(0.0, 0.5) == 0.0
    assert Survival(probability=0.0).alive(1.0, 0.5) == 0.0
    assert Survival(probability=0.99).alive(1e6, 0.5) == pytest.approx(0.5 * 0.1 / -math.log(0.99))


@given(st.integers(0, 200))
def test_the_correction_is_filterpys(seed):
    rng = np.random.default_rng(seed)
    mean, cov = rng.normal(size=(1, 4)) * 5, covariances(seed)
    A = rng.normal(size=(2, 2))
    R = A @ A.T + 0.05 * np.eye(2)
    z = rng.normal(size=(1, 2)) * 5
    kf = KalmanFilter(dim_x=4, dim_z=2)
    kf.x, kf.P, kf.R, kf.H = mean[0].copy(), cov[0].copy(), R, np.eye(2, 4)
    kf.update(z[0])
    innovation = Innovation.of(mean, cov, R)
    W = gain(cov, innovation)
    y = innovation.whitened(z)
    after = corrected_cov(cov, W, R, innovation)
    assert corrected_mean(mean, W, y)[0] == pytest.approx(kf.x, rel=1e-9, abs=1e-9)
    assert after[0] == pytest.approx(kf.P, rel=1e-9, abs=1e-9)
    assert np.array_equal(after, after.transpose(0, 2, 1))
    log_likelihood = innovation.log_norm() - 0.5 * (y**2).sum(axis=1)
    assert log_likelihood[0] == pytest.approx(kf.log_likelihood, rel=1e-9)


@pytest.mark.parametrize("scale", [1e8, 1e-8, 0.0])
def test_ill_conditioned_covariances_stay_covariances(scale):
    cov = scale * np.ones((1, 4, 4)) + np.diag([0.0, scale, scale, 0.0])
    R = 0.09 * np.eye(2)
    innovation = Innovation.of(np.zeros((1, 4)), cov, R)
    after = corrected_cov(cov, gain(cov, innovation), R, innovation)
    assert np.array_equal(after, after.transpose(0, 2, 1))
    assert np.linalg.eigvalsh(after).min() >= -1e-9 * max(scale, 1.0)


def test_a_measurement_many_orders_better_than_the_prior_is_believed():
    """P - K S K' would leave rounding of P where R is smaller than that."""
    cov, R = np.diag([1e6, 1e6, 25.0, 25.0])[None], np.diag([1e-12, 4e-12])
    innovation = Innovation.of(np.zeros((1, 4)), cov, R)
    after = corrected_cov(cov, gain(cov, innovation), R, innovation)
    np.testing.assert_allclose(after[0, :2, :2], R, rtol=1e-9, atol=1e-24)


@given(st.integers(0, 200))
def test_the_gate_holds_whom_it_should(seed):
    """Each measurement of a covariance of its own."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 25, 2)
    mean = np.zeros((n, 4))
    mean[:, :2] = rng.normal(0, 6, (n, 2))
    cov = covariances(seed, n, scale=rng.choice([0.3, 1.0, 5.0], (n, 1, 1)))
    z, R = rng.normal(0, 6, (m, 2)), covariances(seed + 1, m)[:, :2, :2]
    pairs = gated_pairs(mean, cov, np.zeros(n), z, R, 9.0)
    S = cov[:, None, :2, :2] + R
    nu = z - mean[:, None, :2]
    d2 = np.einsum("nmi,nmij,nmj->nm", nu, np.linalg.inv(S), nu)
    expected = np.argwhere(d2 < 9.0)
    assert np.column_stack([pairs.row, pairs.measurement]).tolist() == expected.tolist()
    log_density = -0.5 * (d2 + np.log(np.linalg.det(2 * np.pi * S)))
    assert pairs.log_weight == pytest.approx(log_density[tuple(expected.T)], rel=1e-8, abs=1e-8)


def test_a_crowded_gate_loses_no_one():
    rng = np.random.default_rng(3)
    z = np.concatenate([rng.normal(0, 0.1, (400, 2)), rng.uniform(-500, 500, (600, 2))])
    centre = rng.uniform(-500, 500, (300, 2))
    centre[0] = 0.0
    radius = np.full(300, 8.0)
    radius[1] = 900.0
    row, column = near(centre, radius, z)
    distance = np.hypot(*(centre[:, None] - z).transpose(2, 0, 1))
    assert (
        np.column_stack([row, column]).tolist() == np.argwhere(distance <= radius[:, None]).tolist()
    )


@given(st.lists(st.tuples(st.integers(0, 14), st.integers(0, 9)), max_size=25))
def test_components_are_those_of_the_graph(pairs):
    cluster, measurement = np.array(sorted(set(pairs)), int).reshape(-1, 2).T
    number, of_cluster, of_measurement = components(15, 10, cluster, measurement)
    edges = csr_array((np.ones(len(cluster)), (cluster, 15 + measurement)), shape=(25, 25))
    expected_number, label = connected_components(edges, directed=False)
    got = np.concatenate([of_cluster, of_measurement])
    assert number == expected_number
    assert len(set(zip(got.tolist(), label.tolist(), strict=True))) == number
    assert set(got.tolist()) == set(range(number))
    single = np.bincount(of_cluster, minlength=number) == 1
    assert single[: single.sum()].all()
    assert (np.diff(of_cluster[single[of_cluster]]) == 1).all()


def test_mixtures_keep_their_moments():
    rng = np.random.default_rng(0)
    weight = rng.dirichlet(np.ones(3))
    mean, cov = rng.normal(size=(3, 4)), covariances(0, 3)
    centre, spread = moments(weight, mean, cov, np.array([0]))
    draws = np.concatenate(
        [
            rng.multivariate_normal(m, P, int(200_000 * w))
            for w, m, P in zip(weight, mean, cov, strict=True)
        ]
    )
    assert centre[0] == pytest.approx(draws.mean(axis=0), abs=0.05)
    assert spread[0] == pytest.approx(np.cov(draws.T), abs=0.15)


def test_merging_undetected_objects_keeps_weight_and_moments():
    rng = np.random.default_rng(1)
    wide = np.diag([400.0, 400.0, 100.0, 100.0])
    mean = np.zeros((9, 4))
    mean[:4, :2] = rng.normal(0, 3, (4, 2))
    mean[4:8, 0] = 200 + rng.normal(0, 0.1, 4)
    mean[8] = mean[0] + 0.1
    cov = np.stack([wide] * 4 + [np.eye(4)] * 5)
    before = Mixture(np.log(rng.uniform(0.1, 1, 9)), mean, cov)
    after = merge_mixture(before, 1.0)
    assert len(after) == 3

    def whole(m):
        w = np.exp(m.log_weight)
        centre, spread = moments(w / w.sum(), m.mean, m.cov, np.array([0]))
        return w.sum(), centre, spread

    for a, b in zip(whole(after), whole(before), strict=True):
        assert a == pytest.approx(b, rel=1e-12, abs=1e-9)
    assert len(merge_mixture(before, 0.0)) == 9
    # A narrow component inside a wide one keeps its place.
    assert (np.abs(after.cov[:, 0, 0] - 1.0) < 0.1).sum() == 2


@pytest.mark.parametrize("half_angle", [np.pi, 0.6])
def test_births_cover_the_view_evenly(half_angle):
    view = View(np.array([30.0, -10.0, 0.5]), 0.2, half_angle, 80.0)
    births = spread_over(view, 25, 10.0)
    assert np.exp(births.log_weight).sum() == pytest.approx(1.0)
    rng = np.random.default_rng(0)
    angle = view.pose[2] + view.centre + rng.uniform(-half_angle, half_angle, 2000)
    radius = view.max_range * np.sqrt(rng.random(2000))
    points = view.pose[:2] + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    offset = points[:, None] - births.mean[:, :2]
    s2 = births.cov[:, 0, 0]
    density = (
        np.exp(births.log_weight - 0.5 * (offset**2).sum(axis=2) / s2) / (2 * np.pi * s2)
    ).sum(axis=1) * view.area
    assert density.mean() == pytest.approx(0.8, abs=0.15)
    assert np.quantile(density, 0.1) > 0.3
    assert density.max() < 2.0
    assert view.share_inside(births.mean, births.cov).mean() > 0.7


def test_who_is_in_view():
    view = View(np.array([0.0, 0.0, np.pi / 2]), 0.0, np.pi / 4, 50.0)
    mean = np.array([[0.0, 20, 0, 0], [0, 60, 0, 0], [20, 0, 0, 0], [0, -20, 0, 0], [0, 49, 0, 0]])
    cov = np.tile(np.eye(4), (5, 1, 1))
    share = view.share_inside(mean, cov)
    assert share[:4] == pytest.approx([1, 0, 0, 0], abs=1e-6)
    assert share[4] == pytest.approx(ncx2.cdf(50**2, 2, 49**2), abs=1e-4)


def test_the_share_in_view_of_wide_births_is_that_of_their_integral():
    """Over a disc: the squared range has a noncentral chi-square distribution."""
    view = View(np.array([3.0, -4.0, 0.0]), 0.0, np.pi, 60.0)
    births = spread_over(view, 7, 10.0)
    variance = births.cov[0, 0, 0]
    square = ((births.mean[:, :2] - view.pose[:2]) ** 2).sum(axis=1)
    want = ncx2.cdf(view.max_range**2 / variance, 2, square / variance)
    assert view.share_inside(births.mean, births.cov) == pytest.approx(want, abs=0.02)


def scene(seed, tracks=4):
    """Two clusters with a few hypotheses each."""
    rng = np.random.default_rng(seed)
    H = 2 * tracks
    rows, cluster = [], []
    for c, own in enumerate(np.array_split(np.arange(tracks), 2)):
        for choice in itertools.product([0, 1, None], repeat=len(own)):
            if rng.random() < 0.5:
                rows.append(
                    [2 * t + pick for t, pick in zip(own, choice, strict=True) if pick is not None]
                )
                cluster.append(c)
    cluster = np.array(cluster, np.intp)
    weight = rng.dirichlet(np.ones(len(rows)))
    for c in range(2):
        weight[cluster == c] /= weight[cluster == c].sum()
    return Density(
        Mixture.empty(),
        bernoullis(
            np.repeat(np.arange(tracks), 2),
            rng.random(H),
            rng.normal(size=(H, 4)),
            covariances(0, H),
        ),
        Globals(
            cluster,
            np.log(weight),
            np.cumsum([0, *map(len, rows)]),
            np.array([i for row in rows for i in row], np.intp),
        ),
        np.arange(tracks, dtype=np.int64),
    )


def joint_rows(density):
    """All global hypotheses of the whole scene: (weight, members)."""
    table = density.hypotheses
    own = [
        [
            (math.exp(table.log_weight[g]), table.member[table.start[g] : table.start[g + 1]])
            for g in np.flatnonzero(table.cluster == c)
        ]
        for c in range(table.clusters)
    ]
    for parts in itertools.product(*own):
        yield math.prod(w for w, _ in parts), np.concatenate([m for _, m in parts])


@pytest.mark.parametrize("seed", range(6))
def test_cardinality_three_ways(seed):
    density = scene(seed)
    by_listing = np.zeros(5)
    by_fft = np.zeros(5)
    for weight, members in joint_rows(density):
        r = density.local.existence[members]
        for alive in itertools.product([0, 1], repeat=len(r)):
            chance = np.prod(np.where(alive, r, 1 - r))
            by_listing[sum(alive)] += weight * chance
        turn = np.exp(-2j * np.pi * np.arange(5) / 5)
        by_fft += weight * np.fft.ifft(np.prod(1 - r + r * turn[:, None], axis=1)).real
    got = cardinality(density)
    assert got == pytest.approx(by_listing[: len(got)], abs=1e-12)
    assert got == pytest.approx(by_fft[: len(got)], abs=1e-12)
    assert poisson_binomial(np.zeros(0)).tolist() == [1.0]


@pytest.mark.parametrize("seed", range(12))
def test_estimators_over_clusters_are_those_of_the_whole_scene(seed):
    density = scene(seed)
    r = density.local.existence
    rows = list(joint_rows(density))
    n = int(np.argmax(cardinality(density)))

    def top(members):
        return members[np.argsort(-r[members])[:n]]

    def value(weight, members):
        if len(members) < n:
            return -1.0
        ordered = np.sort(r[members])[::-1]
        return weight * ordered[:n].prod() * (1 - ordered[n:]).prod()

    best = max(rows, key=lambda row: row[0])[1]
    certain = max(rows, key=lambda row: row[0] * np.maximum(r[row[1]], 1 - r[row[1]]).prod())[1]
    likeliest = max(rows, key=lambda row: value(*row))[1]
    assert sorted(best_hypothesis(density, 0.4)) == sorted(best[r[best] > 0.4])
    assert sorted(most_certain_hypothesis(density)) == sorted(certain[r[certain] > 0.5])
    assert sorted(map_cardinality(density)) == sorted(top(likeliest))
    existence = np.zeros(4)
    for weight, members in rows:
        existence[density.local.track[members]] += weight * r[members]
    found = marginals(density)
    present = np.unique(density.local.track)
    assert found.existence[present] == pytest.approx(existence[present], abs=1e-12)
