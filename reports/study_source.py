"""A stored study as a report: its results, its failures, its worst trials played again."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice, zip_longest
from pathlib import Path
from typing import Any

from pmbm.errors import InputError
from pmbm.reports.replays import at_event, trial_replay
from pmbm.reports.study_report import leading_metric
from pmbm.reports.tables import shown_metric
from pmbm.reports.values import CellResults, Failure, StudyReport, WorstTrial
from pmbm.study import ConfiguredTracker, Source, StudyResults, TrialResult, load_results

Resolve = Callable[[str, Mapping[str, Any]], Source]

_TRACKER = "tracker."


@dataclass(frozen=True)
class _Candidate:
    cell: int
    trial: TrialResult
    value: float


def stored_report(
    store: Path,
    resolve: Resolve,
    *,
    study: Path | None = None,
    worst: int = 3,
    reference: str | None = None,
) -> StudyReport:
    """The report of a store, also while the study still runs.

    resolve : turns the names of scenarios, with their swept values, into Sources.
    study : the study's file; by default of the store's name, beside it.
    worst : how many of the worst trials to play again.
    reference : the tracker that the others are compared with; by default the first.

    A trial is played again only where its recording has the digest that was stored; the code or
    the machine may have changed since.  Raises InputError where the store is none or damaged.
    """
    results = load_results(store)
    if reference is not None and reference not in results.trackers:
        raise InputError(
            f"no tracker '{reference}' in this study",
            field="reference",
            expected=f"one of {', '.join(results.trackers)}",
        )
    study = study or store.with_suffix(".toml")
    file = str(study)
    sources = _Sources(results, resolve, study.parent)
    report = StudyReport(
        name=results.name,
        cells=[
            CellResults(
                scenario=cell["scenario"],
                point=cell["point"],
                results=results.trials.get(number, ()),
                stresses=sources.stresses(number),
            )
            for number, cell in enumerate(results.document["cells"])
        ],
        planned=results.total,
        commands={
            "Run it, or resume it": shlex.join(["pmbm", "study", file, "--store", str(store)]),
            "The digest of the results": shlex.join(["pmbm", "digest", str(store)]),
            "This report": shlex.join(["pmbm", "report", str(store)]),
        },
        failures=[*_failures(results, file), *_damaged(results, file)],
        provenance={
            **results.provenance,
            "seed": results.seed,
            "study hash": results.hash,
            "digest of the results": results.digest or "none: rows are damaged",
        },
        reference=reference or results.trackers[0],
    )
    tracker = report.reference or results.trackers[0]
    chosen = worst_trials(results, tracker, worst)
    return replace(report, worst=[_played(results, sources, file, one, tracker) for one in chosen])


def worst_trials(results: StudyResults, tracker: str, count: int) -> list[_Candidate]:
    """The trials where the tracker's leading metric is worst: the worst of each scenario, then
    the second of each, until there are `count`; the worst first."""
    summaries = [s for number in results.trials if (s := results.summary(number))]
    metric = leading_metric(summaries)
    sign = shown_metric(metric).sign or -1
    by_scenario: dict[str, list[_Candidate]] = {}
    for number, trials in results.trials.items():
        for trial in trials:
            value = trial.scores[tracker].get(metric)
            if value is not None:
                candidate = _Candidate(number, trial, value)
                by_scenario.setdefault(trial.source, []).append(candidate)
    ranked = [sorted(found, key=lambda c: sign * c.value) for found in by_scenario.values()]
    rounds = (candidate for row in zip_longest(*ranked) for candidate in row if candidate)
    return sorted(islice(rounds, count), key=lambda c: sign * c.value)


class _Sources:
    """The study's scenarios, found again by name, or None where they are gone."""

    def __init__(self, results: StudyResults, resolve: Resolve, folder: Path) -> None:
        self._cells = results.document["cells"]
        self._resolve = resolve
        self._folder = folder

    def __getitem__(self, number: int) -> Source:
        cell = self._cells[number]
        name = cell["scenario"]
        if name.endswith(".toml"):
            name = str(self._folder / name)
        point = {k: v for k, v in cell["point"].items() if not k.startswith(_TRACKER)}
        return self._resolve(name, point)

    def stresses(self, number: int) -> str:
        try:
            return str(getattr(self[number], "stresses", ""))
        except InputError:
            return ""


def _played(
    results: StudyResults, sources: _Sources, file: str, one: _Candidate, tracker: str
) -> WorstTrial:
    cells = results.document["cells"]
    index = one.trial.trial * len(cells) + one.cell
    summary = results.summary(one.cell)
    assert summary is not None
    metric = shown_metric(leading_metric([summary]))
    label = results.cells["label"][one.cell]
    value = f"{metric.name} of {tracker} {one.value:.3g} {metric.unit}".strip()
    why = f"{label}, trial {one.trial.trial}: {value}"
    command = shlex.join(["pmbm", "study", file, "--replay", str(index)])
    trackers = {
        t["name"]: ConfiguredTracker(t["factory"], tuple(sorted(t["parameters"].items())))
        for t in cells[one.cell]["trackers"]
    }
    try:
        replay, again = trial_replay(sources[one.cell], trackers, results.seed, one.trial.trial)
    except InputError as error:
        return WorstTrial(why=f"{why}. It cannot be played again: {error}", command=command)
    if again.recording != one.trial.recording:
        return WorstTrial(
            why=f"{why}. It is not played here: this machine or version records other traffic",
            command=command,
        )
    return WorstTrial(why=why, command=command, replay=at_event(replay, metric.key))


def _failures(results: StudyResults, file: str) -> list[Failure]:
    labels = results.cells["label"].tolist()
    return [
        Failure(
            trial=f"{labels[row['cell']]}, trial {row['trial']}",
            what=": ".join(str(part) for part in (row["outcome"], row["error"]) if part),
            command=shlex.join(["pmbm", "study", file, "--replay", str(row["index"])]),
        )
        for row in results.failures.to_dict("records")
    ]


def _damaged(results: StudyResults, file: str) -> list[Failure]:
    return [
        Failure(
            trial=f"index {index}",
            what="damaged in the store; run the study again to compute it anew",
            command=shlex.join(["pmbm", "study", file]),
        )
        for index in results.damaged
    ]
