"""The confidence sequence: what n paired trials prove about a mean loss, at every n at once.

It may be looked at after every trial and stopped at any, and holds for every distribution within
the metric's range.  A gambler bets against a mean: of trials whose mean is at least e and which
never exceed a ceiling R, the wealth

    prod over trials t of  1 - c (x_t - e) / (R - e),     0 < c <= 1,

is never negative and expected to fall (a supermartingale), so that by Ville's inequality it ever
reaches 1 / alpha with probability alpha at most.  c = 1 is the largest bet that cannot go below
nothing.  A weighted mean of such wealths is one too; here half of the weight lies on c = 1, which
is the best bet where trials vary little, and the other half on smaller ones, which survive a trial
at the ceiling.  The means that are not yet refuted are an interval, since the wealth grows with e.

Waudby-Smith and Ramdas, "Estimating means of bounded random variables by betting", Journal of the
Royal Statistical Society B 86, 2024, sections 4 and 5.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pmbm.types import FloatArray

BETS = np.array([2.0**-k for k in range(8)])
"""c, the shares of the largest bet."""
WEIGHTS = np.array([0.5] + [0.5 / 7] * 7)
"""What each bet starts with."""

_BISECTIONS = 50


@dataclass(frozen=True)
class Evidence:
    """The evidence of the first n trials, for every n; arrays (..., N), the trials on the last
    axis.

    Each is one over the wealth of a gambler against a hypothesis: the hypothesis is rejected at a
    level, with at most that probability of error however often one looks, where it is not above.

    fail : of "the candidate loses nothing".
    margin : of "it loses the margin or more".
    """

    fail: FloatArray
    margin: FloatArray


def evidence(loss: ArrayLike, excess: ArrayLike, *, value_range: float, ceiling: float) -> Evidence:
    """The evidence of paired trials after each of them.

    loss (..., N) : per trial, by how much the candidate was worse than the baseline, at least
        -value_range.
    excess (..., N) : by how much it was worse than the margin allows, at most `ceiling`.
    """
    return Evidence(
        fail=_p_value(-np.asarray(loss, dtype=np.float64), value_range),
        margin=_p_value(np.asarray(excess, dtype=np.float64), ceiling),
    )


def upper_bound(values: FloatArray, ceiling: float, level: float) -> float:
    """The least mean that values (N,) which never exceed a ceiling refute at a level; the ceiling
    where they refute none.  It lies above their own mean."""
    target = -math.log(level)
    open_mean, refuted = float(values.mean()), ceiling
    for _ in range(_BISECTIONS):
        middle = 0.5 * (open_mean + refuted)
        if not open_mean < middle < refuted:
            break
        if _mixed(_log_growth(values, ceiling, middle).sum(axis=-1)) >= target:
            refuted = middle
        else:
            open_mean = middle
    return refuted


def log_wealth(values: FloatArray, ceiling: float, mean: float = 0.0) -> FloatArray:
    """Log of what the gambler against "the mean is `mean` or more" has, who began with 1, after
    each of values (..., N) that never exceed a ceiling."""
    return _mixed(np.cumsum(_log_growth(values, ceiling, mean), axis=-1))


def fewest_trials(level: float, rarest: float) -> int:
    """Trials after which a disaster of probability `rarest` has been seen, but for `level`."""
    return math.ceil(math.log(level) / math.log1p(-rarest))


def hidden_rate(level: float, trials: int) -> float:
    """The rate of disasters that `trials` trials without one cannot exclude."""
    return -math.expm1(math.log(level) / trials)


def trials_without_change(margin: float, *, ceiling: float, level: float) -> int:
    """Trials after which equal values, each `margin` below what is tolerated, refute a loss of the
    margin, 10^15 where that is not enough; `ceiling` as in `evidence`."""
    growth = np.log1p(BETS * margin / ceiling)
    target = -math.log(level)
    low, high = 1, 10**15
    while low < high:
        n = (low + high) // 2
        low, high = (low, n) if _mixed(n * growth) >= target else (n + 1, high)
    return low


def _log_growth(values: FloatArray, ceiling: float, mean: float) -> FloatArray:
    """Log of each bet's factor in each trial, (bets, ..., N); -inf where it is lost whole."""
    bets = BETS.reshape(-1, *([1] * values.ndim))
    # Rounding may put a value at the ceiling a last bit beyond the largest bet's ruin.
    factor = np.maximum(bets * ((mean - values) / (ceiling - mean)), -1.0)
    with np.errstate(divide="ignore"):
        return np.log1p(factor)


def _mixed(log_wealths: FloatArray) -> FloatArray:
    """Log of the weighted mean of wealths whose logs are (bets, ...)."""
    # The smaller bets are never lost whole, so that the richest has a finite logarithm.
    richest = log_wealths.max(axis=0)
    return richest + np.log(np.tensordot(WEIGHTS, np.exp(log_wealths - richest), axes=1))


def _p_value(values: FloatArray, ceiling: float) -> FloatArray:
    return np.exp(-np.maximum(log_wealth(values, ceiling), 0.0))
