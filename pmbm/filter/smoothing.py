"""The batch mode: a whole run looked at again with what came later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig
from pmbm.filter.gaussian import symmetric
from pmbm.filter.models import constant_velocity
from pmbm.types import FloatArray, IntArray, Tracks


def smooth(
    steps: Sequence[Tracks], config: PMBMConfig | None = None, report_above: float = 0.5
) -> tuple[Tracks, ...]:
    """The tracks of a whole run, each smoothed over its life: one `Tracks` per step, as given.

    Positions and velocities are those of the Rauch-Tung-Striebel smoother (AIAA Journal 3(8),
    1965); a gap inside a track is filled; size is the track's median and label its most frequent.
    A track counts as a whole: it is kept where its existence exceeded `report_above` once, and
    then with all its steps.  A tracker that reports from a lower existence on (`report_above` of
    its own configuration) thus lets tracks begin before the step in which they became probable.

    Parameters
    ----------
    steps : what the tracker reported, in order of time, with covariances.
    config : of that tracker; its process noise is needed (default: `PMBMConfig()`).

    Raises
    ------
    InputError : tracks without covariances, or times that run backwards.
    """
    config = config if config is not None else PMBMConfig()
    times = np.array([one.time for one in steps])
    if (np.diff(times) < 0).any():
        raise InputError("steps out of order", field="time", got=times[1:][np.diff(times) < 0][0])
    if any(one.covariance is None for one in steps):
        raise InputError("smoothing needs the tracks' covariances", field="covariance")
    lives = [
        _smoothed(_life(steps, track), times, config.spectral_density)
        for track, best in sorted(_best_scores(steps).items())
        if best > report_above
    ]
    return tuple(_step(one, number, lives) for number, one in enumerate(steps))


@dataclass(frozen=True, eq=False, slots=True)
class _Life:
    """One track from its first to its last report, n steps.

    first : its first step.  reported (n,) : whether it was reported in a step; where not, a row
    repeats the last report.  mean (n,4), cov (n,4,4), box (n,5), score (n,), label.
    """

    id: int
    first: int
    reported: np.ndarray
    mean: FloatArray
    cov: FloatArray
    box: FloatArray
    score: FloatArray
    label: int


def _best_scores(steps: Sequence[Tracks]) -> dict[int, float]:
    best: dict[int, float] = {}
    for one in steps:
        for track, score in zip(one.id.tolist(), one.score.tolist(), strict=True):
            best[track] = max(best.get(track, 0.0), score)
    return best


def _life(steps: Sequence[Tracks], track: int) -> _Life:
    where: list[tuple[int, int]] = []
    for number, one in enumerate(steps):
        row = np.flatnonzero(one.id == track)
        if len(row):
            where.append((number, int(row[0])))
    numbers = np.array([number for number, _ in where])
    # For each step of the life, the last report so far.
    last = np.searchsorted(numbers, np.arange(numbers[0], numbers[-1] + 1), side="right") - 1
    picked = [(steps[number], row) for number, row in where]
    mean = np.array([[*s.position[r, :2], *s.velocity[r]] for s, r in picked])
    cov = np.array([s.covariance[r] for s, r in picked if s.covariance is not None])
    box = np.array([[s.position[r, 2], *s.size[r], s.yaw[r]] for s, r in picked])
    labels: IntArray = np.array([s.label[r] for s, r in picked], np.int64)
    box[:, 1:4] = np.median(box[:, 1:4], axis=0)
    return _Life(
        track,
        int(numbers[0]),
        np.isin(np.arange(numbers[0], numbers[-1] + 1), numbers),
        mean[last],
        cov[last],
        box[last],
        np.array([s.score[r] for s, r in picked])[last],
        int(np.bincount(labels).argmax()),
    )


def _smoothed(life: _Life, times: FloatArray, spectral_density: float) -> _Life:
    """Forward through the gaps, then back through the life."""
    n = len(life.mean)
    mean, cov = life.mean.copy(), life.cov.copy()
    predicted_mean, predicted_cov = np.empty((n, 4)), np.empty((n, 4, 4))
    F = np.empty((n, 4, 4))
    for k in range(1, n):
        dt = times[life.first + k] - times[life.first + k - 1]
        F[k], Q = constant_velocity(float(dt), spectral_density)
        predicted_mean[k] = F[k] @ mean[k - 1]
        predicted_cov[k] = F[k] @ cov[k - 1] @ F[k].T + Q
        if not life.reported[k]:
            mean[k], cov[k] = predicted_mean[k], predicted_cov[k]
    for k in range(n - 2, -1, -1):
        G = np.linalg.solve(predicted_cov[k + 1], F[k + 1] @ cov[k]).T
        mean[k] += G @ (mean[k + 1] - predicted_mean[k + 1])
        cov[k] += G @ (cov[k + 1] - predicted_cov[k + 1]) @ G.T
    return _Life(
        life.id, life.first, life.reported, mean, symmetric(cov), life.box, life.score, life.label
    )


def _step(given: Tracks, number: int, lives: Sequence[_Life]) -> Tracks:
    rows = [
        (life, number - life.first)
        for life in lives
        if life.first <= number < life.first + len(life.mean)
    ]
    n = len(rows)
    mean = np.array([life.mean[k] for life, k in rows]).reshape(n, 4)
    box = np.array([life.box[k] for life, k in rows]).reshape(n, 5)
    return Tracks(
        time=given.time,
        id=np.array([life.id for life, _ in rows], np.int64),
        position=np.column_stack([mean[:, :2], box[:, 0]]),
        size=box[:, 1:4],
        yaw=box[:, 4],
        velocity=mean[:, 2:],
        score=np.array([life.score[k] for life, k in rows]),
        label=np.array([life.label for life, _ in rows], np.int8),
        covariance=np.array([life.cov[k] for life, k in rows]).reshape(n, 4, 4),
        undetected=given.undetected,
    )
