"""`pmbm fit-tracker`: a preset for a detector of one's own, and what it is worth elsewhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import dataset_options, options
from pmbm.cli.dataset_options import FILE, FOLDER
from pmbm.cli.many import ManyValues

if TYPE_CHECKING:
    from pmbm.arrays import BoolArray
    from pmbm.cli.left_out import Fits, LeftOut, Tables
    from pmbm.datasets import Dataset
    from pmbm.filter.models.score_record import ScoreRecord
    from pmbm.fitting.score_record import ModeRows, Scale
    from pmbm.types import Label, Recording

OURS = "pmbm"
ANY = "any"
"""The preset that is of no detector: what is known before one's own is fitted."""


@click.command(cls=ManyValues)
@dataset_options.detected(
    "The dataset's folder, with its labels.",
    "Detections with raw scores; {class} stands for the class's name where each class has its own.",
    kind=FOLDER,
)
@click.option(
    "--tracker",
    "tracker_name",
    default=OURS,
    show_default=True,
    metavar="NAME",
    help="Or a baseline: argoverse, waymo, probabilistic_kf.",
)
@click.option(
    "--config",
    type=FILE,
    metavar="FILE.toml",
    help="The tracker's other parameters.  [default: what ships for the PMBM tracker on this "
    "dataset; a baseline's own]",
)
@dataset_options.beside
@click.option(
    "--unlabelled",
    is_flag=True,
    help="Fit no weights: they stay those of --beside or --config, on the scale of these scores, "
    "which is found without labels.",
)
@click.option(
    "--folds",
    type=click.IntRange(min=0),
    default=8,
    show_default=True,
    help="Into how many parts the sequences are divided, each tracked by a fit to the others; 0, "
    "what the fit is worth is not told.",
)
@options.mode
@click.option("--out", type=FILE, required=True, metavar="FILE.toml", help="The preset.")
@click.option("--markdown", type=FILE, metavar="FILE.md", help="What was printed, as a page.")
def command(
    dataset_name: str,
    root: Path,
    detections: str,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    tracker_name: str,
    config: Path | None,
    beside: tuple[str, ...],
    unlabelled: bool,
    folds: int,
    mode: str,
    out: Path,
    markdown: Path | None,
) -> None:
    """Fit a tracker to a detector on DATASET, from its detections and labels: of the PMBM tracker,
    which sources of detections are objects; of a baseline, its thresholds, and noise where it knows
    of noise, for the best MOTA.  Writes a preset for `pmbm track --config`, and tells what it is
    worth on sequences that it was not fitted to: each is tracked by a fit to others.

    \b
    Example:
      pmbm fit-tracker kitti --root kitti --detections 'mine/{class}' --poses kitti/pose \\
        --out mine.toml
    """
    from pmbm.cli.detector import Detector
    from pmbm.cli.left_out import left_out
    from pmbm.datasets import chosen_sequences, class_of_label, open_dataset
    from pmbm.durable import replace_text
    from pmbm.errors import InputError
    from pmbm.sim.toml_tables import toml_text

    dataset, *others = (
        open_dataset(dataset_name, root=root, detections=one, poses=poses, classes=classes or None)
        for one in (detections, *beside)
    )
    if tracker_name != OURS:
        for option, asked in (
            *(("--unlabelled", unlabelled), ("--beside", bool(beside))),
            ("--mode batch", mode == "batch"),
        ):
            if asked:
                raise InputError(f"{option} is of the tracker '{OURS}'", field="--tracker")
    names = chosen_sequences(dataset, sequences)
    study: Fits
    if unlabelled:
        study = RecordFits.of(
            dataset, names, parameters(dataset, OURS, config), others, labelled=False
        )
    else:
        study = fits_of(dataset, names, tracker_name, config, folds, others)
    how = "scores' scale by" if unlabelled else "fitted by"
    options = "--unlabelled " if unlabelled else ""
    options += "".join(f"--beside '{one}' " for one in beside)
    options += "" if tracker_name == OURS else f"--tracker {tracker_name} "
    note = (
        f"# The tracker {tracker_name}'s parameters for one detector, a table for each class; "
        f"{how}\n#   pmbm fit-tracker {dataset_name} {options}--sequences {' '.join(names)}\n"
    )
    told = {
        kind: Detector.of(list(study.recordings.values()), label).table()
        for label, kind in class_of_label(dataset).items()
    }
    replace_text(out, note + toml_text({**factored(study.fitted(names)), "detector": told}))
    if folds and (beside or not unlabelled):
        worth = left_out(study, folds, mode)
        title = f"{dataset_name}, {tracker_name} {mode}, {len(names)} sequences in {folds} folds"
        text = report(worth, title)
        click.echo(text, nl=False)
        if markdown is not None:
            replace_text(markdown, text)
    click.echo(out)


def fits_of(
    dataset: Dataset,
    names: Sequence[str],
    tracker: str,
    config: Path | None,
    folds: int,
    others: Sequence[Dataset] = (),
) -> Fits:
    """A tracker and these sequences to fit it to, in so many folds.

    others : the same data with the detections of other detectors.

    Raises InputError for a tracker of which nothing is fitted.
    """
    from pmbm.cli import warn
    from pmbm.cli.fit_baseline import BaselineFits
    from pmbm.cli.track import preset
    from pmbm.errors import InputError
    from pmbm.fitting.baselines import FITTED

    if tracker not in (OURS, *FITTED):
        raise InputError(
            f"nothing of the tracker '{tracker}' is fitted",
            field="--tracker",
            expected=", ".join((OURS, *FITTED)),
        )
    given = parameters(dataset, tracker, config)
    if tracker == OURS:
        if folds and not others and config is None and preset(dataset.name, OURS, ANY):
            warn(
                f"the fit starts from weights that ship, fitted to the public sequences of "
                f"{dataset.name}: figures for these are honest with --beside only"
            )
        return RecordFits.of(dataset, names, given, others, labelled=True)
    return BaselineFits.of(dataset, names, tracker, given, folds)


def parameters(dataset: Dataset, tracker: str, config: Path | None) -> Tables:
    """Of each class what is not fitted: that of a file, of the PMBM tracker what ships for the
    dataset, of a baseline its own."""
    from pmbm.cli.track import class_trackers, preset
    from pmbm.datasets import class_of_label
    from pmbm.study.configured import nested

    shipped = None
    if tracker == OURS:
        shipped = preset(dataset.name, OURS, ANY) or preset(dataset.name, OURS)
    trackers = class_trackers(dataset, tracker, config or shipped)
    return {
        kind: nested(dict(trackers[label].parameters))
        for label, kind in class_of_label(dataset).items()
    }


@dataclass(frozen=True)
class RecordFits:
    """The PMBM tracker and sequences to fit its score records to, with what is worked out once.

    found : of each class and sequence, the rows that the tracker may report; none without labels.
    beside : the same of other detectors.
    """

    dataset: Dataset
    recordings: Mapping[str, Recording]
    given: Tables
    scale: Scale
    found: Mapping[tuple[str, str], ModeRows]
    beside: Sequence[Mapping[tuple[str, str], ModeRows]] = ()

    @property
    def tracker(self) -> str:
        return OURS

    @staticmethod
    def of(
        dataset: Dataset,
        names: Sequence[str],
        given: Tables,
        others: Sequence[Dataset] = (),
        *,
        labelled: bool,
    ) -> RecordFits:
        truth = labelled or bool(others)
        recordings = {name: dataset.recording(name, truth=truth) for name in names}
        scale, found = _found(dataset, recordings, given, labelled=labelled)
        return RecordFits(
            dataset,
            recordings,
            given,
            scale,
            found,
            [
                _found(
                    other,
                    {name: other.recording(name, truth=True) for name in names},
                    given,
                    labelled=True,
                )[1]
                for other in others
            ],
        )

    def fitted(self, names: Sequence[str]) -> Tables:
        """Each class's parameters, fitted to these sequences."""
        from pmbm.fitting.score_record import ModeRows, fit_records

        before = self.known_before(names)
        if self.found:
            whole = {
                label: ModeRows.joined([self.found[kind, name] for name in names])
                for label, kind in self._kinds().items()
            }
            records = fit_records(whole, self.scale, before, sequences=len(names))
        else:
            records = before
        return {
            kind: {**self.given[kind], "scores": as_table(records[label])}
            for label, kind in self._kinds().items()
        }

    def known_before(self, names: Sequence[str]) -> dict[Label, ScoreRecord]:
        """The records that others' detections of these sequences give, or those that are given, of
        the labels that have one.

        Raises InputError where nothing is to be fitted, and one is missing.
        """
        from dataclasses import replace

        from pmbm.errors import InputError
        from pmbm.filter.models.score_record import ScoreRecord
        from pmbm.fitting.score_record import ModeRows, pooled_records

        if self.beside:
            parts = {
                label: [ModeRows.joined([one[kind, name] for name in names]) for one in self.beside]
                for label, kind in self._kinds().items()
            }
            return pooled_records(parts, self.scale)
        found = {}
        for label, kind in self._kinds().items():
            scores = _config(self.given[kind]).scores
            if isinstance(scores, ScoreRecord):
                middle, spread = self.scale
                found[label] = replace(scores, middle=middle, spread=spread)
            elif not self.found:
                raise InputError(
                    "only a score record can be put on another scale",
                    field=f"{kind}.scores.kind",
                    expected="record",
                    got=self.given[kind].get("scores", {}).get("kind"),
                )
        return found

    def _kinds(self) -> dict[Label, str]:
        from pmbm.datasets import class_of_label

        return class_of_label(self.dataset)


def _found(
    dataset: Dataset, recordings: Mapping[str, Recording], given: Tables, *, labelled: bool
) -> tuple[Scale, dict[tuple[str, str], ModeRows]]:
    """The scale of a detector's scores and, where there are labels, the rows of each class and
    sequence."""
    from pmbm.datasets import class_of_label
    from pmbm.fitting.score_record import neutral_config, rows, score_scale

    kinds = class_of_label(dataset)
    configs = {label: _config(given[kind]) for label, kind in kinds.items()}
    scale = score_scale(list(recordings.values()), configs)
    judge = getattr(dataset, "unjudged", None)
    found = {}
    for label, kind in kinds.items() if labelled else ():
        config = neutral_config(configs[label], label, scale)
        for name, recording in recordings.items():
            unjudged: Sequence[BoolArray] | None = None if judge is None else judge(name)
            found[kind, name] = rows(recording, label, config, unjudged)
    return scale, found


def as_table(record: ScoreRecord) -> dict[str, Any]:
    """As a file has it, to the digits that tell."""
    from dataclasses import asdict

    from pmbm.wording import four_digits

    weights = {"online": record.online, "batch": record.batch or record.online}
    return {
        "kind": "record",
        "label": record.label,
        "memory": record.memory,
        "middle": [four_digits(value) for value in record.middle.tolist()],
        "spread": [four_digits(value) for value in record.spread.tolist()],
        **{
            name: {key: four_digits(value) for key, value in asdict(one).items()}
            for name, one in weights.items()
        },
    }


def factored(tables: Tables) -> dict[str, Any]:
    """The same parameters with what all classes share said once, at the top."""
    first, *others = tables.values()
    shared = _shared(first, others) if others else {}
    return {**shared, **{kind: _without(own, shared) for kind, own in tables.items()}}


def _shared(first: Mapping[str, Any], others: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, value in first.items():
        theirs = [other.get(key) for other in others]
        if all(isinstance(one, dict) for one in (value, *theirs)):
            inner = _shared(value, [one for one in theirs if one is not None])
            if inner:
                found[key] = inner
        elif all(one == value for one in theirs):
            found[key] = value
    return found


def _without(own: Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    left: dict[str, Any] = {}
    for key, value in own.items():
        if key not in shared:
            left[key] = value
        elif isinstance(value, dict):
            inner = _without(value, shared[key])
            if inner:
                left[key] = inner
    return left


def report(worth: Mapping[str, LeftOut | None], title: str) -> str:
    """The operating points and reliability of left-out sequences, as Markdown."""
    from pmbm.reports.tables import markdown_table

    lines = [f"{title}, each tracked by a fit to the other folds.", ""]
    header = [
        "class", "MOTA", "95 %", "IDF1", "HOTA", "best threshold's", "regret", "reported", "true",
        "by sequence", "if honest", "log loss",
    ]  # fmt: skip
    rows = []
    for kind, found in worth.items():
        if found is None:
            rows.append([kind, *["no objects"] * (len(header) - 1)])
            continue
        one = found.point
        ends = "–" if one.low is None else f"[{one.low:.3f}, {one.high:.3f}]"
        rows.append(
            [
                kind,
                f"{one.mota:.4f}",
                ends,
                *(_cell(found.figures.get(name), 4) for name in ("IDF1", "HOTA")),
                f"{one.best:.4f} at {one.best_threshold:.2f}",
                f"{one.regret:.4f}",
                _cell(one.reported),
                _cell(one.true),
                _cell(one.spread),
                "–" if one.honest_spread is None else honest_cell(one.honest_spread),
                _cell(one.log_loss),
            ]
        )
    lines += [markdown_table(header, rows, 1), ""]
    lines += [
        "reported: mean probability of what was reported; true: the share of it that is; by "
        "sequence: root mean square of their difference; if honest: what chance alone would make "
        "of it, each track true as a whole with the probability that it reports, in half of all "
        "cases and at most in 95 %.  Where reports say p, a share of",
        "",
    ]
    for kind, found in worth.items():
        if found is not None and found.point.reported is not None:
            said, share = found.point.reliability.curve
            pairs = (f"{p:.2f}: {q:.2f}" for p, q in zip(said, share, strict=True))
            lines.append(f"- {kind} is true: {', '.join(pairs)}")
    return "\n".join(lines) + "\n"


def honest_cell(spread: tuple[float, float]) -> str:
    """The median and the 95 % quantile of `honest_spread`."""
    return f"{spread[0]:.3f}, to {spread[1]:.3f}"


def _cell(value: float | None, digits: int = 3) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _config(table: dict[str, Any]) -> Any:
    """The configuration that a class's parameters make."""
    from pmbm.study.configured import ConfiguredTracker
    from pmbm.types import Site

    made: Any = ConfiguredTracker("pmbm", tuple(table.items()))(Site())
    return made.config
