"""Integer stamps, a near origin, outlines and colours for the logs of all viewers."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np

from pmbm.reports.hidden_grid import HiddenGrid, hidden_grid
from pmbm.reports.palette import LIGHT, TRACKERS
from pmbm.reports.values import ReplayPage
from pmbm.types import FloatArray, Label, Recording, Tracks

FAR: Final = 10_000.0
"""m: viewers draw in float32, which at this distance still tells a millimetre from the next."""
_GRID: Final = 1_000.0
_CORNERS: Final = 24
_SIGMAS: Final = 2.0

_OPACITY: Final = 0.4

Colour = tuple[float, float, float, float]
"""Red, green, blue and opacity, each in [0, 1]."""


def colour(name: str, opacity: float = _OPACITY) -> Colour:
    """A colour of the palette."""
    digits = LIGHT[name].lstrip("#")
    red, green, blue = (int(digits[i : i + 2], 16) / 255 for i in (0, 2, 4))
    return red, green, blue, opacity


def colour_of_tracker(place: int) -> Colour:
    """The colour of the tracker at that place in the list."""
    return colour(f"tracker-{place % TRACKERS}")


class Clock:
    """Stamps of a recording: whole nanoseconds, at least 0.

    `offset` is the second that stamp 0 stands for: 0, or the first time where that is before 0.
    """

    def __init__(self, recording: Recording) -> None:
        times = [frame.time for frame in recording.truth]
        times += [each.time for each in recording.detections]
        self.offset = min(0.0, *times)

    def __call__(self, time: float) -> int:
        # Rounded, never cut: 4.35 s is 4,350,000,000 ns.
        return nanoseconds(time) - nanoseconds(self.offset)


def nanoseconds(time: float) -> int:
    """The nearest whole nanosecond, whole seconds apart so that large times lose nothing."""
    seconds = math.floor(time)
    return seconds * 1_000_000_000 + round((time - seconds) * 1e9)


def origin_of(recording: Recording) -> FloatArray:
    """(3,) m in the world: 0 where everything is near it; else a round number near the scene."""
    positions = [each.position for each in recording.truth]
    positions += [each.position for each in recording.detections]
    positions += [np.append(each.sensor_pose[:2], 0.0)[None] for each in recording.detections[:1]]
    table = np.concatenate(positions)
    if not len(table) or np.abs(table).max() < FAR:
        return np.zeros(3)
    middle = np.rint(table.mean(axis=0) / _GRID) * _GRID
    return np.where(np.abs(table).max(axis=0) < FAR, 0.0, middle)


def label_name(label: int) -> str:
    return Label(label).name.lower()


def track_text(tracks: Tracks, row: int) -> str:
    return f"{int(tracks.id[row])} {label_name(tracks.label[row])} {tracks.score[row]:.2f}"


def spread(tracks: Tracks, row: int) -> FloatArray | None:
    """(V,2) m in the world: the ellipse of two standard deviations of a track's position."""
    if tracks.covariance is None:
        return None
    variances, axes = np.linalg.eigh(tracks.covariance[row, :2, :2])
    radii = _SIGMAS * np.sqrt(np.clip(variances, 0.0, None))
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return tracks.position[row, :2] + (circle * radii) @ axes.T


def view_outline(centre: float, half_angle: float, reach: float) -> FloatArray:
    """(V,2) m in the sensor's frame: what a field of view takes in."""
    arc = centre + np.linspace(-half_angle, half_angle, 2 * _CORNERS + 1)
    outline = reach * np.stack([np.cos(arc), np.sin(arc)], axis=1)
    return outline if half_angle >= np.pi else np.concatenate([np.zeros((1, 2)), outline])


def grids(replay: ReplayPage, origin: FloatArray) -> Iterator[tuple[str, HiddenGrid]]:
    """Of each tracker that says where it expects undetected objects, its name and the grid, which
    has a corner at the origin."""
    for name, tracks in replay.tracks.items():
        grid = hidden_grid(replay.recording, replay.maps.get(name, tracks), origin[:2])
        if grid is not None:
            yield name, grid
