"""What splitting, merging and capping the map of undetected objects must not change."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pmbm import Site
from pmbm.filter.density import Mixture
from pmbm.filter.models.undetected_map import WIDEST, capped, merged_by_cell, narrowed, reduce_map
from pmbm.filter.models.view import View


@st.composite
def mixtures(draw, widest=12.0, reach=30.0):
    n = draw(st.integers(0, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size = rng.uniform(0.1, widest, (n, 4, 1))
    root = rng.normal(0, 0.5, (n, 4, 4)) * size
    return Mixture(
        rng.uniform(-12, 1, n), rng.uniform(-reach, reach, (n, 4)), root @ root.transpose(0, 2, 1)
    )


def same_moments(a, b):
    weights = [np.exp(m.log_weight) for m in (a, b)]
    assert weights[1].sum() == pytest.approx(weights[0].sum(), rel=1e-10)
    first = [w @ m.mean for w, m in zip(weights, (a, b), strict=True)]
    np.testing.assert_allclose(first[1], first[0], rtol=1e-8, atol=1e-8)
    second = [
        np.einsum("p,pij->ij", w, m.cov + m.mean[:, :, None] * m.mean[:, None, :])
        for w, m in zip(weights, (a, b), strict=True)
    ]
    np.testing.assert_allclose(second[1], second[0], rtol=1e-8, atol=1e-6)


@given(mixtures())
def test_splitting_keeps_moments_and_leaves_nothing_wide(mixture):
    narrow = narrowed(mixture)
    same_moments(mixture, narrow)
    assert (np.linalg.eigvalsh(narrow.cov[:, :2, :2]) <= WIDEST**2 * (1 + 1e-6)).all()
    if len(narrow):
        assert np.linalg.eigvalsh(narrow.cov).min() > -1e-6


@given(mixtures(widest=3.0, reach=6.0), st.floats(0, 0.5))
def test_merging_keeps_moments(mixture, fine_above):
    merged = merged_by_cell(mixture, 3.5, fine_above)
    same_moments(mixture, merged)
    cells = {tuple(cell) for cell in np.floor(mixture.mean[:, :2] / 3.5).tolist()}
    assert len(merged) <= 9 * len(cells)
    assert len(merged_by_cell(mixture, 3.5, np.inf)) == len(cells)


@given(mixtures(), st.integers(1, 6))
def test_capping_keeps_moments(mixture, most):
    few = capped(mixture, most)
    same_moments(mixture, few)
    assert len(few) == min(most, len(mixture))


@given(mixtures(reach=60.0), st.floats(0, 0.1))
def test_settling_says_what_it_dropped(mixture, negligible):
    view = View.of(Site(max_range=40.0), np.zeros(3))
    settled, dropped = reduce_map(
        mixture, view, 3.5, most=50, negligible=negligible, fine_above=0.1
    )
    left = np.exp(settled.log_weight).sum()
    total = np.exp(mixture.log_weight).sum()
    assert left + dropped == pytest.approx(total, rel=1e-9)
    assert len(settled) <= 50


@pytest.mark.parametrize("sd", [2.6, 11.0])
def test_a_split_component_has_the_shape_of_the_whole(sd):
    cov = np.diag([sd**2, 0.5, 9.0, 4.0])
    cov[0, 2] = cov[2, 0] = 4.0
    whole = Mixture(np.zeros(1), np.zeros((1, 4)), cov[None])
    x = np.column_stack([np.linspace(-3 * sd, 3 * sd, 81), np.zeros(81)])
    parts, want = narrowed(whole), whole.public().intensity(x)
    assert len(parts) > 2
    np.testing.assert_allclose(parts.public().intensity(x), want, atol=0.06 * want.max())
    # Who is further ahead is faster: the parts carry the velocity that goes with their place.
    np.testing.assert_allclose(parts.mean[:, 2], parts.mean[:, 0] * 4.0 / sd**2, atol=1e-9)
