"""`pmbm track`: a tracker over a real dataset, output in that dataset's format."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import dataset_options, options, settings
from pmbm.cli.many import ManyValues
from pmbm.cli.options import FILE, FOLDER

if TYPE_CHECKING:
    from pmbm.datasets import Dataset
    from pmbm.study.configured import ConfiguredTracker
    from pmbm.types import Label, Recording, TrackSequence


@click.command(cls=ManyValues)
@dataset_options.detected(
    "The dataset's folder.",
    "Detections; {class} stands for the class's name where each class has its own.",
)
@click.option("--out", type=FOLDER, required=True, help="Folder for the results.")
@options.tracker
@settings.option
@click.option(
    "--config",
    type=FILE,
    metavar="FILE.toml|DETECTOR",
    help="The tracker's parameters; a table [CLASS] holds those of one class alone.  Or the name "
    "of a detector that a preset ships for.  [default: what ships for this tracker on this "
    "dataset, if anything]",
)
@options.mode
@click.option(
    "--false-cost",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="BOXES",
    help="How many missed boxes C one false box is worth: 3 for precision, .33 for recall, 1 for "
    "MOTA.  Reported is what is there with a probability above C / (1 + C).  [default: as the "
    "tracker's parameters have it]",
)
@click.option(
    "--log",
    metavar="FILE.mcap|FILE.rrd",
    help="Write each sequence for a viewer too, Foxglove or Rerun; {sequence} stands for its name.",
)
@dataset_options.jobs
def command(
    dataset_name: str,
    root: Path,
    detections: str,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    out: Path,
    tracker_name: str,
    settings: tuple[str, ...],
    config: Path | None,
    mode: str,
    false_cost: float | None,
    log: str | None,
    jobs: int,
) -> None:
    """Run a tracker over DATASET and write what it says in the dataset's own format, one sequence
    at a time.  Each class has a tracker of its own; no label is read.

    \b
    Example:
      pmbm track kitti --root kitti --detections 'kitti/detections/pointrcnn_{class}' \\
        --poses kitti/pose --classes Car Pedestrian Cyclist --sequences 0001 0002 --out results
    """
    from pmbm.cli import warn
    from pmbm.cli.detector import heed_detector
    from pmbm.cli.progress import spread
    from pmbm.cli.settings import parsed
    from pmbm.datasets import chosen_sequences, open_dataset
    from pmbm.datasets.files import prepare_folder

    dataset = open_dataset(
        dataset_name, root=root, detections=detections, poses=poses, classes=classes or None
    )
    if config is not None and not config.exists():
        config = preset(dataset_name, tracker_name, str(config)) or config
    config = config or preset(dataset_name, tracker_name)
    trackers = class_trackers(dataset, tracker_name, config, parsed(settings))
    if false_cost is not None:
        trackers = {label: at_cost(one, false_cost) for label, one in trackers.items()}
    names = chosen_sequences(dataset, sequences)
    if getattr(dataset, "without_poses", False):
        warn("no --poses: objects are followed in the frame of the moving sensor")
    shipped = shipped_detectors(dataset_name, tracker_name)
    told = {
        path: read_toml(path).get("detector", {}) for path in {config, *shipped.values()} if path
    }
    others = {name: told[path] for name, path in shipped.items() if path != config}
    if config is not None:
        heed_detector(dataset, names, config, told[config], others, trackers)
    prepare_folder(out)
    logs = _logs(log, names)
    tasks = [
        (dataset, name, trackers, out, mode, file) for name, file in zip(names, logs, strict=True)
    ]
    boxes = reports = 0
    for path, given, reported in spread(track_sequence, tasks, jobs, "sequences"):
        boxes, reports = boxes + given, reports + reported
        click.echo(path)
    if boxes >= _MANY and not reports:
        warn(
            f"no track was reported among {boxes} detections; pmbm fit-tracker fits the tracker to "
            "a detector"
        )


_MANY = 1000
"""Detections among which it is strange that no track is reported."""


def track_sequence(
    dataset: Dataset,
    name: str,
    trackers: Mapping[Label, ConfiguredTracker],
    out: Path,
    mode: str = "online",
    log: Path | None = None,
) -> tuple[Path, int, int]:
    """Track one sequence, write it, and a log of it where one is named: where it is, how many
    detections there were, and reports."""
    recording = dataset.recording(name, truth=False)
    tracks = tracked(name, recording, trackers, mode)
    if log is not None:
        from pmbm.reports.values import ReplayPage
        from pmbm.reports.viewers import write_log

        tracker = next(iter(trackers.values())).factory
        write_log(ReplayPage(recording=recording, tracks={tracker: tracks}, title=name), log)
    return (
        dataset.write(name, tracks, out),
        sum(len(one) for one in recording.detections),
        sum(len(one) for one in tracks),
    )


def at_cost(tracker: ConfiguredTracker, false_cost: float) -> ConfiguredTracker:
    """The tracker with the least expected cost of its reports, where a missed box costs 1.

    Raises InputError for a tracker whose scores are not probabilities of existence.
    """
    import math

    from pmbm.errors import InputError
    from pmbm.filter import PMBMConfig
    from pmbm.study.configured import ConfiguredTracker, config_of, merged

    if config_of(tracker.factory) is not PMBMConfig:
        raise InputError(
            f"tracker '{tracker.factory}' does not say how probably its tracks exist, or takes no "
            "parameters",
            field="--false-cost",
            hint="use --tracker pmbm",
        )
    if not math.isfinite(false_cost):
        raise InputError("not a cost", field="--false-cost", got=false_cost)
    least = false_cost / (1 + false_cost)
    table = {"report": {"above": least, "keep_above": least}}
    parameters = merged(dict(tracker.parameters), table, PMBMConfig)
    return ConfiguredTracker(tracker.factory, tuple(parameters.items()))


def _logs(log: str | None, sequences: Sequence[str]) -> list[Path | None]:
    """The log of each sequence, where any is wanted.

    Raises InputError, before anything is tracked, where one cannot be written.
    """
    from pmbm.errors import InputError
    from pmbm.reports.viewers import check_log

    if log is None:
        return [None] * len(sequences)
    if len(sequences) > 1 and "{sequence}" not in log:
        raise InputError(
            f"one log for {len(sequences)} sequences",
            field="--log",
            expected="{sequence} in its name",
            got=log,
        )
    files = [Path(log.replace("{sequence}", name)) for name in sequences]
    for file in files:
        check_log(file)
    return list(files)


def tracked(
    sequence: str, recording: Recording, trackers: Mapping[Label, ConfiguredTracker], mode: str
) -> TrackSequence:
    """A sequence's tracks, every label by its own tracker; what these draw at random depends on
    the sequence's name alone."""
    from functools import partial

    from pmbm.errors import InputError
    from pmbm.seeding import seeded, tracker_seed
    from pmbm.tracking import ByLabel, track

    seed = tracker_seed(0, sequence)
    try:
        if mode == "batch":
            with seeded(seed):
                return looked_back(recording, trackers)
        return track(partial(ByLabel, trackers), recording, seed)
    except InputError as error:
        raise error.located(run=f"sequence {sequence}") from error


def looked_back(recording: Recording, trackers: Mapping[Label, ConfiguredTracker]) -> TrackSequence:
    """Every label's tracks, smoothed over the whole recording.

    Tracks are followed from a tenth of the probability at which they are kept on, so that one that
    is reported later may begin where it first appeared; where the scores keep records, every source
    is.  Raises InputError for a tracker that is not the PMBM tracker.
    """
    import dataclasses

    from pmbm.errors import InputError
    from pmbm.filter import PMBMTracker, smooth
    from pmbm.filter.models.score_record import ScoreRecord
    from pmbm.tracking import joined_tracks, run, seen_by

    parts = []
    for label, configured in trackers.items():
        tracker = configured(recording.site)
        if not isinstance(tracker, PMBMTracker):
            raise InputError(
                f"tracker '{configured.factory}' cannot look back", field="--mode", got="batch",
                hint="use --tracker pmbm or --mode online",
            )  # fmt: skip
        config = tracker.config
        early = config.changed(
            {"report.above": config.report.keep_above / 10, "sensor.box_gain": 1.0}
        )
        if isinstance(early.scores, ScoreRecord):
            early = dataclasses.replace(
                early,
                scores=early.scores.of_all_sources(),
                report=dataclasses.replace(early.report, exclusive=False),
            )
        own = tuple(seen_by(tracker, label, frame) for frame in recording.detections)
        alone = dataclasses.replace(recording, detections=own, origin=None)
        found = run(PMBMTracker(early, recording.site), alone, record=True)
        parts.append(smooth(found.steps, config, found.inspections))
    ids: dict[tuple[int, int], int] = {}
    steps = []
    for reports in zip(*parts, strict=True):
        names = [(part, i) for part, tracks in enumerate(reports) for i in tracks.id.tolist()]
        given = [ids.setdefault(name, len(ids)) for name in names]
        steps.append(joined_tracks(reports[0].time, reports, given))
    return dataclasses.replace(found, steps=tuple(steps), seconds=None, inspections=None)


def preset(dataset: str, tracker: str, detector: str | None = None) -> Path | None:
    """The file of parameters that ships for a tracker on a dataset, or for one detector there; how
    each was found is said in it."""
    import re

    name = "_".join([dataset, tracker, *([] if detector is None else [detector])])
    if not re.fullmatch(r"[a-z0-9_]+", name):
        return None
    path = _presets() / f"{name}.toml"
    return path if path.is_file() else None


def shipped_detectors(dataset: str, tracker: str) -> dict[str, Path]:
    """The files that ship for a tracker on a dataset, by the name of the detector."""
    start = f"{dataset}_{tracker}_"
    return {
        path.stem.removeprefix(start): path for path in sorted(_presets().glob(f"{start}*.toml"))
    }


def _presets() -> Path:
    from importlib.resources import files

    return Path(str(files("pmbm.datasets") / "presets"))


def class_trackers(
    dataset: Dataset,
    tracker: str,
    config: Path | None,
    settings: Mapping[str, Any] | None = None,
) -> dict[Label, ConfiguredTracker]:
    """The tracker of each class with its parameters: those of the file's top level, over them those
    of the class's own table, and over these the settings."""
    from pmbm.study.configured import ConfiguredTracker, config_of, merged, nested
    from pmbm.types import Label

    values = {} if config is None else read_toml(config)
    values.pop("detector", None)
    own = {name: values.pop(name, {}) for name in dataset.known_classes}
    trackers = {}
    for name, label in zip(dataset.classes, dataset.labels, strict=True):
        over = nested(_table(own[name], name, config))
        known = config_of(tracker)
        parameters = merged(nested(values), over, known)
        with _blaming(config):
            ConfiguredTracker(tracker, tuple(parameters.items())).bound()
        parameters = merged(parameters, nested(settings or {}), known)
        trackers[Label(label)] = ConfiguredTracker(tracker, tuple(parameters.items()))
        trackers[Label(label)].bound()
    return trackers


def read_toml(path: Path) -> dict[str, Any]:
    """The file's tables; InputError where it is not TOML."""
    import tomllib

    from pmbm.datasets.files import read_text
    from pmbm.errors import InputError

    try:
        return tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None


def _table(value: Any, name: str, config: Path | None) -> dict[str, Any]:
    from pmbm.errors import InputError

    if not isinstance(value, dict):
        raise InputError(
            "not a table", file=config, field=name, expected=f"[{name}]", got=type(value).__name__
        )
    return value


@contextmanager
def _blaming(config: Path | None) -> Iterator[None]:
    from pmbm.errors import InputError

    try:
        yield
    except InputError as error:
        raise error.located(file=config) if config else error from None
