"""Values from counts: ratios of sums, means of samples, curves over thresholds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np

from pmbm.intervals import FEWEST, jackknife_reach
from pmbm.metrics.result import Counts, Undefined
from pmbm.types import FloatArray

Formula = Callable[[Counts], float | Undefined]
Parts = Callable[[Counts], Mapping[str, float]]

STATE_DIMENSION: Final = 4
TGOSPA_PARTS: Final = ("localisation", "missed", "false", "switch")
NO_FRAMES: Final = "no frames"
NO_TRUTH: Final = "no truth"
NO_TRACKS: Final = "no tracks"
NO_MATCH: Final = "nothing is matched"


def ratio(top: str, bottom: str, none: str) -> Formula:
    """counts[top] / counts[bottom], undefined (with this reason) where the latter is 0."""

    def formula(counts: Counts) -> float | Undefined:
        return counts[top] / counts[bottom] if counts[bottom] else Undefined(none)

    return formula


def total(name: str) -> Formula:
    """counts[name] itself."""
    return lambda counts: float(counts[name])


def means(bottom: str, *names: str) -> Parts:
    """Further sums, each over counts[bottom]."""

    def parts(counts: Counts) -> Mapping[str, float]:
        return {name: float(counts[name] / counts[bottom]) for name in names if counts[bottom]}

    return parts


def median(name: str, none: str) -> Formula:
    """The median of samples, undefined (with this reason) without any."""

    def formula(counts: Counts) -> float | Undefined:
        values = counts[name].values
        return float(np.median(values)) if len(values) else Undefined(none)

    return formula


def mean(name: str, none: str) -> Formula:
    """The mean of samples, undefined (with this reason) without any."""

    def formula(counts: Counts) -> float | Undefined:
        values = counts[name].values
        return float(values.mean()) if len(values) else Undefined(none)

    return formula


def described(name: str, *totals: str) -> Parts:
    """Mean, median and number of samples, and further totals."""

    def parts(counts: Counts) -> Mapping[str, float]:
        values = counts[name].values
        numbers = {"n": float(len(values)), **{key: float(counts[key]) for key in totals}}
        if len(values):
            numbers |= {"mean": float(values.mean()), "median": float(np.median(values))}
        return numbers

    return parts


def mota(counts: Counts) -> float | Undefined:
    """1 - (misses + false positives + switches) / truths."""
    if not counts["truths"]:
        return Undefined(NO_TRUTH)
    errors = counts["misses"] + counts["false_positives"] + counts["switches"]
    return 1 - errors / counts["truths"]


def f1(true: str, missed: str, false: str) -> Formula:
    """2 true / (2 true + missed + false)."""

    def formula(counts: Counts) -> float | Undefined:
        rows = 2 * counts[true] + counts[missed] + counts[false]
        return 2 * counts[true] / rows if rows else Undefined("no truth and no tracks")

    return formula


def over_alphas(curve: Callable[[Counts], FloatArray]) -> Formula:
    """The mean of a curve over HOTA's thresholds."""

    def formula(counts: Counts) -> float | Undefined:
        rows = counts["true_positives"] + counts["misses"] + counts["false_positives"]
        return float(curve(counts).mean()) if rows.any() else Undefined("no truth and no tracks")

    return formula


def deta_curve(counts: Counts) -> FloatArray:
    """DetA at each threshold, (A,)."""
    rows = counts["true_positives"] + counts["misses"] + counts["false_positives"]
    return counts["true_positives"] / np.maximum(1, rows)


def assa_curve(counts: Counts) -> FloatArray:
    """AssA at each threshold, (A,); 0 where nothing matches."""
    return counts["association"] / np.maximum(1, counts["true_positives"])


def loca_curve(counts: Counts) -> FloatArray:
    """LocA at each threshold, (A,); 1 where nothing matches."""
    hits = counts["true_positives"]
    return np.where(hits > 0, counts["similarity"] / np.maximum(1, hits), 1.0)


def hota_curve(counts: Counts) -> FloatArray:
    """HOTA at each threshold, (A,)."""
    return np.sqrt(deta_curve(counts) * assa_curve(counts))


def speed_parts(counts: Counts) -> Mapping[str, float]:
    """The root mean square beside a mean velocity error, m/s."""
    if not counts["matches"]:
        return {}
    return {"root_mean_square": float(np.sqrt(counts["velocity_square"] / counts["matches"]))}


def kept_share(counts: Counts) -> float | Undefined:
    """The share of occlusions after which the old id came back."""
    occlusions = counts["kept"] + counts["lost"]
    return counts["kept"] / occlusions if occlusions else Undefined("no tracked object was hidden")


def nees_parts(counts: Counts) -> Mapping[str, float]:
    """How many estimates of how many runs; of five runs or more, where the mean of 95 % of as many
    honest ones lies.

    Estimates of one run are correlated, over frames and over the objects of a scene, so one run
    has no bounds of its own: runs are what varies.
    """
    nees, estimates = counts["run_nees"].values, counts["run_estimates"].values
    seen = estimates > 0
    nees, estimates = nees[seen], estimates[seen]
    parts = {"n": float(estimates.sum()), "runs": float(len(estimates))}
    if len(estimates) < FEWEST:
        return parts
    without = (nees.sum() - nees) / (estimates.sum() - estimates)
    reach = jackknife_reach(without, estimates)
    return {**parts, "low": max(0.0, STATE_DIMENSION - reach), "high": STATE_DIMENSION + reach}


def anees_parts(counts: Counts) -> Mapping[str, float]:
    """`nees_parts`, the bounds per dimension."""
    return {
        key: value / STATE_DIMENSION if key in ("low", "high") else value
        for key, value in nees_parts(counts).items()
    }


def calibration_error(counts: Counts) -> float | Undefined:
    """Mean over reports of |mean probability - share that is real| of their bin."""
    if not counts["reports"]:
        return Undefined(NO_TRACKS)
    return float(np.abs(counts["probability_sum"] - counts["hits"]).sum() / counts["reports"])
