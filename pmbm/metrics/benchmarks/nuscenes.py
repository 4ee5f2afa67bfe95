"""The nuScenes tracking rules: AMOTA and AMOTP (nuscenes-devkit, tracking_nips_2019).

CLEAR MOT by the standard continuing rule over distance in (x, y) < 2 m, at 40 thresholds on a
track's mean score that give recalls from 0.1 to 1.

What differs from the devkit's own evaluation (1.2.0), which runs a generic accumulator anew for
every class and threshold and is slow for it:

- Gaps in tracks and truth are filled in time's order; the devkit weighs the two ends the wrong way
  round, which moves boxes in gaps of two frames and more.  `--rule devkit` does as it does.
- A class without truth has no figures, and a level of recall that is not reached is left out of
  the curves; in AMOTA it counts 0, in AMOTP 2 m, as there.
- Classes stand by themselves: the headline, a mean over the seven, is not printed.
- Distances are exact; the devkit's come by an expansion that is off by up to 1e-6 m, so that a
  pair at 2 m to the last digits may match there and not here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any, Final

import numpy as np

from pmbm.arrays import FloatArray
from pmbm.errors import InputError
from pmbm.metrics.benchmarks.rules import (
    ERRORS,
    ComparedSequence,
    ScoringRule,
    benchmark_evaluation,
    benchmark_metrics,
    or_undefined,
)
from pmbm.metrics.core.clear_matching import Matches, continuing_matches
from pmbm.metrics.core.formulas import NO_TRUTH
from pmbm.metrics.core.gaps import fill_gaps
from pmbm.metrics.core.result import Counts, Evaluation, Joined, Undefined
from pmbm.metrics.core.scene import ScoredScene, make_scene
from pmbm.metrics.families.clear import clear_counts

RECALLS: Final[FloatArray] = np.linspace(0.1, 1.0, 40).round(12)[::-1]
"""Recall levels, the highest first."""
WORST_DISTANCE: Final = 2.0
WORST: Final = {"motar": 0.0, "mota": 0.0, "motp": 2.0, "faf": 500.0, "tid": 20.0, "lgd": 20.0}
"""What the benchmark gives where no recall level is reached."""
SECONDS_PER_FRAME: Final = 0.5


@dataclass(frozen=True, eq=False, kw_only=True)
class NuscenesScores:
    """The scores of one class over all scenes.

    amota : mean of MOTAR over the 40 recall levels, 0 for those not reached.
    amotp : mean of MOTP over them, 2 m for those not reached.
    confidence, motar, motp (40,) : by level, the highest recall first; NaN where not reached.
    best : place of the level with the highest MOTA (the first of equals).
    at_best : the traditional scores there.
    """

    amota: float
    amotp: float
    confidence: FloatArray
    motar: FloatArray
    motp: FloatArray
    best: int
    at_best: dict[str, float | None]


def nuscenes_scores(scenes: Sequence[ScoredScene], gate: float = 2.0) -> NuscenesScores | None:
    """Score one class, or None without truth.

    `scene.tracks.score` holds scores of boxes; a track counts with their mean over its scene.
    """
    scenes = [_without_empty_frames(scene) for scene in scenes]
    truths = sum(len(scene.truth) for scene in scenes)
    if truths == 0:
        return None
    confidence = [_track_scores(scene) for scene in scenes]
    thresholds = _thresholds(scenes, confidence, truths, gate)
    levels: dict[float, dict[str, float]] = {}
    for threshold in np.unique(thresholds[np.isfinite(thresholds)]):
        kept = [
            scene.with_rows(np.ones(len(scene.truth), np.bool_), own >= threshold)
            for scene, own in zip(scenes, confidence, strict=True)
        ]
        levels[float(threshold)] = _at_threshold(kept, gate)
    if not levels:
        return _nothing_reached(scenes, truths, thresholds)
    curves = {
        name: np.array([levels[t][name] if t in levels else np.nan for t in thresholds.tolist()])
        for name in next(iter(levels.values()))
    }
    best = int(np.nanargmax(curves["mota"]))
    return NuscenesScores(
        amota=float(np.nan_to_num(curves["motar"], nan=0.0).mean()),
        amotp=float(np.nan_to_num(curves["motp"], nan=WORST_DISTANCE).mean()),
        confidence=thresholds,
        motar=curves["motar"],
        motp=curves["motp"],
        best=best,
        at_best={name: _number(curve[best]) for name, curve in curves.items()},
    )


def with_track_scores(scene: ScoredScene) -> ScoredScene:
    """Every box of a track with the mean score of its track, before boxes are filled in."""
    return replace(scene, tracks=replace(scene.tracks, score=_track_scores(scene)))


def _track_scores(scene: ScoredScene) -> FloatArray:
    """For each track row the mean score of its track, (K,), to the bit as the devkit rounds it:
    thresholds lie on these very values."""
    score = np.empty(len(scene.tracks))
    order = scene.tracks.by_object
    for rows in np.split(order, np.flatnonzero(np.diff(scene.tracks.index[order])) + 1):
        score[rows] = np.mean(scene.tracks.score[rows]) if len(rows) else 0.0
    return score


def _thresholds(
    scenes: Sequence[ScoredScene], confidence: Sequence[FloatArray], truths: int, gate: float
) -> FloatArray:
    """The confidence at which each recall level is met, (40,), or NaN where it is not reached.

    Recall counts matches that are no identity switch.
    """
    scores = np.concatenate(
        [
            own[matches.track[~matches.switch]]
            for scene, own in zip(scenes, confidence, strict=True)
            for matches in [_matches(scene, gate)]
        ]
    )
    if len(scores) == 0:
        return np.full(len(RECALLS), np.nan)
    recall = np.arange(1, len(scores) + 1) / truths
    thresholds = np.interp(RECALLS, recall, np.sort(scores)[::-1], right=0)
    thresholds[recall.max() < RECALLS] = np.nan
    return thresholds


def _at_threshold(scenes: Sequence[ScoredScene], gate: float) -> dict[str, float]:
    """The traditional scores of these tracks.

    Quirks kept: MOTA and MOTAR are cut at 0; MOTAR's recall leaves identity switches out.
    """
    frames = truths = hits = misses = false = switches = fragments = 0
    tracked = lost = objects_found = 0
    distance = delay = gap = 0.0
    for scene in scenes:
        scene = _without_empty_frames(scene)
        matches = _matches(scene, gate)
        counts = clear_counts(scene, matches)
        frames += counts.frames
        truths += counts.truths
        hits += counts.matches - counts.switches
        misses += counts.misses
        false += counts.false_positives
        switches += counts.switches
        fragments += counts.fragmentations
        tracked += counts.mostly_tracked
        lost += counts.mostly_lost
        distance += counts.distance_sum
        for first, longest in _waits(scene, matches):
            objects_found += 1
            delay += first * SECONDS_PER_FRAME
            gap += longest * SECONDS_PER_FRAME
    errors = misses + switches + false
    recall = hits / truths
    found = hits + switches
    return {
        "gt": truths,
        "tp": hits,
        "fn": misses,
        "fp": false,
        "ids": switches,
        "frag": fragments,
        "mt": tracked,
        "ml": lost,
        "recall": found / truths,
        "mota": max(0.0, 1 - errors / truths),
        "motar": (
            max(0.0, 1 - (errors - (1 - recall) * truths) / (recall * truths))
            if recall
            else float("nan")
        ),
        "motp": distance / found if found else float("nan"),
        "faf": false / frames * 100,
        "tid": delay / objects_found if objects_found else float("nan"),
        "lgd": gap / objects_found if objects_found else float("nan"),
    }


def _waits(scene: ScoredScene, matches: Matches) -> list[tuple[int, int]]:
    """For each object ever matched: frames from its first to its first match, and the longest run
    of frames without a match between its first and last frame."""
    place = scene.truth.index
    matched = [np.zeros(0, np.int64)] * len(scene.truth.ids)
    order = np.lexsort((matches.frame, place[matches.truth]))
    rows = matches.truth[order]
    for part in np.split(rows, np.flatnonzero(np.diff(place[rows])) + 1):
        if len(part):
            matched[place[part[0]]] = scene.truth.frame[part]
    waits = []
    for own, frames in enumerate(matched):
        if len(frames):
            life = scene.truth.frame[place == own]
            gaps = np.diff(np.concatenate([[life[0] - 1], frames, [life[-1] + 1]])) - 1
            waits.append((int(frames[0] - life[0]), int(gaps.max())))
    return waits


def _matches(scene: ScoredScene, gate: float) -> Matches:
    gated = scene.near(gate)
    return continuing_matches(scene, gated, gated.distance)


def _without_empty_frames(scene: ScoredScene) -> ScoredScene:
    """The benchmark numbers only frames in which either side has a box."""
    frames = len(scene)
    used = (scene.truth.count(frames) + scene.tracks.count(frames)) > 0
    number = np.cumsum(used) - 1
    return ScoredScene(
        time=scene.time[used],
        truth=replace(scene.truth, frame=number[scene.truth.frame]),
        tracks=replace(scene.tracks, frame=number[scene.tracks.frame]),
    )


def _nothing_reached(
    scenes: Sequence[ScoredScene], truths: int, thresholds: FloatArray
) -> NuscenesScores:
    levels = len(RECALLS)
    at_best: dict[str, Any] = {
        **WORST,
        "gt": truths,
        "tp": 0,
        "fn": truths,
        "mt": 0,
        "ml": sum(len(scene.truth.ids) for scene in scenes),
        "recall": 0.0,
        # How errors of these kinds would be spread is unknown.
        "fp": None,
        "ids": None,
        "frag": None,
    }
    return NuscenesScores(
        amota=0.0,
        amotp=WORST_DISTANCE,
        confidence=thresholds,
        motar=np.zeros(levels),
        motp=np.full(levels, WORST_DISTANCE),
        best=0,
        at_best=at_best,
    )


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


@dataclass(frozen=True)
class NuscenesFigure:
    """A figure of `nuscenes_scores`, of its averages or at its best threshold."""

    name: str

    def __call__(self, counts: Counts) -> float | Undefined:
        scores = _scores(counts["scenes"], counts["gate"])
        if scores is None:
            return Undefined(NO_TRUTH)
        averaged = self.name not in scores.at_best
        value = getattr(scores, self.name) if averaged else scores.at_best[self.name]
        return or_undefined(value, "no recall level is reached")


@lru_cache(maxsize=1)
def _scores(scenes: Joined, gate: float) -> NuscenesScores | None:
    return nuscenes_scores(scenes.items, gate)


METRICS: Final = benchmark_metrics(
    "nuscenes",
    ("amota", "1", "higher", "MOTAR over recall", NuscenesFigure("amota")),
    ("amotp", "m", "lower", "centre error over recall", NuscenesFigure("amotp")),
    ("motar", "1", "higher", "accuracy at the reached recall", NuscenesFigure("motar")),
    ("mota", "1", "higher", "CLEAR MOT accuracy, cut at 0", NuscenesFigure("mota")),
    ("motp", "m", "lower", "centre error", NuscenesFigure("motp")),
    ("recall", "1", "higher", "share of objects found", NuscenesFigure("recall")),
    ("false_positives", "boxes", "lower", "boxes of nothing", NuscenesFigure("fp")),
    ("misses", "boxes", "lower", "objects not found", NuscenesFigure("fn")),
    ("id_switches", "events", "lower", "changes of identity", NuscenesFigure("ids")),
    ("fragmentations", "events", "lower", "interruptions", NuscenesFigure("frag")),
    ("faf", "1", "lower", "false boxes per 100 frames", NuscenesFigure("faf")),
    ("tid", "s", "lower", "time to the first match", NuscenesFigure("tid")),
    ("lgd", "s", "lower", "longest gap", NuscenesFigure("lgd")),
    ("truths", "boxes", "none", "boxes of truth", NuscenesFigure("gt")),
)


def evaluate_nuscenes(
    scenes: Sequence[ScoredScene], *, gate: float = 2.0, gaps: str = "filled"
) -> Evaluation:
    """nuScenes over scenes of one class.

    gate : centres strictly nearer in (x, y) match, m.
    gaps : where an id is absent between its first and last frame, boxes are "filled" in by
        interpolation on both sides, as the benchmark means it; "devkit" fills them in as its
        program does, the earlier box with the later one's weight; "left" leaves them.
    """
    if gaps not in _GAPS:
        raise InputError(f"no way '{gaps}' with gaps", field="gaps", expected=", ".join(_GAPS))
    filled = tuple(_GAPS[gaps](with_track_scores(scene)) for scene in scenes)
    parameters = {"gate": gate, "gaps": gaps}
    return benchmark_evaluation(METRICS, {"scenes": Joined(filled)}, parameters, len(scenes))


def _left(scene: ScoredScene) -> ScoredScene:
    return scene


_GAPS: Final[Mapping[str, Callable[[ScoredScene], ScoredScene]]] = {
    "filled": fill_gaps,
    "devkit": partial(fill_gaps, reversed_weights=True),
    "left": _left,
}


@dataclass(frozen=True)
class NuscenesScore:
    """The score of one sequence, with one of the ways with gaps."""

    gaps: str

    def __call__(self, sequence: ComparedSequence, kind: str) -> Evaluation:
        return evaluate_nuscenes([make_scene(sequence.truth, sequence.tracks)], gaps=self.gaps)


def _rule(gaps: str, says: str) -> ScoringRule:
    return ScoringRule(NuscenesScore(gaps), f"centres within 2 m seen from above, {says}", _SHOWN)


_SHOWN: Final = {
    "AMOTA": "amota",
    "AMOTP": "amotp",
    "MOTAR": "motar",
    "MOTA": "mota",
    "MOTP": "motp",
    "recall": "recall",
    **ERRORS,
    "FAF": "faf",
    "TID": "tid",
    "LGD": "lgd",
    "GT": "truths",
}

RULES: Final = {
    "nuscenes": _rule("filled", "gaps filled in"),
    "devkit": _rule("devkit", "gaps filled in with the devkit's reversed weights"),
}
