"""Robustness curves: metrics against a swept parameter, one line per tracker, with bands."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pmbm.reports.drawing import colours_of, styled
from pmbm.reports.palette import tracker_colour
from pmbm.reports.tables import ShownMetric
from pmbm.study import Estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class MetricCurve:
    """The values of one metric over the levels of one parameter.

    levels : numbers, or words that are drawn at equal distances.
    lines : tracker -> an estimate per level.
    connected : whether levels are few and shared (a grid), not scattered samples.
    """

    metric: ShownMetric
    levels: tuple[float | str, ...]
    lines: Mapping[str, tuple[Estimate, ...]]
    connected: bool = True


def curve_figure(curve: MetricCurve, parameter: str, *, dark: bool = False) -> Figure:
    """A figure of one metric against one parameter, for a column of a page."""
    from matplotlib.figure import Figure

    colours = colours_of(dark)
    with styled():
        figure = Figure(figsize=(3.8, 2.5))
        figure.set_facecolor(colours["card"])
        axes = figure.add_axes((0.115, 0.185, 0.865, 0.69))
        _panel(axes, curve, colours)
        axes.set_xlabel(parameter, color=colours["soft"], fontsize=8.5, labelpad=3)
    return figure


def svg_image(figure: Figure) -> str:
    """The figure as a data: address of an SVG image, the same text for the same figure."""
    text = io.BytesIO()
    with styled():
        figure.savefig(
            text, format="svg", metadata={"Date": None}, facecolor=figure.get_facecolor()
        )
    return f"data:image/svg+xml;base64,{base64.b64encode(text.getvalue()).decode('ascii')}"


def _panel(axes: Axes, curve: MetricCurve, colours: dict[str, str]) -> None:
    words = not all(isinstance(level, int | float) for level in curve.levels)
    x = np.arange(len(curve.levels)) if words else np.array(curve.levels, dtype=np.float64)
    order = np.argsort(x, kind="stable")
    for index, estimates in enumerate(curve.lines.values()):
        colour = tracker_colour(colours, index)
        mean, low, high = (
            np.array([_number(getattr(e, name)) for e in estimates])[order]
            for name in ("mean", "low", "high")
        )
        style: dict[str, Any] = {"color": colour, "markersize": 4, "marker": "o"}
        if curve.connected:
            axes.plot(x[order], mean, linewidth=1.6, **style)
            axes.fill_between(x[order], low, high, color=colour, alpha=0.16, linewidth=0)
        else:
            axes.plot(x[order], mean, linestyle="none", **style)
            axes.vlines(x[order], low, high, color=colour, alpha=0.5, linewidth=1.2)
    if words:
        axes.set_xticks(x, [str(level) for level in curve.levels])
    elif curve.connected and len(x) <= 8:
        axes.set_xticks(x[order], [f"{level:g}" for level in x[order]])
    unit = f" [{curve.metric.unit}]" if curve.metric.unit else ""
    title = f"{curve.metric.name}{unit} {curve.metric.arrow}"
    axes.set_title(title, x=-0.1, ha="left", fontsize=9.5, color=colours["ink"])
    axes.set_facecolor(colours["card"])
    axes.grid(axis="y", color=colours["hair"], linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(colors=colours["soft"], length=0, labelsize=8.5)
    axes.margins(x=0.04, y=0.12)
    for side, spine in axes.spines.items():
        spine.set_visible(side == "bottom")
        spine.set_color(colours["line"])


def _number(value: float | None) -> float:
    return np.nan if value is None else value
