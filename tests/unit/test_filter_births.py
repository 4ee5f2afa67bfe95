"""Births that come again and again at one place."""

from __future__ import annotations

import numpy as np
import pytest

from pmbm import Site
from pmbm.filter import BroadBirth, ConstantVelocity
from pmbm.filter.density import Density, Mixture
from pmbm.filter.models.birth import spread_over
from pmbm.filter.models.view import View
from pmbm.filter.prediction import Transition, predict


def spread(x=0.0):
    return spread_over(View.of(Site(max_range=50.0), np.array([x, 0.0, 0.0])), 7, 10.0)


def second_moment(mixture: Mixture) -> np.ndarray:
    weight = np.exp(mixture.log_weight)
    outer = mixture.mean[:, :, None] * mixture.mean[:, None, :]
    return np.einsum("p,pij->ij", weight, mixture.cov + outer)


def after(steps, merge, places):
    density = Density.initial(spread(places(0)))
    F, Q = ConstantVelocity(acceleration_density=2.0).transition(0.1)
    birth = BroadBirth(merge_below=1.0 if merge else 0.0)
    for step in range(1, steps + 1):
        births = spread(places(step))
        density = predict(density, Transition(F, Q, 0.97), births, birth)
    return density.undetected


def test_merged_births_keep_weight_mean_and_covariance():
    merged, apart = (after(5, merge, lambda step: 0.0) for merge in (True, False))
    assert (len(merged), len(apart)) == (7, 42)
    weight = np.exp(apart.log_weight)
    assert np.exp(merged.log_weight).sum() == pytest.approx(weight.sum(), rel=1e-12)
    np.testing.assert_allclose(
        np.exp(merged.log_weight) @ merged.mean, weight @ apart.mean, rtol=1e-12, atol=1e-9
    )
    np.testing.assert_allclose(second_moment(merged), second_moment(apart), rtol=1e-12)


def test_births_elsewhere_are_components_of_their_own():
    assert len(after(3, True, lambda step: float(step))) == 28
