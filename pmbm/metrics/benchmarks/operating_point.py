"""Scores at every threshold on a tracker's scores, and the calibration of these.

A tracker that reports what is more probably true than not, by a probability that is honest, leaves
nothing to be gained by a threshold: what one would gain is its regret.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.intervals import FEWEST, jackknife_reach
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.metrics.benchmarks.trackeval import SimilarityScore, trackeval_matches
from pmbm.metrics.families.existence import Reliability, reliability

THRESHOLDS: Final = np.concatenate([np.arange(0.0, 0.96, 0.04), [0.97, 0.98, 0.99, 0.995, 0.999]])
_ENOUGH: Final = 100
"""Rows from which on a sequence's share of true ones is known."""
_SURE: Final = 1e-4
_DRAWS: Final = 4000
_HONEST: Final = (0.5, 0.95)


@dataclass(frozen=True, eq=False)
class Sweep:
    """The counts of one sequence and class at every threshold.

    errors (T,) : false, missed and switched boxes among what scores above each threshold.
    truths : boxes.  score (K,), true (K,), id (K,) : of what was reported and counts.
    """

    errors: IntArray
    truths: int
    score: FloatArray
    true: BoolArray
    id: IntArray


def sweep(
    rule: SimilarityScore, sequence: ComparedSequence, thresholds: FloatArray = THRESHOLDS
) -> Sweep:
    """Count a sequence's reports at every threshold by a rule's own matching."""
    similar, excused = rule.similar(sequence)
    score = similar.scene.tracks.score
    errors: list[int] = []
    found = None
    before = -1
    for threshold in thresholds.tolist():
        kept = score > threshold
        if found is not None and int(kept.sum()) == before:
            errors.append(errors[-1])
            continue
        before = int(kept.sum())
        counted = similar.with_tracks(kept).counted(rule.least, excused[kept])
        matches = trackeval_matches(counted.scene, counted.similarity, rule.least)
        hit = np.zeros(len(counted.scene.tracks), bool)
        hit[matches.track] = True
        misses = len(counted.scene.truth) - len(matches)
        errors.append(misses + int((~hit).sum()) + int(matches.switch.sum()))
        if found is None:
            found = counted.scene.tracks, hit, len(counted.scene.truth)
    assert found is not None
    reported, true, truths = found
    return Sweep(np.array(errors), truths, reported.score, true, reported.id)


@dataclass(frozen=True)
class OperatingPoint:
    """Several sequences of one class together.

    mota : as given, with its 95 % interval by a jackknife over the sequences, None where fewer than
        five hold objects.
    best, best_threshold : at the single threshold that does best.
    reported, true : mean probability of what was reported, and the share of it that is true; None
        where nothing was.
    spread : root mean square of their difference over sequences of 100 rows and more; None without.
    honest_spread : what it would be by chance alone, `honest_spread`.
    log_loss : mean over what was reported.  reliability : in ten bins.
    """

    mota: float
    low: float | None
    high: float | None
    best: float
    best_threshold: float
    reported: float | None
    true: float | None
    spread: float | None
    honest_spread: tuple[float, float] | None
    log_loss: float | None
    reliability: Reliability

    @property
    def regret(self) -> float:
        return self.best - self.mota


def operating_point(
    sweeps: Sequence[Sweep], thresholds: FloatArray = THRESHOLDS
) -> OperatingPoint | None:
    """What these sequences say together, or None without truth.  The first threshold is what the
    reports were given at."""
    truths = np.array([one.truths for one in sweeps])
    errors = np.array([one.errors for one in sweeps])
    if not truths.sum():
        return None
    mota = 1 - errors.sum(axis=0) / truths.sum()
    best = int(np.argmax(mota))
    score = np.concatenate([one.score for one in sweeps])
    true = np.concatenate([one.true for one in sweeps])
    p = score.clip(_SURE, 1 - _SURE)
    known = [one for one in sweeps if len(one.score) >= _ENOUGH]
    off = [float(one.score.mean() - one.true.mean()) for one in known]
    held = truths > 0
    low = high = None
    if held.sum() >= FEWEST:
        given, counted = errors[held, 0], truths[held]
        without = 1 - (given.sum() - given) / (counted.sum() - counted)
        reach = jackknife_reach(without, counted.astype(np.float64).tolist())
        low, high = float(mota[0]) - reach, float(mota[0]) + reach
    return OperatingPoint(
        mota=float(mota[0]),
        low=low,
        high=high,
        best=float(mota[best]),
        best_threshold=float(thresholds[best]),
        reported=float(score.mean()) if len(score) else None,
        true=float(true.mean()) if len(score) else None,
        spread=float(np.sqrt(np.mean(np.square(off)))) if off else None,
        honest_spread=honest_spread(known) if known else None,
        log_loss=float(-np.where(true, np.log(p), np.log1p(-p)).mean()) if len(p) else None,
        reliability=reliability(score.clip(0.0, 1.0), true),
    )


def honest_spread(sweeps: Sequence[Sweep]) -> tuple[float, float]:
    """Median and 95 % quantile of the root mean square, over sequences, of mean reported
    probability less share true, if these very reports were honest: a few tracks make a share, so
    chance alone takes it from its mean.

    Each track is true in all its rows or in none, with the mean probability that they report.
    """
    rng = np.random.default_rng(0)
    square = np.zeros(_DRAWS)
    for one in sweeps:
        track = np.unique(one.id, return_inverse=True)[1]
        rows = np.bincount(track)
        p = np.bincount(track, weights=one.score).clip(0.0, rows) / rows
        true = rng.random((_DRAWS, len(rows))) < p
        square += np.square((p - true) @ rows / rows.sum())
    median, high = np.quantile(np.sqrt(square / len(sweeps)), _HONEST)
    return float(median), float(high)
