"""The object that each detection of a real recording most likely came from."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.optimize import linear_sum_assignment

from pmbm.errors import InputError
from pmbm.geometry import iou
from pmbm.types import CLUTTER, Detections, GroundTruth, IntArray, Recording


def with_origins(recording: Recording, *, min_iou: float = 0.25) -> Recording:
    """The recording with an origin for every detection: per frame and label the pairing with the
    truth of largest total 3D IoU among pairs of at least `min_iou`; the others are clutter.

    The statistics that want origins (a fitted detector, a fitted filter, the clairvoyant) then run
    on real logs too.  Raises InputError where `min_iou` is not in (0, 1].
    """
    if not 0.0 < min_iou <= 1.0:
        raise InputError("origins by overlap", field="min_iou", expected="(0, 1]", got=min_iou)
    origin = tuple(
        _match(detections, recording.truth[frame], min_iou)
        for detections, frame in zip(recording.detections, recording.frame.tolist(), strict=True)
    )
    provenance = {**recording.provenance, "origins": f"3D IoU >= {min_iou:g}"}
    return dataclasses.replace(recording, origin=origin, provenance=provenance)


def _match(detections: Detections, truth: GroundTruth, min_iou: float) -> IntArray:
    overlap = iou(
        detections.position,
        detections.size,
        detections.yaw,
        truth.position,
        truth.size,
        truth.yaw,
    )
    overlap[(overlap < min_iou) | (detections.label[:, None] != truth.label)] = 0.0
    rows, columns = linear_sum_assignment(overlap, maximize=True)
    matched = overlap[rows, columns] > 0
    origin = np.full(len(detections), CLUTTER, dtype=np.int64)
    origin[rows[matched]] = columns[matched]
    return origin
