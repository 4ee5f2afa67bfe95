"""How the detector loses and finds objects, from recordings whose detections' origins are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pmbm.errors import InputError
from pmbm.filter.models.detection import DetectionChain, FixedDetection
from pmbm.types import CLUTTER, FloatArray, Label, Recording

_OVER = -1
"""In a table of runs: the run is over."""
_SELDOM = 50
"""Misses of an unseen object that the fit believes in beforehand: a few objects' runs do not tell a
short flicker from being hidden, and who takes hidden objects for gone loses their identity."""
_FIRST_GUESS = (0.97, 0.15, 0.97, 0.9)


def runs(recordings: Sequence[Recording], label: Label) -> list[NDArray[np.int8]]:
    """For every object of a label, frame by frame from its first detection to its last, whether it
    was detected, 1 or 0: whatever kept the detector from it, the tracker has to bridge it.

    Raises InputError for recordings without origins.
    """
    found = []
    for recording in recordings:
        if recording.origin is None:
            raise InputError("runs of misses are fitted to known origins", field="origin")
        hits: dict[int, list[int]] = {}
        frames = zip(recording.frame.tolist(), recording.origin, strict=True)
        for step, (frame, origin) in enumerate(frames):
            truth = recording.truth[frame]
            rows = np.unique(origin[origin != CLUTTER])
            for row in rows[truth.label[rows] == label].tolist():
                hits.setdefault(int(truth.id[row]), []).append(step)
        for steps in hits.values():
            one = np.zeros(steps[-1] - steps[0] + 1, np.int8)
            one[np.array(steps) - steps[0]] = 1
            found.append(one)
    return found


def fit_detection_chain(flags: Sequence[NDArray[np.int8]], interval: float = 0.1) -> DetectionChain:
    """Fit the chain of being detectable to runs of misses by its greatest posterior.

    flags : `runs`, which begin and end with a detection.  interval : s between frames.

    Beforehand an undetectable object is taken to be seldom detected.  Raises InputError where
    nothing was ever missed.
    """
    long = [one for one in flags if len(one) > 1]
    if not any((one == 0).any() for one in long):
        raise InputError(
            "fitting the detection chain", field="flags", expected="misses among detections"
        )
    table = np.full((len(long), max(map(len, long))), _OVER, np.int8)
    for row, one in enumerate(long):
        table[row, : len(one)] = one
    start = np.log(_FIRST_GUESS) - np.log1p(-np.array(_FIRST_GUESS))
    best = minimize(
        lambda x: -_log_likelihood(table, *_shares(x)) - _SELDOM * np.log1p(-_shares(x)[1]),
        start,
        method="Nelder-Mead",
        options={"xatol": 1e-3, "fatol": 1e-3, "maxiter": 800},
    )
    P_D, undetectable, stay_detectable, stay_undetectable = _shares(best.x).tolist()
    return DetectionChain(
        base=FixedDetection(probability=P_D),
        undetectable=undetectable,
        stay_detectable=stay_detectable,
        stay_undetectable=stay_undetectable,
        interval=interval,
    )


def _shares(x: FloatArray) -> FloatArray:
    shares: FloatArray = 0.5 * (1 + np.tanh(x / 2))
    return shares.clip(1e-4, 1 - 1e-4)


def _log_likelihood(
    table: NDArray[np.int8], P_D: float, unseen: float, stay_seen: float, stay_unseen: float
) -> float:
    """Of runs (N,T), one an object, given that each begins with a detection."""
    if stay_seen + stay_unseen < 1:
        return -np.inf
    usual = (1 - stay_unseen) / (2 - stay_seen - stay_unseen)
    of_hit = np.array([P_D, P_D * unseen])
    move = np.array([[stay_seen, 1 - stay_seen], [1 - stay_unseen, stay_unseen]])
    state = np.tile(np.array([usual, 1 - usual]) * of_hit, (len(table), 1))
    state /= state.sum(axis=1, keepdims=True)
    total = 0.0
    for flag in table[:, 1:].T:
        state = state @ move
        said = np.where((flag == 1)[:, None], of_hit, 1 - of_hit)
        state = np.where((flag == _OVER)[:, None], state, state * said)
        weight = state.sum(axis=1, keepdims=True)
        total += float(np.log(weight).sum())
        state /= weight
    return total
