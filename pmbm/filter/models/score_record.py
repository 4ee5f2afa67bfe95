"""What a source's detections have said so far, as a logistic regression."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Annotated, Final

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.models.protocols import SceneDensity
from pmbm.filter.models.scores import OneClass, ScoredDetections
from pmbm.score import logistic
from pmbm.types import Detections, FloatArray, IntArray, Label
from pmbm.validation import POSITIVE, Checker, check_fields, equal_fields


@dataclass(frozen=True, kw_only=True)
class RecordWeights:
    """Weights of a logistic regression on a source's record, in the order of `features`.

    log-odds = offset + score s + count ln(n / 5) + detected f + distance d + distance_squared d^2
    + rival q.
    """

    offset: float
    score: float
    count: float = 0.0
    detected: float = 0.0
    distance: float = 0.0
    distance_squared: float = 0.0
    rival: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "score record")

    def share(self, told: FloatArray) -> FloatArray:
        """P(object) (T,) of sources with these features (T,7)."""
        return logistic(told @ np.array([getattr(self, name) for name in WEIGHTS]))


WEIGHTS: Final = tuple(one.name for one in fields(RecordWeights))
_SUREST: Final = 40.0
"""Log-odds of what is not in doubt."""
_NEAREST, _MIDDLE, _FARTHEST, _UNIT = 5.0, 30.0, 70.0, 15.0
"""m: distances count between the first and the third, from the second, in the last."""
_SLACK = 1e-6
"""s by which two times that are the same may differ."""
_FEW = 5.0
"""Detections from which on their number speaks for a source, not against it."""
_APART = 0.8
"""m; things of two labels are at least this far from each other, centre from centre."""
_SHARP = 3.0
"""How sharply a rival's score begins to count about the middle of its label's scores."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ScoreRecord(OneClass):
    """How probably a source of detections is an object, by the record of its detections.

    The filter follows every source alike, whatever its scores; which of them are objects is said by
    a logistic regression on what their detections said.  A detector says the same of a pole in
    every frame, so scores that follow each other are no independent evidence: they count by their
    mean, never by their sum.  It is linear in

    s : mean of the source's scores, recent ones first: weights fall by e over `memory` seconds.
    n : how many there are.
    f : share of the frames since the first of them that have one.
    d : distance from the sensor less 30 m, in units of 15 m, between 5 and 70 m.
    q : mean, recent ones first, of how high the scores of another label's detections are at the
        same place, within .8 m; 0 without.

    label : of the sources; detections of other labels count as rivals alone.
    middle, spread (7,) : by label, the raw score that counts as 0, and what counts as 1 above it;
        of a label whose spread is 0 there are no rivals.
    online : the weights while it goes on.  batch : those of a source whose whole life is known: n
        and f are those at its end, s and q those half a `memory` later.  None: those of `online`.
    """

    label: int
    middle: FloatArray
    spread: FloatArray
    online: RecordWeights
    batch: RecordWeights | None = None
    memory: Annotated[float, POSITIVE] = 1.0

    def __post_init__(self) -> None:
        check_fields(self, "score record")
        door = Checker(self, "score record")
        for name in ("middle", "spread"):
            door.floats(name, (len(Label),))
        if self.label not in list(Label) or self.spread[self.label] <= 0:
            raise InputError(
                "score record",
                field="label",
                expected="a label whose spread is above 0",
                got=self.label,
            )

    __eq__ = equal_fields

    @property
    def needs_all_labels(self) -> bool:
        return True

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        """Raises InputError where the detections have no raw scores."""
        raw = detections.raw_score
        if raw is None and len(detections):
            raise InputError(
                "the score record reads raw scores, and the detections have none", field="raw_score"
            )
        known = self.spread[detections.label] > 0
        scale = np.where(known, self.spread[detections.label], 1.0)
        raw = np.zeros(0) if raw is None else raw
        score = (raw - self.middle[detections.label]) / scale
        own = np.flatnonzero(detections.label == self.label)
        rival = self._rivals(detections, own, np.where(known, score, -np.inf))
        n, one = len(own), np.ones(len(own))
        return ScoredDetections(
            detections.take(own),
            np.ones((n, 1)),
            np.ones(1),
            None,
            np.column_stack([score[own], one, rival, one, np.zeros(n)]),
        )

    def _rivals(self, detections: Detections, own: IntArray, score: FloatArray) -> FloatArray:
        """(n,) how high the highest score of another label is at the place of each of `own`."""
        others = np.flatnonzero(detections.label != self.label)
        if not len(others):
            return np.zeros(len(own))
        x, y = detections.position[:, 0], detections.position[:, 1]
        near = np.hypot(x[own, None] - x[others], y[own, None] - y[others]) < _APART
        height: FloatArray = np.logaddexp(0.0, _SHARP * score[others]) / _SHARP
        return np.where(near, height, 0.0).max(axis=1)

    @property
    def steady(self) -> bool:
        return False

    @property
    def sums(self) -> int:
        return 5

    def aged(self, record: FloatArray, dt: float) -> FloatArray:
        left = np.exp(-dt / self.memory)
        return record * [left, left, left, 1.0, 1.0] + [0.0, 0.0, 0.0, 0.0, 1.0]

    def recorded_share(self, record: FloatArray, distance: FloatArray) -> FloatArray:
        return self.online.share(features(record, distance))

    def share_by_life(
        self, record: FloatArray, distance: FloatArray, time: FloatArray
    ) -> FloatArray:
        weights = self.online if self.batch is None else self.batch
        return weights.share(features(record_by_life(record, time, self.memory), distance))

    def of_all_sources(self) -> ScoreRecord:
        """A record by which every source is an object."""
        return replace(self, online=RecordWeights(offset=_SUREST, score=0.0), batch=None)


def record_by_life(record: FloatArray, time: FloatArray, memory: float) -> FloatArray:
    """Records (n,5) at the steps of a source's life, by all of it.

    What is recent is told half a `memory` later, so that it is as much before as after the step;
    all else at the life's end.  time (n,) : s, rising.
    """
    later = np.searchsorted(time, time + (0.5 * memory + _SLACK), side="right") - 1
    whole = np.tile(record[-1], (len(record), 1))
    whole[:, :3] = record[later, :3]
    return whole


def features(record: FloatArray, distance: FloatArray) -> FloatArray:
    """(T,7) what the log-odds of sources with these records (T,5), at these distances (T,), are
    linear in.

    record : sums of recent scores, of recent ones, of recent rivals, and of all ones; and the
        frames after the first detection.
    """
    d = (distance.clip(_NEAREST, _FARTHEST) - _MIDDLE) / _UNIT
    recent, count = record[:, 1], record[:, 3]
    # Long out of sight, the weights of recent scores are tiny, their mean is not.
    share = np.where(recent > 0, recent, 1.0)
    return np.column_stack(
        [
            np.ones(len(record)),
            record[:, 0] / share,
            np.log(np.maximum(count, 1.0) / _FEW),
            count / (record[:, 4] + 1.0),
            d,
            d**2,
            record[:, 2] / share,
        ]
    )
