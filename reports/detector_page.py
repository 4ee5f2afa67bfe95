"""A fitted detector laid over the data it was fitted to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import special

from pmbm.labels import Label
from pmbm.reports.curves import svg_image
from pmbm.reports.drawing import colours_of, styled
from pmbm.reports.page import render_page
from pmbm.sim.fit.goodness_of_fit import FitComparison
from pmbm.sim.fit.observations import Observations
from pmbm.sim.fit.two_sample import TwoSample
from pmbm.types import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FEWEST = 20


@dataclass(frozen=True)
class Realism:
    """The result of the two-sample test.

    same_truth : real against modelled boxes of the same recordings.
    real, model : areas under the curve of real against other real recordings, and of real against
        modelled others, over the same random halves.
    """

    same_truth: TwoSample
    real: tuple[float, ...]
    model: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class DetectorReport:
    """All that the page shows.

    name, provenance, command : of the fitted model, and what makes it again.
    real, model : the evidence of the fitted recordings and of the model on the same truth.
    fitted, held_back : figures of both; `held_back` with intervals, or empty.
    """

    name: str
    provenance: str
    command: str
    real: Observations
    model: Observations
    fitted: Sequence[FitComparison]
    held_back: Sequence[FitComparison]
    realism: Realism | None


def detector_page(report: DetectorReport) -> str:
    """The page as one HTML file."""
    return render_page(
        "detector.html.j2",
        title=f"Detector {report.name}",
        command=report.command,
        lede=report.provenance,
        pictures=[
            {
                "alt": title,
                "light": svg_image(_picture(report, title, draw, dark=False)),
                "dark": svg_image(_picture(report, title, draw, dark=True)),
            }
            for title, draw in _pictures(report)
        ],
        fitted=[_row(item) for item in report.fitted],
        held_back=[_row(item) for item in report.held_back],
        realism=None if report.realism is None else _realism(report.realism),
    )


def _row(item: FitComparison) -> dict[str, Any]:
    recall = item.name.startswith("recall")
    return {
        "name": item.name,
        "real": f"{item.real:.3f}",
        "model": f"{item.model:.3f}",
        "weight": f"{item.weight:.0f}",
        "difference": f"{100 * item.difference:+z.1f}" + (" points" if recall else " %"),
        "interval": ""
        if item.interval is None
        else f"{100 * item.interval[0]:+z.1f} to {100 * item.interval[1]:+z.1f}",
        "inside": "inside" if item.inside else "outside",
    }


def _realism(realism: Realism) -> dict[str, Any]:
    return {
        "same": f"{realism.same_truth.auc:.3f}",
        "real": f"{np.mean(realism.real):.3f}",
        "model": f"{np.mean(realism.model):.3f}",
        "halves": len(realism.real),
        "betraying": [
            (name, f"{alone:.3f}", f"{lost:.3f}")
            for name, alone, lost in realism.same_truth.betraying
        ],
    }


_Draw = Callable[["Axes", Observations, str, str, bool], None]


def _pictures(report: DetectorReport) -> list[tuple[str, _Draw]]:
    labels = np.unique(report.real.chances.label[report.real.hits.chance])
    pictures: list[tuple[str, _Draw]] = []
    for value in labels.tolist():
        name = Label(value).name.lower()
        pictures += [
            (f"recall of {name} over range, m", _recall_over_range(value)),
            (f"recall of {name} over visible share", _recall_over_visibility(value)),
            (f"radial (solid) and lateral error of {name} over range, m", _noise(value)),
            (f"log-odds of scores of {name}: true (solid) and false", _scores(value)),
            (f"misses of {name} in a row: share of runs at least as long", _runs(value)),
        ]
    pictures.append(("false boxes in a frame: share of frames", _clutter))
    return pictures


def _picture(report: DetectorReport, title: str, draw: _Draw, *, dark: bool) -> Figure:
    from matplotlib.figure import Figure

    colours = colours_of(dark)
    with styled():
        figure = Figure(figsize=(3.8, 2.5))
        figure.set_facecolor(colours["card"])
        axes = figure.add_axes((0.115, 0.13, 0.865, 0.75))
        axes.set_facecolor(colours["card"])
        axes.set_title(title, fontsize=8.5, color=colours["ink"], loc="left")
        axes.tick_params(colors=colours["soft"], labelsize=7.5)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        for side in ("bottom", "left"):
            axes.spines[side].set_color(colours["soft"])
        draw(axes, report.real, colours["truth"], "real", True)
        draw(axes, report.model, colours["detection"], "model", False)
        if axes.get_yscale() == "linear":
            axes.set_ylim(bottom=0)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(frameon=False, fontsize=7.5, labelcolor=colours["soft"])
    return figure


def _style(real: bool) -> dict[str, Any]:
    return {"marker": "o", "markersize": 3, "linewidth": 1.0} if real else {"linewidth": 1.6}


def _means(x: FloatArray, values: FloatArray, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean x and mean value of each interval that holds enough."""
    number = np.digitize(x, edges)
    enough = [k for k in np.unique(number) if np.count_nonzero(number == k) >= _FEWEST]
    return (
        np.array([x[number == k].mean() for k in enough]),
        np.array([values[number == k].mean() for k in enough]),
    )


def _recall_over_range(label: int) -> _Draw:
    def draw(axes: Axes, evidence: Observations, colour: str, name: str, real: bool) -> None:
        rows = evidence.chances.label == label
        chances = evidence.chances.take(rows)
        x, y = _means(chances.distance, chances.found.astype(float), np.arange(0, 200, 8.0))
        axes.plot(x, y, color=colour, label=name, **_style(real))
        axes.set_ylim(0, 1.02)

    return draw


def _recall_over_visibility(label: int) -> _Draw:
    def draw(axes: Axes, evidence: Observations, colour: str, name: str, real: bool) -> None:
        chances = evidence.chances.take(evidence.chances.label == label)
        edges = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
        x, y = _means(chances.visibility, chances.found.astype(float), edges)
        axes.plot(x, y, color=colour, label=name, **_style(real))
        axes.set_xlim(-0.03, 1.03)
        axes.set_ylim(0, 1.02)

    return draw


def _noise(label: int) -> _Draw:
    def draw(axes: Axes, evidence: Observations, colour: str, name: str, real: bool) -> None:
        chances = evidence.chances.take(evidence.hits.chance)
        rows = chances.label == label
        for axis, line in ((0, "-"), (1, ":")):
            square = np.square(evidence.hits.error[rows, axis])
            x, y = _means(chances.distance[rows], square, np.arange(0, 200, 8.0))
            told = name if axis == 0 else None
            axes.plot(x, np.sqrt(y), line, color=colour, label=told, **_style(real))

    return draw


def _scores(label: int) -> _Draw:
    def draw(axes: Axes, evidence: Observations, colour: str, name: str, real: bool) -> None:
        hits = evidence.hits.score[evidence.chances.label[evidence.hits.chance] == label]
        falses = evidence.falses.score[evidence.falses.label == label]
        for score, line in ((hits, "-"), (falses, ":")):
            if len(score) < _FEWEST:
                continue
            odds = special.logit(np.clip(score, 1e-7, 1 - 1e-7))
            density, edges = np.histogram(odds, np.linspace(-5, 16, 43), density=True)
            told = name if line == "-" else None
            axes.plot((edges[1:] + edges[:-1]) / 2, density, line, color=colour, label=told)

    return draw


def _runs(label: int) -> _Draw:
    def draw(axes: Axes, evidence: Observations, colour: str, name: str, real: bool) -> None:
        chances = evidence.chances.take(evidence.chances.label == label)
        order = np.lexsort((chances.frame, chances.object_id, chances.recording))
        missed = ~chances.found[order]
        same = (
            (np.diff(chances.recording[order]) == 0)
            & (np.diff(chances.object_id[order]) == 0)
            & (np.diff(chances.frame[order]) == 1)
        )
        begins = missed & ~np.append(False, missed[:-1] & same)
        if not begins.any():
            return
        length = np.bincount(np.cumsum(begins)[missed] - 1)
        x = np.arange(1, 31)
        axes.plot(x, [(length >= k).mean() for k in x], color=colour, label=name, **_style(real))
        axes.set_yscale("log")

    return draw


def _clutter(axes: Axes, evidence: Observations, colour: str, name: str, real: bool) -> None:
    key = evidence.falses.recording * 10**7 + evidence.falses.frame
    count = np.unique(key, return_counts=True)[1]
    frames = int(evidence.frames.sum())
    share = np.bincount(count, minlength=16) / frames
    share[0] = 1 - len(count) / frames
    axes.plot(np.arange(len(share))[:26], share[:26], color=colour, label=name, **_style(real))
