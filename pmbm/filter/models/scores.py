"""Scores of detections where they tell no lasting classes of sources apart (Pang & Radha 2021,
Sec. 2.6; the paper names the ideas and gives no formulas)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.models.protocols import SceneDensity
from pmbm.score import ScoreModel, confidence_in
from pmbm.types import Detections, FloatArray
from pmbm.validation import check_fields

_ONE = np.ones(1)


@dataclass(frozen=True, eq=False, slots=True)
class ScoredDetections:
    """The detections of a frame that may come from the tracker's objects, and what they say.

    detections : M of them.
    evidence (M,K) : p(score, label | class) / p(score, label | clutter).
    birth (K,) or (M,K) : shares of the classes among sources detected for the first time, the same
        anywhere or by what may be where each measurement is.
    first (M,2) : factors on the density of first detections and on that of clutter; None, none.
    said (M,R) : what each detection adds to the running sums of its source's record.
    """

    detections: Detections
    evidence: FloatArray
    birth: FloatArray
    first: FloatArray | None
    said: FloatArray


class NoRecord:
    """Sources of which no record is kept, R = 0, and whose classes never change."""

    @property
    def steady(self) -> bool:
        return True

    @property
    def sums(self) -> int:
        return 0

    def aged(self, record: FloatArray, dt: float) -> FloatArray:
        return record

    def recorded_share(self, record: FloatArray, distance: FloatArray) -> FloatArray:
        return np.ones(len(record))

    def share_by_life(
        self, record: FloatArray, distance: FloatArray, time: FloatArray
    ) -> FloatArray | None:
        return None


class OneClass(NoRecord):
    """Sources that scores do not tell apart: all are objects, K = 1."""

    @property
    def classes(self) -> int:
        return 1

    @property
    def needs_all_labels(self) -> bool:
        return False

    def predicted(self, source: FloatArray, dt: float) -> FloatArray:
        return source

    def object_share(self, scene: SceneDensity) -> FloatArray:
        return _ONE

    def observed(
        self, scene: SceneDensity, in_view: Callable[[FloatArray], float], dt: float
    ) -> SceneDensity:
        return scene

    def labels(self, last: NDArray[np.int8], source: FloatArray) -> NDArray[np.int8]:
        return last


@dataclass(frozen=True, kw_only=True)
class IgnoreScores(OneClass):
    """Scores say nothing."""

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        n = len(detections)
        return ScoredDetections(detections, np.ones((n, 1)), _ONE, None, np.zeros((n, 0)))


@dataclass(frozen=True, kw_only=True)
class FirstScore(OneClass):
    """The score s of a first detection scales its existence and weight, as the paper has it:
    r = s e / (s e + (1 - s) lambda_c).

    score_model : what a score means; None takes scores at their word.
    """

    score_model: ScoreModel | None = None

    def __post_init__(self) -> None:
        check_fields(self, "first score")

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        s = confidence_in(detections, self.score_model)
        first = np.column_stack([2 * s, 2 * (1 - s)])
        return ScoredDetections(
            detections, np.ones((len(s), 1)), _ONE, first, np.zeros((len(s), 0))
        )


@dataclass(frozen=True, kw_only=True)
class EveryScore(OneClass):
    """Every score counts as a likelihood ratio of object against clutter, in all branches.

    score_model : what a score means; None takes scores at their word.
    """

    score_model: ScoreModel | None = None

    def __post_init__(self) -> None:
        check_fields(self, "every score")

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        s = confidence_in(detections, self.score_model)
        ratio = (s / (1 - s))[:, None]
        return ScoredDetections(detections, ratio, _ONE, None, np.zeros((len(s), 0)))
