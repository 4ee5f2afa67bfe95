"""Pairs of Gaussians and the measurements in their gates, with their likelihoods."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np

from pmbm.filter.density import Index, Mixture, summed
from pmbm.filter.hypotheses.gaussian import Innovation
from pmbm.filter.hypotheses.weights import log_of_each
from pmbm.kernels import twin
from pmbm.types import FloatArray

DENSE_BELOW = 20_000
"""Gaussians times measurements; below it, looking at every pair costs less than a tree."""
_NEIGHBOURS = 4
"""Measurements fetched per Gaussian in the first, vectorised look-up."""
_USUAL_WIDTH = 4.0
"""Reaches up to this many times the median are looked up together."""


@dataclass(frozen=True, eq=False, slots=True)
class GatedPairs:
    """Gated pairs of a Gaussian and a measurement.

    row (n,) : of the local table, or of the PPP.  measurement (n,).
    y (n,2) : whitened innovation.
    log_weight (n,) : log(r P_D N(z)) of a local hypothesis, log(w P_D N(z)) of a PPP component.
    innovation : of every Gaussian, paired or not.
    """

    row: Index
    measurement: Index
    y: FloatArray
    log_weight: FloatArray
    innovation: Innovation

    def weighted(self, log_factor: FloatArray) -> GatedPairs:
        """The same with the weights multiplied by exp(log_factor) (n,)."""
        weight = self.log_weight + log_factor
        return GatedPairs(self.row, self.measurement, self.y, weight, self.innovation)


@dataclass(frozen=True, eq=False, slots=True)
class FirstDetectionDensity:
    """Density of first detections of undetected objects, over places.

    innovation : of the PPP components.  log_height (P,) : log of w P_D times the height of N(z).
    gate : squared distance up to which a component counts.
    """

    innovation: Innovation
    log_height: FloatArray
    gate: float

    def pairs(self, z: FloatArray) -> GatedPairs:
        """Gated pairs of components and measurements z (M,2)."""
        return _paired(self.innovation, self.log_height, z, self.gate)

    def log_density(self, z: FloatArray) -> FloatArray:
        """(M,) log of the sum of w P_D N(z) over the components in whose gate z lies."""
        pairs = self.pairs(z)
        if not len(pairs.row):
            return np.full(len(z), -np.inf)
        top = pairs.log_weight.max()
        return top + log_of_each(summed(np.exp(pairs.log_weight - top), pairs.measurement, len(z)))


def gated_pairs(
    mean: FloatArray,
    cov: FloatArray,
    prior: FloatArray,
    z: FloatArray,
    R: FloatArray,
    threshold: float,
) -> GatedPairs:
    """Pairs within the gate; a Gaussian that cannot be detected (0 in `prior`, r P_D) has none."""
    innovation, row, measurement, y, log_weight = _gated(
        mean, cov, R, prior, np.ascontiguousarray(z), threshold
    )
    return GatedPairs(row, measurement, y, log_weight, Innovation(*innovation))


@twin("gated")
def _gated(
    mean: FloatArray,
    cov: FloatArray,
    R: FloatArray,
    prior: FloatArray,
    z: FloatArray,
    threshold: float,
) -> tuple[tuple[FloatArray, ...], Index, Index, FloatArray, FloatArray]:
    """The columns of the innovations, and rows, measurements, y and log weights of the pairs."""
    innovation = Innovation.of(mean, cov, R)
    pairs = _paired(innovation, log_of_each(prior) + innovation.log_norm(), z, threshold)
    return innovation.columns(), pairs.row, pairs.measurement, pairs.y, pairs.log_weight


def _paired(
    innovation: Innovation, log_height: FloatArray, z: FloatArray, threshold: float
) -> GatedPairs:
    row, measurement, y = gate(innovation, z, threshold)
    log_weight = log_height[row] - 0.5 * (y[:, 0] * y[:, 0] + y[:, 1] * y[:, 1])
    possible = log_weight > -np.inf
    if not possible.all():
        row, measurement, y = row[possible], measurement[possible], y[possible]
        log_weight = log_weight[possible]
    return GatedPairs(row, measurement, y, log_weight, innovation)


def first_detections(
    ppp: Mixture, log_detected: FloatArray, z: FloatArray, R: FloatArray, threshold: float
) -> tuple[FirstDetectionDensity, FloatArray]:
    """The PPP as first detections see it, and log e (M,).

    log_detected (P,) : log of w P_D.
    """
    innovation, log_height, log_e = _first_detections(
        ppp.mean, ppp.cov, R, log_detected, np.ascontiguousarray(z), threshold
    )
    return FirstDetectionDensity(Innovation(*innovation), log_height, threshold), log_e


@twin("first_detections")
def _first_detections(
    mean: FloatArray,
    cov: FloatArray,
    R: FloatArray,
    log_detected: FloatArray,
    z: FloatArray,
    threshold: float,
) -> tuple[tuple[FloatArray, ...], FloatArray, FloatArray]:
    """The columns of the innovations, log heights (P,), and log e (M,)."""
    innovation = Innovation.of(mean, cov, R)
    density = FirstDetectionDensity(innovation, log_detected + innovation.log_norm(), threshold)
    return innovation.columns(), density.log_height, density.log_density(z)


def gate(
    innovation: Innovation, z: FloatArray, threshold: float
) -> tuple[Index, Index, FloatArray]:
    """All pairs with squared Mahalanobis distance of the innovation below `threshold`.

    z (M,2).  Gives rows (n,) of the Gaussians, ascending, rows (n,) of the measurements, and the
    whitened innovations (n,2), whose squared length is that distance.
    """
    return _gate(*innovation.columns(), np.ascontiguousarray(z), threshold)


@twin("gate")
def _gate(
    expected: FloatArray,
    l11: FloatArray,
    l21: FloatArray,
    l22: FloatArray,
    z: FloatArray,
    threshold: float,
) -> tuple[Index, Index, FloatArray]:
    innovation = Innovation(expected, l11, l21, l22)
    if len(expected) * len(z) <= DENSE_BELOW:
        y0, y1 = innovation.whiten_all(z)
        row, column = np.nonzero(y0 * y0 + y1 * y1 < threshold)
        return row, column, np.stack([y0[row, column], y1[row, column]], axis=1)
    row, column = near(expected, innovation.reach(threshold), z)
    y = innovation.whiten(row, z[column])
    inside = np.flatnonzero(y[:, 0] * y[:, 0] + y[:, 1] * y[:, 1] < threshold)
    return row[inside], column[inside], y[inside]


def near(centre: FloatArray, radius: FloatArray, z: FloatArray) -> tuple[Index, Index]:
    """Pairs of a centre (N,2) and a point (M,2) no further apart than `radius` (N,) of the centre,
    and perhaps some that are, sorted by centre, then point."""
    if len(centre) * len(z) <= DENSE_BELOW:
        close = np.abs(centre[:, None, 0] - z[:, 0]) <= radius[:, None]
        close &= np.abs(centre[:, None, 1] - z[:, 1]) <= radius[:, None]
        row, column = np.nonzero(close)
        return row, column
    return _near_by_tree(centre, radius, z)


def _near_by_tree(centre: FloatArray, radius: FloatArray, z: FloatArray) -> tuple[Index, Index]:
    """`near` where there are too many pairs to look at each.

    Most reaches are about equally wide and hold few points: these are looked up together.  The
    crowded ones among them are looked up again, and the wide ones compared with every point.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(z)
    usual = radius <= _USUAL_WIDTH * np.median(radius)
    rows = np.flatnonzero(usual)
    k = min(_NEIGHBOURS, len(z))
    distance, found = tree.query(
        centre[rows], k=np.arange(1, k + 1), distance_upper_bound=radius[rows].max()
    )
    within = distance <= radius[rows][:, None]
    crowded = within[:, -1].copy() if k < len(z) else np.zeros(len(rows), bool)
    within[crowded] = False
    i, j = np.nonzero(within)
    again = rows[crowded]
    lists = tree.query_ball_point(centre[again], radius[again])
    length = np.fromiter(map(len, lists), np.intp, len(lists))
    wide = np.flatnonzero(~usual)
    close = np.hypot(*(centre[wide, :, None] - z.T).transpose(1, 0, 2)) <= radius[wide, None]
    wide_row, wide_column = np.nonzero(close)
    row = np.concatenate([rows[i], np.repeat(again, length), wide[wide_row]])
    column = np.concatenate(
        [found[i, j], np.fromiter(chain.from_iterable(lists), np.intp), wide_column]
    )
    order = np.lexsort((column, row))
    return row[order], column[order]
