"""Confidences fitted: the scale on which they are Beta variables, and those of true boxes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize, special

from pmbm.sim.detector.knobs import Curve
from pmbm.sim.fit.binning import BIN_WIDTH, binned
from pmbm.sim.fit.observations import Observations, Opportunities
from pmbm.sim.streams import normal
from pmbm.types import FloatArray, IntArray


@dataclass(frozen=True)
class ScoreScale:
    """Scores come from Beta variables: log-odds divided by a temperature, plus an offset, and
    squeezed into what is above a floor."""

    temperature: float
    offset: float
    floor: float

    def quality(self, score: FloatArray) -> FloatArray:
        """The Beta variables (R,) behind scores (R,)."""
        above = (score - self.floor) / (1 - self.floor)
        log_odds = special.logit(np.clip(above, 1e-9, 1 - 1e-9))
        return np.clip(special.expit(self.temperature * (log_odds - self.offset)), 1e-6, 1 - 1e-6)


def score_scale(evidence: Observations) -> ScoreScale:
    """The scale on which scores are most like Betas (maximum likelihood over moment fits)."""
    hits, falses = evidence.hits, evidence.falses
    chances = evidence.chances.take(hits.chance)
    groups = [
        (hits.score, chances.label, chances.distance),
        (falses.score, falses.label, falses.distance),
    ]
    split = []
    for score, label, distance in groups:
        bins = label * 100 + (distance / BIN_WIDTH).astype(np.int64)
        split.append((score, np.unique(bins, return_inverse=True)[1], label))

    scores = np.concatenate([score for score, _, _ in groups])
    floor = float(np.clip(scores.min() - 1e-3, 0.0, 0.99)) if len(scores) else 0.0

    def loss(x: FloatArray) -> float:
        scale = ScoreScale(float(np.exp(x[0])), float(x[1]), floor)
        total = 0.0
        for score, bins, label in split:
            value = scale.quality(score)
            for kind in np.unique(label):
                rows = label == kind
                inside = value[rows]
                mean = np.clip(binned(value, bins), 1e-3, 1 - 1e-3)[bins[rows]]
                concentration = concentration_of(inside, mean)
                a, b = mean * concentration, (1 - mean) * concentration
                density = a * np.log(inside) + b * np.log1p(-inside) - special.betaln(a, b)
                total -= float(density.sum()) + len(inside) * x[0]
        return total + 0.1 * float(np.square(x[0]) + np.square(x[1]))

    found = optimize.minimize(
        loss, np.zeros(2), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1.0}
    )
    return ScoreScale(float(np.exp(found.x[0])), float(found.x[1]), floor)


def fit_scores(
    score: FloatArray,
    chances: Opportunities,
    bins: IntArray,
    at: tuple[float, ...],
    scale: ScoreScale,
) -> tuple[dict[str, Any], FloatArray]:
    """The knobs of true scores, and each box's standard normal quality under them."""
    value = scale.quality(score)
    hidden = 1 - chances.visibility
    loss = 0.0
    for _ in range(5):
        # Alternate the mean in full view, bin by bin, and what hiding takes off it.
        mean = np.clip(binned(value, bins) / binned(1 - loss * hidden, bins), 1e-3, 1 - 1e-3)
        if hidden.any():
            expected = mean[bins] * hidden
            lost = expected @ (mean[bins] - value) / (expected @ expected)
            loss = float(np.clip(lost, 0.0, 0.9))
    expected = np.clip(mean[bins] * (1 - loss * hidden), 1e-3, 1 - 1e-3)
    concentration = concentration_of(value, expected)
    below = special.betainc(expected * concentration, (1 - expected) * concentration, value)
    quality = normal(np.clip(below, 1e-9, 1 - 1e-9))
    knobs = {
        "score_mean": Curve(at=at, value=tuple(mean)),
        "hidden_score_loss": loss,
        "score_concentration": concentration,
    }
    return knobs, quality


def concentration_of(value: FloatArray, mean: FloatArray) -> float:
    """Sum of the shapes of Betas of these means by their pooled variance."""
    spread = np.square(value - mean).sum()
    return float(np.clip((mean * (1 - mean)).sum() / max(spread, 1e-9) - 1, 0.2, 500.0))
