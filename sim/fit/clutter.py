"""False boxes fitted: how many, where, what they look like, which stay and which come together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy import special, stats

from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.sim.detector.boxes import TYPICAL_SIZE
from pmbm.sim.detector.clutter import ClutterModel, FalseBoxes
from pmbm.sim.detector.knobs import Curve
from pmbm.sim.fit.binning import BIN_WIDTH, FEWEST, binned, pair_correlations, range_bins
from pmbm.sim.fit.observations import FalseAlarms, Observations
from pmbm.sim.fit.scores import ScoreScale, concentration_of
from pmbm.sim.streams import normal
from pmbm.types import BoolArray, FloatArray, IntArray

_SPREADS: Final = (0.02, 0.5)
"""Between these lies how far headings may stray from a direction and still keep to it, rad."""
_NEAR: Final = 1.5
"""A false box of the next frame this close belongs to the same place, m."""
_LATER: Final = 10
"""Frames after which what one frame's score owes to the last is over."""
_ECHO_REACH: Final = 0.6
"""Boxes of two labels this close are at one place, m."""
_SECOND_REACH: Final = 0.5
"""How near a second box of an object may be, in typical lengths."""
_COMPANION_REACH: Final = 3.0
"""How near a companion may be, m, or within two typical lengths."""


def fit_clutter(evidence: Observations, scale: ScoreScale, company: CoOccurrence) -> ClutterModel:
    """The false boxes that come by themselves, and what they bring."""
    falses = evidence.falses
    frames = int(evidence.frames.sum())
    if len(falses.score) == 0:
        return ClutterModel()
    labels = np.unique(falses.label).tolist()
    alone = company.alone(evidence)
    looks = {
        v: FalseBoxes(**_false_boxes(evidence, falses.label == v, scale), **company.of_false(v))
        for v in labels
    }
    return ClutterModel(
        rate=float(sum(alone.values())) / frames,
        **_fit_places(falses, _quality(falses, looks, scale)),
        labels={Label(v): float(alone[v] / sum(alone.values())) for v in labels},
        label={Label(v): look for v, look in looks.items()},
    )


@dataclass(frozen=True, eq=False)
class CoOccurrence:
    """Boxes that come with others, beyond chance.

    second : for each label, the probability of a further false box of the same label near a true
        box, and the spread about it, m.
    companion : the same near a false box.
    echo_of_true, echo_of_false : for each label, the probability of a false box of each other
        label at the same place.
    """

    second: Mapping[int, tuple[float, float]]
    companion: Mapping[int, tuple[float, float]]
    echo_of_true: Mapping[int, Mapping[Label, float]]
    echo_of_false: Mapping[int, Mapping[Label, float]]

    def of_true(self, label: int) -> dict[str, Any]:
        """The knobs of objects of a label."""
        probability, spread = self.second[label]
        return {
            "duplicate_probability": probability,
            "duplicate_spread": spread,
            "echo": self.echo_of_true[label],
        }

    def of_false(self, label: int) -> dict[str, Any]:
        """The knobs of false boxes of a label."""
        (probability, spread), echo = self.companion[label], self.echo_of_false[label]
        return {
            "companion_probability": probability,
            "companion_spread": spread,
            # Companions bring no echoes, but were counted among the boxes.
            "echo": {k: min(v * (1 + probability), 1.0) for k, v in echo.items()},
        }

    def alone(self, evidence: Observations) -> dict[int, float]:
        """The number of false boxes of each label that come by themselves."""
        true = evidence.chances.label[evidence.hits.chance]
        count = {v: float(np.sum(evidence.falses.label == v)) for v in self.companion}
        for label, rest in count.items():
            brought = np.count_nonzero(true == label) * self.second[label][0]
            brought += sum(
                np.count_nonzero(true == other) * echo.get(Label(label), 0.0)
                for other, echo in self.echo_of_true.items()
            )
            brought += sum(
                count[other] * echo.get(Label(label), 0.0)
                for other, echo in self.echo_of_false.items()
            )
            count[label] = max(rest - brought, 0.05 * rest) / (1 + self.companion[label][0])
        return count


def fit_company(evidence: Observations) -> CoOccurrence:
    """How many boxes have another near, less those that would by chance: near the boxes of a frame
    of another recording."""
    hits, falses = evidence.hits, evidence.falses
    true_label = evidence.chances.label[hits.chance]
    start = np.concatenate([[0], np.cumsum(evidence.truth_frames)])
    chances = evidence.chances.take(hits.chance)
    true_frame, false_frame = (
        start[chances.recording] + chances.frame,
        start[falses.recording] + falses.frame,
    )
    frames = int(start[-1])

    def excess(of_true: bool, label: int, other: int, reach: float) -> tuple[float, float]:
        kind, frame, place = (
            (true_label, true_frame, hits.place)
            if of_true
            else (falses.label, false_frame, falses.place)
        )
        own, near = kind == label, falses.label == other
        if min(np.count_nonzero(own), np.count_nonzero(near)) < FEWEST:
            return 0.0, reach / 2
        boxes, others = (frame[own], place[own]), (false_frame[near], falses.place[near])
        found = _nearest(boxes, others, among_them=label == other and not of_true)
        by_chance = _nearest(boxes, ((others[0] + frames // 2) % frames, others[1]))
        return _beyond_chance(found, by_chance, reach)

    labels = np.union1d(true_label, falses.label).tolist()
    often = sorted(labels, key=lambda v: -np.count_nonzero(falses.label == v))
    companion = {}
    for label in labels:
        reach = max(_COMPANION_REACH, 2.0 * _length(label))
        share, spread = excess(False, label, label, reach)
        companion[label] = (share / (2 - share), spread)
    return CoOccurrence(
        second={v: excess(True, v, v, _SECOND_REACH * _length(v)) for v in labels},
        companion=companion,
        echo_of_true={
            a: _echo({b: excess(True, a, b, _ECHO_REACH)[0] for b in labels if b != a})
            for a in labels
        },
        # Of two labels at one place, the one that is more often false brings the other.
        echo_of_false={
            a: _echo({b: excess(False, a, b, _ECHO_REACH)[0] for b in often[often.index(a) + 1 :]})
            for a in labels
        },
    )


def _length(label: int) -> float:
    return TYPICAL_SIZE[Label(label)][0]


def _echo(shares: Mapping[int, float]) -> dict[Label, float]:
    return {Label(label): share for label, share in shares.items() if share > 0}


_Places = tuple[IntArray, FloatArray]
"""Frames (R,), places (R,2)."""


def _beyond_chance(found: FloatArray, by_chance: FloatArray, reach: float) -> tuple[float, float]:
    """The share of distances (R,) within reach beyond that of chance, and the standard deviation
    of those about the boxes, m."""
    near, chance = found < reach, by_chance < reach
    share = (near.mean() - chance.mean()) / max(1 - chance.mean(), 1e-9)
    more = max(np.count_nonzero(near) - np.count_nonzero(chance), 1)
    square = np.square(found[near]).sum() - np.square(by_chance[chance]).sum()
    spread = float(np.sqrt(np.clip(square / more / 2, 0.05**2, reach**2)))
    # Two standard errors: less than that may be chance.
    error = np.sqrt((near.mean() + chance.mean()) / len(near))
    return (float(np.clip(share, 0.0, 0.95)) if share > 2 * error else 0.0), spread


def _nearest(boxes: _Places, others: _Places, *, among_them: bool = False) -> FloatArray:
    """Distance (R,) from each box to the nearest other one of its frame, m; `among_them` if the
    boxes are among the others."""
    frame, place = others
    order = np.argsort(frame, kind="stable")
    frame, place = frame[order], place[order]
    low, high = (np.searchsorted(frame, boxes[0], side=side) for side in ("left", "right"))
    nearest = np.full(len(boxes[0]), np.inf)
    for row, (begin, end) in enumerate(zip(low, high, strict=True)):
        apart = np.linalg.norm(place[begin:end] - boxes[1][row], axis=1)
        if among_them:
            apart = np.sort(apart)[1:]
        nearest[row] = min(apart, default=np.inf)
    return nearest


def _false_boxes(evidence: Observations, rows: BoolArray, scale: ScoreScale) -> Mapping[str, Any]:
    falses = evidence.falses
    distance, size = falses.distance[rows], falses.size[rows]
    edges = np.arange(0.0, evidence.fields_of_view[:, 1].max() + BIN_WIDTH, BIN_WIDTH)
    # The area that was looked at, ring by ring, summed over frames.
    half_angle, reach = evidence.fields_of_view.T
    ring = np.square(np.minimum(edges[1:, None], reach)) - np.square(
        np.minimum(edges[:-1, None], reach)
    )
    area = np.maximum((ring * half_angle * evidence.frames).sum(axis=1), 1e-9)
    density = np.histogram(distance, edges)[0] / area
    value = scale.quality(falses.score[rows])
    bins = range_bins(distance)
    mean = np.clip(binned(value, bins), 1e-3, 1 - 1e-3)
    aligned, across, spread = _headings(falses.yaw[rows] + falses.bearing[rows])
    typical = size.mean(axis=0)
    return {
        "range_profile": Curve(
            at=tuple((edges[1:] + edges[:-1]) / 2), value=tuple(density / density.max())
        ),
        "score_mean": Curve(at=tuple(binned(distance, bins)), value=tuple(mean)),
        "score_concentration": concentration_of(value, mean[bins]),
        "typical_size": tuple(typical.tolist()),
        "size_spread": tuple(np.clip(size.std(axis=0) / typical, 0.0, 0.5).tolist()),
        "size_correlation": pair_correlations(size),
        "aligned_share": aligned,
        "across_share": across,
        "aligned_spread": spread,
    }


def _headings(heading: FloatArray) -> tuple[float, float, float]:
    """The shares of headings (R,), relative to the sensor's, that lie along its axis and across it,
    and their spread about them (maximum likelihood by expectation and maximisation; the others are
    uniform)."""
    if len(heading) < FEWEST:
        return 0.0, 0.0, 0.2
    along = np.abs(wrap_angle(2 * heading)) / 2
    aside = np.stack([along, np.pi / 2 - along], axis=1)
    share, spread = np.array([1 / 3, 1 / 3]), 0.2
    for _ in range(200):
        density = share * stats.halfnorm.pdf(aside / spread) / spread
        belongs = density / (density.sum(axis=1) + (1 - share.sum()) * 2 / np.pi)[:, None]
        share = belongs.mean(axis=0)
        mean_square = np.sum(belongs * np.square(aside)) / max(belongs.sum(), 1e-9)
        spread = float(np.clip(np.sqrt(mean_square), _SPREADS[0], _SPREADS[1]))
    return float(share[0]), float(share[1]), spread


def _quality(falses: FalseAlarms, looks: Mapping[int, FalseBoxes], scale: ScoreScale) -> FloatArray:
    """The standard normal quality (R,) behind each score, under what false boxes are like."""
    value, quality = scale.quality(falses.score), np.zeros(len(falses.score))
    for label, look in looks.items():
        rows = falses.label == label
        mean, shapes = look.score_mean(falses.distance[rows]), look.score_concentration
        below = special.betainc(mean * shapes, (1 - mean) * shapes, value[rows])
        quality[rows] = normal(np.clip(below, 1e-6, 1 - 1e-6))
    return quality


def _fit_places(falses: FalseAlarms, quality: FloatArray) -> Mapping[str, Any]:
    """The share of false boxes that stay at a place, how often a place gives a box, how these
    stray about it, and how their quality (R,) differs.

    A box of a place has one near it a frame later with the place's probability, any other box
    hardly ever; given one a frame later, so it has two frames later.  What the qualities of boxes a
    second apart have in common, their place keeps.
    """
    key = falses.recording * 10**7 + falses.frame
    order = np.argsort(key, kind="stable")
    key = key[order]
    position, label = falses.position[order], falses.label[order]

    def nearest_after(lag: int) -> IntArray:
        """The row (R,) of the box of the same label so many frames later that is nearest, -1 where
        none is near."""
        found = np.full(len(key), -1)
        low = np.searchsorted(key, key + lag, side="left")
        high = np.searchsorted(key, key + lag, side="right")
        for row, (begin, end) in enumerate(zip(low, high, strict=True)):
            alike = begin + np.flatnonzero(label[begin:end] == label[row])
            apart = np.linalg.norm(position[alike] - position[row], axis=1)
            if apart.min(initial=np.inf) < _NEAR:
                found[row] = alike[apart.argmin()]
        return found

    after = nearest_after(1)
    once, twice = after >= 0, nearest_after(2) >= 0
    if np.count_nonzero(once) < FEWEST:
        return {}
    detection = float(np.clip(twice[once].mean(), 0.05, 1.0))
    apart = np.square(position[after[once]] - position[once]).sum(axis=1)
    heading = (falses.yaw + falses.bearing + falses.heading)[order]
    turned = np.abs(wrap_angle(2 * (heading[after[once]] - heading[once]))) / 2
    shift = share = 0.0
    quality, later = quality[order], nearest_after(_LATER)
    if np.count_nonzero(later >= 0) >= FEWEST:
        pair = np.stack([quality[later >= 0], quality[later[later >= 0]]])
        shift = float(np.clip(pair.mean(), -2.0, 2.0))
        share = float(np.clip(np.prod(pair - pair.mean(), axis=0).mean() / pair.var(), 0.0, 0.95))
    # Medians, since some boxes are near by chance; of two boxes each strays by itself.
    return {
        "persistent_share": float(np.clip(once.mean() / detection, 0.0, 1.0)),
        "persistent_detection": detection,
        "persistent_noise": float(np.sqrt(np.median(apart) / 2 / stats.chi2.median(2))),
        "persistent_yaw_noise": float(np.median(turned) / np.sqrt(2) / stats.halfnorm.median()),
        "persistent_score_shift": shift,
        "persistent_score_share": share,
    }
