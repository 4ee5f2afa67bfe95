"""Batched Gaussian algebra for a position measured out of [x, y, vx, vy]: H = [I 0].

S = H P H' + R is 2x2, so its Cholesky factor is written out; everything else follows from it and
no matrix is ever inverted.  N Gaussians, n pairs of a Gaussian and a measurement.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmbm.filter.density import Index
from pmbm.types import FloatArray

_LOG_2PI = float(np.log(2 * np.pi))


@dataclass(frozen=True, eq=False, slots=True)
class Innovation:
    """The predicted measurements of N Gaussians: z ~ N(expected, L L').

    expected (N,2) : H m.
    l11, l21, l22 (N,) : the lower Cholesky factor L of S.
    """

    expected: FloatArray
    l11: FloatArray
    l21: FloatArray
    l22: FloatArray

    @staticmethod
    def of(mean: FloatArray, cov: FloatArray, R: FloatArray) -> Innovation:
        """mean (N,4), cov (N,4,4), R (2,2) or (N,2,2)."""
        l11 = np.sqrt(cov[:, 0, 0] + R[..., 0, 0])
        l21 = (cov[:, 1, 0] + R[..., 1, 0]) / l11
        l22 = np.sqrt(cov[:, 1, 1] + R[..., 1, 1] - l21 * l21)
        return Innovation(mean[:, :2], l11, l21, l22)

    def whitened(self, z: FloatArray) -> FloatArray:
        """L^-1 (z - H m), (N,2), of a measurement (N,2) under each."""
        y0 = (z[:, 0] - self.expected[:, 0]) / self.l11
        return np.stack([y0, (z[:, 1] - self.expected[:, 1] - self.l21 * y0) / self.l22], axis=1)

    def log_norm(self) -> FloatArray:
        """(N,) log of the density's height: -log(2 pi) - log det(S) / 2."""
        return -_LOG_2PI - np.log(self.l11) - np.log(self.l22)


def gain(cov: FloatArray, innovation: Innovation) -> FloatArray:
    """W = P H' L^-T, (N,4,2): the Kalman gain for whitened innovations, K nu = W L^-1 nu."""
    W = np.empty((len(cov), cov.shape[1], 2))
    W[..., 0] = cov[:, :, 0] / innovation.l11[:, None]
    W[..., 1] = (cov[:, :, 1] - innovation.l21[:, None] * W[..., 0]) / innovation.l22[:, None]
    return W


def corrected_cov(
    cov: FloatArray, W: FloatArray, R: FloatArray, innovation: Innovation
) -> FloatArray:
    """P - W W', (N,4,4), symmetric to the last bit.

    The position block is taken as R - R S^-1 R, which is equal and does not cancel where P is many
    orders larger than R.
    """
    corrected = cov - W @ W.transpose(0, 2, 1)
    R = np.broadcast_to(R, (len(cov), 2, 2))
    V0 = R[:, :, 0] / innovation.l11[:, None]
    V1 = (R[:, :, 1] - innovation.l21[:, None] * V0) / innovation.l22[:, None]
    corrected[:, :2, :2] = R - V0[:, :, None] * V0[:, None, :] - V1[:, :, None] * V1[:, None, :]
    return symmetric(corrected)


def corrected_mean(mean: FloatArray, W: FloatArray, y: FloatArray) -> FloatArray:
    """m + W y, (n,4), for whitened innovations y (n,2)."""
    return mean + W[:, :, 0] * y[:, :1] + W[:, :, 1] * y[:, 1:]


def symmetric(matrix: FloatArray) -> FloatArray:
    """The symmetric part of each of (N,4,4)."""
    return 0.5 * (matrix + matrix.transpose(0, 2, 1))


def moments(
    weight: FloatArray, mean: FloatArray, cov: FloatArray, start: Index
) -> tuple[FloatArray, FloatArray]:
    """Mean (M,4) and covariance (M,4,4) of M mixtures, each a run of components from `start[m]`.

    weight (n,) adds up to one in each run; mean (n,4); cov (n,4,4).  No run is empty.
    """
    centre = np.add.reduceat(weight[:, None] * mean, start, axis=0)
    count = np.diff(start, append=len(weight))
    spread = mean - np.repeat(centre, count, axis=0)
    scatter = weight[:, None, None] * (cov + spread[:, :, None] * spread[:, None, :])
    return centre, np.add.reduceat(scatter, start, axis=0)
