"""What the filter takes from one frame of detections."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.models.radar import RadarScan
from pmbm.filter.models.scores import ScoredDetections
from pmbm.types import FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Scan:
    """The measurements of one frame, M rows.

    position (M,2); box (M,5) : z, length, width, height, yaw; label (M,) int8.
    evidence (M,K) : p(score, label | class) / p(score, label | clutter) for the K classes of
        sources that scores tell apart; K = 1 where they tell none apart.
    birth (K,), (M,K) : shares of the classes among objects detected for the first time, the same
        anywhere or by what may be where each measurement is.
    first (M,2) : factors on the density of first detections and on that of clutter, for the rule
        that lets a score speak there alone.
    said (M,R) : what each detection adds to its source's record.
    confidence (M,) : in [0, 1], what a track may remember of its detections.
    radar : what is particular to a radar's measurements, or None.
    """

    position: FloatArray
    box: FloatArray
    label: NDArray[np.int8]
    evidence: FloatArray
    birth: FloatArray
    first: FloatArray
    said: FloatArray
    confidence: FloatArray
    radar: RadarScan | None = None

    def ratio_if_first(self) -> FloatArray:
        """(M,) likelihood ratio, object against clutter, if each is a first detection."""
        if self.birth.ndim == 1:
            return self.evidence @ self.birth
        return (self.evidence * self.birth).sum(axis=1)

    def ratio_if_known(
        self, source: FloatArray, row: NDArray[np.intp], measurement: NDArray[np.intp]
    ) -> FloatArray:
        """(n,) likelihood ratio of the measurements if they are of the local hypotheses `row`,
        whose P(class) is `source` (H,K)."""
        return (source[row] * self.evidence[measurement]).sum(axis=1)

    def source_if_first(self, measurement: NDArray[np.intp]) -> FloatArray:
        """P(class) (n,K) of objects that these measurements (n,) are the first detections of."""
        birth = self.birth if self.birth.ndim == 1 else self.birth[measurement]
        return self.source_after(birth, measurement)

    def source_after(self, before: FloatArray, measurement: NDArray[np.intp]) -> FloatArray:
        """P(class) (n,K) after these measurements (n,), by Bayes' rule from (n,K) or (K,)."""
        joint = before * self.evidence[measurement]
        total = joint.sum(axis=1, keepdims=True)
        return np.divide(joint, total, out=before + np.zeros_like(joint), where=total > 0)

    def with_denser_births(self, factor: FloatArray) -> Scan:
        """With the densities of first detections multiplied by these factors (M,)."""
        return replace(self, first=self.first * np.stack([factor, np.ones(len(factor))], axis=1))

    def __len__(self) -> int:
        return len(self.position)

    @staticmethod
    def of(
        scored: ScoredDetections, confidence: FloatArray, radar: RadarScan | None = None
    ) -> Scan:
        """The boxes of a frame, with what their scores say."""
        detections = scored.detections
        box = np.empty((len(detections), 5))
        box[:, 0] = detections.position[:, 2]
        box[:, 1:4] = detections.size
        box[:, 4] = detections.yaw
        return Scan(
            detections.position[:, :2],
            box,
            detections.label,
            scored.evidence,
            scored.birth,
            scored.first,
            scored.said,
            confidence,
            radar,
        )
