"""Real recordings and their model side by side: recall, noise, clutter, runs of misses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from scipy import stats

from pmbm.datasets import with_origins
from pmbm.labels import Label
from pmbm.sim.detector.model import DetectorModel
from pmbm.sim.detector.replay import replay
from pmbm.sim.fit.observations import Observations, gather
from pmbm.types import BoolArray, FloatArray, IntArray, Recording

RANGE_EDGES: Final = (0.0, 20.0, 40.0, 60.0, np.inf)
"""m."""
_FEWEST: Final = 50
_NOISES: Final = ("radial", "lateral", "length", "width", "yaw")


@dataclass(frozen=True)
class Figure:
    """One figure of recordings: a sum over a weight, so that recordings add up.

    name : such as "recall car 20-40 m".
    total, weight : the figure is total / weight; for noise, the root of it.
    """

    name: str
    total: float
    weight: float

    @property
    def value(self) -> float:
        """The figure itself."""
        ratio = self.total / self.weight if self.weight else np.nan
        return float(np.sqrt(ratio)) if self.name.startswith("noise") else ratio


def figures(recording: Recording, detector: DetectorModel | None = None) -> dict[str, Figure]:
    """All figures of one recording with known origins, by name.

    For a recording that `detector` made, recall is its mean detection probability: what recall
    would be over ever more trials.
    """
    evidence = gather([recording])
    chances = evidence.chances
    found_share = chances.found.astype(float)
    if detector is not None:
        for value in np.unique(chances.label).tolist():
            rows = chances.label == value
            found_share[rows] = detector.of(Label(value)).probability(
                chances.distance[rows], chances.visibility[rows]
            )
    found = {}
    for name, total, weight in [
        *_recall(evidence, found_share),
        *_noise(evidence),
        *_clutter(evidence),
        *_runs(evidence),
    ]:
        found[name] = Figure(name, float(total), float(weight))
    return found


def pooled(parts: Sequence[dict[str, Figure]]) -> dict[str, Figure]:
    """The figures of all recordings together."""
    names = dict.fromkeys(name for part in parts for name in part)
    return {
        name: Figure(
            name,
            sum(part[name].total for part in parts if name in part),
            sum(part[name].weight for part in parts if name in part),
        )
        for name in names
    }


def modelled(
    detector: DetectorModel,
    recordings: Sequence[Recording],
    seed: int,
    trial: int = 0,
    *,
    min_iou: float | None = None,
) -> list[Recording]:
    """What the detector makes of the truth of recordings, each with a seed of its own; `min_iou` to
    lose sight of where its boxes come from and find it by overlap, as one must for real ones."""
    made = [
        detector.detect(replay(recording), seed + number, trial)
        for number, recording in enumerate(recordings)
    ]
    return made if min_iou is None else [with_origins(r, min_iou=min_iou) for r in made]


@dataclass(frozen=True)
class FitComparison:
    """A figure of real recordings beside that of the model on the same truth.

    name : of the figure.
    real, model : its values.
    weight : what the real one rests on: rows, frames or runs.
    interval : 95 % bootstrap interval of model - real (of their ratio less one for noise and
        clutter), or None.
    """

    name: str
    real: float
    model: float
    weight: float
    interval: tuple[float, float] | None = None

    @property
    def difference(self) -> float:
        """Model less real; relative for all but recall."""
        return _difference(self.name, self.real, self.model)

    @property
    def inside(self) -> bool:
        """Whether the difference lies in the interval, or there is none."""
        return self.interval is None or self.interval[0] <= self.difference <= self.interval[1]


def outside(rows: Sequence[FitComparison]) -> list[str]:
    """Names of the figures that leave their interval."""
    return [row.name for row in rows if not row.inside]


def compare(
    real: Sequence[dict[str, Figure]], model: Sequence[dict[str, Figure]]
) -> list[FitComparison]:
    """All figures that rest on enough, pooled over recordings."""
    left, right = pooled(real), pooled(model)
    return [
        FitComparison(name, figure.value, right[name].value, figure.weight)
        for name, figure in left.items()
        if figure.weight >= _FEWEST and name in right and right[name].weight > 0
    ]


def bootstrap(
    fitted_real: Sequence[dict[str, Figure]],
    refitted: Sequence[Sequence[dict[str, Figure]]],
    held_real: Sequence[dict[str, Figure]],
    held_model: Sequence[dict[str, Figure]],
    *,
    draws: int = 4000,
    seed: int = 0,
) -> list[FitComparison]:
    """Figures on held-back recordings, with the interval that resampling the fitted ones gives.

    refitted : for each of several models, its figures on every fitted recording; each model is
        fitted to as many recordings as the real one, drawn of them with replacement.

    As many recordings as are held back are drawn, with replacement, of the fitted ones; the
    interval holds the middle of the differences of model and real over such draws and models: how
    a model fitted to so many recordings differs from so many others of the same kind.  It reaches
    as far beyond the middle 95 % as few recordings ask for (`_tail`).
    """
    resampled = _Resampled(len(fitted_real), len(held_real), draws, seed)
    result = []
    for item in compare(held_real, held_model):
        real = _sums(item.name, fitted_real, resampled.held)
        model = np.zeros_like(real)
        for number, of_model in enumerate(refitted):
            rows = slice(number, None, len(refitted))
            model[rows] = _sums(item.name, of_model, resampled.held[rows])
        interval = _middle(item.name, real, model, len(fitted_real))
        if interval is not None:
            result.append(replace(item, interval=interval))
    return result


def between_real(
    fitted: Sequence[dict[str, Figure]],
    held: Sequence[dict[str, Figure]],
    *,
    draws: int = 4000,
    seed: int = 0,
) -> list[FitComparison]:
    """The comparison of `bootstrap` between two disjoint sets of real recordings, without any
    model.

    The figures of those held back stand for the model's, those of all fitted ones for the real;
    the interval is that of two such sets drawn of the fitted ones.  What leaves it does so because
    recordings differ.
    """
    resampled = _Resampled(len(fitted), len(held), draws, seed)
    result = []
    for item in compare([pooled(fitted)], held):
        weight = pooled(held)[item.name].weight
        interval = _middle(
            item.name,
            _sums(item.name, fitted, resampled.fitted),
            _sums(item.name, fitted, resampled.held),
            len(fitted),
        )
        if interval is not None and weight >= _FEWEST:
            result.append(replace(item, weight=weight, interval=interval))
    return result


def outside_by_chance(
    recordings: Sequence[dict[str, Figure]], fitted: int, *, splits: int = 100, seed: int = 0
) -> FloatArray:
    """Shares (splits,) of figures that leave their interval in `between_real`, where so many of all
    real recordings, drawn at random, stand for the fitted ones: what leaves it though nothing
    differs but which recordings are held back."""
    rng = np.random.default_rng(seed)
    shares = []
    for _ in range(splits):
        order = rng.permutation(len(recordings))
        one, other = ([recordings[row] for row in part] for part in np.split(order, [fitted]))
        rows = between_real(one, other, draws=1000)
        shares.append(len(outside(rows)) / max(len(rows), 1))
    return np.array(shares)


class _Resampled:
    """Rows (draws, n) of so many fitted recordings, drawn with replacement: as many as are fitted,
    and as many as are held back."""

    def __init__(self, fitted: int, held: int, draws: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.held = rng.integers(0, fitted, (draws, held))
        self.fitted = rng.integers(0, fitted, (draws, fitted))


def _sums(name: str, parts: Sequence[dict[str, Figure]], rows: IntArray) -> FloatArray:
    """Totals and weights (draws,2) of a figure over recordings (draws, n)."""
    none = Figure(name, 0.0, 0.0)
    each = [part.get(name, none) for part in parts]
    sums: FloatArray = np.array([(figure.total, figure.weight) for figure in each])[rows].sum(
        axis=1
    )
    return sums


def _middle(
    name: str, real: FloatArray, model: FloatArray, recordings: int
) -> tuple[float, float] | None:
    """95 % interval of the differences of sums (draws,2), drawn of so many recordings; None where
    few draws have both, or there is but one recording."""
    differences = [
        _difference(name, Figure(name, *a).value, Figure(name, *b).value)
        for a, b in zip(real, model, strict=True)
        if a[1] > 0 and b[1] > 0
    ]
    if len(differences) < len(real) / 2 or recordings < 2:
        return None
    tail = _tail(recordings)
    low, high = np.quantile(differences, [tail, 1 - tail])
    return float(low), float(high)


def _tail(recordings: int) -> float:
    """Share of the draws beyond each end of a 95 % interval.

    Draws of n recordings vary by (n - 1) / n of what recordings do, and n of them do not tell how
    much that is: the interval is wider as Student's is than the normal one (the expanded percentile
    interval of Hesterberg, The American Statistician 69(4), 2015).
    """
    wider = np.sqrt(recordings / (recordings - 1)) * stats.t.ppf(0.975, recordings - 1)
    return float(stats.norm.cdf(-wider))


def _difference(name: str, real: float, model: float) -> float:
    if name.startswith("recall"):
        return model - real
    return model / real - 1 if real > 0 else np.nan


_Rows = list[tuple[str, float, float]]


def _cells(label: IntArray, distance: FloatArray) -> list[tuple[str, BoolArray]]:
    """Names and masks of each label and range."""
    cells = []
    for value in np.unique(label).tolist():
        for low, high in pairwise(RANGE_EDGES):
            reach = f"{low:.0f}-{high:.0f} m" if np.isfinite(high) else f"over {low:.0f} m"
            inside = (label == value) & (distance >= low) & (distance < high)
            cells.append((f"{Label(value).name.lower()} {reach}", inside))
    return cells


def _recall(evidence: Observations, found: FloatArray) -> _Rows:
    chances = evidence.chances
    rows = [
        (f"recall {name}", found[inside].sum(), inside.sum())
        for name, inside in _cells(chances.label, chances.distance)
    ]
    for value in np.unique(chances.label).tolist():
        for name, low, high in (
            ("hidden", -1, 0.5),
            ("partly hidden", 0.5, 0.9),
            ("clear", 0.9, 2),
        ):
            inside = (
                (chances.label == value) & (chances.visibility >= low) & (chances.visibility < high)
            )
            what = f"recall {Label(value).name.lower()} {name}"
            rows.append((what, found[inside].sum(), inside.sum()))
    return rows


def _noise(evidence: Observations) -> _Rows:
    hits, chances = evidence.hits, evidence.chances.take(evidence.hits.chance)
    straight = np.abs(hits.yaw_error) < np.pi / 2
    size = hits.size - hits.true_size
    rows: _Rows = []
    for name, inside in _cells(chances.label, chances.distance):
        for noise, column in zip(
            _NOISES,
            (hits.error[:, 0], hits.error[:, 1], size[:, 0], size[:, 1], hits.yaw_error),
            strict=True,
        ):
            keep = inside & straight if noise == "yaw" else inside
            rows.append((f"noise {noise} {name}", np.square(column[keep]).sum(), keep.sum()))
    return rows


def _clutter(evidence: Observations) -> _Rows:
    labels = np.union1d(evidence.falses.label, evidence.chances.label).tolist()
    frames = evidence.frames.sum()
    return [
        (f"clutter {Label(v).name.lower()} a frame", (evidence.falses.label == v).sum(), frames)
        for v in labels
    ]


def _runs(evidence: Observations) -> _Rows:
    """Mean length of runs of misses: misses over runs."""
    chances = evidence.chances
    rows: _Rows = []
    for value in np.unique(chances.label).tolist():
        part = chances.take(chances.label == value)
        order = np.lexsort((part.frame, part.object_id))
        missed = ~part.found[order]
        follows = (np.diff(part.object_id[order]) == 0) & (np.diff(part.frame[order]) == 1)
        begins = missed & ~np.append(False, missed[:-1] & follows)
        what = f"misses in a row {Label(value).name.lower()}"
        rows.append((what, missed.sum(), begins.sum()))
    return rows
