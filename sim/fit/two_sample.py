"""The classifier two-sample test between real detections and modelled ones.

A classifier two-sample test (Lopez-Paz and Oquab, Revisiting classifier two-sample tests, 2017):
where the held-out area under the curve is near one half, the two kinds cannot be told apart by
these features; the weights of the features that matter most name what betrays the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import optimize, special, stats

from pmbm.geometry import wrap_angle
from pmbm.sim.detector.boxes import polar
from pmbm.types import FloatArray, IntArray, Recording

FEATURES: Final = (
    *("range", "bearing", "log-odds of the score", "length", "width", "height"),
    *("heading, side on", "heading, end on", "boxes in the frame", "distance to the next box"),
)
_FOLDS: Final = 4
_RIDGE: Final = 10.0
_APART: Final = (0.05, 100.0)
"""Distances are told apart between these, m."""


@dataclass(frozen=True, eq=False)
class TwoSample:
    """The outcome of a two-sample test.

    auc : area under the curve on held-out recordings; 0.5 is indistinguishable.
    betraying : features by falling importance, each with the AUC that it has alone, and what the
        AUC of all loses without it: what betrays the model only beside other features shows there.
    """

    auc: float
    betraying: tuple[tuple[str, float, float], ...]


def features(recording: Recording) -> tuple[FloatArray, IntArray]:
    """What a box looks like from above, sensor-relative: (R, len(FEATURES)), and its label (R,)."""
    rows, labels = [np.zeros((0, len(FEATURES)))], [np.zeros(0, dtype=np.int64)]
    for detections in recording.detections:
        count = len(detections)
        if count == 0:
            continue
        pose = np.broadcast_to(detections.sensor_pose, (count, 3))
        distance, bearing = polar(detections.position, pose)
        apart = np.linalg.norm(
            detections.position[:, None, :2] - detections.position[None, :, :2], axis=2
        )
        np.fill_diagonal(apart, np.inf)
        side = 2 * (detections.yaw - bearing)
        rows.append(
            np.stack(
                [
                    distance,
                    wrap_angle(bearing - pose[:, 2]),
                    special.logit(np.clip(detections.score, 1e-7, 1 - 1e-7)),
                    *detections.size.T,
                    np.cos(side),
                    np.sin(side),
                    np.full(count, float(count)),
                    np.log(np.clip(apart.min(axis=1), *_APART)),
                ],
                axis=1,
            )
        )
        labels.append(detections.label.astype(np.int64))
    return np.concatenate(rows), np.concatenate(labels)


def two_sample(real: Sequence[Recording], other: Sequence[Recording]) -> TwoSample:
    """Tell the boxes of `real` from those of `other` by logistic regression, recordings held out.

    Recordings are dealt to folds in the order given, of each kind alike, so that a recording and
    its model in the same place are held out together.
    """
    raw, label, kind, fold = _tables(real, other)
    auc = _held_out_auc(raw, label, kind, fold)
    betraying = [
        (
            name,
            _held_out_auc(raw[:, [index]], label, kind, fold),
            auc - _held_out_auc(np.delete(raw, index, axis=1), label, kind, fold),
        )
        for index, name in enumerate(FEATURES)
    ]
    return TwoSample(auc, tuple(sorted(betraying, key=lambda row: -row[2])))


def area(real: Sequence[Recording], other: Sequence[Recording]) -> float:
    """The area under the curve of `two_sample` alone."""
    raw, label, kind, fold = _tables(real, other)
    return _held_out_auc(raw, label, kind, fold)


def _tables(
    real: Sequence[Recording], other: Sequence[Recording]
) -> tuple[FloatArray, IntArray, IntArray, IntArray]:
    """Features, label, kind and fold of every box."""
    tables = [
        (*features(recording), np.full(_count(recording), kind), np.full(_count(recording), place))
        for kind, side in enumerate((real, other))
        for place, recording in enumerate(side)
    ]
    raw, label, kinds, places = (np.concatenate(column) for column in zip(*tables, strict=True))
    return raw, label, kinds, places % min(_FOLDS, len(real), len(other))


def _count(recording: Recording) -> int:
    return sum(len(detections) for detections in recording.detections)


def _expanded(raw: FloatArray) -> FloatArray:
    """Features with their squares and products."""
    scaled = (raw - raw.mean(axis=0)) / np.maximum(raw.std(axis=0), 1e-9)
    scaled = np.clip(scaled, -4.0, 4.0)
    first, second = np.triu_indices(raw.shape[1])
    products = scaled[:, first] * scaled[:, second]
    return np.concatenate([np.ones((len(scaled), 1)), scaled, products], axis=1)


def _held_out_auc(raw: FloatArray, label: IntArray, kind: IntArray, fold: IntArray) -> float:
    """Mean over folds of the area under the curve on what was not trained on.

    One classifier a label: that is what one for all labels comes to whose columns are each label's
    own.
    """
    parts = [(rows, _expanded(raw[rows])) for rows in (label == v for v in np.unique(label))]
    areas = []
    for held_out in np.unique(fold):
        test = fold == held_out
        share = np.bincount(kind[~test], minlength=2) / np.count_nonzero(~test)
        importance = 0.5 / np.maximum(share, 1e-9)[kind]
        score = np.zeros(len(raw))
        for rows, columns in parts:
            train = ~test[rows]
            weight = _logistic_regression(
                columns[train], kind[rows][train], importance[rows][train]
            )
            score[rows] = columns @ weight
        areas.append(_area_under_curve(score[test], kind[test]))
    return float(np.mean(areas))


def _logistic_regression(columns: FloatArray, kind: IntArray, importance: FloatArray) -> FloatArray:
    """Weights (C,) of ridge-penalised logistic regression."""
    sign = 2.0 * kind - 1.0

    def loss(weight: FloatArray) -> tuple[float, FloatArray]:
        margin = sign * (columns @ weight)
        slope = -importance * sign * special.expit(-margin)
        value = importance @ np.logaddexp(0.0, -margin) + _RIDGE / 2 * weight @ weight
        return float(value), columns.T @ slope + _RIDGE * weight

    start = np.zeros(columns.shape[1])
    found = optimize.minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 200})
    weight: FloatArray = found.x
    return weight


def _area_under_curve(score: FloatArray, kind: IntArray) -> float:
    """The share of pairs of different kinds that the score puts in order; ties count half."""
    positive = int(np.count_nonzero(kind))
    negative = len(kind) - positive
    if positive == 0 or negative == 0:
        return 0.5
    rank = stats.rankdata(score)[kind == 1].sum()
    return float((rank - positive * (positive + 1) / 2) / (positive * negative))
