"""Models of the detection probability P_D in view (Pang & Radha 2021, Sec. 2.6)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.density import Marks
from pmbm.filter.models.protocols import DETECTIONS, Detection
from pmbm.score import ScoreModel, confidence_in
from pmbm.types import Detections, FloatArray
from pmbm.validation import POSITIVE, SHARE, Bounds, check_fields

_INSIDE = Bounds(above=0.0, below=1.0)


@dataclass(frozen=True, kw_only=True)
class FixedDetection:
    """One P_D for all objects in view.

    probability : P_D.
    """

    probability: Annotated[float, SHARE] = 0.95

    def __post_init__(self) -> None:
        check_fields(self, "fixed detection")

    def of_undetected(self) -> float:
        return self.probability

    def of_tracks(self, marks: Marks) -> FloatArray:
        return np.full(len(marks), self.probability)

    def confidence(self, detections: Detections) -> FloatArray:
        return np.zeros(len(detections))

    def predicted(self, marks: Marks, dt: float) -> Marks:
        return marks

    def if_missed(self, marks: Marks, P_D: FloatArray) -> Marks:
        return marks

    def if_detected(self, marks: Marks, confidence: FloatArray) -> Marks:
        return marks

    def first(self, source: FloatArray, confidence: FloatArray) -> Marks:
        return Marks.of_source(source)

    def never_detected(self, source: FloatArray) -> Marks:
        return Marks.of_source(source)


@dataclass(frozen=True, kw_only=True)
class DetectionFromScores:
    """P_D of a track from the running mean of its past scores, linear between two bounds.

    Pang & Radha (2021, Sec. 2.6) say that P_D depends on past scores and leave the form open.

    low, high : the bounds.
    rising : whether clear tracks have the high one; then a track that was detected with high scores
        and is missed has probably gone.  Falling, it outlives a doubtful one.
    newest : weight of the newest score in the running mean.
    undetected : P_D of objects never detected, which have no past scores.
    score_model : what a score means; None takes scores at their word.
    """

    low: Annotated[float, SHARE] = 0.7
    high: Annotated[float, SHARE] = 0.95
    rising: bool = False
    newest: Annotated[float, Bounds(above=0.0, most=1.0)] = 0.3
    undetected: Annotated[float, SHARE] = 0.95
    score_model: ScoreModel | None = None

    def __post_init__(self) -> None:
        check_fields(self, "detection from scores")
        if self.low > self.high:
            raise InputError(
                "detection from scores",
                field="low",
                expected=f"at most high = {self.high:g}",
                got=self.low,
            )

    def of_undetected(self) -> float:
        return self.undetected

    def of_tracks(self, marks: Marks) -> FloatArray:
        share = marks.confidence if self.rising else 1 - marks.confidence
        return np.clip(self.low + (self.high - self.low) * share, self.low, self.high)

    def confidence(self, detections: Detections) -> FloatArray:
        return confidence_in(detections, self.score_model)

    def predicted(self, marks: Marks, dt: float) -> Marks:
        return marks

    def if_missed(self, marks: Marks, P_D: FloatArray) -> Marks:
        return marks

    def if_detected(self, marks: Marks, confidence: FloatArray) -> Marks:
        mean = (1 - self.newest) * marks.confidence + self.newest * confidence
        return Marks(marks.source, mean, marks.detectable)

    def first(self, source: FloatArray, confidence: FloatArray) -> Marks:
        return Marks(source, confidence, np.ones(len(source)))

    def never_detected(self, source: FloatArray) -> Marks:
        return Marks.of_source(source)


@dataclass(frozen=True, kw_only=True)
class DetectionChain:
    """Misses that come in runs: a two-state Markov chain of being detectable, or not for the time
    being, around another model of P_D.

    A parked van, a bad angle, a wet windscreen: after a miss the object is probably still not
    detectable, so that the next miss says less about its existence.

    base : P_D of an object while it is detectable.
    undetectable : share of P_D that is left while it is not.
    stay_detectable, stay_undetectable : probability of staying in a state over `interval`.
    interval : s.
    """

    base: Annotated[Detection, DETECTIONS] = field(default_factory=FixedDetection)
    undetectable: Annotated[float, SHARE] = 0.1
    stay_detectable: Annotated[float, _INSIDE] = 0.97
    stay_undetectable: Annotated[float, _INSIDE] = 0.8
    interval: Annotated[float, POSITIVE] = 0.1

    def __post_init__(self) -> None:
        check_fields(self, "detection chain")
        if isinstance(self.base, DetectionChain):
            raise InputError(
                "detection chain",
                field="base",
                expected="a model without a chain of its own",
                got=type(self.base).__name__,
            )
        if self.stay_detectable + self.stay_undetectable < 1:
            raise InputError(
                "detection chain",
                field="stay_undetectable",
                expected="staying at least as probable as changing",
                got=self.stay_undetectable,
            )

    @property
    def stationary(self) -> float:
        """P(detectable) in the long run: of an object about which nothing else is known."""
        return (1 - self.stay_undetectable) / (2 - self.stay_detectable - self.stay_undetectable)

    def share(self, detectable: FloatArray) -> FloatArray:
        """Share (H,) of the base's P_D that objects have, given P(detectable) (H,)."""
        return detectable + (1 - detectable) * self.undetectable

    def of_undetected(self) -> float:
        usual = self.stationary
        return self.base.of_undetected() * (usual + (1 - usual) * self.undetectable)

    def of_tracks(self, marks: Marks) -> FloatArray:
        return self.base.of_tracks(marks) * self.share(marks.detectable)

    def confidence(self, detections: Detections) -> FloatArray:
        return self.base.confidence(detections)

    def predicted(self, marks: Marks, dt: float) -> Marks:
        marks = self.base.predicted(marks, dt)
        memory = (self.stay_detectable + self.stay_undetectable - 1) ** (dt / self.interval)
        after = self.stationary + (marks.detectable - self.stationary) * memory
        return Marks(marks.source, marks.confidence, after)

    def if_missed(self, marks: Marks, P_D: FloatArray) -> Marks:
        marks = self.base.if_missed(marks, P_D)
        after = detectable_if_missed(marks.detectable, P_D, self.undetectable)
        return Marks(marks.source, marks.confidence, after)

    def if_detected(self, marks: Marks, confidence: FloatArray) -> Marks:
        marks = self.base.if_detected(marks, confidence)
        return Marks(marks.source, marks.confidence, self._after_detection(marks.detectable))

    def first(self, source: FloatArray, confidence: FloatArray) -> Marks:
        marks = self.base.first(source, confidence)
        usual = self._after_detection(np.full(1, self.stationary))
        return Marks(marks.source, marks.confidence, usual.repeat(len(marks)))

    def never_detected(self, source: FloatArray) -> Marks:
        marks = self.base.never_detected(source)
        return Marks(marks.source, marks.confidence, np.full(len(marks), self.stationary))

    def _after_detection(self, detectable: FloatArray) -> FloatArray:
        return detectable / np.maximum(self.share(detectable), np.finfo(float).tiny)


def detectable_if_missed(
    detectable: FloatArray, P_D: FloatArray, undetectable: float
) -> FloatArray:
    """P(detectable) (H,) of objects that exist and were missed.

    P_D (H,) : over both states.  undetectable : share of P_D that is left in the other state.
    """
    share = detectable + (1 - detectable) * undetectable
    missed_if_detectable = 1 - P_D / np.maximum(share, np.finfo(float).tiny)
    chance = 1 - P_D
    return np.divide(
        detectable * missed_if_detectable, chance, out=detectable.copy(), where=chance > 0
    )
