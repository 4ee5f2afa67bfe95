"""Classes of objects, and the persistent clutter that looks like each, told apart by labels and
scores.

An object's class never changes; each detection weighs it by what its score and label say.  Beside
each label stands persistent clutter: a source that looks like it, such as a pole that is reported
as a pedestrian frame after frame.  Its existence is certain and it is no object, so what is
reported is the probability of existing and of not being persistent clutter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.filter.models.protocols import SceneDensity
from pmbm.filter.models.scores import NoRecord, ScoredDetections
from pmbm.score import ScoreModel
from pmbm.types import Detections, FloatArray, Label
from pmbm.validation import Checker, equal_fields, hash_of_fields

_LABELS = len(Label)
_CLASSES = 2 * _LABELS


@dataclass(frozen=True, eq=False, kw_only=True)
class ObjectClasses(NoRecord):
    """Classes of sources, and what the detections of each look like.

    birth (14,) : share of new sources of detections that are of each class: the labels, then the
        persistent clutter of each; adds up to one.
    confusion (14,7) : P(reported label | class), each row adding up to one.
    clutter (7,) : P(reported label) of clutter that does not persist; adds up to one.
    score, persistent_score : what a score says of an object, and of persistent clutter, against
        other clutter.
    """

    birth: FloatArray
    confusion: FloatArray
    clutter: FloatArray
    score: ScoreModel
    persistent_score: ScoreModel

    def __post_init__(self) -> None:
        door = Checker(self, "object classes")
        door.unit_interval("birth", _CLASSES)
        door.rows("confusion", _LABELS)
        door.floats("confusion", (_CLASSES, _LABELS))
        door.unit_interval("clutter", _LABELS)
        for name in ("birth", "confusion", "clutter"):
            values = getattr(self, name)
            if (values < 0).any() or np.abs(values.sum(axis=-1) - 1).max() > 1e-9:
                raise InputError(
                    "object classes", field=name, expected="shares that add up to one", got=values
                )

    @staticmethod
    def neutral() -> ObjectClasses:
        """Labels and scores say nothing."""
        return ObjectClasses(
            birth=np.full(_CLASSES, 1 / _CLASSES),
            confusion=np.full((_CLASSES, _LABELS), 1 / _LABELS),
            clutter=np.full(_LABELS, 1 / _LABELS),
            score=ScoreModel.uninformative(),
            persistent_score=ScoreModel.uninformative(),
        )

    @staticmethod
    def simple(
        *,
        persistent_clutter: float,
        score: ScoreModel,
        mislabelled: float = 0.05,
        persistent_score: ScoreModel | None = None,
    ) -> ObjectClasses:
        """All labels equally frequent and equally often taken for each other.

        persistent_clutter : share of new sources that are persistent clutter, in [0, 1).
        mislabelled : share of detections with another label than the source's, in [0, 1).  The
        scores of persistent clutter are those of other clutter unless `persistent_score` says
        otherwise.
        """
        confusion = np.full((_CLASSES, _LABELS), mislabelled / (_LABELS - 1))
        np.fill_diagonal(confusion[:_LABELS], 1 - mislabelled)
        np.fill_diagonal(confusion[_LABELS:], 1 - mislabelled)
        birth = np.full(_CLASSES, (1 - persistent_clutter) / _LABELS)
        birth[_LABELS:] = persistent_clutter / _LABELS
        return ObjectClasses(
            birth=birth,
            confusion=confusion,
            clutter=np.full(_LABELS, 1 / _LABELS),
            score=score,
            persistent_score=persistent_score or ScoreModel.uninformative(),
        )

    __eq__ = equal_fields
    __hash__ = hash_of_fields

    @property
    def classes(self) -> int:
        return _CLASSES

    @property
    def needs_all_labels(self) -> bool:
        return False

    def read(self, detections: Detections, scene: SceneDensity) -> ScoredDetections:
        return ScoredDetections(
            detections,
            self.evidence(detections),
            self.birth,
            None,
            np.zeros((len(detections), 0)),
        )

    def predicted(self, source: FloatArray, dt: float) -> FloatArray:
        return source

    def object_share(self, scene: SceneDensity) -> FloatArray:
        """(14,) whether each class is an object: labels are, their persistent clutter is not."""
        return np.repeat([1.0, 0.0], _LABELS)

    def observed(
        self, scene: SceneDensity, in_view: Callable[[FloatArray], float], dt: float
    ) -> SceneDensity:
        return scene

    def labels(self, last: NDArray[np.int8], source: FloatArray) -> NDArray[np.int8]:
        """The likeliest label of each row (H,), by all of its detections."""
        return source[:, :_LABELS].argmax(axis=1).astype(np.int8)

    def evidence(self, detections: Detections) -> FloatArray:
        """(M,14) p(score, label | class) / p(score, label | clutter) of every detection."""
        with np.errstate(divide="ignore"):
            of_label = self.confusion[:, detections.label] / np.maximum(
                self.clutter[detections.label], 1e-6
            )
        of_score = np.empty((_CLASSES, len(detections)))
        for rows, model in (
            (slice(_LABELS), self.score),
            (slice(_LABELS, None), self.persistent_score),
        ):
            of_score[rows] = np.exp(model.log_likelihood_ratio(model.read(detections)))
        return np.ascontiguousarray((of_label * of_score).T)
