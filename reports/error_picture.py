"""Trackers' GOSPA error in its parts: over time, and on average."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

import numpy as np

from pmbm.errors import InputError
from pmbm.metrics import Evaluation, evaluate
from pmbm.reports.drawing import colours_of, styled
from pmbm.reports.palette import tracker_colour
from pmbm.types import FloatArray, Recording, TrackSequence

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PARTS: Final = ("localisation", "missed", "false")


def error_picture(
    recording: Recording,
    tracks: Mapping[str, TrackSequence],
    *,
    observable: bool = False,
    dark: bool = False,
    width: float = 8.0,
) -> Figure:
    """A row a tracker: the parts of GOSPA^p of every frame, stacked, and their means beside it.

    tracks : tracker -> what it said of the recording.
    observable : score observable objects only.
    width : inches.

    The mean of the whole stands in GOSPA's own unit, metres.  Write it with
    `save(figure, "errors.svg")`.  Raises InputError without any tracker.
    """
    from matplotlib.figure import Figure

    if not tracks:
        raise InputError("nothing to draw", field="tracks", expected="at least one tracker")
    suffix = "_observable" if observable else ""
    names = ["gospa", *(f"gospa_{part}" for part in PARTS)]
    scored = {
        tracker: evaluate(recording, said, [name + suffix for name in names])
        for tracker, said in tracks.items()
    }
    colours = colours_of(dark)
    with styled():
        figure = Figure(figsize=(width, 0.7 + 1.35 * len(tracks)), layout="constrained")
        figure.set_facecolor(colours["card"])
        axes = figure.subplots(
            len(tracks), 2, squeeze=False, sharex="col", sharey="col", width_ratios=(4, 1)
        )
        for row, (tracker, evaluation) in enumerate(scored.items()):
            times = np.array([recording.truth[k].time for k in tracks[tracker].frame])
            _over_time(axes[row, 0], times, evaluation, suffix, colours)
            axes[row, 0].set_title(
                tracker,
                loc="left",
                color=tracker_colour(colours, row),
                fontsize=9,
                fontweight="bold",
                pad=4,
            )
            _on_average(axes[row, 1], evaluation, suffix, colours)
        power = evaluation["gospa" + suffix].parameters["order"]
        # After all rows, which share their scales.
        axes[0, 0].set_ylim(bottom=0)
        axes[0, 1].set_xlim(left=0)
        axes[-1, 0].set_xlabel("time, s", color=colours["soft"], fontsize=8)
        figure.supylabel(f"parts of GOSPA$^{power:g}$, m$^{power:g}$", **_soft(colours))
        _legend(figure, colours)
    return figure


def _over_time(
    axes: Axes, times: FloatArray, evaluation: Evaluation, suffix: str, colours: dict[str, str]
) -> None:
    """The parts of every frame, stacked as steps."""
    bottom = np.zeros(len(times))
    for part in PARTS:
        series = evaluation[f"gospa_{part}{suffix}"].series
        assert series is not None
        axes.fill_between(
            times, bottom, bottom + series, step="mid", color=colours[part], linewidth=0
        )
        bottom = bottom + series
    axes.margins(x=0)
    _quiet(axes, colours)


def _on_average(axes: Axes, evaluation: Evaluation, suffix: str, colours: dict[str, str]) -> None:
    """The means of the parts as one bar, and the mean GOSPA over it."""
    left = 0.0
    for part in PARTS:
        mean = evaluation[f"gospa_{part}{suffix}"].value or 0.0
        axes.barh(0, mean, left=left, height=0.6, color=colours[part], linewidth=0)
        left += mean
    whole = evaluation["gospa" + suffix].value
    says = "undefined" if whole is None else f"mean GOSPA {whole:.2f} m"
    axes.set_title(says, loc="left", color=colours["ink"], fontsize=8, pad=4)
    axes.set(ylim=(-0.9, 0.9), yticks=[])
    _quiet(axes, colours)


def _quiet(axes: Axes, colours: dict[str, str]) -> None:
    axes.set_facecolor(colours["stage"])
    axes.tick_params(colors=colours["soft"], labelsize=8, length=2)
    for name, spine in axes.spines.items():
        spine.set(color=colours["line"], linewidth=0.8, visible=name in ("left", "bottom"))


def _legend(figure: Figure, colours: dict[str, str]) -> None:
    from matplotlib.patches import Patch

    says = {"localisation": "misplaced", "missed": "missed objects", "false": "false tracks"}
    figure.legend(
        handles=[Patch(facecolor=colours[part], label=says[part]) for part in PARTS],
        loc="outside lower center",
        ncols=len(PARTS),
        frameon=False,
        fontsize=8,
        labelcolor=colours["soft"],
    )


def _soft(colours: dict[str, str]) -> dict[str, object]:
    return {"color": colours["soft"], "fontsize": 8}
