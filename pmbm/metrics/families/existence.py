"""Existence: reported probabilities against the share of reports that is real.

A reported track "exists" in a frame where it is matched to an object.

Brier, "Verification of forecasts expressed in terms of probability", Monthly Weather Review 78,
1950; expected calibration error: Naeini, Cooper, Hauskrecht, "Obtaining well calibrated
probabilities using Bayesian binning", AAAI 2015.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from pmbm.arrays import FloatArray, IntArray
from pmbm.errors import InputError
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import NO_TRACKS, Ratio
from pmbm.metrics.core.result import Counts, Undefined


@dataclass(frozen=True, eq=False, kw_only=True)
class Reliability:
    """Reports sorted into B bins of equal width by probability; runs are combined by adding.

    edges (B+1,) : a bin holds its lower edge, the last one both.
    count (B,) : reports.  hits (B,) : those that are true.  probability_sum (B,).
    square_sum : over reports, (probability - truth)^2.
    """

    edges: FloatArray
    count: IntArray
    hits: IntArray
    probability_sum: FloatArray
    square_sum: float

    def __add__(self, other: Reliability) -> Reliability:
        return Reliability(
            edges=self.edges,
            count=self.count + other.count,
            hits=self.hits + other.hits,
            probability_sum=self.probability_sum + other.probability_sum,
            square_sum=self.square_sum + other.square_sum,
        )

    @property
    def expected_error(self) -> float | None:
        """Mean over reports of |mean probability - share that is true| of their bin."""
        total = int(self.count.sum())
        return float(np.abs(self.probability_sum - self.hits).sum()) / total if total else None

    @property
    def curve(self) -> tuple[FloatArray, FloatArray]:
        """Mean probability and share that is true of each bin that is not empty."""
        used = self.count > 0
        count = self.count[used]
        return self.probability_sum[used] / count, self.hits[used] / count


def reliability(probability: ArrayLike, true: ArrayLike, bins: int = 10) -> Reliability:
    """Sort reports, probability (N,) in [0, 1] and whether they are true (N,), into bins."""
    p, hit = np.asarray(probability, np.float64), np.asarray(true, np.bool_)
    if p.ndim != 1 or hit.shape != p.shape:
        raise InputError(
            "bad reports", field="true", expected=f"shape {p.shape}", got=f"shape {hit.shape}"
        )
    outside = np.flatnonzero(~((p >= 0) & (p <= 1)))
    if len(outside):
        raise InputError(
            "bad probability",
            field="probability",
            rows=outside,
            expected="numbers in [0, 1]",
            got=p[outside[0]],
        )
    if bins < 1:
        raise InputError("bad number of bins", field="bins", expected="at least 1", got=bins)
    place = np.minimum((p * bins).astype(np.int64), bins - 1)
    return Reliability(
        edges=np.linspace(0.0, 1.0, bins + 1),
        count=np.bincount(place, minlength=bins),
        hits=np.bincount(place, hit, minlength=bins).astype(np.int64),
        probability_sum=np.bincount(place, p, minlength=bins).astype(np.float64),
        square_sum=float(((p - hit) ** 2).sum()),
    )


@dataclass(frozen=True)
class CalibrationError:
    """Mean over reports of |mean probability - share that is real| of their bin."""

    def __call__(self, counts: Counts) -> float | Undefined:
        if not counts["reports"]:
            return Undefined(NO_TRACKS)
        return float(np.abs(counts["probability_sum"] - counts["hits"]).sum() / counts["reports"])


def _count(work: Work) -> Tally:
    real = np.zeros(len(work.scene.tracks), np.bool_)
    real[work.matches.track] = True
    result = reliability(work.scene.tracks.score, real)
    return Tally.of(
        {
            "reports": len(real),
            "count": result.count,
            "hits": result.hits,
            "probability_sum": result.probability_sum,
            "square_sum": result.square_sum,
        },
        gate=work.parameters.gate,
        bins=len(result.count),
    )


FAMILY: Final = Family(
    name="existence",
    rule="the reported probability of a track against whether CLEAR MOT matches it, in bins",
    count=_count,
    metrics=(
        share(
            name="existence_brier",
            direction="lower",
            default=False,
            question="How good is the reported probability of existence (mean squared error)?",
            formula=Ratio("square_sum", "reports", NO_TRACKS),
        ),
        share(
            name="existence_calibration_error",
            direction="lower",
            default=False,
            question="How far is the reported probability from the share that is real?",
            formula=CalibrationError(),
        ),
    ),
)
