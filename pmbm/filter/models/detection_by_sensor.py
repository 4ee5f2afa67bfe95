"""P_D where there are several sensors: what one remembers of a track is no other's."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pmbm.filter.density import Marks
from pmbm.filter.models.protocols import Detection
from pmbm.types import Detections, FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class DetectionBySensor:
    """The `Detection` of one of S sensors, beside the memories of all: `confidence` and
    `detectable` of its marks are (H,S).  A track that is in a blind angle of the lidar, or that a
    failing radar no longer finds, is as detectable as before to the other.

    models : of each sensor.  looking : which of them the frame is of.
    blind : whether that sees nothing in this frame.
    """

    models: tuple[Detection, ...]
    looking: int
    blind: bool = False

    @property
    def _own(self) -> Detection:
        return self.models[self.looking]

    def of_undetected(self) -> float:
        return 0.0 if self.blind else self._own.of_undetected()

    def of_tracks(self, marks: Marks) -> FloatArray:
        if self.blind:
            return np.zeros(len(marks))
        return self._own.of_tracks(self._of(marks, self.looking))

    def confidence(self, detections: Detections) -> FloatArray:
        return self._own.confidence(detections)

    def predicted(self, marks: Marks, dt: float) -> Marks:
        each = [
            model.predicted(self._of(marks, sensor), dt) for sensor, model in enumerate(self.models)
        ]
        return _beside(marks.source, each)

    def if_missed(self, marks: Marks, P_D: FloatArray) -> Marks:
        return self._with(marks, self._own.if_missed(self._of(marks, self.looking), P_D))

    def if_detected(self, marks: Marks, confidence: FloatArray) -> Marks:
        return self._with(marks, self._own.if_detected(self._of(marks, self.looking), confidence))

    def first(self, source: FloatArray, confidence: FloatArray) -> Marks:
        own = self._own.first(source, confidence)
        each = [
            own if sensor == self.looking else model.never_detected(source)
            for sensor, model in enumerate(self.models)
        ]
        return _beside(own.source, each)

    def never_detected(self, source: FloatArray) -> Marks:
        return _beside(source, [model.never_detected(source) for model in self.models])

    def _of(self, marks: Marks, sensor: int) -> Marks:
        """The marks as one sensor's model knows them; of tracks of no memory yet, all alike."""
        if marks.detectable.ndim == 1:
            return marks
        return Marks(
            marks.source,
            np.ascontiguousarray(marks.confidence[:, sensor]),
            np.ascontiguousarray(marks.detectable[:, sensor]),
        )

    def _with(self, marks: Marks, own: Marks) -> Marks:
        confidence, detectable = marks.confidence.copy(), marks.detectable.copy()
        confidence[:, self.looking], detectable[:, self.looking] = own.confidence, own.detectable
        return replace(own, confidence=confidence, detectable=detectable)


def _beside(source: FloatArray, each: list[Marks]) -> Marks:
    return Marks(
        source,
        np.stack([one.confidence for one in each], axis=1),
        np.stack([one.detectable for one in each], axis=1),
    )
