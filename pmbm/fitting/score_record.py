"""Score records from recordings with labels: which sources of detections are objects.

The filter follows all sources alike, so one run of it tells what each row that it may report was
known by; a logistic regression over these rows says how probably each is true.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import MISSED
from pmbm.filter.estimation import in_view
from pmbm.filter.models.score_record import WEIGHTS, ScoreRecord, features
from pmbm.filter.tracker import PMBMTracker
from pmbm.geometry import iou
from pmbm.types import BoolArray, FloatArray, Label, Recording

_OVERLAP = 0.25
"""3D IoU from which a row is one of the object's."""
_EXISTS = 0.05
"""Existence of a source from which its rows are fitted to."""
_RIDGE = np.array([1e-3, 2.0, 2.0, 2.0, 2.0, 20.0, 2.0])
"""How firmly each weight is held to 0, in rows."""
_SHARED = np.array([3.0, 30.0, 30.0, 30.0, 30.0, 30.0, 30.0])
"""How firmly the weights of labels that are fitted together are held to each other, in rows."""
_FEW = 10_000
"""True rows up to which a label's sources are few."""
_MIDDLE, _HIGH = 0.5, 0.9
"""Quantiles of raw scores that count as 0 and 1."""


@dataclass(frozen=True, eq=False)
class Rows:
    """What a tracker may report of one label in a recording, N rows over all its frames.

    features (N,7) : as `features` has them.  existence (N,) : of the source.
    true (N,) : whether an object that counts is there, or none.
    """

    features: FloatArray
    existence: FloatArray
    true: BoolArray

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        return Rows(
            np.concatenate([one.features for one in parts]),
            np.concatenate([one.existence for one in parts]),
            np.concatenate([one.true for one in parts]),
        )


Scale = tuple[FloatArray, FloatArray]
"""`middle` and `spread` of a `ScoreRecord`."""


def score_scale(recordings: Sequence[Recording], labels: Sequence[Label]) -> Scale:
    """(7,) of each label the middle of its raw scores, and how far its high ones are from it; 0
    where there are no scores that differ.

    Raises InputError for detections without raw scores.
    """
    middle, spread = np.zeros((2, len(Label)))
    for label in labels:
        found = [np.zeros(0)]
        for recording in recordings:
            for detections in recording.detections:
                if detections.raw_score is not None:
                    found.append(detections.raw_score[detections.label == label])
                elif len(detections):
                    raise InputError("score records are fitted to raw scores", field="raw_score")
        scores = np.concatenate(found)
        if len(scores):
            middle[label], high = np.quantile(scores, [_MIDDLE, _HIGH])
            spread[label] = high - middle[label]
    return middle, spread


def rows(
    recording: Recording,
    label: Label,
    config: PMBMConfig,
    unjudged: Sequence[BoolArray] | None = None,
) -> Rows:
    """The rows of one recording, which has truth.

    config : of the tracker, with a `ScoreRecord`, whose weights do not count.
    unjudged : of every frame, the detections of which the labels say neither that they are true nor
        that they are not; a row is left out where its source's last detection was one.
    """
    tracker = PMBMTracker(config, recording.site)
    told, exists, true = [np.zeros((0, len(WEIGHTS)))], [np.zeros(0)], [np.zeros(0, bool)]
    open_question: dict[int, bool] = {}
    for step, (detections, frame) in enumerate(
        zip(recording.detections, recording.frame.tolist(), strict=True)
    ):
        tracker.step(detections)
        density, trace = tracker.density, tracker.trace
        assert density is not None
        assert trace is not None
        marginal, inside = in_view(density, trace.frame.region)
        kept = np.flatnonzero((inside > 0.5) & (marginal.existence > _EXISTS))
        local = density.local.take(marginal.best[kept])
        own = np.flatnonzero(detections.label == label)
        ids, taken = density.track_id[kept].tolist(), local.history[:, -1].tolist()
        for name, one in zip(ids, taken, strict=True):
            if one > MISSED:
                open_question[name] = unjudged is not None and bool(unjudged[step][own[one]])
        truth = recording.truth[frame]
        overlap = iou(
            np.column_stack([local.mean[:, :2], local.box[:, :1]]),
            local.box[:, 1:4],
            local.box[:, 4],
            truth.position,
            truth.size,
            truth.yaw,
        )
        overlap[(overlap < _OVERLAP) | (truth.label != label)] = 0.0
        row, column = linear_sum_assignment(overlap, maximize=True)
        found = overlap[row, column] > 0
        hit, excused = np.zeros((2, len(kept)), bool)
        hit[row[found]] = True
        excused[row[found]] = ~truth.observable[column[found]]
        asked = np.array([open_question.get(name, False) for name in ids], bool)
        judged = ~excused & (hit | ~asked)
        away = trace.frame.region.distance(local.mean)
        told.append(features(local.record, away)[judged])
        exists.append(marginal.existence[kept][judged])
        true.append(hit[judged])
    return Rows(np.concatenate(told), np.concatenate(exists), np.concatenate(true))


def fit_records(
    found: Mapping[Label, Rows],
    scale: Scale,
    few: int = _FEW,
) -> dict[Label, ScoreRecord]:
    """The score record of every label.

    scale : as `score_scale` gives it.
    few : labels with fewer true rows are fitted together, their weights held to each other.

    Raises InputError for a label of which nothing, or everything, is true.
    """
    for label, one in found.items():
        if not one.true.any() or one.true.all():
            raise InputError(
                "fitting score records",
                field=Label(label).name,
                expected="objects and others among its tracks",
                got=f"{int(one.true.sum())} true of {len(one.true)} rows",
            )
    together = [label for label, one in found.items() if one.true.sum() < few]
    groups = [[label] for label in found if label not in together]
    if together:
        groups.append(together)
    records = {}
    for group in groups:
        weights = _fit([found[label] for label in group])
        for label, own in zip(group, weights, strict=True):
            values = dict(zip(WEIGHTS, own.tolist(), strict=True))
            records[label] = ScoreRecord(
                label=int(label), middle=scale[0], spread=scale[1], **values
            )
    return records


def _fit(parts: Sequence[Rows]) -> FloatArray:
    """Weights (G,7) of each of G labels: those that all share, and where there are several, how
    each differs, by their greatest posterior."""
    groups, k = len(parts), len(WEIGHTS)

    def loss(x: FloatArray) -> tuple[float, FloatArray]:
        shared, own = x[:k], x[k:].reshape(-1, k)
        value = 0.5 * float(_RIDGE @ shared**2 + (own**2 @ _SHARED).sum())
        gradient = np.concatenate([_RIDGE * shared, (_SHARED * own).ravel()])
        for g, part in enumerate(parts):
            added, slope = _loss(part, shared + own[g] if groups > 1 else shared)
            value += added
            gradient[:k] += slope
            if groups > 1:
                gradient[k * (g + 1) : k * (g + 2)] += slope
        return value, gradient

    start = np.zeros(k * (1 if groups == 1 else groups + 1))
    best = minimize(loss, start, jac=True, method="L-BFGS-B").x
    if groups == 1:
        return best[None]
    weights: FloatArray = best[:k] + best[k:].reshape(-1, k)
    return weights


def _loss(part: Rows, weights: FloatArray) -> tuple[float, FloatArray]:
    """Negative log-likelihood of rows that are true with P(existence) P(object), and its slope."""
    share = 1.0 / (1.0 + np.exp(-np.clip(part.features @ weights, -40.0, 40.0)))
    p = (part.existence * share).clip(1e-9, 1 - 1e-9)
    value = -float(np.where(part.true, np.log(p), np.log1p(-p)).sum())
    return value, part.features.T @ ((p - part.true) / (1 - p) * (1 - share))
