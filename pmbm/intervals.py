"""Intervals and p-values of means over trials and of figures over recordings.

An interval is made for what the values can be (`Scale`): Student's t for measurements; for counts,
which may be rare, a gamma interval with the counts' own dispersion; for values that are equal in
every trial what the range allows.  None has a width of zero.  How often they cover is measured by
tests/statistical/test_interval_coverage.py.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import gammaincinv, ndtri, stdtr, stdtrit

from pmbm.arrays import FloatArray

Ends = tuple[float, float]

LEVEL: Final = 0.95
FEWEST: Final = 5
"""Recordings: with fewer, no interval over recordings holds what it says."""
SAME: Final = 1e-12
"""Values that differ by less, or by less than this share, differ by rounding alone."""


@dataclass(frozen=True)
class Scale:
    """The values that a metric can take in a trial.

    low, high : ends of its range.
    step : of a count, the value of one; None for a measurement.
    """

    low: float = -math.inf
    high: float = math.inf
    step: float | None = None

    @property
    def of_differences(self) -> Scale:
        """The scale of one value less another."""
        return Scale(self.low - self.high, self.high - self.low, self.step)

    def mean_of(self, count: int) -> Scale:
        """The scale of the mean of so many values."""
        return Scale(self.low, self.high, None if self.step is None else self.step / count)


MEASURED: Final = Scale()
COUNT: Final = Scale(0.0, math.inf, 1.0)
SHARE: Final = Scale(0.0, 1.0)


class Uncertainty(Protocol):
    """A mean with its interval and p-value."""

    def ends(self, level: float = LEVEL) -> Ends | None:
        """The interval's ends, or None where there is none."""
        ...

    def p_value(self) -> float:
        """The two-sided p-value against a mean of zero: 1 less the level at which the interval
        reaches it."""
        ...


@dataclass(frozen=True)
class Student:
    """The mean of measurements: Student's t."""

    mean: float
    sem: float
    n: int

    def ends(self, level: float = LEVEL) -> Ends:
        reach = float(stdtrit(self.n - 1, (1 + level) / 2)) * self.sem
        return self.mean - reach, self.mean + reach

    def p_value(self) -> float:
        return float(2 * stdtr(self.n - 1, -abs(self.mean) / self.sem))


@dataclass(frozen=True)
class Equal:
    """The mean of values of which all n are equal.

    Of other values there can be few: with probability (1 + level) / 2 or more, a share of at most
    1 - ((1 - level) / 2)^(1/n) of all trials.  Where they end is known for a metric with ends.
    A difference other than zero has the p-value of the sign test, and no interval.
    """

    mean: float
    n: int
    scale: Scale

    def ends(self, level: float = LEVEL) -> Ends | None:
        low, high = self.scale.low, self.scale.high
        bounded = math.isfinite(low) and math.isfinite(high)
        if not bounded or (low < 0 and self.mean != 0):
            return None
        share = 1 - ((1 - level) / 2) ** (1 / self.n)
        return self.mean - share * (self.mean - low), self.mean + share * (high - self.mean)

    def p_value(self) -> float:
        return 2.0 ** (1 - self.n) if self.mean else 1.0


@dataclass(frozen=True)
class _Side:
    """Counts of one sign over n trials: mean, variance, and dispersion, which is the variance in
    units of the mean: 1 of single events, more where they come in bursts."""

    mean: float
    variance: float
    dispersion: float
    n: int

    @classmethod
    def of(cls, counts: FloatArray, unseen: float) -> _Side:
        mean, variance = float(counts.mean()), float(counts.var(ddof=1))
        return cls(mean, variance, variance / mean if mean else unseen, len(counts))

    def ends(self, level: float) -> Ends:
        """The gamma interval of Fay and Feuer (Statistics in Medicine 16, 1997) for a weighted sum
        of Poisson counts: of single events it is Garwood's for a Poisson count.

        The variance is never below that of rare events, and is widened for being an estimate as
        Student's t widens it.  One more burst than was seen would add, at most, what a single event
        adds and twice the dispersion beyond that (the factor by simulation).
        """
        tail = (1 - level) / 2
        wider = float(stdtrit(self.n - 1, tail) / ndtri(tail)) ** 2
        burst = max(1.0, 2 * wider * self.dispersion - 1)
        total = self.n * self.mean
        variance = self.n * wider * max(self.variance, min(self.mean, 1.0))
        low = variance / total * gammaincinv(total**2 / variance, tail) if total else 0.0
        more, spread = total + burst, variance + burst**2
        high = spread / more * gammaincinv(more**2 / spread, 1 - tail)
        return float(low) / self.n, float(high) / self.n


@dataclass(frozen=True)
class Counts:
    """The mean of counts, or of differences of counts.

    Each sign is counted apart, and the two intervals joined by the method of variance estimates
    recovery (Zou and Donner, Statistics in Medicine 27, 2008).

    up, down : in units of `scale.step`.
    correlation : between them.
    """

    up: _Side
    down: _Side
    correlation: float
    scale: Scale

    @classmethod
    def of(cls, values: FloatArray, scale: Scale) -> Counts:
        assert scale.step is not None
        counts = values / scale.step
        n = len(counts)
        ups, downs = np.maximum(counts, 0.0), np.maximum(-counts, 0.0)
        seen = float(np.abs(counts).mean())
        # What was never seen on one side may come in bursts as the other's do.
        unseen = float(counts.var(ddof=1)) / seen if seen else 0.0
        up, down = _Side.of(ups, unseen), _Side.of(downs, unseen)
        both = math.sqrt(up.variance * down.variance)
        covariance = -up.mean * down.mean * n / (n - 1)
        return cls(up, down, covariance / both if both else 0.0, scale)

    def ends(self, level: float = LEVEL) -> Ends:
        up, down = self.up.mean, self.down.mean
        (up_low, up_high), (down_low, down_high) = self.up.ends(level), self.down.ends(level)
        if self.scale.low >= 0:
            low, high = up_low, up_high
        else:
            low = up - down - self._joined(up - up_low, down_high - down)
            high = up - down + self._joined(up_high - up, down - down_low)
        step = self.scale.step or 1.0
        return max(self.scale.low, step * low), min(self.scale.high, step * high)

    def _joined(self, one: float, other: float) -> float:
        return math.sqrt(max(0.0, one**2 + other**2 - 2 * self.correlation * one * other))

    def p_value(self) -> float:
        def excludes(level: float) -> bool:
            low, high = self.ends(level)
            return low > 0 or high < 0

        return _least(lambda p: excludes(1 - p))


def _least(holds: Callable[[float], bool]) -> float:
    """The least p, to a thousandth of it, from which on something holds, or 1 where that is above
    .999."""
    low, high = math.log(1e-15), math.log(0.999)
    if not holds(0.999):
        return 1.0
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (low, middle) if holds(math.exp(middle)) else (middle, high)
    return math.exp(high)


def of_mean(values: FloatArray, scale: Scale) -> Uncertainty | None:
    """The uncertainty of a mean over all trials, from the values of some, or None of fewer than
    two."""
    n = len(values)
    if n < 2:
        return None
    mean = math.fsum(values) / n
    equal = bool(np.ptp(values) <= SAME * max(1.0, float(np.abs(values).max())))
    nothing = abs(mean) <= SAME
    if scale.step is not None and not (equal and scale.low < 0 and not nothing):
        return Counts.of(values, scale)
    if equal:
        return Equal(0.0 if nothing else mean, n, scale)
    sem = math.sqrt(math.fsum((values - mean) ** 2) / (n - 1) / n)
    return Student(mean, sem, n)


def jackknife(without: ArrayLike, lengths: Sequence[float]) -> tuple[float, float]:
    """Standard error of a figure over recordings, and the degrees of freedom of its Student's t.

    without (n,) : the figure without each recording.
    lengths (n,) : of the recordings, such as objects: what a recording weighs in the figure.

    Recordings of unequal length leave fewer degrees than n - 1: by the effective number of
    recordings, (sum L)^2 / sum L^2 - 1 (Kish), and by Satterthwaite's for a sum of squares that
    weigh L^2, (sum L^2)^2 / sum L^4, half of one more since the jackknife is a little too wide
    there; the smaller of the two.
    """
    left = np.asarray(without, dtype=np.float64)
    weights = np.asarray(lengths, dtype=np.float64)
    n = len(left)
    error = math.sqrt((n - 1) / n * float(((left - left.mean()) ** 2).sum()))
    squares = float((weights**2).sum())
    kish = float(weights.sum()) ** 2 / squares - 1
    satterthwaite = squares**2 / float((weights**4).sum()) + 0.5
    return error, min(kish, satterthwaite)


def jackknife_reach(without: ArrayLike, lengths: Sequence[float], level: float = LEVEL) -> float:
    """Half of the interval of a figure over recordings, see `jackknife`."""
    error, degrees = jackknife(without, lengths)
    return float(stdtrit(degrees, (1 + level) / 2)) * error
