"""Score records from recordings with labels: which sources of detections are objects.

The filter follows all sources alike, so one run of it tells what each row that it may report was
known by; a logistic regression over these rows says how probably each is true.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass, field, replace
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment, minimize
from scipy.special import expit

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import MISSED
from pmbm.filter.estimation import in_view
from pmbm.filter.models.score_record import (
    WEIGHTS,
    RecordWeights,
    ScoreRecord,
    features,
    record_by_life,
)
from pmbm.filter.tracker import PMBMTracker
from pmbm.geometry import iou
from pmbm.score import raw_scores
from pmbm.types import BoolArray, FloatArray, IntArray, Label, Recording

_OVERLAP: Final = 0.25
"""3D IoU from which a row is one of the object's."""
_EXISTS: Final = 0.05
"""Existence of a source from which its rows are fitted to."""
_RIDGE: Final = np.array([1e-3, 2.0, 2.0, 2.0, 2.0, 2.0, 20.0])
"""Precision of the weights' Gaussian prior about 0, where no record is known before."""
_HELD: Final = {
    "online": np.array([100.0, 1000.0, 1000.0, 1000.0, 1000.0, 1000.0, 1000.0]),
    "batch": np.array([1000.0, 10000.0, 10000.0, 10000.0, 10000.0, 10000.0, 10000.0]),
}
"""Precision of their prior about a record known before, of one sequence; of n it is 1/n^2 of that.

The rows of a sequence are many, and tell of one road and of few sources; those of a source's whole
life tell nearly the same.  Chosen by the log loss of left-out sequences, in all four detectors of
KITTI, of fits to 1, 2, 4, 8 and 14 others."""
_OFFSET: Final = 300.0
"""Precision of the prior of what the offsets of labels that are fitted together differ by."""
_TOGETHER: Final = (
    (Label.CAR, Label.TRUCK, Label.BUS),
    (Label.PEDESTRIAN, Label.CYCLIST, Label.MOTORCYCLIST),
)
"""Labels whose detections err alike: the weights of one differ from what was known before as those
of another do, but for the offset.  Objects of one label are often few."""
_CHANCE, _LASTING, _STEADY = 2, 20, 0.8
"""Detections up to which a source is chance, and from which it lasts, seen in this share of its
frames."""
_ENOUGH: Final = 50
"""Detections of either from which on they tell a scale."""
_MIDDLE, _HIGH = 0.5, 0.9
"""Quantiles of raw scores that count as 0 and 1 where sources do not tell."""

Scale = tuple[FloatArray, FloatArray]
"""`middle` and `spread` of a `ScoreRecord`."""


@dataclass(frozen=True, eq=False)
class Rows:
    """What a tracker may report of one label, N rows over all frames.

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


@dataclass(frozen=True, eq=False)
class ModeRows:
    """The rows of one label as the online mode reports them, and as the batch mode does."""

    online: Rows
    batch: Rows

    @staticmethod
    def joined(parts: Sequence[ModeRows]) -> ModeRows:
        return ModeRows(
            Rows.joined([one.online for one in parts]), Rows.joined([one.batch for one in parts])
        )


def quantile_scale(recordings: Sequence[Recording], labels: Sequence[Label]) -> Scale:
    """(7,) of each label the middle of its raw scores, and how far its high ones are from it; 0
    where there are no scores that differ.

    Raises InputError for detections without raw scores.
    """
    for recording in recordings:
        if any(len(one) and one.raw_score is None for one in recording.detections):
            raise InputError("score records are fitted to raw scores", field="raw_score")
    middle, spread = np.zeros((2, len(Label)))
    for label in labels:
        scores = raw_scores(recordings, label)
        if len(scores):
            middle[label], high = np.quantile(scores, [_MIDDLE, _HIGH])
            spread[label] = high - middle[label]
    return middle, spread


def score_scale(recordings: Sequence[Recording], configs: Mapping[Label, PMBMConfig]) -> Scale:
    """`quantile_scale`, but where sources tell more: 0 is the median score of detections that
    nothing follows, 1 that of sources that last.  No labels are read.

    configs : of the tracker of each label.
    """
    middle, spread = quantile_scale(recordings, list(configs))
    found = middle.copy(), spread.copy()
    for label, config in configs.items():
        if spread[label] <= 0:
            continue
        neutral = neutral_config(config, label, (middle, spread))
        chance, lasting = _chance_and_lasting(recordings, label, neutral)
        if min(len(chance), len(lasting)) >= _ENOUGH:
            low, high = float(np.median(chance)), float(np.median(lasting))
            if high > low:
                found[0][label], found[1][label] = low, high - low
    return found


def _chance_and_lasting(
    recordings: Sequence[Recording], label: Label, config: PMBMConfig
) -> tuple[FloatArray, FloatArray]:
    """Raw scores of detections of sources that are chance, and of those that last."""
    chance, lasting = [np.zeros(0)], [np.zeros(0)]
    for recording in recordings:
        for source in _sources(recording, label, config):
            taken = source.score[source.taken > MISSED]
            if len(taken) <= _CHANCE:
                chance.append(taken)
            elif len(taken) >= _LASTING and len(taken) >= _STEADY * len(source.taken):
                lasting.append(taken)
    return np.concatenate(chance), np.concatenate(lasting)


def neutral_config(config: PMBMConfig, label: Label, scale: Scale) -> PMBMConfig:
    """The tracker by which every source is an object."""
    weights = RecordWeights(offset=0.0, score=0.0)
    record = ScoreRecord(label=int(label), middle=scale[0], spread=scale[1], online=weights)
    return replace(config, scores=record.of_all_sources())


def rows(
    recording: Recording,
    label: Label,
    config: PMBMConfig,
    unjudged: Sequence[BoolArray] | None = None,
) -> ModeRows:
    """The rows of one recording, which has truth.

    config : of the tracker, by which every source is an object (`neutral_config`).
    unjudged : of every frame, the detections of which the labels say neither that they are true nor
        that they are not; a row is left out where its source's last detection was one.
    """
    memory = config.scores.memory if isinstance(config.scores, ScoreRecord) else 1.0
    online, batch = [_NO_ROWS], [_NO_ROWS]
    for source in _sources(recording, label, config, unjudged):
        there = source.judged
        online.append(
            Rows(
                features(source.record, source.distance)[there],
                source.existence[there],
                source.hit[there],
            )
        )
        life = slice(0, int(np.flatnonzero(source.taken > MISSED)[-1]) + 1)
        told = features(
            record_by_life(source.record[life], source.time[life], memory), source.distance[life]
        )
        there = there[life]
        batch.append(Rows(told[there], np.ones(int(there.sum())), source.hit[life][there]))
    return ModeRows(Rows.joined(online), Rows.joined(batch))


_NO_ROWS: Final = Rows(np.zeros((0, len(WEIGHTS))), np.zeros(0), np.zeros(0, bool))


@dataclass(frozen=True, eq=False)
class _Source:
    """One source over the n frames in which it may be reported.

    time (n,), record (n,R), distance (n,), existence (n,).
    taken (n,) : measurement, or MISSED.  score (n,) : its raw score, NaN where missed.
    hit (n,) : whether an object is there.  judged (n,) : whether the labels say.
    """

    time: FloatArray
    record: FloatArray
    distance: FloatArray
    existence: FloatArray
    taken: IntArray
    score: FloatArray
    hit: BoolArray
    judged: BoolArray


def _sources(
    recording: Recording,
    label: Label,
    config: PMBMConfig,
    unjudged: Sequence[BoolArray] | None = None,
) -> Iterator[_Source]:
    """Every source that was detected while it could be reported."""
    tracker = PMBMTracker(config, recording.site)
    found: dict[int, _Gathered] = {}
    for step, detections in enumerate(recording.detections):
        tracker.step(detections)
        density, trace = tracker.density, tracker.trace
        assert density is not None
        assert trace is not None
        marginal, inside = in_view(density, trace.frame.region)
        kept = np.flatnonzero((inside > 0.5) & (marginal.existence > _EXISTS))
        local = density.local.take(marginal.best[kept])
        own = np.flatnonzero(detections.label == label)
        hit, excused = _found(recording, step, label, local.mean, local.box)
        away = trace.frame.region.distance(local.mean)
        taken = local.history[:, -1]
        for row, name in enumerate(density.track_id[kept].tolist()):
            gathered = found.setdefault(name, _Gathered())
            one = int(taken[row])
            score = np.nan
            if one > MISSED:
                assert detections.raw_score is not None
                score = float(detections.raw_score[own[one]])
                gathered.asked = unjudged is not None and bool(unjudged[step][own[one]])
            judged = not excused[row] and bool(hit[row] or not gathered.asked)
            gathered.records.append(local.record[row])
            gathered.rows.append(
                (
                    *(detections.time, away[row], marginal.existence[kept[row]]),
                    *(one, score, hit[row], judged),
                )
            )
    for gathered in found.values():
        time, distance, existence, taken, score, hit, judged = np.array(gathered.rows).T
        if (taken > MISSED).any():
            yield _Source(
                time=time,
                record=np.array(gathered.records),
                distance=distance,
                existence=existence,
                taken=taken.astype(np.int64),
                score=score,
                hit=hit > 0,
                judged=judged > 0,
            )


@dataclass
class _Gathered:
    """What is known of one source so far; asked: whether its last detection is unjudged."""

    records: list[FloatArray] = field(default_factory=list)
    rows: list[tuple[float, ...]] = field(default_factory=list)
    asked: bool = False


def _found(
    recording: Recording, step: int, label: Label, mean: FloatArray, box: FloatArray
) -> tuple[BoolArray, BoolArray]:
    """Of each state whether it is an object of the label, and whether that does not count."""
    truth = recording.truth[int(recording.frame[step])]
    overlap = iou(
        np.column_stack([mean[:, :2], box[:, :1]]),
        box[:, 1:4],
        box[:, 4],
        truth.position,
        truth.size,
        truth.yaw,
    )
    overlap[(overlap < _OVERLAP) | (truth.label != label)] = 0.0
    row, column = linear_sum_assignment(overlap, maximize=True)
    found = overlap[row, column] > 0
    hit, excused = np.zeros((2, len(mean)), bool)
    hit[row[found]] = True
    excused[row[found]] = ~truth.observable[column[found]]
    return hit, excused


def fit_records(
    found: Mapping[Label, ModeRows],
    scale: Scale,
    before: Mapping[Label, ScoreRecord] | None = None,
    *,
    sequences: int = 1,
) -> dict[Label, ScoreRecord]:
    """The score record of every label.

    scale : as `score_scale` gives it.
    before : records known before, of other detectors, on scales found alike: rows of few
        `sequences` do not overrule them.

    Raises InputError for a label of which nothing, or everything, is true.
    """
    for label, one in found.items():
        true = one.online.true
        if not true.any() or true.all():
            raise InputError(
                "fitting score records",
                field=Label(label).name,
                expected="objects and others among its tracks",
                got=f"{int(true.sum())} true of {len(true)} rows",
            )
    known = before or {}
    records = {}
    alone = [(label,) for label in found if not any(label in group for group in _TOGETHER)]
    for group in (*_TOGETHER, *alone):
        labels = [label for label in group if label in found]
        online = _fit(
            [found[label].online for label in labels],
            [None if label not in known else known[label].online for label in labels],
            _HELD["online"] / sequences**2,
        )
        batch = _fit(
            [found[label].batch for label in labels],
            [
                None if label not in known else known[label].batch or known[label].online
                for label in labels
            ],
            _HELD["batch"] / sequences**2,
        )
        for label, now, whole in zip(labels, online, batch, strict=True):
            records[label] = ScoreRecord(
                label=int(label), middle=scale[0], spread=scale[1], online=now, batch=whole
            )
    return {label: records[label] for label in found}


def pooled_records(
    found: Mapping[Label, Sequence[ModeRows]], scale: Scale
) -> dict[Label, ScoreRecord]:
    """The score record of every label that n detectors have in common, each on a scale of its own;
    every row counts 1/n."""
    records = {}
    for label, parts in found.items():
        online, batch = (
            _fit_one([getattr(one, mode) for one in parts]) for mode in ("online", "batch")
        )
        records[label] = ScoreRecord(
            label=int(label), middle=scale[0], spread=scale[1], online=online, batch=batch
        )
    return records


def _fit_one(parts: Sequence[Rows]) -> RecordWeights:
    def loss(x: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = 0.5 * float(_RIDGE @ x**2), _RIDGE * x
        for part in parts:
            added, slope = _loss(part, x)
            value, gradient = value + added / len(parts), gradient + slope / len(parts)
        return value, gradient

    return _weights(_least(loss, len(WEIGHTS)))


def _fit(
    parts: Sequence[Rows], before: Sequence[RecordWeights | None], held: FloatArray
) -> list[RecordWeights]:
    """Weights of labels that are fitted together, by their greatest posterior: what was known
    before, one difference from it that all share, of precision `held`, and offsets of their own."""
    k = len(WEIGHTS)
    if before and all(one is not None for one in before):
        start = [np.array(astuple(one)) for one in before if one is not None]
    else:
        held, start = _RIDGE, [np.zeros(k)] * len(parts)

    def loss(x: FloatArray) -> tuple[float, FloatArray]:
        shared, own = x[:k], x[k:]
        value = 0.5 * float(held @ shared**2 + _OFFSET * own @ own)
        gradient = np.concatenate([held * shared, _OFFSET * own])
        for row, (part, known) in enumerate(zip(parts, start, strict=True)):
            weights = known + shared
            weights[0] += own[row]
            added, slope = _loss(part, weights)
            value += added
            gradient[:k] += slope
            gradient[k + row] += slope[0]
        return value, gradient

    best = _least(loss, k + len(parts))
    found = []
    for row, known in enumerate(start):
        weights = known + best[:k]
        weights[0] += best[k + row]
        found.append(_weights(weights))
    return found


def _least(loss: Callable[[FloatArray], tuple[float, FloatArray]], size: int) -> FloatArray:
    best: FloatArray = minimize(
        loss, np.zeros(size), jac=True, method="L-BFGS-B", options={"maxiter": 2000}
    ).x
    return best


def _weights(values: FloatArray) -> RecordWeights:
    return RecordWeights(**dict(zip(WEIGHTS, values.tolist(), strict=True)))


def _loss(part: Rows, weights: FloatArray) -> tuple[float, FloatArray]:
    """Negative log-likelihood of rows that are true with P(existence) P(object), and its slope."""
    share = expit(part.features @ weights)
    p = (part.existence * share).clip(1e-9, 1 - 1e-9)
    value = -float(np.where(part.true, np.log(p), np.log1p(-p)).sum())
    return value, part.features.T @ ((p - part.true) / (1 - p) * (1 - share))
