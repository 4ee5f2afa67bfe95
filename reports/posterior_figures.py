"""Figures of the checks of a posterior against the truth that it was computed from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pmbm.reports.drawing import colours_of, styled

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SMALLEST = 1e-18


def errors_figure(errors: Mapping[str, ArrayLike], bound: float) -> Figure:
    """How far numbers are from exact ones: what -> relative errors (N,), and the promised bound."""

    def draw(axes: Axes, colours: dict[str, str]) -> None:
        bins = np.linspace(-18, np.log10(bound) + 1, 60).tolist()
        for i, (what, values) in enumerate(errors.items()):
            shown = np.log10(np.maximum(np.asarray(values, float), _SMALLEST))
            colour = colours[f"tracker-{i}"]
            axes.hist(shown, bins, histtype="step", color=colour, label=f"{what} ({len(shown)})")
        axes.axvline(np.log10(bound), color=colours["error"], linewidth=1, label=f"bound {bound:g}")
        axes.set(
            yscale="log", xlabel="log10 of the relative error (none at all: -18)", ylabel="numbers"
        )

    return _figure("Against the enumeration of everything that can have happened", draw)


def transform_figure(values: ArrayLike, band: float) -> Figure:
    """The distribution function of probability integral transforms (N,), less the uniform one, in
    its simultaneous band of half-width `band`."""

    def draw(axes: Axes, colours: dict[str, str]) -> None:
        u = np.sort(np.asarray(values, float))
        gap = np.arange(1, len(u) + 1) / len(u) - u
        axes.axhspan(-band, band, color=colours["accent-wash"], label="band, 99 % of all samples")
        axes.axhline(0, color=colours["line"], linewidth=0.8)
        axes.step(u, gap, where="post", color=colours["tracker-0"], label=f"{len(u)} worlds")
        axes.set(xlabel="transform of the true number", ylabel="share below, less uniform")

    return _figure("The true number of objects in its posterior", draw)


def reliability_figure(claimed: ArrayLike, true: ArrayLike, half: ArrayLike) -> Figure:
    """What was claimed (B,), the mean of a bin, against what was true (B,), with half-intervals
    (B,)."""

    def draw(axes: Axes, colours: dict[str, str]) -> None:
        axes.plot([0, 1], [0, 1], color=colours["line"], linewidth=0.8)
        axes.errorbar(
            np.asarray(claimed, float),
            np.asarray(true, float),
            np.asarray(half, float),
            fmt="o",
            markersize=3,
            linewidth=1,
            color=colours["tracker-0"],
            label="bins, 99.9 % intervals by trial",
        )
        axes.set(xlabel="claimed probability of existence", ylabel="share that exists")

    return _figure("Existence as claimed, and in truth", draw)


def squares_figure(samples: Mapping[str, tuple[ArrayLike, int]]) -> Figure:
    """Squared, normalised errors against their law: what -> (values (N,), degrees of freedom)."""
    from scipy.stats import chi2

    def draw(axes: Axes, colours: dict[str, str]) -> None:
        for i, (what, (values, dof)) in enumerate(samples.items()):
            x = np.sort(np.asarray(values, float))
            share = (np.arange(len(x)) + 0.5) / len(x)
            axes.plot(
                chi2.ppf(share, dof),
                x,
                ".",
                markersize=2.5,
                color=colours[f"tracker-{i}"],
                label=f"{what}, chi-square of {dof} ({len(x)})",
            )
        top = max(axes.get_xlim()[1], axes.get_ylim()[1])
        axes.plot([0, top], [0, top], color=colours["line"], linewidth=0.8, zorder=0)
        axes.set(xlabel="quantile expected", ylabel="quantile found")

    return _figure("Squared errors against their law", draw)


def cost_figure(pairs: Mapping[str, tuple[ArrayLike, ArrayLike]]) -> Figure:
    """Expected numbers of objects: what -> (nearly exact (N,), reduced (N,)), world by world."""

    def draw(axes: Axes, colours: dict[str, str]) -> None:
        axes.axhline(0, color=colours["line"], linewidth=0.8)
        for i, (what, (exact, reduced)) in enumerate(pairs.items()):
            exact, reduced = np.asarray(exact, float), np.asarray(reduced, float)
            axes.plot(
                exact,
                reduced - exact,
                ".",
                markersize=4,
                color=colours[f"tracker-{i}"],
                label=f"{what}: {np.mean(reduced - exact):+.4f} on average",
            )
        axes.set(xlabel="expected number, hardly reduced", ylabel="difference when reduced")

    return _figure("What pruning, capping and gating cost", draw)


def _figure(title: str, draw: Callable[[Any, dict[str, str]], None]) -> Figure:
    from matplotlib.figure import Figure

    colours = colours_of(False)
    with styled():
        figure = Figure(figsize=(5.2, 3.4), layout="constrained")
        figure.set_facecolor(colours["card"])
        axes = figure.add_subplot()
        draw(axes, colours)
        axes.set_title(title, loc="left", fontsize=9.5, color=colours["ink"])
        axes.set_facecolor(colours["stage"])
        axes.tick_params(colors=colours["soft"], labelsize=8, length=2)
        axes.xaxis.label.set(color=colours["soft"], fontsize=8.5)
        axes.yaxis.label.set(color=colours["soft"], fontsize=8.5)
        for name, spine in axes.spines.items():
            spine.set(color=colours["line"], linewidth=0.8, visible=name in ("left", "bottom"))
        axes.legend(
            fontsize=7.5,
            labelcolor=colours["soft"],
            facecolor=colours["stage"],
            edgecolor="none",
            framealpha=0.9,
        )
    return figure
