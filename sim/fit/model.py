"""A detector model fitted to recordings whose truth and origins are known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy import optimize, special

from pmbm.labels import Label
from pmbm.sim.detector.knobs import Curve
from pmbm.sim.detector.model import DetectorModel
from pmbm.sim.detector.objects import ObjectModel
from pmbm.sim.detector.sensor import SensorModel
from pmbm.sim.fit.binning import FEWEST, Sample, binned, range_bins, sample, steps
from pmbm.sim.fit.boxes import fit_errors
from pmbm.sim.fit.clutter import fit_clutter, fit_company
from pmbm.sim.fit.goodness_of_fit import Figure, figures, modelled
from pmbm.sim.fit.observations import Opportunities, gather
from pmbm.sim.fit.scores import ScoreScale, score_scale
from pmbm.types import FloatArray, Recording

_VISIBILITY_EDGES: Final = (0.1, 0.5, 0.9)
_SUREST: Final = 0.999


def fit_detector(
    recordings: Recording | Sequence[Recording],
    *,
    name: str = "fitted",
    provenance: str = "",
    min_iou: float | None = None,
) -> DetectorModel:
    """The detector model under which recordings look as they do.

    `min_iou` is the 3D overlap from which their origins join a box to an object, where they do
    (`pmbm.datasets.with_origins`): boxes of the model that overlap less will count as misses and
    false boxes too, and the detection probability makes up for them.

    Detection probability (over range and visibility) and miss bursts are of maximum likelihood;
    noise, sizes, scores and clutter match moments range by range; duplicates, companions and
    echoes are what boxes have near them beyond chance.  Labels with fewer than `40` detected
    objects share what is fitted to all together.  What single recordings cannot tell is left at
    its null: confusion (origins join equal labels, so that a wrong label is a miss and a false
    box), split objects (one half is the object's box, the other false), lateness, jitter and pose
    noise; and the biases of size, which the pull to a typical size holds already.

    Raises InputError for no recordings, or one without origins.
    """
    if isinstance(recordings, Recording):
        recordings = [recordings]
    evidence = gather(recordings)
    chances, hits = evidence.chances, evidence.hits
    scale, company = score_scale(evidence), fit_company(evidence)
    everything = np.ones(len(chances.found), dtype=bool)
    by_label = {
        Label(label): _fit_objects(
            sample(evidence, chances.label == label), scale, company.of_true(label)
        )
        for label in np.unique(chances.label).tolist()
        if np.count_nonzero(chances.label[hits.chance] == label) >= FEWEST
    }
    frames, delivered = int(evidence.truth_frames.sum()), int(evidence.frames.sum())
    source = (
        f"Fitted to {len(recordings)} recordings, {delivered} frames, {len(chances.found)} objects "
        f"in view, {len(hits.score)} of them detected, {len(evidence.falses.score)} false boxes."
    )
    model = DetectorModel(
        name=name,
        objects=_fit_objects(sample(evidence, everything), scale, {}),
        label=by_label,
        clutter=fit_clutter(evidence, scale, company),
        sensor=SensorModel(drop_probability=1.0 - delivered / frames),
        score_temperature=scale.temperature,
        score_offset=scale.offset,
        score_floor=scale.floor,
        provenance=f"{provenance} {source}".strip(),
    )
    return model if min_iou is None else _made_up(model, recordings, min_iou)


def refits(
    recordings: Sequence[Recording], count: int, *, min_iou: float | None = None, seed: int = 0
) -> Iterator[list[dict[str, Figure]]]:
    """The figures, on each of the recordings, of models fitted to as many of them drawn with
    replacement: what `pmbm.sim.fit.goodness_of_fit.bootstrap` resamples."""
    rng = np.random.default_rng(seed)
    for rows in rng.integers(0, len(recordings), (count, len(recordings))):
        model = fit_detector([recordings[row] for row in rows], min_iou=min_iou)
        yield [figures(r) for r in modelled(model, recordings, seed, min_iou=min_iou)]


def _made_up(
    model: DetectorModel, recordings: Sequence[Recording], min_iou: float
) -> DetectorModel:
    """The model with detection probabilities over the shares of its boxes that overlap enough."""
    chances = gather(modelled(model, recordings, seed=0)).chances
    matched = gather(modelled(model, recordings, seed=0, min_iou=min_iou)).chances.found
    by_label = {}
    for label, objects in model.label.items():
        rows = chances.found & (chances.label == label)
        curve = objects.detection_probability
        share = _hats(chances.distance[rows], np.array(curve.at))
        enough = share.sum(axis=0) >= FEWEST
        kept = np.where(enough, share.T @ matched[rows] / np.maximum(share.sum(axis=0), 1e-9), 1.0)
        value = np.clip(np.array(curve.value) / np.maximum(kept, 0.1), 0.0, _SUREST)
        made_up = Curve(at=curve.at, value=tuple(np.maximum(value, curve.value)))
        by_label[label] = replace(objects, detection_probability=made_up)
    return replace(model, label=by_label)


def _fit_objects(part: Sample, scale: ScoreScale, company: dict[str, Any]) -> ObjectModel:
    chances = part.chances
    if len(chances.found) == 0:
        return ObjectModel()
    probability, odds = _fit_probability(chances)
    values: dict[str, Any] = {"detection_probability": probability, "visibility_odds": odds}
    expected = ObjectModel(**values).probability(chances.distance, chances.visibility)
    if len(part.hits.score) == 0:
        return ObjectModel(**values)
    return ObjectModel(
        **values,
        miss_burst_length=_fit_bursts(chances, expected),
        **fit_errors(part, scale),
        **company,
    )


def _hats(x: FloatArray, knots: FloatArray) -> FloatArray:
    """Shares (R,K) of the knots in linear interpolation at x (R,)."""
    return np.stack([np.interp(x, knots, column) for column in np.eye(len(knots))], axis=1)


def _fit_probability(chances: Opportunities) -> tuple[Curve, Curve]:
    """Detection probability in full view over range, and what multiplies its odds over visibility
    (maximum likelihood); the second is 1 in full view."""
    knots = binned(chances.distance, range_bins(chances.distance, FEWEST // 2))
    level = np.digitize(chances.visibility, _VISIBILITY_EDGES)
    full = level == len(_VISIBILITY_EDGES)
    dim = [k for k in np.unique(level[~full]).tolist() if np.count_nonzero(level == k) >= FEWEST]
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


def _fit_bursts(chances: Opportunities, probability: FloatArray) -> float:
    """Mean length of runs of misses under which pairs of frames look as they do (maximum
    composite likelihood of the latent-renewal chain)."""
    earlier, later = steps(chances)
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
