"""Pairs of Gaussians and the measurements in their gates, and the Gaussians after these.

The position comes first.  The radial velocity that a radar measures is taken in after it, linear in
the state too: along the measured line of sight, not that to where an object is expected, so that
the order of two sensors' deliveries of one time makes no difference.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from pmbm.filter.density import Index, summed
from pmbm.filter.hypotheses.gaussian import (
    Innovation,
    corrected_cov,
    corrected_mean,
    gain,
    symmetric,
)
from pmbm.filter.hypotheses.weights import log_of_each
from pmbm.filter.models.radar import RadarScan
from pmbm.types import FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class GatedPairs:
    """Gated pairs of a Gaussian and a measurement, and the Gaussians after the measurement.

    row (n,) : of the local table, or of the PPP, ascending.  measurement (n,).
    log_weight (n,) : log(r P_D N(z)) of a local hypothesis, log(w P_D N(z)) of a PPP component.
    mean (n,4), cov (n,4,4) : of the Gaussian after the measurement.
    """

    row: Index
    measurement: Index
    log_weight: FloatArray
    mean: FloatArray
    cov: FloatArray

    def weighted(self, log_factor: FloatArray) -> GatedPairs:
        """The same with the weights multiplied by exp(log_factor) (n,)."""
        return replace(self, log_weight=self.log_weight + log_factor)

    def take(self, pairs: Index) -> GatedPairs:
        return GatedPairs(
            self.row[pairs],
            self.measurement[pairs],
            self.log_weight[pairs],
            self.mean[pairs],
            self.cov[pairs],
        )


def gated_pairs(
    mean: FloatArray,
    cov: FloatArray,
    log_prior: FloatArray,
    z: FloatArray,
    R: FloatArray,
    threshold: float,
    radar: RadarScan | None = None,
) -> GatedPairs:
    """Pairs of a squared distance below `threshold`, which counts all measured components.

    mean (N,4), cov (N,4,4) : predicted.  log_prior (N,) : log of what their density is multiplied
    by, r P_D or w P_D; those of -inf have no pair.
    z (M,2) : positions.  R (2,2) or (M,2,2) : their covariances.  radar : what else is measured.
    """
    R = np.broadcast_to(R, (len(z), 2, 2))
    # Reaches of the widest measurement: what is too far for it is too far for all.
    widest = np.linalg.eigvalsh(R)[:, -1].max(initial=0.0)
    spread = np.linalg.eigvalsh(cov[:, :2, :2])[:, -1] + widest
    row, measurement = near(mean[:, :2], np.sqrt(threshold * spread) * (1 + 1e-9), z)
    possible = log_prior[row] > -np.inf
    row, measurement = row[possible], measurement[possible]
    before, noise = cov[row], R[measurement]
    innovation = Innovation.of(mean[row], before, noise)
    y, W = innovation.whitened(z[measurement]), gain(before, innovation)
    distance = (y * y).sum(axis=1)
    pairs = GatedPairs(
        row,
        measurement,
        log_prior[row] + innovation.log_norm() - 0.5 * distance,
        corrected_mean(mean[row], W, y),
        corrected_cov(before, W, noise, innovation),
    )
    if radar is not None and radar.radial_speed is not None:
        pairs, further = _with_radial_velocity(pairs, radar, radar.radial_speed)
        distance = distance + further
    return pairs.take(np.flatnonzero(distance < threshold))


def _with_radial_velocity(
    pairs: GatedPairs, radar: RadarScan, speed: FloatArray
) -> tuple[GatedPairs, FloatArray]:
    """The pairs updated by the radial velocity (M,) as well, and its squared distance (n,)."""
    sight = radar.sight[pairs.measurement]
    PH = np.einsum("nij,nj->ni", pairs.cov[:, :, 2:4], sight)
    S = (PH[:, 2:4] * sight).sum(axis=1) + radar.radial_variance[pairs.measurement]
    error = speed[pairs.measurement] - (sight * pairs.mean[:, 2:4]).sum(axis=1)
    distance, K = error**2 / S, PH / S[:, None]
    updated = replace(
        pairs,
        log_weight=pairs.log_weight - 0.5 * (np.log(2 * np.pi * S) + distance),
        mean=pairs.mean + K * error[:, None],
        cov=symmetric(pairs.cov - K[:, :, None] * PH[:, None, :]),
    )
    return updated, distance


def near(centre: FloatArray, radius: FloatArray, z: FloatArray) -> tuple[Index, Index]:
    """Pairs of a centre (N,2) and a point z (M,2) no further apart than `radius` (N,) of the
    centre, sorted by centre, then point."""
    from scipy.spatial import cKDTree

    found = cKDTree(z).query_ball_point(centre, radius, return_sorted=True)
    row = np.repeat(np.arange(len(centre)), [len(points) for points in found])
    return row, np.fromiter(chain.from_iterable(found), np.intp, len(row))


def log_density(pairs: GatedPairs, measurements: int) -> FloatArray:
    """(M,) log of the sum of the weights of the pairs that each measurement is of; -inf of none."""
    top = pairs.log_weight.max(initial=-np.inf)
    weight = np.exp(pairs.log_weight - top)
    return top + log_of_each(summed(weight, pairs.measurement, measurements))
