"""Values that a report shows: sections of results, and trials to replay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

from pmbm.errors import InputError
from pmbm.types import FloatArray, Recording, TrackSequence

if TYPE_CHECKING:
    from pmbm.study import Summary, TrialResult


@dataclass(frozen=True, eq=False, kw_only=True)
class ReplayPage:
    """The frames of one trial to look at.

    recording : what happened and what the detector said of it.
    tracks : tracker -> what it said; the order is the order on the page.
    series : tracker -> metric -> value of each step (S,), NaN where undefined.  `gospa`,
        `gospa_localisation`, `gospa_missed` and `gospa_false` are drawn where they are given,
        over observable objects where the same name with "_observable" at its end is given too.
    maps : tracker -> reports whose `undetected` is shown in place of its own: what it expects where
        it cannot see, kept in more detail.
    title : which trial this is, for people.
    start : truth frame that is shown first.
    """

    recording: Recording
    tracks: Mapping[str, TrackSequence]
    series: Mapping[str, Mapping[str, FloatArray]] = field(default_factory=dict)
    maps: Mapping[str, TrackSequence] = field(default_factory=dict)
    title: str = ""
    start: int = 0

    def __post_init__(self) -> None:
        if not len(self.recording):
            raise InputError(f"recording '{self.recording.name}' has no frames to replay")
        for tracker, metrics in self.series.items():
            steps = len(self.tracks[tracker]) if tracker in self.tracks else None
            for metric, values in metrics.items():
                if steps is None or len(values) != steps:
                    raise InputError(
                        f"replay of '{self.recording.name}': a series has one value per step",
                        field=f"series['{tracker}']['{metric}']",
                        expected=steps if steps is not None else f"one of {list(self.tracks)}",
                        got=len(values),
                    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Section:
    """The results of one scenario.

    name : of the scenario.
    stresses : one sentence, what it is hard for.
    summary : means with intervals per tracker and metric, and paired differences.
    replay : one trial to look at, or None.
    provenance : what is needed to make the results again.
    problems : what went wrong, a line each.
    """

    name: str
    stresses: str
    summary: Summary
    replay: ReplayPage | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    problems: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False, kw_only=True)
class CellResults:
    """One configuration of a study and what its trials gave.

    scenario : its name.
    stresses : one sentence, what it is hard for, or "".
    point : swept parameter -> value here; empty where nothing is swept.
    results : the trials that gave one.
    """

    scenario: str
    point: Mapping[str, Any]
    results: Sequence[TrialResult]
    stresses: str = ""

    @property
    def label(self) -> str:
        """The point in words; the scenario's name where nothing is swept."""
        settings = ", ".join(f"{key} = {_short(value)}" for key, value in self.point.items())
        return settings or self.scenario


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A trial that gave no result: which, what happened, and the command that replays it."""

    trial: str
    what: str
    command: str


@dataclass(frozen=True, eq=False, kw_only=True)
class WorstTrial:
    """A trial to look at: why it was chosen, how to see it again, and its replay where it could
    be made again."""

    why: str
    command: str
    replay: ReplayPage | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class StudyReport:
    """A study as a report shows it.

    name : of the study.
    cells : its configurations, in order.
    planned : trials that the study is to have, over all cells.
    commands : what -> the command that does it (repeat, digest, report).
    failures, worst : see there.
    provenance : what is needed to make the results again.
    reference : the tracker that the others are compared with; by default the first.
    """

    name: str
    cells: Sequence[CellResults]
    planned: int
    commands: Mapping[str, str] = field(default_factory=dict)
    failures: Sequence[Failure] = ()
    worst: Sequence[WorstTrial] = ()
    provenance: Mapping[str, Any] = field(default_factory=dict)
    reference: str | None = None

    @cached_property
    def summaries(self) -> tuple[Summary | None, ...]:
        """Of each cell, or None where it has no results yet."""
        from pmbm.study import summarise

        return tuple(
            summarise(cell.results, self.reference) if cell.results else None for cell in self.cells
        )

    @property
    def scenarios(self) -> dict[str, list[tuple[CellResults, Summary]]]:
        """Name -> its cells that have results, in order."""
        found: dict[str, list[tuple[CellResults, Summary]]] = {}
        for cell, summary in zip(self.cells, self.summaries, strict=True):
            if summary is not None:
                found.setdefault(cell.scenario, []).append((cell, summary))
        return found

    @property
    def done(self) -> int:
        return sum(len(cell.results) for cell in self.cells)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
