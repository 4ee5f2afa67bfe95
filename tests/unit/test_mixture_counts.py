"""Intensity and expected count of a Gaussian mixture, against scipy and by sampling."""

import numpy as np
import pytest
from scipy import stats

from pmbm import InputError
from pmbm.geometry import normal_in_polygon, points_in_polygon
from pmbm.types import GaussianMixture

CONCAVE = np.array([[-6, -4], [7, -5], [2, 0], [8, 6], [-3, 4], [-1, 0.5]], dtype=float)


def mixture(components=5, seed=0):
    rng = np.random.default_rng(seed)
    root = rng.normal(0, 1.5, (components, 4, 4))
    return GaussianMixture(
        log_weight=np.log(rng.uniform(0.1, 2, components)),
        mean=rng.normal(0, 4, (components, 4)),
        cov=root @ root.transpose(0, 2, 1) + 0.05 * np.eye(4),
    )


def test_the_intensity_is_scipys():
    m = mixture()
    points = np.random.default_rng(1).uniform(-10, 10, (40, 2))
    want = sum(
        np.exp(w) * stats.multivariate_normal(mean[:2], cov[:2, :2]).pdf(points)
        for w, mean, cov in zip(m.log_weight, m.mean, m.cov, strict=True)
    )
    np.testing.assert_allclose(m.intensity(points), want, rtol=1e-10)
    assert m.intensity(np.zeros((0, 2))).shape == (0,)
    assert GaussianMixture.empty().intensity(points).tolist() == [0.0] * 40


@pytest.mark.parametrize("clockwise", [False, True])
def test_the_count_in_a_box_is_scipys(clockwise):
    m = mixture(seed=2)
    box = np.array([[-3, -2], [4, -2], [4, 5], [-3, 5]], dtype=float)
    want = sum(
        np.exp(w)
        * stats.multivariate_normal(mean[:2], cov[:2, :2]).cdf([4, 5], lower_limit=[-3, -2])
        for w, mean, cov in zip(m.log_weight, m.mean, m.cov, strict=True)
    )
    assert m.expected_count(box[::-1] if clockwise else box) == pytest.approx(want, rel=1e-6)


def test_the_count_in_any_polygon_is_the_share_of_samples():
    m = mixture(seed=3)
    rng = np.random.default_rng(4)
    inside = normal_in_polygon(CONCAVE, m.mean[:, :2], m.cov[:, :2, :2])
    for share, mean, cov in zip(inside, m.mean, m.cov, strict=True):
        n = 100_000
        hits = points_in_polygon(rng.multivariate_normal(mean[:2], cov[:2, :2], n), CONCAVE).sum()
        low, high = stats.binom.interval(1 - 1e-5, n, share)
        assert low <= hits <= high


def test_the_parts_of_a_region_add_up_and_the_whole_plane_holds_all():
    m = mixture(seed=5)
    total = np.exp(m.log_weight).sum()
    plane = 1e4 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert m.expected_count(plane) == pytest.approx(total, rel=1e-13)
    left = np.array([[-6, -4], [-1, 0.5], [2, 0], [7, -5]])
    right = np.array([[-1, 0.5], [-3, 4], [8, 6], [2, 0]])
    parts = m.expected_count(left) + m.expected_count(right)
    assert parts == pytest.approx(m.expected_count(CONCAVE), rel=1e-12)


def test_a_corner_on_the_mean_and_a_point_mass():
    quadrant = np.array([[0, 0], [100, 0], [100, 100], [0, 100]], dtype=float)
    assert normal_in_polygon(quadrant, np.zeros((1, 2)), np.eye(2)[None])[0] == pytest.approx(0.25)
    point = GaussianMixture(
        log_weight=[np.log(0.5), -np.inf],
        mean=[[1, 1, 0, 0], [2, 2, 0, 0]],
        cov=np.zeros((2, 4, 4)),
    )
    assert point.expected_count(quadrant) == pytest.approx(0.5)
    assert point.expected_count(quadrant - 200) == 0


@pytest.mark.parametrize("polygon", [[[0, 0], [1, 1]], [0, 1, 2], [[0, 0], [1, np.nan], [1, 1]]])
def test_what_is_no_polygon_is_refused(polygon):
    with pytest.raises(InputError, match="polygon"):
        mixture().expected_count(polygon)
