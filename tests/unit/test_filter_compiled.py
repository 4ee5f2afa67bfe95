"""What is compiled in the filter against its plain twins."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from pmbm import Detections, PMBMConfig, PMBMTracker, Site, kernels
from pmbm.filter import LastingScores
from pmbm.filter.density import Mixture, RecycledFrom
from pmbm.filter.estimation import suppress_overlaps
from pmbm.filter.models.rays import box_rays
from pmbm.filter.models.undetected_map import reduce_map
from pmbm.filter.models.view import View
from pmbm.filter.reduction import merge_mixture
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
