"""What the filter takes from one frame of detections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmbm.types import Detections, FloatArray


@dataclass(frozen=True, eq=False, slots=True)
class Scan:
    """The measurements of one frame, M rows.

    position (M,2); box (M,5) : z, length, width, height, yaw; label (M,) int8.
    evidence (M,K) or None : p(score, label | kind) / p(score, label | clutter) for the K kinds that
        an object may be of; None is a scan whose scores and labels say nothing.
    kinds (K,), (M,K) or None : shares of the kinds among objects detected for the first time, the
        same anywhere or by what may be where each measurement is; None where K = 1, which needs no
        keeping track of.
    first (M,2) or None : factors on the density of first detections and on that of clutter, for
        the rule that lets a score speak there alone.
    confidence (M,) or None : in [0, 1], what a track remembers of its detections.
    """

    position: FloatArray
    box: FloatArray
    label: NDArray[np.int8]
    evidence: FloatArray | None = None
    kinds: FloatArray | None = None
    first: FloatArray | None = None
    confidence: FloatArray | None = None

    def said_of_first(self) -> FloatArray:
        """(M,) what each detection says of an object never detected before."""
        assert self.evidence is not None
        if self.kinds is None:
            return self.evidence[:, 0]
        if self.kinds.ndim == 1:
            return self.evidence @ self.kinds
        return (self.evidence * self.kinds).sum(axis=1)

    def said_of_known(
        self, kind: FloatArray | None, row: NDArray[np.intp], measurement: NDArray[np.intp]
    ) -> FloatArray:
        """(n,) what the measurements say of the objects of local hypotheses `row`, of P(kind)
        `kind` (H,K)."""
        assert self.evidence is not None
        if kind is None:
            return self.evidence[measurement, 0]
        return (kind[row] * self.evidence[measurement]).sum(axis=1)

    def kind_first(self, measurement: NDArray[np.intp]) -> FloatArray:
        """P(kind) (n,K) of objects that these measurements (n,) are the first detections of."""
        assert self.evidence is not None
        assert self.kinds is not None
        kinds = self.kinds if self.kinds.ndim == 1 else self.kinds[measurement]
        return self.kind_after(kinds, measurement)

    def kind_after(self, before: FloatArray, measurement: NDArray[np.intp]) -> FloatArray:
        """P(kind) (n,K) after these measurements (n,), by Bayes' rule from (n,K) or (K,)."""
        assert self.evidence is not None
        joint = before * self.evidence[measurement]
        total = joint.sum(axis=1, keepdims=True)
        return np.divide(joint, total, out=before + np.zeros_like(joint), where=total > 0)

    def __len__(self) -> int:
        return len(self.position)

    @staticmethod
    def of_positions(position: ArrayLike) -> Scan:
        """Points (M,2) alone, for problems without boxes."""
        position = np.asarray(position, dtype=np.float64).reshape(-1, 2)
        return Scan(position, np.ones((len(position), 5)), np.zeros(len(position), np.int8))

    @staticmethod
    def of(
        detections: Detections,
        evidence: FloatArray | None = None,
        kinds: FloatArray | None = None,
    ) -> Scan:
        """The boxes of a frame; their scores are the business of who knows what they mean."""
        box = np.empty((len(detections), 5))
        box[:, 0] = detections.position[:, 2]
        box[:, 1:4] = detections.size
        box[:, 4] = detections.yaw
        return Scan(detections.position[:, :2], box, detections.label, evidence, kinds)
