"""Occlusion: what becomes of tracks while their objects are hidden.

Objects and tracks are matched by the standard CLEAR rule.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.metrics.core.clear_matching import Matches
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import Described, Mean, Totals
from pmbm.metrics.core.result import Counts, Metric, Samples, Undefined
from pmbm.metrics.core.scene import ScoredScene


@dataclass(frozen=True, eq=False, kw_only=True)
class OcclusionMeasures:
    """The fates of tracks while their objects were hidden.

    kept, lost : occlusions after which the object's first match had, or had not (or never came),
        the id of its last match before.
    untracked : occlusions of objects never matched before: there was no id to keep.
    coasting_error : distance of the reported track of that id to the hidden object in (x, y), m,
        one per hidden frame in which it is reported.
    hidden : hidden frames of objects that had an id to keep.
    """

    kept: int
    lost: int
    untracked: int
    coasting_error: FloatArray
    hidden: int


@dataclass(frozen=True, slots=True)
class Occlusion:
    """A spell during which one object is out of sight.

    rows : of the scene's truth, one per hidden frame.
    begin, end : time of its last row in sight before, and of its first one after, s.
    before, after : index of the track that last matched it before, and first after; None: none did.
    """

    rows: IntArray
    begin: float
    end: float
    before: int | None
    after: int | None

    @property
    def kept(self) -> bool:
        """Whether it came back under its old id."""
        return self.before is not None and self.after == self.before


def occlusions(scene: ScoredScene, matches: Matches, frames: int = 5) -> Iterator[Occlusion]:
    """Every object's spells of at least `frames` consecutive unobservable rows between two
    observable ones, object by object."""
    truth = scene.truth
    track_of_row = np.full(len(truth), -1)
    track_of_row[matches.truth] = scene.tracks.index[matches.track]
    order = truth.by_object
    for rows in np.split(order, np.flatnonzero(np.diff(truth.index[order])) + 1):
        for begin, end in _hidden_spells(truth.observable[rows], frames):
            before, after = track_of_row[rows[:begin]], track_of_row[rows[end:]]
            before, after = before[before >= 0], after[after >= 0]
            yield Occlusion(
                rows=rows[begin:end],
                begin=float(scene.time[truth.frame[rows[begin - 1]]]),
                end=float(scene.time[truth.frame[rows[end]]]),
                before=int(before[-1]) if len(before) else None,
                after=int(after[0]) if len(after) else None,
            )


def occlusion_measures(scene: ScoredScene, matches: Matches, frames: int = 5) -> OcclusionMeasures:
    """Follow every object through each of its `occlusions`."""
    truth, tracks = scene.truth, scene.tracks
    row_of_report = {
        (int(frame), int(index)): row
        for row, (frame, index) in enumerate(zip(tracks.frame, tracks.index, strict=True))
    }
    kept = lost = untracked = hidden = 0
    errors: list[float] = []
    for spell in occlusions(scene, matches, frames):
        if spell.before is None:
            untracked += 1
            continue
        kept, lost = kept + spell.kept, lost + (not spell.kept)
        hidden += len(spell.rows)
        for row in spell.rows:
            report = row_of_report.get((int(truth.frame[row]), spell.before))
            if report is not None:
                offset = tracks.position[report, :2] - truth.position[row, :2]
                errors.append(float(np.hypot(*offset)))
    return OcclusionMeasures(
        kept=kept,
        lost=lost,
        untracked=untracked,
        coasting_error=np.array(errors),
        hidden=hidden,
    )


def _hidden_spells(observable: BoolArray, frames: int) -> list[tuple[int, int]]:
    """[begin, end) of runs of at least `frames` False between True values."""
    seen = np.flatnonzero(observable)
    gaps = np.flatnonzero(np.diff(seen) > frames)
    return [(int(seen[gap]) + 1, int(seen[gap + 1])) for gap in gaps]


@dataclass(frozen=True)
class KeptShare:
    """kept / (kept + lost)."""

    def __call__(self, counts: Counts) -> float | Undefined:
        spells = counts["kept"] + counts["lost"]
        return counts["kept"] / spells if spells else Undefined("no tracked object was hidden")


def _count(work: Work) -> Tally:
    p = work.parameters
    result = occlusion_measures(work.scene, work.matches, p.occlusion_frames)
    return Tally.of(
        {**vars(result), "coasting_error": Samples(result.coasting_error)},
        gate=p.gate,
        occlusion_frames=p.occlusion_frames,
    )


FAMILY: Final = Family(
    name="occlusion",
    rule="spells of at least `occlusion_frames` unobservable frames, by the pairs that "
    "CLEAR MOT matches",
    count=_count,
    follows_objects=True,
    metrics=(
        share(
            name="id_kept",
            question="In what share of occlusions does the object come back under its old id?",
            formula=KeptShare(),
            parts=Totals(("kept", "lost", "untracked")),
        ),
        Metric(
            name="coasting_error",
            unit="m",
            direction="lower",
            question="How far from the hidden object is its track?",
            formula=Mean("coasting_error", "no track is reported for a hidden object"),
            parts=Described("coasting_error", ("hidden",)),
        ),
    ),
)
