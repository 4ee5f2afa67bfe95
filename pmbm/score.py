"""What a detector's score says: the probability that the detection is true, and how much more
probable the score is of an object than of clutter.

A model is a rising curve of log-odds over the score.  It is fitted from scores with known origin,
by logistic regression or by isotonic regression, and kept as TOML.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from pmbm.arrays import FloatArray
from pmbm.durable import replace_text
from pmbm.errors import InputError, nearest_hint
from pmbm.kernels import twin
from pmbm.types import Detections, Label, Recording
from pmbm.validation import Checker, equal_fields, hash_of_fields

Scale = Literal["score", "raw_score"]

_LABELS = len(Label)
_SURE = 1e-6
"""Probabilities are kept this far from 0 and 1, so that no single score decides for ever."""
_LEAST_CONFIDENCE = 1e-3
_SCALES = ("score", "raw_score")


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoreModel:
    """Calibrated log-odds of a detection being true, as a function of its score.

    knot (K,) : scores, strictly rising, K >= 1.
    log_odds (K,) : log(q / (1 - q)) at the knots, q = P(true | score); linear between the knots,
        constant beyond them.
    base_rate : P(true) among the detections that the model was fitted to, in (0, 1).
    scale : whether the knots are on the scale of `Detections.score` or `Detections.raw_score`.

    Example
    -------
    >>> model = ScoreModel.trusting()
    >>> float(model.probability([0.8])[0].round(6))
    0.8
    """

    knot: FloatArray
    log_odds: FloatArray
    base_rate: float
    scale: Scale = "score"

    def __post_init__(self) -> None:
        door = Checker(self, "score model")
        knots = np.size(self.knot)
        door.floats("knot", (max(knots, 1),))
        door.floats("log_odds", (knots,))
        door.number("base_rate", above=0.0)
        if (np.diff(self.knot) <= 0).any():
            raise InputError("score model", field="knot", expected="strictly rising", got=self.knot)
        if self.base_rate >= 1:
            raise InputError(
                "score model", field="base_rate", expected="below 1", got=self.base_rate
            )
        if self.scale not in _SCALES:
            raise InputError(
                "score model",
                field="scale",
                got=self.scale,
                hint=nearest_hint(self.scale, _SCALES, "scale"),
            )

    __eq__ = equal_fields
    __hash__ = hash_of_fields

    def read(self, detections: Detections) -> FloatArray:
        """The scores (N,) on the scale that this model reads.

        Raises InputError where it reads raw scores and the detections have none.
        """
        if self.scale == "score":
            return detections.score
        if detections.raw_score is None:
            raise InputError(
                "the score model reads raw scores, and the detections have none",
                field="raw_score",
                hint="fit a model to calibrated scores: scale = 'score'",
            )
        return detections.raw_score

    def probability(self, score: ArrayLike) -> FloatArray:
        """(N,) calibrated P(true | score)."""
        given = np.asarray(score, dtype=np.float64)
        return _precise_logistic(_read_off(given, self.knot, self.log_odds, 0.0, np.inf))

    def log_likelihood_ratio(self, score: ArrayLike, within: float = np.inf) -> FloatArray:
        """(N,) log p(score | object) / p(score | clutter): the log-odds less those of the base;
        beyond `within`, either way, a score says no more."""
        given = np.asarray(score, dtype=np.float64)
        return _read_off(given, self.knot, self.log_odds, self._base_log_odds, within)

    @cached_property
    def _base_log_odds(self) -> float:
        return float(_logit(np.float64(self.base_rate)))

    def evidence(self, score: ArrayLike) -> FloatArray:
        """(N,) the score's own word in [0, 1], whatever the base rate: 0.5 says nothing.

        The logistic of the log likelihood ratio.
        """
        return _precise_logistic(self.log_likelihood_ratio(score))

    @staticmethod
    @cache
    def trusting(base_rate: float = 0.5) -> ScoreModel:
        """Takes scores in [0, 1] at their word: q = score."""
        knot = np.concatenate([[0.0], np.linspace(0.001, 0.999, 999), [1.0]])
        return ScoreModel(
            knot=knot, log_odds=_logit(np.clip(knot, 1e-4, 1 - 1e-4)), base_rate=base_rate
        )

    @staticmethod
    def uninformative() -> ScoreModel:
        """A score model that tells objects and clutter apart by nothing."""
        return ScoreModel(knot=np.zeros(1), log_odds=np.zeros(1), base_rate=0.5)

    @staticmethod
    def fit_isotonic(
        score: ArrayLike, true: ArrayLike, scale: Scale = "score", bins: int = 30
    ) -> ScoreModel:
        """The rising curve nearest to the shares of true detections in bins of equal counts, by
        pooling neighbours that fall (Ayer et al., Annals of Mathematical Statistics 26, 1955)."""
        x, y = _sample(score, true)
        order = np.argsort(x, kind="stable")
        blocks: list[list[float]] = []
        for rows in np.array_split(order, min(bins, len(order))):
            blocks.append([float(y[rows].sum()), float(len(rows)), float(x[rows].sum())])
            while len(blocks) > 1 and _falls(blocks[-2], blocks[-1]):
                last = blocks.pop()
                blocks[-1] = [a + b for a, b in zip(blocks[-1], last, strict=True)]
        true_count, count, total = np.array(blocks).T
        knot = total / count
        log_odds = _logit((true_count + 0.5) / (count + 1))
        rising = np.concatenate([[True], np.diff(knot) > 0])
        return ScoreModel(
            knot=knot[rising],
            log_odds=np.maximum.accumulate(log_odds)[rising],
            base_rate=_base_rate(y),
            scale=scale,
        )

    def save(self, path: str | Path) -> None:
        """Write the model as TOML."""
        replace_text(
            Path(path),
            "# Calibrated log-odds of a detection being true, over its score.\n"
            f'scale = "{self.scale}"\n'
            f"base_rate = {self.base_rate!r}\n"
            f"knot = {self.knot.tolist()!r}\n"
            f"log_odds = {self.log_odds.tolist()!r}\n",
        )

    @staticmethod
    def load(path: str | Path) -> ScoreModel:
        """Read a model; raises InputError, naming file and key, where it cannot be used."""
        try:
            values: dict[str, Any] = tomllib.loads(Path(path).read_text(encoding="utf-8-sig"))
        except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
            raise InputError(f"score model cannot be read: {error}", file=path) from None
        known = ("scale", "base_rate", "knot", "log_odds")
        for name in values:
            if name not in known:
                raise InputError(
                    "unknown key", file=path, field=name, hint=nearest_hint(name, known, "key")
                )
        missing = [name for name in known[1:] if name not in values]
        if missing:
            raise InputError("missing key", file=path, field=missing[0])
        try:
            return ScoreModel(**values)
        except InputError as error:
            raise error.located(file=path) from None


@twin("read_off")
def _read_off(
    x: FloatArray, knot: FloatArray, value: FloatArray, base: float, within: float
) -> FloatArray:
    """A curve's height over x (N,) less its base, from -within to within."""
    return np.clip(np.interp(x, knot, value) - base, -within, within)


def confidence_in(detections: Detections, model: ScoreModel | None) -> FloatArray:
    """(N,) the evidence of each detection's score, kept off 0 and 1; None takes scores at their
    word.

    Raises InputError as `ScoreModel.read` does.
    """
    model = model or ScoreModel.trusting()
    evidence = model.evidence(model.read(detections))
    return np.clip(evidence, _LEAST_CONFIDENCE, 1 - _LEAST_CONFIDENCE)


@dataclass(frozen=True, eq=False, kw_only=True)
class Calibration:
    """Log-odds that a detection is what its label says: linear in its raw score and in its range,
    label by label, and less where a detection of another label claims the same place.

    offset, slope, per_metre (7,) : log-odds = offset + slope raw_score + per_metre range, by label;
        the range, in m from the sensor, counts between `near` and `far`.
    apart : m; things of two labels are at least this far from each other, centre from centre.

    Two detections nearer than that cannot both be what they say.  Of such a pair, with odds a and b
    taken alone, the first is true with odds a / (1 + b).
    """

    offset: FloatArray
    slope: FloatArray
    per_metre: FloatArray
    near: float = 10.0
    far: float = 60.0
    apart: float = 0.8

    def __post_init__(self) -> None:
        door = Checker(self, "calibration")
        for name in ("offset", "slope", "per_metre"):
            door.floats(name, (_LABELS,))
        door.number("near", at_least=0.0)
        door.number("far", above=self.near)
        door.number("apart", at_least=0.0)

    __eq__ = equal_fields
    __hash__ = hash_of_fields

    def log_odds(self, detections: Detections) -> FloatArray:
        """(N,) log-odds of every detection, of whatever label.

        Raises InputError where the detections have no raw scores.
        """
        alone = self._alone(detections)
        if self.apart == 0 or len(alone) < 2:
            return alone
        x, y = detections.position[:, 0], detections.position[:, 1]
        near = np.hypot(x[:, None] - x, y[:, None] - y) < self.apart
        rivals = near & (detections.label[:, None] != detections.label)
        return alone - np.log1p(rivals @ np.exp(alone))

    def _alone(self, detections: Detections) -> FloatArray:
        if detections.raw_score is None:
            raise InputError(
                "the calibration reads raw scores, and the detections have none", field="raw_score"
            )
        own = detections.label
        return (
            self.offset[own]
            + self.slope[own] * detections.raw_score
            + self.per_metre[own] * detections.distance.clip(self.near, self.far)
        )


def raw_scores(recordings: Iterable[Recording], label: Label) -> FloatArray:
    """(N,) the raw scores of all detections of a label that have one."""
    found = [
        one.raw_score[one.label == label]
        for recording in recordings
        for one in recording.detections
        if one.raw_score is not None
    ]
    return np.concatenate([np.zeros(0), *found])


def logistic(x: FloatArray) -> FloatArray:
    """1 / (1 + exp(-x)) to an absolute error of rounding: 0 below -38."""
    return 0.5 * (1.0 + np.tanh(x / 2))


def _precise_logistic(x: FloatArray) -> FloatArray:
    """`logistic` to a relative error of rounding, for small probabilities whose odds matter."""
    with np.errstate(over="ignore"):
        return 1.0 / (1.0 + np.exp(-x))


def _logit(q: Any) -> Any:
    return np.log(q) - np.log1p(-q)


def _base_rate(y: FloatArray) -> float:
    return float(np.clip(y.mean(), _SURE, 1 - _SURE))


def _falls(left: list[float], right: list[float]) -> bool:
    return left[0] / left[1] >= right[0] / right[1]


def _sample(score: ArrayLike, true: ArrayLike) -> tuple[FloatArray, FloatArray]:
    x, y = np.asarray(score, dtype=np.float64), np.asarray(true, dtype=np.float64)
    if x.ndim != 1 or not len(x) or not np.isfinite(x).all():
        raise InputError("fitting a score model", field="score", expected="N > 0 finite numbers")
    if y.shape != x.shape or not np.isin(y, (0, 1)).all():
        raise InputError(
            "fitting a score model", field="true", expected=f"{len(x)} flags", got=f"{y.shape}"
        )
    return x, y
