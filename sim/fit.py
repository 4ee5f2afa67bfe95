"""A detector model fitted to recordings whose truth and origins are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import optimize, special

from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.types import BoolArray, FloatArray, IntArray, Recording
from sim.clutter import ClutterModel, FalseBoxes
from sim.detector import DetectorModel
from sim.evidence import Chances, Evidence, Falses, Hits, gather
from sim.knobs import Curve
from sim.objects import ObjectModel
from sim.sensor import SensorModel
from sim.streams import normal

_BIN_WIDTH: Final = 10.0
_FEWEST: Final = 40
_VISIBILITY_EDGES: Final = (0.1, 0.5, 0.9)
_ALIGNED_NEAR: Final = 0.95
_NEAR: Final = 1.5
"""A false box of the next frame this close belongs to the same place, m."""


def fit_detector(
    recordings: Recording | Sequence[Recording], *, name: str = "fitted", provenance: str = ""
) -> DetectorModel:
    """The detector model under which recordings look as they do.

    Detection probability (over range and visibility) and miss bursts are of maximum likelihood;
    noise, sizes, scores and clutter match moments range by range.  Labels with fewer than
    `40` detected objects share what is fitted to all together.  What single recordings cannot
    tell is left at its null: confusion (origins join equal labels), split objects, lateness,
    jitter and pose noise.

    Raises InputError for no recordings, or one without origins.
    """
    if isinstance(recordings, Recording):
        recordings = [recordings]
    evidence = gather(recordings)
    chances, hits = evidence.chances, evidence.hits
    scale = _score_scale(evidence)
    everything = np.ones(len(chances.found), dtype=bool)
    by_label = {
        Label(label): _fit_objects(_of(evidence, chances.label == label), scale)
        for label in np.unique(chances.label).tolist()
        if np.count_nonzero(chances.label[hits.chance] == label) >= _FEWEST
    }
    frames, delivered = int(evidence.truth_frames.sum()), int(evidence.frames.sum())
    source = (
        f"Fitted to {len(recordings)} recordings, {delivered} frames, {len(chances.found)} objects "
        f"in view, {len(hits.score)} of them detected, {len(evidence.falses.score)} false boxes."
    )
    return DetectorModel(
        name=name,
        objects=_fit_objects(_of(evidence, everything), scale),
        label=by_label,
        clutter=_fit_clutter(evidence, scale),
        sensor=SensorModel(drop_probability=1.0 - delivered / frames),
        score_temperature=scale.temperature,
        score_offset=scale.offset,
        score_floor=scale.floor,
        provenance=f"{provenance} {source}".strip(),
    )


@dataclass(frozen=True, eq=False)
class _Sample:
    """Chances of one label, and hits whose `chance` counts in them."""

    chances: Chances
    hits: Hits


@dataclass(frozen=True)
class _ScoreScale:
    """Scores come from Beta variables: log-odds divided by a temperature, plus an offset, and
    squeezed into what is above a floor."""

    temperature: float
    offset: float
    floor: float

    def quality(self, score: FloatArray) -> FloatArray:
        """The Beta variables (R,) behind scores (R,)."""
        above = (score - self.floor) / (1 - self.floor)
        log_odds = special.logit(np.clip(above, 1e-9, 1 - 1e-9))
        return np.clip(special.expit(self.temperature * (log_odds - self.offset)), 1e-6, 1 - 1e-6)


def _of(evidence: Evidence, keep: BoolArray) -> _Sample:
    number = np.cumsum(keep) - 1
    hits = evidence.hits
    rows = keep[hits.chance]
    return _Sample(
        evidence.chances.take(keep),
        Hits(
            number[hits.chance[rows]],
            *(
                getattr(hits, name)[rows]
                for name in ("error", "size", "true_size", "yaw", "true_yaw", "score")
            ),
        ),
    )


def _fit_objects(sample: _Sample, scale: _ScoreScale) -> ObjectModel:
    if len(sample.chances.found) == 0:
        return ObjectModel()
    probability, odds = _fit_probability(sample.chances)
    values: dict[str, Any] = {"detection_probability": probability, "visibility_odds": odds}
    expected = ObjectModel(**values).probability(sample.chances.distance, sample.chances.visibility)
    if len(sample.hits.score) == 0:
        return ObjectModel(**values)
    return ObjectModel(
        **values,
        miss_burst_length=_fit_bursts(sample.chances, expected),
        **_fit_errors(sample, scale),
    )


def _range_bins(distance: FloatArray) -> IntArray:
    """Bins (R,) of range, neighbours joined until each holds enough."""
    number = (distance / _BIN_WIDTH).astype(np.int64)
    joined = np.zeros(number.max() + 1, dtype=np.int64)
    current, held = 0, 0
    count = np.bincount(number)
    for index, here in enumerate(count):
        joined[index] = current
        held += here
        if held >= _FEWEST and count[index + 1 :].sum() >= _FEWEST:
            current, held = current + 1, 0
    return joined[number]


def _binned(values: FloatArray, bins: IntArray) -> FloatArray:
    """Means of values in each bin."""
    return np.bincount(bins, values) / np.bincount(bins)


def _hats(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Shares (R,K) of the knots in linear interpolation at x (R,)."""
    return np.stack([np.interp(x, knots, column) for column in np.eye(len(knots))], axis=1)


def _fit_probability(chances: Chances) -> tuple[Curve, Curve]:
    """Detection probability in full view over range, and what multiplies its odds over visibility
    (maximum likelihood); the second is 1 in full view."""
    knots = _binned(chances.distance, _range_bins(chances.distance))
    level = np.digitize(chances.visibility, _VISIBILITY_EDGES)
    full = level == len(_VISIBILITY_EDGES)
    dim = [k for k in np.unique(level[~full]).tolist() if np.count_nonzero(level == k) >= _FEWEST]
    views = np.array([chances.visibility[level == k].mean() for k in dim] + [1.0])
    range_share, view_share = _hats(chances.distance, knots), _hats(chances.visibility, views)
    found = chances.found

    def loss(x: FloatArray) -> tuple[float, FloatArray]:
        at_knot, odds = special.expit(x[: len(knots)]), np.exp(x[len(knots) :])
        p, h = range_share @ at_knot, view_share @ np.append(odds, 1.0)
        p = np.clip(p, 1e-9, 1 - 1e-9)
        scale = 1 - p + p * h
        chance = np.clip(p * h / scale, 1e-9, 1 - 1e-9)
        slope = np.where(found, -1 / chance, 1 / (1 - chance)) / np.square(scale)
        gradient = np.concatenate(
            [
                ((slope * h) @ range_share) * at_knot * (1 - at_knot),
                ((slope * p * (1 - p)) @ view_share)[:-1] * odds,
            ]
        )
        # A whisper of a prior keeps shares off 0 and 1, where no data could move them again.
        log_likelihood = np.log(np.where(found, chance, 1 - chance)).sum()
        return 0.02 * (x @ x) - log_likelihood, 0.04 * x + gradient

    start = np.append(np.full(len(knots), 2.0), np.zeros(len(dim)))
    x = optimize.minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 500}).x
    return (
        Curve(at=tuple(knots), value=tuple(special.expit(x[: len(knots)]))),
        Curve(at=tuple(views), value=(*np.exp(x[len(knots) :]), 1.0)),
    )


def _steps(chances: Chances) -> tuple[IntArray, IntArray]:
    """Rows of the same object in a frame and in the next."""
    order = np.lexsort((chances.frame, chances.object_id, chances.recording))
    earlier, later = order[:-1], order[1:]
    follows = (
        (chances.recording[earlier] == chances.recording[later])
        & (chances.object_id[earlier] == chances.object_id[later])
        & (chances.frame[earlier] + 1 == chances.frame[later])
    )
    return earlier[follows], later[follows]


def _fit_bursts(chances: Chances, probability: FloatArray) -> float:
    """Mean length of runs of misses under which pairs of frames look as they do (maximum
    composite likelihood of the latent-renewal chain)."""
    earlier, later = _steps(chances)
    p, q = probability[earlier], probability[later]
    seen, seen_next = chances.found[earlier], chances.found[later]

    def loss(log_length: float) -> float:
        keep = 1 - 1 / np.maximum(np.exp(log_length) * q, 1.0)
        both = keep * np.minimum(p, q) + (1 - keep) * p * q
        joint = np.where(
            seen,
            np.where(seen_next, both, p - both),
            np.where(seen_next, q - both, 1 - p - q + both),
        )
        return -float(np.log(np.maximum(joint, 1e-12)).sum())

    best = optimize.minimize_scalar(loss, bounds=(0.0, np.log(50.0)), method="bounded")
    return float(np.exp(best.x)) if best.fun < loss(0.0) else 1.0


def _fit_errors(sample: _Sample, scale: _ScoreScale) -> dict[str, Any]:
    """Sizes, errors of the box and scores: moments by range."""
    hits, chances = sample.hits, sample.chances.take(sample.hits.chance)
    bins = _range_bins(chances.distance)
    at = tuple(_binned(chances.distance, bins))

    def curve(values: FloatArray) -> Curve:
        return Curve(at=at, value=tuple(values))

    def spread(error: FloatArray) -> FloatArray:
        return np.sqrt(_binned(np.square(error), bins))

    typical = hits.size.mean(axis=0)
    pull, size_error = _fit_pull(hits, typical, bins)
    hidden = _fit_hidden_noise(hits.error[:, :2], chances.visibility, bins)
    position_error = hits.error / (1 + hidden * (1 - chances.visibility))[:, None]
    flipped = np.abs(hits.yaw_error) > np.pi / 2
    straight = np.where(flipped, 0.0, hits.yaw_error)
    kept = np.maximum(1 - _binned(flipped.astype(float), bins), 0.1)
    columns = [*position_error.T, *size_error.T, straight]
    deviations = [spread(column) for column in columns]
    deviations[6] = deviations[6] / np.sqrt(kept)
    standard = np.stack(
        [
            column / np.maximum(deviation, 1e-9)[bins]
            for column, deviation in zip(columns, deviations, strict=True)
        ],
        axis=1,
    )
    scores, quality = _fit_scores(hits.score, chances, bins, at, scale)
    names = (
        *("radial_noise", "lateral_noise", "vertical_noise"),
        *("length_noise", "width_noise", "height_noise", "yaw_noise"),
    )
    return {
        **{name: curve(values) for name, values in zip(names, deviations, strict=True)},
        "hidden_noise": hidden,
        "size_pull": curve(pull),
        "typical_size": tuple(typical.tolist()),
        "size_correlation": _pair_correlation(standard[:, 3:6]),
        "flip_probability": float(flipped.mean()),
        "error_persistence": _lag_correlation(standard[:, :6], chances),
        "score_persistence": _lag_correlation(quality[:, None], chances),
        "quality_coupling": _coupling(standard[:, :6], quality),
        **scores,
    }


def _fit_pull(hits: Hits, typical: FloatArray, bins: IntArray) -> tuple[FloatArray, FloatArray]:
    """How far sizes are pulled to the typical in each bin, and the errors (R,3) left."""
    gap, error = typical - hits.true_size, hits.size - hits.true_size
    weight = 1 / np.maximum(error.var(axis=0), 1e-6)
    above = _binned((gap * error) @ weight, bins)
    pull = np.clip(above / np.maximum(_binned(np.square(gap) @ weight, bins), 1e-9), 0.0, 1.0)
    return pull, error - pull[bins, None] * gap


def _fit_hidden_noise(error: FloatArray, visibility: FloatArray, bins: IntArray) -> float:
    """How much more the centre errs when hidden (Gaussian maximum likelihood)."""
    if np.ptp(visibility) == 0:
        return 0.0

    def loss(hidden: float) -> float:
        factor = 1 + hidden * (1 - visibility)
        spread = [_binned(np.square(column / factor), bins) for column in error.T]
        log_spread = sum(np.log(np.maximum(s, 1e-12))[bins].sum() / 2 for s in spread)
        return float(log_spread + error.shape[1] * np.log(factor).sum())

    return float(optimize.minimize_scalar(loss, bounds=(0.0, 4.0), method="bounded").x)


def _lag_correlation(standard: FloatArray, chances: Chances) -> float:
    """Mean correlation of columns of standardised values with those a frame later."""
    earlier, later = _steps(chances)
    if len(earlier) < _FEWEST:
        return 0.0
    correlations = [
        np.corrcoef(column[earlier], column[later])[0, 1]
        for column in standard.T
        if np.ptp(column) > 0
    ]
    return float(np.clip(np.mean(correlations), 0.0, 0.99)) if correlations else 0.0


def _coupling(standard: FloatArray, quality: FloatArray) -> float:
    """Slope of the log of an error's size over the quality, with its sign turned."""
    if np.ptp(quality) == 0:
        return 0.0
    size = np.log(np.maximum(np.abs(standard), 1e-3))
    slopes = [-np.cov(column, quality)[0, 1] / quality.var() for column in size.T]
    return float(np.clip(np.mean(slopes), 0.0, 1.0))


def _fit_scores(
    score: FloatArray, chances: Chances, bins: IntArray, at: tuple[float, ...], scale: _ScoreScale
) -> tuple[dict[str, Any], FloatArray]:
    """The knobs of true scores, and each box's standard normal quality under them."""
    value = scale.quality(score)
    hidden = 1 - chances.visibility
    loss = 0.0
    for _ in range(5):
        # Alternate the mean in full view, bin by bin, and what hiding takes off it.
        mean = np.clip(_binned(value, bins) / _binned(1 - loss * hidden, bins), 1e-3, 1 - 1e-3)
        if hidden.any():
            expected = mean[bins] * hidden
            lost = expected @ (mean[bins] - value) / (expected @ expected)
            loss = float(np.clip(lost, 0.0, 0.9))
    expected = np.clip(mean[bins] * (1 - loss * hidden), 1e-3, 1 - 1e-3)
    concentration = _concentration(value, expected)
    below = special.betainc(expected * concentration, (1 - expected) * concentration, value)
    quality = normal(np.clip(below, 1e-9, 1 - 1e-9))
    knobs = {
        "score_mean": Curve(at=at, value=tuple(mean)),
        "hidden_score_loss": loss,
        "score_concentration": concentration,
    }
    return knobs, quality


def _concentration(value: FloatArray, mean: FloatArray) -> float:
    """Sum of the shapes of Betas of these means by their pooled variance."""
    spread = np.square(value - mean).sum()
    return float(np.clip((mean * (1 - mean)).sum() / max(spread, 1e-9) - 1, 0.2, 500.0))


def _score_scale(evidence: Evidence) -> _ScoreScale:
    """The scale on which scores are most like Betas (maximum likelihood over moment fits)."""
    hits, falses = evidence.hits, evidence.falses
    chances = evidence.chances.take(hits.chance)
    groups = [
        (hits.score, chances.label, chances.distance),
        (falses.score, falses.label, falses.distance),
    ]
    split = []
    for score, label, distance in groups:
        bins = label * 100 + (distance / _BIN_WIDTH).astype(np.int64)
        split.append((score, np.unique(bins, return_inverse=True)[1], label))

    scores = np.concatenate([score for score, _, _ in groups])
    floor = float(np.clip(scores.min() - 1e-3, 0.0, 0.99)) if len(scores) else 0.0

    def loss(x: FloatArray) -> float:
        scale = _ScoreScale(float(np.exp(x[0])), float(x[1]), floor)
        total = 0.0
        for score, bins, label in split:
            value = scale.quality(score)
            for kind in np.unique(label):
                rows = label == kind
                inside = value[rows]
                mean = np.clip(_binned(value, bins), 1e-3, 1 - 1e-3)[bins[rows]]
                concentration = _concentration(inside, mean)
                a, b = mean * concentration, (1 - mean) * concentration
                density = a * np.log(inside) + b * np.log1p(-inside) - special.betaln(a, b)
                total -= float(density.sum()) + len(inside) * x[0]
        return total + 0.1 * float(np.square(x[0]) + np.square(x[1]))

    found = optimize.minimize(
        loss, np.zeros(2), method="Nelder-Mead", options={"xatol": 0.01, "fatol": 1.0}
    )
    return _ScoreScale(float(np.exp(found.x[0])), float(found.x[1]), floor)


def _fit_clutter(evidence: Evidence, scale: _ScoreScale) -> ClutterModel:
    falses = evidence.falses
    frames = int(evidence.frames.sum())
    if len(falses.score) == 0:
        return ClutterModel()
    share, detection = _fit_places(falses)
    labels = np.unique(falses.label).tolist()
    return ClutterModel(
        rate=len(falses.score) / frames,
        persistent_share=share,
        persistent_detection=detection,
        labels={Label(v): float(np.mean(falses.label == v)) for v in labels},
        label={
            Label(v): FalseBoxes(**_false_boxes(evidence, falses.label == v, scale)) for v in labels
        },
    )


def _false_boxes(evidence: Evidence, rows: BoolArray, scale: _ScoreScale) -> Mapping[str, Any]:
    falses = evidence.falses
    distance, size = falses.distance[rows], falses.size[rows]
    edges = np.arange(0.0, evidence.fields_of_view[:, 1].max() + _BIN_WIDTH, _BIN_WIDTH)
    # The area that was looked at, ring by ring, summed over frames.
    half_angle, reach = evidence.fields_of_view.T
    ring = np.square(np.minimum(edges[1:, None], reach)) - np.square(
        np.minimum(edges[:-1, None], reach)
    )
    area = np.maximum((ring * half_angle * evidence.frames).sum(axis=1), 1e-9)
    density = np.histogram(distance, edges)[0] / area
    value = scale.quality(falses.score[rows])
    mean = np.full(len(value), np.clip(value.mean(), 1e-3, 1 - 1e-3))
    typical = size.mean(axis=0)
    return {
        "range_profile": Curve(
            at=tuple((edges[1:] + edges[:-1]) / 2), value=tuple(density / density.max())
        ),
        "score_mean": float(mean[0]),
        "score_concentration": _concentration(value, mean),
        "typical_size": tuple(typical.tolist()),
        "size_spread": tuple(np.clip(size.std(axis=0) / typical, 0.0, 0.5).tolist()),
        "size_correlation": _pair_correlation(size),
        "aligned_share": _aligned_share(falses.yaw[rows] + falses.bearing[rows]),
    }


def _pair_correlation(columns: FloatArray) -> float:
    """Mean correlation of two columns."""
    if len(columns) < _FEWEST or (np.ptp(columns, axis=0) == 0).any():
        return 0.0
    count = columns.shape[1]
    correlation = np.corrcoef(columns.T).reshape(count, count)
    return float(np.clip(correlation[np.triu_indices(count, 1)].mean(), 0.0, 0.99))


def _aligned_share(heading: FloatArray) -> float:
    """The share of headings (R,), relative to the sensor's, that lie along its axis: of uniform
    ones a quarter is within pi / 8 of it, of aligned ones nearly all."""
    aside = np.abs(wrap_angle(2 * heading)) / 2
    near = float(np.mean(aside < np.pi / 8))
    return float(np.clip((near - 0.25) / (_ALIGNED_NEAR - 0.25), 0.0, 1.0))


def _fit_places(falses: Falses) -> tuple[float, float]:
    """The share of false boxes that stay at a place, and how often a place gives a box.

    A box of a place has one near it a frame later with the place's probability, any other box
    hardly ever; given one a frame later, so it has two frames later.
    """
    key = falses.recording * 10**7 + falses.frame
    order = np.argsort(key, kind="stable")
    key = key[order]
    position, label = falses.position[order], falses.label[order]

    def next_near(rows: IntArray, lag: int) -> BoolArray:
        near = np.zeros(len(rows), dtype=bool)
        low = np.searchsorted(key, key[rows] + lag, side="left")
        high = np.searchsorted(key, key[rows] + lag, side="right")
        for index, (row, begin, end) in enumerate(zip(rows, low, high, strict=True)):
            apart = np.linalg.norm(position[begin:end] - position[row], axis=1)
            near[index] = np.any((apart < _NEAR) & (label[begin:end] == label[row]))
        return near

    every = np.arange(len(key))
    once, twice = next_near(every, 1), next_near(every, 2)
    if np.count_nonzero(once) < _FEWEST:
        return 0.0, 0.8
    detection = float(np.clip(twice[once].mean(), 0.05, 1.0))
    return float(np.clip(once.mean() / detection, 0.0, 1.0)), detection
