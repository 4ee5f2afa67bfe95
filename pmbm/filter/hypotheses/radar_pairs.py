"""Gating and update by measurements each of which has a covariance of its own, and perhaps a radial
velocity: a radar's.

The position comes first.  The radial velocity is taken in after it, linear in the state too: along
the measured line of sight, not that to where an object is expected, so that the order of two
sensors' deliveries of one time makes no difference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmbm.filter.density import Index, summed
from pmbm.filter.hypotheses.gating import near
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
class UpdatedPairs:
    """Gated pairs of a Gaussian and a radar's measurement, and the Gaussians after them.

    row (n,), measurement (n,), log_weight (n,) : as of `GatedPairs`, rows ascending.
    mean (n,4), cov (n,4,4) : the Gaussian after the measurement.
    """

    row: Index
    measurement: Index
    log_weight: FloatArray
    mean: FloatArray
    cov: FloatArray

    def weighted(self, log_factor: FloatArray) -> UpdatedPairs:
        """The same with the weights multiplied by exp(log_factor) (n,)."""
        weight = self.log_weight + log_factor
        return UpdatedPairs(self.row, self.measurement, weight, self.mean, self.cov)

    def take(self, rows: Index) -> UpdatedPairs:
        return UpdatedPairs(
            self.row[rows],
            self.measurement[rows],
            self.log_weight[rows],
            self.mean[rows],
            self.cov[rows],
        )


def updated_pairs(
    mean: FloatArray,
    cov: FloatArray,
    log_prior: FloatArray,
    z: FloatArray,
    radar: RadarScan,
    threshold: float,
) -> UpdatedPairs:
    """Pairs within the gate, which counts all measured components.

    mean (N,4), cov (N,4,4) : predicted.  log_prior (N,) : log of what their density is multiplied
    by, r P_D or w P_D; those of -inf have no pair.  z (M,2) : positions.
    """
    if not len(mean) or not len(z):
        none = np.zeros(0, np.intp)
        return UpdatedPairs(none, none, np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4)))
    # Reaches of the widest measurement: what is too far for it is too far for all.
    widest = np.linalg.eigvalsh(radar.R)[:, -1].max()
    spread = np.linalg.eigvalsh(cov[:, :2, :2])[:, -1] + widest
    row, measurement = near(mean[:, :2], np.sqrt(threshold * spread), z)
    kept = log_prior[row] > -np.inf
    row, measurement = row[kept], measurement[kept]
    R = radar.R[measurement]
    innovation = Innovation.of(mean[row], cov[row], R)
    y = innovation.whiten(np.arange(len(row)), z[measurement])
    distance = (y * y).sum(axis=1)
    inside = np.flatnonzero(distance < threshold)
    row, measurement, y, distance, R = (
        row[inside],
        measurement[inside],
        y[inside],
        distance[inside],
        R[inside],
    )
    innovation = innovation.take(inside)
    W = gain(cov[row], innovation)
    pairs = UpdatedPairs(
        row,
        measurement,
        log_prior[row] + innovation.log_norm() - 0.5 * distance,
        corrected_mean(mean[row], W, y),
        corrected_cov(cov[row], W, R, innovation),
    )
    if radar.radial_speed is None:
        return pairs
    return _with_radial_velocity(pairs, radar, distance, threshold)


def _with_radial_velocity(
    pairs: UpdatedPairs, radar: RadarScan, distance: FloatArray, threshold: float
) -> UpdatedPairs:
    """The pairs that remain in the gate, updated by the radial velocity as well; `distance` (n,) is
    the squared one of their positions."""
    assert radar.radial_speed is not None
    sight = radar.sight[pairs.measurement]
    PH = np.einsum("nij,nj->ni", pairs.cov[:, :, 2:4], sight)
    S = (PH[:, 2:4] * sight).sum(axis=1) + radar.radial_variance[pairs.measurement]
    error = radar.radial_speed[pairs.measurement] - (sight * pairs.mean[:, 2:4]).sum(axis=1)
    further = error**2 / S
    inside = np.flatnonzero(distance + further < threshold)
    K = PH / S[:, None]
    cov = pairs.cov - K[:, :, None] * PH[:, None, :]
    return UpdatedPairs(
        pairs.row,
        pairs.measurement,
        pairs.log_weight - 0.5 * (np.log(2 * np.pi * S) + further),
        pairs.mean + K * error[:, None],
        symmetric(cov),
    ).take(inside)


def log_first_detection(pairs: UpdatedPairs, measurements: int) -> FloatArray:
    """(M,) log e, the sum of w P_D N(z) over the components in whose gate each measurement lies."""
    if not len(pairs.row):
        return np.full(measurements, -np.inf)
    top = pairs.log_weight.max()
    weight = np.exp(pairs.log_weight - top)
    return top + log_of_each(summed(weight, pairs.measurement, measurements))
