"""The least that any tracker of this kind must do in a frame."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import min_weight_full_bipartite_matching
from scipy.spatial import cKDTree
from world import DT, MEASUREMENT_SD

GATE = 20.0
REACH = 3.0


class Floor:
    """N Kalman filters, all told which measurement is theirs, in a few numpy calls a frame."""

    def __init__(self, truth: np.ndarray, velocity: np.ndarray) -> None:
        n = len(truth)
        self.mean = np.concatenate([truth, velocity], axis=1)
        self.cov = np.tile(np.diag([0.1, 0.1, 1.0, 1.0]), (n, 1, 1))
        self.F = np.eye(4) + DT * np.eye(4, k=2)
        self.Q = 2.0 * np.array(
            [[DT**3 / 3, 0, DT**2 / 2, 0], [0, DT**3 / 3, 0, DT**2 / 2],
             [DT**2 / 2, 0, DT, 0], [0, DT**2 / 2, 0, DT]]
        )  # fmt: skip
        self.R = MEASUREMENT_SD**2 * np.eye(2)

    def seconds(self, z: np.ndarray, truth: np.ndarray) -> tuple[float, float]:
        """CPU time of one frame: floor, and floor2.

        floor : the assignment of the gated costs (the cheaper of scipy's dense and sparse solvers)
        and the Kalman step; floor2 : the Kalman step, and building and querying a tree instead.
        """
        kalman = _timed(lambda: self._kalman(truth))
        tree = _timed(lambda: cKDTree(z).query_ball_point(self.mean[:, :2], REACH))
        if len(z) > 1000:
            return np.nan, kalman + tree
        cost = self._cost(z)
        dense = np.where(np.isfinite(cost), cost, 1e3)
        rows, columns = np.nonzero(np.isfinite(cost))
        # A constant keeps costs above 0, which the sparse solver takes for "no edge".
        sparse = csr_array((cost[rows, columns] + 1e2, (rows, columns)), shape=cost.shape)
        assignment = min(
            _timed(lambda: linear_sum_assignment(dense)),
            _timed(lambda: min_weight_full_bipartite_matching(sparse)),
        )
        return kalman + assignment, kalman + tree

    def _kalman(self, z: np.ndarray) -> None:
        F, Q, R = self.F, self.Q, self.R
        mean = self.mean @ F.T
        cov = F @ self.cov @ F.T + Q
        S = cov[:, :2, :2] + R
        gain = cov[:, :, :2] @ np.linalg.inv(S)
        self.mean = mean + (gain @ (z - mean[:, :2])[:, :, None])[:, :, 0]
        self.cov = cov - gain @ cov[:, :2, :]

    def _cost(self, z: np.ndarray) -> np.ndarray:
        """(N, M + N): gated squared distances, and a column of its own for each missed track."""
        n, m = len(self.mean), len(z)
        apart = z[None] - self.mean[:, None, :2]
        inverse = np.linalg.inv(self.cov[:, :2, :2] + self.R)
        distance = np.einsum("nmi,nij,nmj->nm", apart, inverse, apart)
        cost = np.full((n, m + n), np.inf)
        cost[:, :m] = np.where(distance < GATE, distance, np.inf)
        cost[np.arange(n), m + np.arange(n)] = GATE
        return cost


def _timed(work: Callable[[], object]) -> float:
    begin = time.process_time()
    work()
    return time.process_time() - begin
