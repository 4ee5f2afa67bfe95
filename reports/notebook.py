"""Replays in notebooks."""

from __future__ import annotations

import html
from collections.abc import Mapping
from dataclasses import dataclass

from pmbm.metrics import evaluate
from pmbm.reports.render import replay_page
from pmbm.reports.values import ReplayPage
from pmbm.types import Recording, TrackSequence


@dataclass(frozen=True, eq=False)
class Shown:
    """A replay that a notebook shows as the value of a cell, in a frame of its own."""

    replay: ReplayPage
    height: int = 1000

    def _repr_html_(self) -> str:
        page = html.escape(replay_page(self.replay), quote=True)
        return (
            f'<iframe srcdoc="{page}" sandbox="allow-scripts" width="100%" '
            f'height="{self.height}" style="border:0"></iframe>'
        )


def show(
    recording: Recording, tracks: Mapping[str, TrackSequence] | TrackSequence | None = None
) -> Shown:
    """The replay of a recording, with what trackers said of it.

    tracks : tracker -> what it said; or of one tracker; or nothing, for the scene alone.

    Example, as the last line of a notebook's cell: ``show(recording, {"pmbm": tracks})``.
    """
    if isinstance(tracks, TrackSequence):
        tracks = {"tracks": tracks}
    series = {
        name: {k: v.series for k, v in evaluate(recording, said).items() if v.series is not None}
        for name, said in (tracks or {}).items()
    }
    return Shown(ReplayPage(recording=recording, tracks=tracks or {}, series=series))
