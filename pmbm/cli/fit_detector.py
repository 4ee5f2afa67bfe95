"""`pmbm fit-detector`: a detector profile from a dataset's labels and detections."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from pmbm.cli import dataset_options
from pmbm.cli.dataset_options import FOLDER
from pmbm.cli.many import ManyValues

if TYPE_CHECKING:
    from pmbm.reports.detector_page import Realism
    from pmbm.sim.detector.model import DetectorModel
    from pmbm.sim.fit.goodness_of_fit import Figure, FitComparison
    from pmbm.types import Recording

_SEED = 7


@click.command(cls=ManyValues)
@dataset_options.detected(
    "The dataset's folder.",
    "Detections; {class} stands for the class's name where each class has its own.",
    kind=FOLDER,
)
@click.option(
    "--held-back", multiple=True, metavar="NAME...", help="Sequences to judge the fit by, not used."
)
@click.option("--name", default="fitted", show_default=True, help="Of the profile.")
@click.option(
    "--min-iou",
    type=click.FloatRange(0.0, 1.0, min_open=True),
    default=0.25,
    show_default=True,
    help="3D overlap from which a box is an object's.",
)
@click.option(
    "--trials",
    type=click.IntRange(min=1),
    default=8,
    show_default=True,
    help="Trials of the model that are held against the data.",
)
@click.option(
    "--refits",
    type=click.IntRange(min=1),
    default=20,
    show_default=True,
    help="Models fitted to resampled sequences, for the intervals of those held back.",
)
@click.option("--realism/--no-realism", default=True, help="Run the classifier two-sample test.")
@click.option("--out", type=FOLDER, default=Path("reports"), show_default=True)
def command(
    dataset_name: str,
    root: Path,
    detections: str,
    poses: Path | None,
    classes: tuple[str, ...],
    sequences: tuple[str, ...],
    held_back: tuple[str, ...],
    name: str,
    min_iou: float,
    trials: int,
    refits: int,
    realism: bool,
    out: Path,
) -> None:
    """Fit the detector model to DATASET; write a profile and a page that lays it over the data.

    \b
    Example:
      pmbm fit-detector kitti --root kitti --detections 'kitti/detections/pointrcnn_{class}' \\
          --poses kitti/pose --sequences 0000 0002 0003 --held-back 0006 0008 --out fitted
    """
    import numpy as np

    from pmbm.cli.progress import bar
    from pmbm.datasets import load, open_dataset, with_origins
    from pmbm.durable import replace_text
    from pmbm.reports.detector_page import DetectorReport, detector_page
    from pmbm.sim.detector.model import load_profile
    from pmbm.sim.fit.goodness_of_fit import (
        between_real,
        bootstrap,
        compare,
        figures,
        modelled,
        outside,
        outside_by_chance,
    )
    from pmbm.sim.fit.model import fit_detector
    from pmbm.sim.fit.model import refits as models_of_resampled
    from pmbm.sim.fit.observations import gather
    from pmbm.sim.toml_tables import toml_text

    dataset = open_dataset(
        dataset_name, root=root, detections=detections, poses=poses, classes=classes or None
    )
    names = list(sequences) or [s for s in dataset.sequences() if s not in held_back]
    real = [with_origins(r, min_iou=min_iou) for r in load(dataset, names)]
    held = [with_origins(r, min_iou=min_iou) for r in load(dataset, held_back)]
    again = _command(
        dataset_name, root, detections, poses, classes, names, held_back, name, min_iou
    )
    provenance = f"{dataset_name}: {', '.join(names)}. Made by: {again}."
    model = fit_detector(real, name=name, provenance=provenance, min_iou=min_iou)
    model = load_profile(_rounded(model.plain()))
    out.mkdir(parents=True, exist_ok=True)
    profile = out / f"{name}.toml"
    replace_text(profile, toml_text(model.plain()))

    fitted_real = [figures(r) for r in real]
    fitted_model = _modelled_figures(model, real, trials, min_iou)
    fitted = compare(fitted_real, fitted_model)
    judged: list[FitComparison] = []
    if held:
        held_model = _modelled_figures(model, held, trials, min_iou)
        held_real = [figures(r) for r in held]
        others = models_of_resampled(real, refits, min_iou=min_iou)
        with bar() as shown:
            refitted = list(shown.track(others, total=refits, description="refitting"))
        judged = bootstrap(fitted_real, refitted, held_real, held_model)
    _print("fitted sequences", fitted)
    if judged:
        _print("sequences held back, with the interval of a bootstrap of the fitted ones", judged)
        alone = between_real(fitted_real, held_real)
        left, left_alone = outside(judged), outside(alone)
        shared = len(set(left) & set(left_alone))
        click.echo(
            f"outside the interval: {len(left)} of {len(judged)} figures; between the real "
            "sequences alone, those held back against those fitted, without any model: "
            f"{len(left_alone)} of {len(alone)} figures; {shared} of them the same"
        )
        chance = 100 * outside_by_chance([*fitted_real, *held_real], len(fitted_real))
        click.echo(
            f"of the real sequences' figures, split at random into as many: {chance.mean():.0f} % "
            f"outside on average, {np.quantile(chance, 0.95):.0f} % in one split of twenty"
        )
    outcome = _realism([*real, *held], model) if realism and len(real) + len(held) > 3 else None
    page = out / f"{name}.html"
    replace_text(
        page,
        detector_page(
            DetectorReport(
                name=name,
                provenance=model.provenance,
                command=again,
                real=gather(real),
                model=gather(modelled(model, real, _SEED, min_iou=min_iou)),
                fitted=fitted,
                held_back=judged,
                realism=outcome,
            )
        ),
    )
    click.echo(f"profile  {profile}\npage     {page}")


def _rounded(value: Any) -> Any:
    """A plain value with its numbers to six digits: no data say more."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    return [_rounded(inner) for inner in value] if isinstance(value, list | tuple) else value


def _modelled_figures(
    model: DetectorModel, recordings: Sequence[Recording], trials: int, min_iou: float
) -> list[dict[str, Figure]]:
    """Figures of the model on the truth of each recording, over all trials."""
    from pmbm.sim.fit.goodness_of_fit import figures, modelled, pooled

    made = [
        [figures(r) for r in modelled(model, recordings, _SEED, trial, min_iou=min_iou)]
        for trial in range(trials)
    ]
    return [pooled(parts) for parts in zip(*made, strict=True)]


def _realism(recordings: Sequence[Recording], model: DetectorModel) -> Realism:
    import numpy as np

    from pmbm.reports.detector_page import Realism
    from pmbm.sim.fit.goodness_of_fit import modelled
    from pmbm.sim.fit.two_sample import area, two_sample

    made = modelled(model, recordings, _SEED)
    rng = np.random.default_rng(_SEED)
    halves = [np.array_split(rng.permutation(len(recordings)), 2) for _ in range(4)]
    outcome = Realism(
        same_truth=two_sample(recordings, made),
        real=tuple(
            area([recordings[i] for i in first], [recordings[i] for i in second])
            for first, second in halves
        ),
        model=tuple(
            area([recordings[i] for i in first], [made[i] for i in second])
            for first, second in halves
        ),
    )
    click.echo(
        f"realism: area under the curve, real against other real {np.mean(outcome.real):.3f}, "
        f"against modelled others {np.mean(outcome.model):.3f}, against the model of the same "
        f"recordings {outcome.same_truth.auc:.3f}"
    )
    names = ", ".join(
        f"{name} {lost:.3f} ({alone:.3f})" for name, alone, lost in outcome.same_truth.betraying[:5]
    )
    click.echo(f"betraying features (area lost without each; that of each alone): {names}")
    return outcome


def _print(title: str, rows: Sequence[FitComparison]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left")
    table.add_column("figure")
    for column in ("real", "model", "difference", "interval", "rests on"):
        table.add_column(column, justify="right")
    for row in rows:
        unit = " pt" if row.name.startswith("recall") else " %"
        interval = (
            ""
            if row.interval is None
            else (
                f"{100 * row.interval[0]:+z.1f} to {100 * row.interval[1]:+z.1f}"
                + ("" if row.inside else "  out")
            )
        )
        table.add_row(
            row.name,
            f"{row.real:.3f}",
            f"{row.model:.3f}",
            f"{100 * row.difference:+z.1f}{unit}",
            interval,
            f"{row.weight:.0f}",
        )
    Console().print(table)


def _command(
    dataset: str,
    root: Path,
    detections: str,
    poses: Path | None,
    classes: Sequence[str],
    sequences: Sequence[str],
    held_back: Sequence[str],
    name: str,
    min_iou: float,
) -> str:
    """The command that makes the same profile again."""
    words: list[Any] = [dataset, "--root", root, "--detections", detections]
    if poses is not None:
        words += ["--poses", poses]
    if classes:
        words += ["--classes", *classes]
    words += ["--sequences", *sequences]
    if held_back:
        words += ["--held-back", *held_back]
    words += ["--min-iou", min_iou, "--name", name]
    return f"pmbm fit-detector {shlex.join(map(str, words))}"
