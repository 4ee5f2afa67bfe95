"""Pictures for README files and documents, as matplotlib figures in one style."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.reports.drawing import (
    ScenePanel,
    add_heat_scale,
    add_legend,
    colours_of,
    planar_intensity,
    save,
    styled,
)
from pmbm.reports.error_picture import error_picture
from pmbm.reports.matching import first_detection
from pmbm.reports.palette import tracker_colour
from pmbm.reports.shadows import hidden_region
from pmbm.types import FloatArray, GaussianMixture, Recording, Tracks, TrackSequence

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["error_picture", "hidden_counts", "hidden_traffic_picture", "save", "scene_picture"]

Extent = tuple[float, float, float, float]
TRAIL_SECONDS = 2.0
SHOWN, LEAST = 3, 0.02
"""Shadows that are marked with their numbers, at most, and the fewest expected there."""


def scene_picture(
    recording: Recording,
    tracks: Mapping[str, TrackSequence] | None = None,
    frame: int | None = None,
    *,
    extent: Extent | None = None,
    dark: bool = False,
    width: float = 8.0,
) -> Figure:
    """One frame from above: truth, detections, shadows and field of view, and one panel a tracker.

    tracks : tracker -> what it said; without any, the scene alone.
    frame : of the truth; by default the one with the most hidden objects in view.
    extent : (x0, y0, x1, y1) to show, m; by default the traffic within range.
    width : inches.

    Write it with `save(figure, "scene.svg")`.  Raises InputError for a frame that is not there.
    """
    frame = _busiest(recording) if frame is None else frame
    _check_frame(recording, frame)
    panels = dict(tracks or {})
    extent = extent or traffic_extent(recording, frame)
    with styled():
        figure, axes = _figure(max(1, len(panels)), extent, dark=dark, width=width)
        for index, panel_axes in enumerate(axes):
            panel = ScenePanel(panel_axes, colours_of(dark), extent)
            draw_world(panel, recording, frame)
            if panels:
                name, sequence = list(panels.items())[index]
                colour = tracker_colour(colours_of(dark), index)
                draw_tracks(panel, recording, sequence, frame, colour)
                panel.caption(name, colour)
        when = f"{recording.name}, {recording.truth[frame].time:.1f} s"
        axes[0].set_title(when, loc="right", color=colours_of(dark)["soft"], fontsize=8, pad=6)
        add_legend(figure, colours_of(dark), recording.site, tracks=bool(panels))
    return figure


def hidden_traffic_picture(
    recording: Recording,
    tracks: TrackSequence,
    frame: int | None = None,
    *,
    extent: Extent | None = None,
    dark: bool = False,
    width: float = 8.0,
) -> Figure:
    """The map of what cannot be seen: the intensity of undetected objects, and for each shadow how
    many the tracker expects there beside how many there are.

    tracks : of a tracker that gives `Tracks.undetected`.
    frame : of the truth; by default the last one with the most hidden objects that no detection
        has shown.
    extent, width : as for `scene_picture`.

    Raises InputError for a frame that is not there or that has no intensity.
    """
    frame = _most_unknown(recording, tracks) if frame is None else frame
    _check_frame(recording, frame)
    report = report_at(tracks, frame)
    if report is None or report.undetected is None:
        raise InputError(
            "there is no intensity of undetected objects to draw",
            frame=frame,
            hint="a tracker gives it as Tracks.undetected, for the frames that it was stepped",
        )
    extent = extent or traffic_extent(recording, frame)
    colours = colours_of(dark)
    with styled():
        figure, (axes,) = _figure(1, extent, dark=dark, width=width)
        panel = ScenePanel(axes, colours, extent)
        truth = recording.truth[frame]
        unknown = truth.take(never_detected(recording, frame) & ~truth.observable)
        counted = hidden_counts(recording, report, frame, extent, least=0.0)
        worth_telling = [c for c in counted if c.there or c.expected >= LEAST]
        panel.heat(report.undetected)
        draw_world(panel, recording, frame)
        panel.tracks(report, truth, tracker_colour(colours, 0))
        panel.unknown(unknown)
        for count in sorted(worth_telling, key=lambda c: (c.there, c.expected))[-SHOWN:]:
            panel.marked(count.region)
            panel.callout(f"{count.expected:.2f} expected, {count.there} there", count.place)
        total, there = sum(c.expected for c in counted), sum(c.there for c in counted)
        panel.caption(f"Undetected objects in all shadows: {total:.2f} expected, {there} there")
        when = f"{recording.name}, {recording.truth[frame].time:.1f} s"
        axes.set_title(when, loc="right", color=colours["soft"], fontsize=8, pad=6)
        add_heat_scale(axes, colours)
        add_legend(figure, colours, recording.site, tracks=True, unknown=True)
    return figure


class HiddenCount(NamedTuple):
    """Undetected objects in a shadow: how many a tracker expects, and how many are there.

    place (2,) : a point in it, in its widest part.
    """

    place: FloatArray
    region: shapely.Polygon
    expected: float
    there: int


def hidden_counts(
    recording: Recording, report: Tracks, frame: int, extent: Extent, *, least: float = LEAST
) -> list[HiddenCount]:
    """Per connected shadow within `extent`: the expected number of undetected objects, and the true
    number of objects there that no detection has ever shown.

    Shadows with fewer than `least` expected and none there are left out.
    """
    assert report.undetected is not None
    truth = recording.truth[frame]
    region = hidden_region(truth, recording.site, sensor_pose(recording, frame))
    region = shapely.intersection(region, shapely.box(*extent))
    unknown = never_detected(recording, frame)
    found = []
    for part in shapely.get_parts(region):
        if part.geom_type != "Polygon":
            continue
        expected = expected_in(report.undetected, part)
        # An object's own box casts the shadow's edge: count those whose centre it nearly holds.
        inside = shapely.contains_xy(part.buffer(1.5), *truth.position[:, :2].T)
        there = int((inside & unknown & ~truth.observable).sum())
        if expected >= least or there:
            widest = shapely.maximum_inscribed_circle(part, tolerance=0.5).coords[0]
            found.append(HiddenCount(np.array(widest), part, expected, there))
    return found


def never_detected(recording: Recording, frame: int) -> NDArray[np.bool_]:
    """The objects of a frame that no detection has shown up to then."""
    first = first_detection(recording)
    return np.array(
        [first.get(i, frame + 1) > frame for i in recording.truth[frame].id.tolist()], dtype=bool
    )


def expected_in(mixture: GaussianMixture, region: shapely.Polygon, step: float = 0.5) -> float:
    """Expected objects in a region, by the midpoint rule on a grid of `step` m."""
    x0, y0, x1, y1 = region.bounds
    x = np.arange(x0 + step / 2, x1, step)
    y = np.arange(y0 + step / 2, y1, step)
    if not len(x) or not len(y):
        return 0.0
    inside = shapely.contains_xy(region, *np.meshgrid(x, y))
    return float(planar_intensity(mixture, x, y)[inside].sum() * step**2)


def draw_world(panel: ScenePanel, recording: Recording, frame: int) -> None:
    """Site, what cannot be seen, truth, sensor and detections of a frame."""
    truth = recording.truth[frame]
    pose = sensor_pose(recording, frame)
    panel.site(recording.site)
    panel.unseen(truth, recording.site, pose)
    panel.truth(truth)
    names = [one.name for one in recording.site.sensors]
    for delivery in np.flatnonzero(recording.frame == frame):
        seen = recording.detections[delivery]
        panel.detections(seen, names.index(seen.sensor) if names else 0)
    panel.sensor(pose)
    panel.scale_bar()


def draw_tracks(
    panel: ScenePanel, recording: Recording, sequence: TrackSequence, frame: int, colour: str
) -> None:
    """A tracker's boxes in a frame, with trails of the last two seconds."""
    now = recording.truth[frame].time
    past = [
        step
        for step, at in zip(sequence, sequence.frame.tolist(), strict=True)
        if at <= frame and recording.truth[at].time >= now - TRAIL_SECONDS
    ]
    present = report_at(sequence, frame) or Tracks.empty(now)
    shown = set(present.id.tolist())
    panel.trails([step.take([i in shown for i in step.id.tolist()]) for step in past], colour)
    panel.tracks(present, recording.truth[frame], colour)


def report_at(sequence: TrackSequence, frame: int) -> Tracks | None:
    """The tracker's report of a frame, or None where it was not stepped."""
    steps = np.flatnonzero(sequence.frame == frame)
    return sequence[int(steps[0])] if len(steps) else None


def sensor_pose(recording: Recording, frame: int) -> FloatArray:
    """Where the sensor was, or the carrier of several: of the frame's delivery, or of the nearest
    one."""
    if not len(recording.detections):
        return np.zeros(3)
    nearest = int(np.abs(recording.frame - frame).argmin())
    return recording.site.carrier_pose(recording.detections[nearest])


def traffic_extent(recording: Recording, frame: int) -> Extent:
    """The rectangle around the sensor and the objects within its range; at least as wide as high,
    at most three times."""
    pose = sensor_pose(recording, frame)
    position = recording.truth[frame].position[:, :2]
    near = np.hypot(*(position - pose[:2]).T) <= recording.site.max_range
    points = np.vstack([pose[None, :2], position[near]])
    low, high = points.min(axis=0) - 8, points.max(axis=0) + 8
    centre, half = (low + high) / 2, (high - low) / 2
    half = np.maximum(half, [half[1], half[0] / 3])
    x0, y0 = centre - half
    x1, y1 = centre + half
    return float(x0), float(y0), float(x1), float(y1)


def _figure(panels: int, extent: Extent, *, dark: bool, width: float) -> tuple[Figure, list[Any]]:
    from matplotlib.figure import Figure

    ratio = (extent[3] - extent[1]) / (extent[2] - extent[0])
    # Wide scenes are stacked, others stand side by side.
    rows, columns = (panels, 1) if ratio < 0.6 else (1, panels)
    height = width / columns * ratio * rows + 0.35 * rows + 0.3
    figure = Figure(figsize=(width, height), layout="constrained")
    figure.set_facecolor(colours_of(dark)["card"])
    axes = figure.subplots(rows, columns, squeeze=False).ravel().tolist()
    return figure, axes


def _busiest(recording: Recording) -> int:
    """The frame with the most objects that are hidden within range, then with the most objects."""
    keys = []
    for frame, truth in enumerate(recording.truth):
        pose = sensor_pose(recording, frame)
        near = np.hypot(*(truth.position[:, :2] - pose[:2]).T) <= recording.site.max_range
        keys.append((int((near & ~truth.observable).sum()), int(near.sum()), -frame))
    return max(range(len(keys)), key=keys.__getitem__) if keys else 0


def _most_unknown(recording: Recording, tracks: TrackSequence) -> int:
    """The last stepped frame with the most objects out of sight that no detection has shown, then
    with the most out of sight."""
    keys = []
    for frame in tracks.frame.tolist():
        truth = recording.truth[frame]
        offset = truth.position[:, :2] - sensor_pose(recording, frame)[:2]
        hidden = (np.hypot(*offset.T) <= recording.site.max_range) & ~truth.observable
        unknown = hidden & never_detected(recording, frame)
        keys.append((int(unknown.sum()), int(hidden.sum()), frame))
    return max(keys)[2] if keys else 0


def _check_frame(recording: Recording, frame: int) -> None:
    if not 0 <= frame < len(recording):
        raise InputError(
            f"recording '{recording.name}' has no such frame",
            field="frame",
            expected=f"0 to {len(recording) - 1}",
            got=frame,
        )
