"""Fitted errors of boxes: centre, size and heading by moments, range by range."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from scipy import optimize

from pmbm.sim.detector.knobs import Curve
from pmbm.sim.fit.binning import Sample, binned, lag_correlation, pair_correlations, range_bins
from pmbm.sim.fit.observations import Detected, Opportunities
from pmbm.sim.fit.scores import ScoreScale, fit_scores
from pmbm.types import FloatArray, IntArray

_HELD_BY: Final = 2.0
"""Objects."""
_SAME_SIZE: Final = 0.02
"""Objects whose sizes differ by less, m, do not say how a detector responds to size."""
_LONG: Final = 10
"""Frames."""


def fit_errors(sample: Sample, scale: ScoreScale) -> dict[str, Any]:
    """Sizes, errors of the box and scores: moments by range."""
    hits, chances = sample.hits, sample.chances.take(sample.hits.chance)
    bins = range_bins(chances.distance)
    at = tuple(binned(chances.distance, bins))

    def curve(values: FloatArray) -> Curve:
        return Curve(at=at, value=tuple(values))

    def spread(error: FloatArray) -> FloatArray:
        return np.sqrt(binned(np.square(error), bins))

    objects = len(np.unique(np.stack([chances.recording, chances.object_id]), axis=1).T)
    sizes, expected = _fit_sizes(hits, bins, objects)
    size_error = hits.size - expected
    anchor, error = _fit_anchor(hits, bins, objects)
    hidden = _fit_hidden_noise(error[:, :2], chances.visibility, bins)
    position_error = error / (1 + hidden * (1 - chances.visibility))[:, None]
    flipped = np.abs(hits.yaw_error) > np.pi / 2
    straight = np.where(flipped, 0.0, hits.yaw_error)
    kept = np.maximum(1 - binned(flipped.astype(float), bins), 0.1)
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
    persistence = lag_correlation(standard[:, :3], chances)
    scores, quality = fit_scores(hits.score, chances, bins, at, scale)
    names = (
        *("radial_noise", "lateral_noise", "vertical_noise"),
        *("length_noise", "width_noise", "height_noise", "yaw_noise"),
    )
    return {
        **{name: curve(values) for name, values in zip(names, deviations, strict=True)},
        "hidden_noise": hidden,
        **sizes,
        "size_pull": curve(sizes["size_pull"]),
        "facing_anchor": curve(anchor),
        "size_correlation": pair_correlations(standard[:, 3:6]),
        "flip_probability": float(flipped.mean()),
        "error_persistence": persistence,
        "lasting_size_error": _lasting_share(standard[:, 3:6], chances, persistence),
        "score_persistence": lag_correlation(quality[:, None], chances),
        "quality_coupling": _coupling(standard[:, :6], quality),
        **scores,
    }


def _fit_sizes(hits: Detected, bins: IntArray, objects: int) -> tuple[dict[str, Any], FloatArray]:
    """Typical size, response and pull, and the sizes (R,3) expected under them.

    Least squares, in turn of the pull of each bin and of the response, which is held to the
    identity.
    """
    typical = hits.size.mean(axis=0)
    spread = hits.true_size.var(axis=0)
    weight = 1 / np.maximum((hits.size - hits.true_size).var(axis=0), 1e-6)
    hold = _HELD_BY * len(bins) / objects * np.diag(spread)
    response, varied = np.eye(3), bool((spread > _SAME_SIZE**2).all())
    for _ in range(20 if varied else 1):
        gap, shown = hits.true_size - typical, hits.size - typical
        expected = gap @ response.T
        above = binned((shown * expected) @ weight, bins)
        shares = _ratio(above, binned(np.square(expected) @ weight, bins), bins, objects)
        if varied:
            scaled = shares[bins, None] * gap
            normal_matrix = scaled.T @ scaled + hold
            response = np.linalg.solve(normal_matrix, scaled.T @ shown + hold).T
            # The pull and the response may trade a factor: let the pull begin at none.
            response, shares = response * shares.max(), shares / max(shares.max(), 1e-9)
            # The typical size under which errors are none on average, as far as it matters.
            bias = (shown - shares[bins, None] * (gap @ response.T)).mean(axis=0)
            moves = np.eye(3) - shares[bins].mean() * response
            typical = typical + np.linalg.solve(moves.T @ moves + 0.05 * np.eye(3), moves.T @ bias)
    knobs: dict[str, Any] = {"size_pull": 1.0 - shares, "typical_size": tuple(typical.tolist())}
    if varied:
        knobs["size_response"] = tuple(map(tuple, np.clip(response, -2.0, 2.0).tolist()))
    gap = hits.true_size - typical
    return knobs, typical + shares[bins, None] * (gap @ response.T)


def _fit_anchor(hits: Detected, bins: IntArray, objects: int) -> tuple[FloatArray, FloatArray]:
    """How far the centre moves with the side that faces the sensor (least squares), and the errors
    of the centre (R,3) left."""
    cos, sin = np.cos(hits.true_yaw), np.sin(hits.true_yaw)
    shrunk = (hits.true_size - hits.size)[:, :2] / 2
    # Along the object's axes the sensor lies at (-cos, sin); back on the line of sight:
    x, y = -cos * shrunk[:, 0], sin * shrunk[:, 1]
    move = np.stack([x * cos - y * sin, x * sin + y * cos], axis=1)
    above = binned((move * hits.error[:, :2]).sum(axis=1), bins)
    anchor = _ratio(above, binned(np.square(move).sum(axis=1), bins), bins, objects)
    return anchor, hits.error - anchor[bins, None] * np.pad(move, ((0, 0), (0, 1)))


def _ratio(above: FloatArray, below: FloatArray, bins: IntArray, objects: int) -> FloatArray:
    """Ratios in each bin, from 0 to 1, held to that of all bins with the weight of so many objects:
    an error of size lasts, so that a thousand boxes of ten objects say little more than ten."""
    boxes = np.bincount(bins)
    total, mass = float(boxes @ above), max(float(boxes @ below), 1e-9)
    hold = _HELD_BY / objects * mass / len(boxes)
    held: FloatArray = (boxes * above + hold * total / mass) / (boxes * below + hold)
    return np.clip(held, 0.0, 1.0)


def _lasting_share(standard: FloatArray, chances: Opportunities, persistence: float) -> float:
    """The share of a variance that lasts: what is left of the correlation after `_LONG` frames."""
    fading = persistence**_LONG
    return float(
        np.clip((lag_correlation(standard, chances, _LONG) - fading) / (1 - fading), 0.0, 1.0)
    )


def _fit_hidden_noise(error: FloatArray, visibility: FloatArray, bins: IntArray) -> float:
    """The growth of the centre's error when hidden (Gaussian maximum likelihood)."""
    if np.ptp(visibility) == 0:
        return 0.0

    def loss(hidden: float) -> float:
        factor = 1 + hidden * (1 - visibility)
        spread = [binned(np.square(column / factor), bins) for column in error.T]
        log_spread = sum(np.log(np.maximum(s, 1e-12))[bins].sum() / 2 for s in spread)
        return float(log_spread + error.shape[1] * np.log(factor).sum())

    return float(optimize.minimize_scalar(loss, bounds=(0.0, 4.0), method="bounded").x)


def _coupling(standard: FloatArray, quality: FloatArray) -> float:
    """Slope of the log of an error's size over the quality, with its sign turned."""
    if np.ptp(quality) == 0:
        return 0.0
    size = np.log(np.maximum(np.abs(standard), 1e-3))
    slopes = [-np.cov(column, quality)[0, 1] / quality.var() for column in size.T]
    return float(np.clip(np.mean(slopes), 0.0, 1.0))
