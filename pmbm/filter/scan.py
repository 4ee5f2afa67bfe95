"""The filter's input from one frame of detections."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.models.radar import RadarScan
from pmbm.filter.models.scores import ScoredDetections
from pmbm.types import Detections, FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Scan:
    """The measurements of one frame, M rows.

    detections : where they are, and their boxes and labels.
    evidence (M,K) : p(score, label | class) / p(score, label | clutter) for the K classes of
        sources that scores tell apart; K = 1 where they tell none apart.
    birth (K,), (M,K) : shares of the classes among objects detected for the first time, the same
        anywhere or by what may be where each measurement is.
    first (M,2) : factors on the density of first detections and on that of clutter, for the rule
        that lets a score speak there alone; None, none.
    said (M,R) : what each detection adds to its source's record.
    confidence (M,) : in [0, 1], what a track may remember of its detections.
    radar : what is particular to a radar's measurements, or None.
    """

    detections: Detections
    evidence: FloatArray
    birth: FloatArray
    first: FloatArray | None
    said: FloatArray
    confidence: FloatArray
    radar: RadarScan | None = None

    @property
    def position(self) -> FloatArray:
        """(M,2)"""
        return self.detections.position[:, :2]

    def covariance(self, R: FloatArray) -> FloatArray:
        """R (2,2) of a measured position; (M,2,2) where a radar has one for each."""
        return R if self.radar is None else self.radar.R

    @property
    def box(self) -> FloatArray:
        """(M,5) z, length, width, height, yaw."""
        given = self.detections
        return np.column_stack([given.position[:, 2], given.size, given.yaw])

    @property
    def label(self) -> NDArray[np.int8]:
        """(M,)"""
        return self.detections.label

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
        return replace(
            self, first=self.factors() * np.stack([factor, np.ones(len(factor))], axis=1)
        )

    def factors(self) -> FloatArray:
        """`first` (M,2), of ones where there are none."""
        return np.ones((len(self), 2)) if self.first is None else self.first

    def __len__(self) -> int:
        return len(self.detections)

    @staticmethod
    def of(
        scored: ScoredDetections, confidence: FloatArray, radar: RadarScan | None = None
    ) -> Scan:
        """The boxes of a frame, with what their scores say."""
        return Scan(
            scored.detections,
            scored.evidence,
            scored.birth,
            scored.first,
            scored.said,
            confidence,
            radar,
        )
