"""The confidence sequence: what n paired trials prove about a mean loss, at every n at once.

A t-test that is looked at after every trial raises false alarms several times as often as it
says.  An asymptotic confidence sequence (Waudby-Smith, Arbour, Sinha, Kennedy, Ramdas, "Time-
uniform central limit theory and asymptotic confidence sequences") may be looked at after every
trial and stopped at any: it mixes Gaussian likelihood ratios over the unknown mean, here over a
half-normal, which makes it one-sided (Howard, Ramdas, McAuliffe, Sekhon, "Time-uniform,
nonparametric, nonasymptotic confidence sequences", Annals of Statistics 49, 2021, section 3).

Two additions guard against rare disasters, which a short run of trials may miss and a sample
variance then does not know of: the variance is never taken below B^2 / n, where B is the
metric's range, and nothing passes before so many trials that a disaster in a share `rarest` of
all trials would have been seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import log_ndtr

from pmbm.types import FloatArray

_NEWTON_STEPS = 25


@dataclass(frozen=True)
class Evidence:
    """What the first n trials prove, for every n; arrays (..., N), the trials on the last axis.

    loss : mean loss of the candidate against the baseline, in the metric's unit.
    low, high : one-sided confidence sequences for it, each at `level`.
    p_fail : anytime-valid p-value of "the candidate loses nothing".
    p_margin : anytime-valid p-value of "it loses the margin or more".
    p_pass : the same of "... or a disaster befalls it in a share `rarest` of trials".
    """

    loss: FloatArray
    low: FloatArray
    high: FloatArray
    p_fail: FloatArray
    p_margin: FloatArray
    p_pass: FloatArray


def evidence(
    loss: ArrayLike,
    margin: ArrayLike,
    *,
    value_range: float,
    alpha: float,
    rarest: float,
    level: float | None = None,
) -> Evidence:
    """What paired trials prove after each of them.

    loss (..., N) : per trial, by how much the candidate was worse than the baseline.
    margin : tolerated loss, in the same unit: a number, or one per trial (a share of the
        baseline's value in that trial).
    value_range : B, the greatest difference that two values of the metric can have.
    alpha : level that the sequence is tuned for, to be narrowest where a pass first may be.
    level : of `low` and `high`; alpha, unless a correction for many comparisons lowers it.
    """
    losses = np.asarray(loss, dtype=np.float64)
    margins = np.broadcast_to(np.asarray(margin, dtype=np.float64), losses.shape)
    n = np.arange(1, losses.shape[-1] + 1, dtype=np.float64)
    spread = _spread(alpha, fewest_trials(alpha, rarest))
    reach = _reach(n, spread, alpha if level is None else level)

    mean, sd = _running(losses, n, value_range)
    room, room_sd = _running(margins - losses, n, value_range)
    p_margin = _p_value(room / room_sd, n, spread)
    blind = (1.0 - rarest) ** n
    # Equal values leave nothing to estimate: all that may hide then is what was never drawn.
    equal = np.logical_and.accumulate(losses == 0.0, axis=-1)
    return Evidence(
        loss=mean,
        low=mean - reach * sd,
        high=mean + reach * room_sd,
        p_fail=_p_value(mean / sd, n, spread),
        p_margin=p_margin,
        p_pass=np.where(equal, blind, np.maximum(p_margin, blind)),
    )


def fewest_trials(alpha: float, rarest: float) -> int:
    """Trials after which a disaster of probability `rarest` has been seen, but for alpha."""
    return math.ceil(math.log(alpha) / math.log1p(-rarest))


def hidden_rate(alpha: float, trials: int) -> float:
    """The rate of disasters that `trials` trials without one cannot exclude."""
    return -math.expm1(math.log(alpha) / trials)


def trials_without_change(
    margin: float, *, value_range: float, alpha: float, rarest: float, at_most: int = 1_000_000
) -> int:
    """Trials that a pass costs when nothing but the floor of the variance is in the way: the
    least that a margin costs unless all values are equal.  `at_most` where that is not enough."""
    least = fewest_trials(alpha, rarest)
    spread = _spread(alpha, least)
    low, high = least, at_most
    while low < high:
        n = (low + high) // 2
        reach = _reach(np.array([float(n)]), spread, alpha)[0] * value_range / math.sqrt(n)
        low, high = (low, n) if reach < margin else (n + 1, high)
    return low


def _running(x: FloatArray, n: FloatArray, value_range: float) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of the first n values, the variance at least B^2 / n."""
    # Centred on the first value: equal values then give a variance of exactly zero.
    shifted = x - x[..., :1]
    mean = np.cumsum(shifted, axis=-1) / n
    square = np.cumsum(shifted**2, axis=-1) / n
    variance = np.maximum(square - mean**2, 0.0) * n / np.maximum(n - 1, 1)
    return x[..., :1] + mean, np.sqrt(np.maximum(variance, value_range**2 / n))


def _spread(alpha: float, best_at: int) -> float:
    """Variance of the mixing half-normal that makes the sequence narrowest near n = `best_at`
    (Waudby-Smith et al., section on tuning; one side at alpha is two sides at 2 alpha)."""
    a = -2.0 * math.log(2.0 * alpha)
    return (a + math.log(a) + 1.0) / best_at


def _log_e_value(score: FloatArray, n: FloatArray, spread: float) -> FloatArray:
    """Log of the mixture of likelihood ratios; `score` is mean / sd of the first n trials."""
    x = score * n * np.sqrt(spread / (n * spread + 1.0))
    return math.log(2.0) - 0.5 * np.log(n * spread + 1.0) + 0.5 * x**2 + log_ndtr(x)


def _p_value(score: FloatArray, n: FloatArray, spread: float) -> FloatArray:
    with np.errstate(under="ignore"):
        return np.exp(-np.maximum(_log_e_value(score, n, spread), 0.0))


def _reach(n: FloatArray, spread: float, alpha: float) -> FloatArray:
    """The score at which the e-value is 1 / alpha: the half-width in standard deviations."""
    target = math.log(1.0 / alpha) - math.log(2.0) + 0.5 * np.log(n * spread + 1.0)
    # Phi >= 1/2 on this side, so this start lies beyond the root, and on a convex function
    # Newton's method comes down to it without a miss.
    x = np.sqrt(2.0 * (target + math.log(2.0)))
    for _ in range(_NEWTON_STEPS):
        log_cdf = log_ndtr(x)
        slope = x + np.exp(-0.5 * x**2 - 0.5 * math.log(2 * math.pi) - log_cdf)
        x = x - (0.5 * x**2 + log_cdf - target) / slope
    return x / (n * np.sqrt(spread / (n * spread + 1.0)))
