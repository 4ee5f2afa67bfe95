"""`pmbm compare`: several trackers over a dataset's sequences, and who is better by how much."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import dataset_options, options
from pmbm.cli.many import ManyValues

if TYPE_CHECKING:
    from pmbm.cli.left_out import Trackers
    from pmbm.datasets import Dataset
    from pmbm.metrics import Evaluation
    from pmbm.metrics.benchmarks.rules import ScoringRule
    from pmbm.study import ConfiguredTracker, Difference

WITHOUT_POSES = ", no poses"
Runs = dict[str, dict[str, "list[Evaluation]"]]
"""Class -> tracker -> what every sequence scored."""
Entries = dict[str, "Mapping[str, Trackers]"]
"""Tracker -> sequence -> the tracker of each class."""


@click.command(cls=ManyValues)
@dataset_options.detected("The dataset's folder, with its truth.", "As for pmbm track.")
@click.option(
    "--trackers",
    multiple=True,
    metavar="NAME...",
    help="The first is compared with each; clairvoyant knows the truth, and bounds them.  "
    "[default: pmbm argoverse waymo probabilistic_kf clairvoyant]",
)
@click.option(
    "--published",
    is_flag=True,
    help="Trackers at their own defaults, not with what ships for them on this dataset.",
)
@click.option(
    "--fit",
    "fit_in",
    type=click.IntRange(min=2),
    metavar="FOLDS",
    help="Fit the trackers to these detections, as pmbm fit-tracker does: the sequences are in "
    "so many parts, and each is tracked by fits to the others.",
)
@dataset_options.beside
@click.option(
    "--ego-motion", is_flag=True, help="Also each tracker without the poses: what they are worth."
)
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME...",
    help="Of the rule's, to compare by.  [default: its first]",
)
@dataset_options.rule
@options.figures
@click.option("--markdown", metavar="FILE|-", help="Write the tables as Markdown.")
@dataset_options.jobs
def command(
    dataset_name: str,
    root: Path,
    detections: str,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    trackers: tuple[str, ...],
    published: bool,
    fit_in: int | None,
    beside: tuple[str, ...],
    ego_motion: bool,
    metrics: tuple[str, ...],
    rule: str | None,
    json_file: str | None,
    markdown: str | None,
    jobs: int,
) -> None:
    """Run trackers over DATASET frame by frame, score them by its own rules, and compare the first
    with each other one, class by class: paired differences, their 95 % intervals by a jackknife
    over sequences, of five at least.  Labels are read for scoring, for --fit, and by the
    clairvoyant.

    \b
    Example:
      pmbm compare kitti --root kitti --detections 'kitti/detections/pointrcnn_{class}' \\
        --poses kitti/pose --sequences 0006 0008 --trackers pmbm argoverse clairvoyant
    """
    from pmbm.cli.dataset_scores import rule_of
    from pmbm.cli.evaluate import write_json
    from pmbm.datasets import chosen_sequences, open_dataset
    from pmbm.durable import replace_text
    from pmbm.errors import InputError, nearest_hint

    dataset, *others = (
        open_dataset(dataset_name, root=root, detections=one, classes=classes or None, poses=poses)
        for one in (detections, *beside)
    )
    by = rule_of(dataset, rule)
    metrics = metrics or (next(iter(by.shown)),)
    for metric in metrics:
        if metric not in by.shown:
            hint = nearest_hint(metric, by.shown, "metric")
            raise InputError(f"the rule has no '{metric}'", field="--metric", hint=hint)
    if fit_in and published:
        raise InputError("what is fitted is not as published", field="--fit")
    if beside and not fit_in:
        raise InputError("what is fitted is held to other detectors", field="--beside")
    if ego_motion and poses is None:
        raise InputError("without poses there is nothing to leave out", field="--poses")
    names = chosen_sequences(dataset, sequences)
    chosen = list(dict.fromkeys(trackers)) or list(_DEFAULT)

    def runs_on(seen: Dataset) -> Runs:
        return _run(
            seen, names, _entries(seen, names, chosen, published, fit_in, others), rule, jobs
        )

    runs = runs_on(dataset)
    if ego_motion:
        standing = open_dataset(
            dataset_name, root=root, detections=detections, classes=classes or None
        )
        for kind, found in runs_on(standing).items():
            runs[kind] |= {f"{name}{WITHOUT_POSES}": each for name, each in found.items()}
    tables = [_table(kind, found, by, metrics) for kind, found in runs.items()]
    title = f"{dataset_name}: {by.says}, online, sequences {' '.join(names)}"
    if fit_in:
        title += f", in {fit_in} folds, each tracked by fits to the others"
    if json_file is not None:
        figures = {one.kind: one.figures() for one in tables}
        write_json(json_file, {"dataset": dataset_name, "rule": by.says, "compared": figures})
    text = _markdown(title, tables, metrics)
    if markdown not in (None, "-"):
        replace_text(Path(str(markdown)), text)
    if json_file != "-":
        click.echo(text, nl=False)


@dataclass(frozen=True)
class _Table:
    """One class: every tracker's scores, why some of these are undefined, and by each metric the
    first less each other one, or of one without poses, itself with them less that."""

    kind: str
    scores: Mapping[str, Mapping[str, float | None]]
    reasons: Mapping[str, Mapping[str, str]]
    differences: Mapping[str, Mapping[str, Difference]]

    def figures(self) -> dict[str, Any]:
        compared = {
            name: {
                metric: {
                    "difference": one.value,
                    "low": one.low,
                    "high": one.high,
                    "reason": one.reason,
                }
                for metric, one in found.items()
            }
            for name, found in self.differences.items()
        }
        return {
            "scores": dict(self.scores),
            "reasons": {name: dict(found) for name, found in self.reasons.items()},
            "less it": compared,
        }


_DEFAULT = ("pmbm", "argoverse", "waymo", "probabilistic_kf", "clairvoyant")


def _entries(
    dataset: Dataset,
    names: Sequence[str],
    trackers: Sequence[str],
    published: bool,
    fit_in: int | None,
    others: Sequence[Dataset],
) -> Entries:
    """Every tracker for every sequence and class; with `fit_in`, bounds apart, fitted to the
    others of so many folds, and held to the detections of `others`."""
    from pmbm.cli.fit_tracker import fits_of
    from pmbm.cli.left_out import fitted_to_others
    from pmbm.tracking import SHIPPED_BOUNDS

    entries: Entries = {}
    for tracker in trackers:
        if fit_in and tracker not in SHIPPED_BOUNDS:
            fits = fits_of(dataset, names, tracker, None, fit_in, others)
            entries[tracker] = dict(fitted_to_others(fits, fit_in))
        else:
            entries[tracker] = dict.fromkeys(names, _configured(dataset, tracker, published))
    return entries


def _configured(dataset: Dataset, tracker: str, published: bool) -> Trackers:
    """A tracker for every class; a bound has the model of what ships for our own tracker."""
    from pmbm.cli.track import class_trackers, preset
    from pmbm.errors import InputError
    from pmbm.filter import ConstantVelocity, PMBMTracker
    from pmbm.study import ConfiguredTracker
    from pmbm.tracking import SHIPPED_BOUNDS
    from pmbm.types import Site

    def shipped(name: str) -> Trackers:
        return class_trackers(dataset, name, None if published else preset(dataset.name, name))

    def bound(like: ConfiguredTracker) -> ConfiguredTracker:
        made = like(Site())
        assert isinstance(made, PMBMTracker)
        motion = made.config.motion
        if not isinstance(motion, ConstantVelocity):
            raise InputError(
                f"the bound '{tracker}' moves with constant velocity", got=type(motion).__name__
            )
        model = {
            "acceleration_density": motion.acceleration_density,
            "position_sd": made.config.sensor.position_sd,
        }
        return ConfiguredTracker(tracker, tuple(model.items()))

    if tracker not in SHIPPED_BOUNDS:
        return shipped(tracker)
    return {label: bound(like) for label, like in shipped("pmbm").items()}


def _run(
    dataset: Dataset,
    names: Sequence[str],
    entries: Entries,
    rule: str | None,
    jobs: int,
) -> Runs:
    from pmbm.cli.dataset_scores import score_run
    from pmbm.cli.progress import spread

    keys = [(tracker, name) for tracker in entries for name in names]
    tasks = [(dataset, name, entries[tracker][name], rule) for tracker, name in keys]
    scored = dict(zip(keys, spread(score_run, tasks, jobs, "runs"), strict=True))
    return {
        kind: {tracker: [scored[tracker, name][kind] for name in names] for tracker in entries}
        for kind in dataset.classes
    }


def _table(
    kind: str,
    runs: Mapping[str, list[Evaluation]],
    by: ScoringRule,
    metrics: Sequence[str],
) -> _Table:
    from pmbm.study import jackknife_difference

    first, *others = runs

    def against(other: str) -> list[Evaluation]:
        return runs[other.removesuffix(WITHOUT_POSES) if other.endswith(WITHOUT_POSES) else first]

    return _Table(
        kind=kind,
        scores={tracker: by.figures(found) for tracker, found in runs.items()},
        reasons={tracker: by.reasons(found) for tracker, found in runs.items()},
        differences={
            other: {
                metric: jackknife_difference(against(other), runs[other], by.shown[metric])
                for metric in metrics
            }
            for other in others
        },
    )


def _markdown(title: str, tables: Sequence[_Table], metrics: Sequence[str]) -> str:
    from pmbm.cli.evaluate import undefined_lines
    from pmbm.reports.tables import markdown_table, plain_markdown

    first = next(iter(tables[0].scores))
    bare = any(name.endswith(WITHOUT_POSES) for name in tables[0].scores)
    lines = [
        f"{title}. Last, {' and '.join(metrics)} of {first} less that of the row, 95 % intervals "
        "by a jackknife over the sequences, which falls short where a few of them are far from the "
        "others (docs/guide/intervals.md)"
        + (f"; for a row '{WITHOUT_POSES[2:]}', of the same tracker with them." if bare else "."),
    ]
    for table in tables:
        columns = list(next(iter(table.scores.values())))
        rows = [
            [
                name,
                *(_cell(scores[key]) for key in columns),
                *(_words(table.differences.get(name, {}).get(metric)) for metric in metrics),
            ]
            for name, scores in table.scores.items()
        ]
        header = [table.kind, *columns, *(f"{metric} of {first} less it" for metric in metrics)]
        lines += ["", markdown_table(header, rows, 1)]
        for name, reasons in table.reasons.items():
            for why in undefined_lines(reasons):
                lines += ["", f"{plain_markdown(name)}: {why}"]
    return "\n".join(lines) + "\n"


def _words(one: Difference | None) -> str:
    if one is None:
        return ""
    if one.value is None:
        return "undefined"
    ends = f"[{one.low:+z.4f}, {one.high:+z.4f}]" if one.reason is None else f"({one.reason})"
    return f"{one.value:+z.4f} {ends}"


def _cell(value: float | None) -> str:
    if value is None:
        return "–"
    return str(value) if isinstance(value, int) else f"{value:z.4f}"
