"""Speed of the K best assignments: the compiled kernel beside the plain one."""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np

import pmbm.assignment  # noqa: F401  (holds the plain twin)
from pmbm.kernels import TWINS

SEEDS = range(5)


def gated(seed: int, rows: int, width: int, share: float = 0.05) -> np.ndarray:
    """(rows, width) costs: a column of its own for each row, and a share of the other pairs."""
    random = np.random.default_rng([seed, rows, width])
    others = width - rows
    cost = np.full((rows, width), np.inf)
    allowed = random.random((rows, others)) < share
    cost[:, :others][allowed] = random.normal(-3, 3, allowed.sum())
    cost[np.arange(rows), others + np.arange(rows)] = random.normal(size=rows)
    return cost


def f() -> tuple[float, dict[str, Any]]:
    """Reference time over compiled time, gated 100 x 200, K = 100; both give the same bits."""
    native = importlib.import_module("pmbm._native")
    ratios, fast, slow = [], [], []
    for seed in SEEDS:
        problem = _problem(gated(seed, 100, 200), 100)
        plain, plain_seconds = _timed(TWINS["k_best"], problem, 1)
        compiled, compiled_seconds = _timed(native.k_best, problem, 20)
        assert all(map(np.array_equal, plain, compiled))
        ratios.append(plain_seconds / compiled_seconds)
        fast.append(compiled_seconds)
        slow.append(plain_seconds)
    thousand = [_timed(native.k_best, _problem(gated(s, 100, 200), 1000), 5)[1] for s in SEEDS]
    dense = [
        _timed(native.k_best, _problem(np.random.default_rng(s).normal(size=(20, 40)), 100), 50)[1]
        for s in SEEDS
    ]
    return float(np.median(ratios)), {
        "compiled_ms": 1e3 * float(np.median(fast)),
        "reference_ms": 1e3 * float(np.median(slow)),
        "compiled_ms_k1000": 1e3 * float(np.median(thousand)),
        "compiled_ms_dense_20x40": 1e3 * float(np.median(dense)),
    }


def _problem(cost: np.ndarray, k: int) -> tuple[np.ndarray, ...]:
    rows, width = cost.shape
    return cost.ravel(), np.array([rows], np.int32), np.array([width], np.int32), np.array([k])


def _timed(solve: Any, problem: tuple[np.ndarray, ...], times: int) -> tuple[Any, float]:
    """The answer, and the median CPU time."""
    seconds = []
    for _ in range(times):
        begin = time.process_time()
        answer = solve(*problem)
        seconds.append(time.process_time() - begin)
    return answer, float(np.median(seconds))
