"""`pmbm fit-marks`: what scores and runs of misses say, from a dataset's labels and detections."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import dataset_options
from pmbm.cli.dataset_options import FILE, FOLDER
from pmbm.cli.many import ManyValues

if TYPE_CHECKING:
    from pmbm.datasets import Dataset
    from pmbm.filter import PMBMConfig, ScoreLevels


@click.command(cls=ManyValues)
@dataset_options.dataset
@dataset_options.root("The dataset's folder, with its labels.", kind=FOLDER)
@dataset_options.detections(
    "Detections with raw scores; {class} stands for the class's name where each class has its own."
)
@dataset_options.poses
@dataset_options.classes
@click.option("--sequences", multiple=True, required=True, metavar="NAME...", help="To fit to.")
@click.option(
    "--together",
    multiple=True,
    metavar="CLASS...",
    help="Classes that share what their scores say, for lack of examples of each.",
)
@click.option(
    "--config",
    type=FILE,
    metavar="FILE.toml",
    help="The PMBM tracker's other parameters.  [default: what ships for this dataset]",
)
@click.option("--out", type=FILE, required=True, metavar="FILE.toml", help="Parameters and marks.")
def command(
    dataset_name: str,
    root: Path,
    detections: str,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    together: tuple[str, ...],
    config: Path | None,
    out: Path,
) -> None:
    """Fit the PMBM tracker's marks to DATASET: what a score says of an object and of a pole, and
    how misses come in runs; write them, with the tracker's other parameters, as a file that
    `pmbm track --config` takes.  Sequences kept for reporting are refused.

    \b
    Example:
      pmbm fit-marks kitti --root kitti --detections 'kitti/detections/pointrcnn_{class}' \\
        --poses kitti/pose --sequences 0000 0002 0003 --together Pedestrian Cyclist --out marks.toml
    """
    from pmbm.cli.track import class_trackers, preset
    from pmbm.datasets import open_dataset
    from pmbm.durable import replace_text
    from pmbm.sim.toml_tables import toml_text
    from pmbm.study.configured import nested
    from pmbm.tune import refuse_reserved_sequences

    refuse_reserved_sequences(dataset_name, sequences)
    dataset = open_dataset(
        dataset_name, root=root, detections=detections, poses=poses, classes=classes or None
    )
    trackers = class_trackers(dataset, "pmbm", config or preset(dataset_name, "pmbm"))
    given = {
        name: nested(dict(trackers[label].parameters))
        for name, label in zip(dataset.classes, trackers, strict=True)
    }
    fitted = _fitted(dataset, list(dict.fromkeys(sequences)), together, given)
    note = (
        "# The PMBM tracker's parameters, a table for each class.\n"
        f"# sensor.detection and scores: by pmbm fit-marks {dataset_name}, sequences\n"
        f"# {' '.join(sequences)}"
        + (f";\n# what scores say is shared by {' and '.join(together)}.\n" if together else ".\n")
    )
    replace_text(out, note + toml_text(fitted))
    click.echo(out)


def _fitted(
    dataset: Dataset,
    sequences: Sequence[str],
    together: Sequence[str],
    given: dict[str, dict[str, Any]],
) -> dict[str, Any]:
    """Each class's parameters with what was fitted in their place."""
    from pmbm.datasets import with_origins
    from pmbm.errors import InputError, nearest_hint
    from pmbm.fitting.detection_chain import fit_detection_chain, runs
    from pmbm.fitting.score_levels import fit_marks
    from pmbm.study.configured import ConfiguredTracker
    from pmbm.types import Label, Site

    labels = dict(zip(dataset.classes, map(Label, dataset.labels), strict=True))
    for name in together:
        if name not in labels:
            raise InputError(
                f"no class '{name}'",
                field="--together",
                hint=nearest_hint(name, labels, "class"),
            )
    recordings = [with_origins(dataset.recording(name)) for name in sequences]
    judge = getattr(dataset, "unjudged", None)
    unjudged = None if judge is None else [judge(name) for name in sequences]
    configs: dict[Label, PMBMConfig] = {}
    result: dict[str, Any] = {}
    for name, label in labels.items():
        own = {key: value for key, value in given[name].items() if key != "scores"}
        own["sensor"] = {
            **own.get("sensor", {}),
            "detection": _chain(fit_detection_chain(runs(recordings, label))),
        }
        made: Any = ConfiguredTracker("pmbm", tuple(own.items()))(Site())
        configs[label], result[name] = made.config, own
    groups = [[labels[name] for name in together]] if together else []
    groups += [[label] for name, label in labels.items() if name not in together]
    levels = fit_marks(recordings, groups, configs, unjudged)
    for name, label in labels.items():
        # Fitted as if levels lasted: how they drift is for a tracker to be tuned by.
        drift = given[name].get("scores", {}).get("drift", 0.0)
        result[name]["scores"] = _levels(replace(levels[label], drift=drift))
    return result


def _chain(chain: Any) -> dict[str, Any]:
    """As a file has it."""
    shares = ("undetectable", "stay_detectable", "stay_undetectable")
    return {
        "kind": "chain",
        **{name: _short(getattr(chain, name)) for name in shares},
        "base": {"kind": "fixed", "probability": _short(chain.base.probability)},
    }


def _levels(levels: ScoreLevels) -> dict[str, Any]:
    """As a file has it, to the digits that tell."""
    calibration = levels.calibration
    births: dict[str, Any] = (
        {"birth": _shares(levels.birth)}
        if levels.birth_at is None
        else {
            "birth_at": _shortened(levels.birth_at),
            "birth": [_shares(row) for row in levels.birth],
        }
    )
    return {
        "kind": "levels",
        "label": levels.label,
        "scatter": _short(levels.scatter),
        "drift": levels.drift,
        "level": _shortened(levels.level),
        "object": _shortened(levels.object),
        **births,
        "clutter": _shares(levels.clutter),
        **(
            {}
            if levels.mean_objects is None
            else {
                "mean_objects": _short(levels.mean_objects),
                "prior_seconds": levels.prior_seconds,
            }
        ),
        "calibration": {
            **{name: _shortened(getattr(calibration, name)) for name in _BY_LABEL},
            **{name: _short(getattr(calibration, name)) for name in ("near", "far", "apart")},
        },
    }


_BY_LABEL = ("offset", "slope", "per_metre")


def _shares(values: Any) -> list[float]:
    """Rounded; what that takes goes to the largest, so that they still add up to one."""
    rounded = [round(value, 5) for value in values.tolist()]
    top = rounded.index(max(rounded))
    rounded[top] = round(rounded[top] + 1 - sum(rounded), 5)
    return rounded


def _shortened(values: Any) -> list[float]:
    return [_short(value) for value in values.tolist()]


def _short(value: float) -> float:
    return float(f"{value:.4g}")
