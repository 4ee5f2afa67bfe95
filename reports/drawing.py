"""Drawings of one frame from above with matplotlib, in the replay's own style."""

from __future__ import annotations

import contextlib
import io
import logging
from collections.abc import Iterable, Iterator
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import shapely
from numpy.typing import ArrayLike

from pmbm.durable import replace_bytes
from pmbm.geometry import corners
from pmbm.reports.matching import matched
from pmbm.reports.palette import DARK, LIGHT
from pmbm.reports.shadows import field_of_view, hidden_region, rings
from pmbm.types import Detections, FloatArray, GaussianMixture, GroundTruth, Site, Tracks

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FONTS = ("Inter", "Helvetica Neue", "Helvetica", "Arial", "Liberation Sans", "DejaVu Sans")


@contextlib.contextmanager
def styled() -> Iterator[None]:
    """Make and save figures in the project's style, the same bytes every time."""
    import matplotlib
    from matplotlib import font_manager

    known = {entry.name for entry in font_manager.fontManager.ttflist}
    log = logging.getLogger("matplotlib.font_manager")
    level = log.level
    log.setLevel(logging.ERROR)
    settings: dict[Any, Any] = {
        "font.family": [name for name in _FONTS if name in known] or ["sans-serif"],
        "font.size": 9.0,
        "svg.fonttype": "none",
        "svg.hashsalt": "pmbm",
        "axes.unicode_minus": True,
        "path.simplify": True,
    }
    try:
        with matplotlib.rc_context(settings):
            yield
    finally:
        log.setLevel(level)


def save(figure: Figure, path: str | FilePath) -> None:
    """Write a figure as the file's suffix says (.svg, .png, .pdf)."""
    undated: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
    suffix = FilePath(path).suffix.lower()
    picture = io.BytesIO()
    with styled():
        figure.savefig(
            picture,
            format=suffix[1:],
            dpi=200,
            facecolor=figure.get_facecolor(),
            metadata=undated.get(suffix),
            bbox_inches="tight",
            pad_inches=0.08,
        )
    replace_bytes(FilePath(path), picture.getvalue())


def colours_of(dark: bool) -> dict[str, str]:
    return DARK if dark else LIGHT


_Dashes = Literal["-", "--", ":", "-."]
_DASHES: tuple[_Dashes, ...] = ("-", "--", ":", "-.")
"""Of the boxes of one sensor after the other."""


def _sensor_styles(site: Site) -> list[tuple[str, _Dashes]]:
    """The legend's words and the lines of detections, by sensor where there are several."""
    if not site.sensors:
        return [("detection", "-")]
    return [
        (f"detection, {one.name}", _DASHES[number % len(_DASHES)])
        for number, one in enumerate(site.sensors)
    ]


def add_legend(
    figure: Figure,
    colours: dict[str, str],
    site: Site,
    *,
    tracks: bool,
    unknown: bool = False,
) -> None:
    """Add one quiet line under the picture that says what the marks are."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    edge: dict[str, Any] = {"edgecolor": colours["truth"], "linewidth": 0.8}
    entries: list[Any] = [
        Patch(facecolor=colours["truth-fill"], **edge, label="true object"),
        Patch(facecolor="none", **edge, linestyle="--", label="hidden"),
        *(
            Patch(facecolor="none", edgecolor=colours["detection"], label=label, linestyle=dashes)
            for label, dashes in _sensor_styles(site)
        ),
        Patch(facecolor=colours["unseen"], label="cannot be seen"),
    ]
    if unknown:
        style: dict[str, Any] = {"edgecolor": colours["heat"], "linewidth": 1.8, "linestyle": "--"}
        entries.insert(2, Patch(facecolor="none", **style, label="never detected"))
    if tracks:
        ring: dict[str, Any] = {"color": "none", "fillstyle": "none"}
        ring["markeredgecolor"] = colours["error"]
        entries[-1:-1] = [
            Patch(facecolor="none", edgecolor=colours["soft"], linewidth=1.5, label="track"),
            Line2D([], [], marker="o", markersize=9, **ring, label="missed"),
            Line2D([], [], marker="x", markersize=7, **ring, label="false"),
        ]
    figure.legend(
        handles=entries,
        loc="outside lower center",
        ncols=len(entries),
        frameon=False,
        fontsize=8,
        labelcolor=colours["soft"],
        handlelength=1.6,
        handleheight=0.8,
        columnspacing=1.6,
        handletextpad=0.5,
    )


def heat_opacity(density: FloatArray) -> FloatArray:
    """Of an intensity in objects per square metre: from a thousandth of an object per 100 square
    metres (clear) to one (0.85), by decades."""
    with np.errstate(divide="ignore"):
        opacity: FloatArray = 0.85 * np.clip((np.log10(100 * density) + 3) / 3, 0, 1)
    return opacity


def add_heat_scale(axes: Axes, colours: dict[str, str]) -> None:
    """Add the scale of the heat's opacity inside the picture's lower right corner."""
    from matplotlib.colors import to_rgb

    scale = axes.inset_axes((0.76, 0.075, 0.2, 0.028), zorder=13)
    strip = np.empty((1, 200, 4))
    strip[..., :3] = to_rgb(colours["heat"])
    strip[0, :, 3] = heat_opacity(np.logspace(-5, -2, 200))
    scale.imshow(strip, extent=(-3, 0, 0, 1), aspect="auto")
    scale.set_facecolor(colours["stage"])
    scale.set_yticks([])
    scale.set_xticks([-3, -2, -1, 0], ["0.001", "0.01", "0.1", "1"])
    scale.tick_params(colors=colours["soft"], length=2, labelsize=7, pad=2)
    scale.set_title("expected per 100 m²", fontsize=7.5, color=colours["soft"], pad=3)
    for spine in scale.spines.values():
        spine.set(color=colours["line"], linewidth=0.6)


class ScenePanel:
    """Draws layers of one frame into axes, back to front."""

    def __init__(
        self, axes: Axes, colours: dict[str, str], extent: tuple[float, float, float, float]
    ) -> None:
        self._axes = axes
        self._colours = colours
        self._extent = extent
        axes.set(xlim=extent[::2], ylim=extent[1::2], xticks=[], yticks=[])
        axes.set_aspect("equal")
        axes.set_facecolor(colours["stage"])
        for spine in axes.spines.values():
            spine.set(color=colours["line"], linewidth=0.8)

    def site(self, site: Site) -> None:
        for area in site.drivable_area or ():
            self._polygons([area], zorder=0, facecolor=self._colours["road"])
        self._polygons(site.occluders, zorder=3, facecolor=self._colours["building"])

    def unseen(self, truth: GroundTruth, site: Site, pose: FloatArray) -> None:
        """Shades what is out of view or in a shadow."""
        x0, y0, x1, y1 = self._extent
        view = field_of_view(site, pose)
        outside = shapely.difference(shapely.box(x0, y0, x1, y1), view)
        region = shapely.union(outside, hidden_region(truth, site, pose))
        self._region(region, facecolor=self._colours["unseen"], linewidth=0, zorder=1)
        self._region(view, facecolor="none", edgecolor=self._colours["line"], linewidth=0.7)

    def heat(self, mixture: GaussianMixture) -> None:
        """The intensity of undetected objects, from 0.001 to 1 object per 100 square metres."""
        from matplotlib.colors import to_rgb

        x0, y0, x1, y1 = self._extent
        columns = 360
        lines = max(2, round(columns * (y1 - y0) / (x1 - x0)))
        x = x0 + (np.arange(columns) + 0.5) * (x1 - x0) / columns
        y = y0 + (np.arange(lines) + 0.5) * (y1 - y0) / lines
        density = planar_intensity(mixture, x, y)
        image = np.empty((lines, columns, 4))
        image[..., :3] = to_rgb(self._colours["heat"])
        image[..., 3] = heat_opacity(density)
        self._axes.imshow(
            image, extent=(x0, x1, y0, y1), origin="lower", interpolation="bilinear", zorder=1.5
        )

    def unknown(self, truth: GroundTruth) -> None:
        """Objects that no detection has shown."""
        outlines = corners(truth.position, truth.size, truth.yaw)
        self._polygons(
            outlines,
            zorder=8,
            facecolor=self._colours["card"],
            edgecolor=self._colours["heat"],
            linewidth=1.8,
            linestyle="--",
        )

    def marked(self, region: shapely.Geometry) -> None:
        """The outline of a region that a callout speaks of."""
        style: dict[str, Any] = {"edgecolor": self._colours["heat"], "linestyle": (0, (4, 2.5))}
        self._region(region, facecolor="none", linewidth=0.8, zorder=3, **style)

    def callout(self, text: str, place: FloatArray) -> None:
        """Words on a small card, inside the picture."""
        x0, y0, x1, y1 = self._extent
        inset = 0.09 * (x1 - x0), 0.05 * (y1 - y0)
        x = np.clip(place[0], x0 + inset[0], x1 - inset[0])
        y = np.clip(place[1], y0 + inset[1], y1 - inset[1])
        card = {
            "boxstyle": "round,pad=.35",
            "facecolor": self._colours["card"],
            "edgecolor": self._colours["heat"],
            "linewidth": 0.8,
        }
        self._axes.text(
            x,
            y,
            text,
            color=self._colours["ink"],
            fontsize=8,
            ha="center",
            va="center",
            bbox=card,
            zorder=12,
        )

    def sensor(self, pose: FloatArray) -> None:
        x, y, yaw = pose
        size = max(1.6, 0.011 * (self._extent[2] - self._extent[0]))
        arrow = np.array([[1, 0], [-0.7, 0.62], [-0.35, 0], [-0.7, -0.62]]) * size
        cos, sin = np.cos(yaw), np.sin(yaw)
        outline = arrow @ np.array([[cos, sin], [-sin, cos]]) + (x, y)
        self._polygons([outline], zorder=8, facecolor=self._colours["ink"])

    def truth(self, truth: GroundTruth) -> None:
        edge = self._colours["truth"]
        outlines = corners(truth.position, truth.size, truth.yaw)
        for seen, fill, line in ((True, self._colours["truth-fill"], "-"), (False, "none", "--")):
            chosen = outlines[truth.observable == seen]
            self._polygons(
                chosen, zorder=4, facecolor=fill, edgecolor=edge, linewidth=0.8, linestyle=line
            )
        for outline in outlines:
            # A windscreen says which way it faces.
            left = outline[0] + 0.28 * (outline[1] - outline[0])
            right = outline[3] + 0.28 * (outline[2] - outline[3])
            self._axes.plot(*zip(left, right, strict=True), color=edge, linewidth=0.8, zorder=4)

    def detections(self, detections: Detections, sensor: int = 0) -> None:
        """Boxes, the surer the stronger, of the sensor of that number."""
        outlines = corners(detections.position, detections.size, detections.yaw)
        for outline, score in zip(outlines, detections.score, strict=True):
            self._polygons(
                [outline],
                zorder=5,
                facecolor="none",
                edgecolor=self._colours["detection"],
                linewidth=0.9,
                linestyle=_DASHES[sensor % len(_DASHES)],
                alpha=0.35 + 0.65 * float(score),
            )

    def trails(self, history: Iterable[Tracks], colour: str) -> None:
        """Where each track came from: `history` is older first, the present last."""
        points: dict[int, list[FloatArray]] = {}
        for step in history:
            for identity, position in zip(step.id.tolist(), step.position, strict=True):
                points.setdefault(identity, []).append(position[:2])
        for line in points.values():
            self._axes.plot(*np.array(line).T, color=colour, linewidth=1.1, alpha=0.45, zorder=6)

    def tracks(self, tracks: Tracks, truth: GroundTruth, colour: str) -> None:
        """Boxes with their ids and velocity over one second; crosses on false ones, rings around
        observable objects that no track is near."""
        outlines = corners(tracks.position, tracks.size, tracks.yaw)
        self._polygons(
            outlines, zorder=7, facecolor="none", edgecolor=colour, linewidth=1.5, joinstyle="round"
        )
        is_track, is_object = matched(truth, tracks)
        error = self._colours["error"]
        lift = 0.012 * (self._extent[3] - self._extent[1])
        for row, outline in enumerate(outlines):
            x, y = tracks.position[row, :2]
            self._arrow((x, y), tracks.velocity[row], colour)
            self._words(str(tracks.id[row]), (x, outline[:, 1].max() + lift), colour)
            if not is_track[row]:
                self._axes.plot(x, y, "x", color=error, markersize=8, markeredgewidth=1.6, zorder=9)
        lost = ~is_object & truth.observable
        self._axes.plot(
            *truth.position[lost, :2].T, "o", color=error, fillstyle="none", markersize=17, zorder=9
        )

    def scale_bar(self) -> None:
        x0, y0, x1, _ = self._extent
        metres = next(m for m in (1, 2, 5, 10, 20, 50, 100, 200, 500) if m > 0.08 * (x1 - x0))
        inset = 0.02 * (x1 - x0)
        x, y = x0 + inset, y0 + inset
        soft = self._colours["soft"]
        tick = 0.006 * (x1 - x0)
        line = [(x, y + tick), (x, y), (x + metres, y), (x + metres, y + tick)]
        self._axes.plot(*zip(*line, strict=True), color=soft, linewidth=1.0, zorder=9)
        self._axes.text(
            x + metres + 0.4 * inset, y, f"{metres} m", color=soft, fontsize=8, va="center"
        )

    def caption(self, text: str, colour: str | None = None) -> None:
        self._axes.set_title(
            text, loc="left", color=colour or self._colours["ink"], fontsize=10, pad=6
        )

    def _words(self, text: str, place: tuple[float, float], colour: str) -> None:
        from matplotlib import patheffects

        halo = patheffects.withStroke(linewidth=2.2, foreground=self._colours["stage"])
        self._axes.text(
            *place,
            text,
            color=colour,
            fontsize=7.5,
            fontweight="bold",
            ha="center",
            va="bottom",
            path_effects=[halo],
            clip_on=True,
            zorder=9,
        )

    def _arrow(self, start: tuple[float, float], velocity: FloatArray, colour: str) -> None:
        if np.hypot(*velocity) < 0.5:
            return
        self._axes.annotate(
            "",
            (start[0] + velocity[0], start[1] + velocity[1]),
            start,
            arrowprops={
                "arrowstyle": "-|>,head_width=.14,head_length=.28",
                "color": colour,
                "linewidth": 1.0,
                "shrinkA": 0,
                "shrinkB": 0,
            },
            annotation_clip=True,
            zorder=7,
        )

    def _polygons(self, outlines: Iterable[ArrayLike], **style: Any) -> None:
        from matplotlib.collections import PolyCollection

        outlines = [np.asarray(outline) for outline in outlines]
        if outlines:
            self._axes.add_collection(PolyCollection(outlines, **style), autolim=False)

    def _region(self, region: shapely.Geometry, **style: Any) -> None:
        from matplotlib.patches import PathPatch
        from matplotlib.path import Path

        # shapely turns outlines and holes opposite ways, as the winding rule needs it.
        paths = [Path(ring, closed=True) for ring in rings(shapely.normalize(region))]
        if paths:
            style = {"linewidth": 0, "zorder": 1, **style}
            self._axes.add_patch(PathPatch(Path.make_compound_path(*paths), **style))


def planar_intensity(mixture: GaussianMixture, x: FloatArray, y: FloatArray) -> FloatArray:
    """Objects per square metre (len(y), len(x)) at the points of a grid."""
    total = np.zeros((len(y), len(x)))
    heavy = mixture.take(mixture.log_weight > np.log(1e-6))
    for log_weight, mean, cov in zip(heavy.log_weight, heavy.mean, heavy.cov, strict=True):
        (xx, xy), (_, yy) = cov[:2, :2]
        determinant = xx * yy - xy * xy
        if determinant <= 0:
            continue
        u = x - mean[0]
        v = (y - mean[1])[:, None]
        square = (yy * u**2 - 2 * xy * u * v + xx * v**2) / determinant
        total += np.exp(log_weight - square / 2) / (2 * np.pi * np.sqrt(determinant))
    return total
