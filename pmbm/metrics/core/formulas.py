"""Formulas that families share: values from counts, as frozen callables that pickle and print.

A field names a count; `undefined` is the reason given where there is nothing to divide by.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.metrics.core.result import Counts, Undefined

NO_FRAMES: Final = "no frames"
NO_TRUTH: Final = "no truth"
NO_TRACKS: Final = "no tracks"
NO_MATCH: Final = "nothing is matched"
NOTHING: Final = "no truth and no tracks"


@dataclass(frozen=True)
class Ratio:
    """top / bottom."""

    top: str
    bottom: str
    undefined: str

    def __call__(self, counts: Counts) -> float | Undefined:
        if not counts[self.bottom]:
            return Undefined(self.undefined)
        return counts[self.top] / counts[self.bottom]


@dataclass(frozen=True)
class OneMinusRatio:
    """1 - (sum of `tops`) / bottom."""

    tops: tuple[str, ...]
    bottom: str
    undefined: str

    def __call__(self, counts: Counts) -> float | Undefined:
        if not counts[self.bottom]:
            return Undefined(self.undefined)
        errors = sum(counts[top] for top in self.tops)
        return 1 - errors / counts[self.bottom]


@dataclass(frozen=True)
class F1:
    """2 true / (2 true + missed + false), of rows."""

    true: str
    missed: str
    false: str
    undefined: str = NOTHING

    def __call__(self, counts: Counts) -> float | Undefined:
        rows = 2 * counts[self.true] + counts[self.missed] + counts[self.false]
        return 2 * counts[self.true] / rows if rows else Undefined(self.undefined)


@dataclass(frozen=True)
class Total:
    """The count itself."""

    name: str

    def __call__(self, counts: Counts) -> float:
        return float(counts[self.name])


@dataclass(frozen=True)
class Median:
    """The median of samples."""

    samples: str
    undefined: str

    def __call__(self, counts: Counts) -> float | Undefined:
        values = counts[self.samples].values
        return float(np.median(values)) if len(values) else Undefined(self.undefined)


@dataclass(frozen=True)
class Mean:
    """The mean of samples."""

    samples: str
    undefined: str

    def __call__(self, counts: Counts) -> float | Undefined:
        values = counts[self.samples].values
        return float(values.mean()) if len(values) else Undefined(self.undefined)


@dataclass(frozen=True)
class Number:
    """The number of samples."""

    samples: str

    def __call__(self, counts: Counts) -> float:
        return float(len(counts[self.samples].values))


@dataclass(frozen=True)
class Totals:
    """Parts: these counts themselves."""

    names: tuple[str, ...]

    def __call__(self, counts: Counts) -> Mapping[str, float]:
        return {name: float(counts[name]) for name in self.names}


@dataclass(frozen=True)
class Means:
    """Parts: these counts, each over `bottom`, or none where that is 0."""

    names: tuple[str, ...]
    bottom: str

    def __call__(self, counts: Counts) -> Mapping[str, float]:
        over = counts[self.bottom]
        return {name: float(counts[name] / over) for name in self.names if over}


@dataclass(frozen=True)
class Described:
    """Parts: mean, median and number of samples, and further counts."""

    samples: str
    totals: tuple[str, ...]

    def __call__(self, counts: Counts) -> Mapping[str, float]:
        values = counts[self.samples].values
        numbers = {"n": float(len(values)), **{key: float(counts[key]) for key in self.totals}}
        if len(values):
            numbers |= {"mean": float(values.mean()), "median": float(np.median(values))}
        return numbers
