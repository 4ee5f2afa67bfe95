"""A scenario's roads as the lanes of a highway-env network."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.sim.schema import Road as RoadForm
from pmbm.sim.world.highway import env as highway
from pmbm.sim.world.highway.env import AbstractLane, CircularLane, StraightLane

LaneIndex = tuple[str, str, int]


@dataclass(frozen=True, eq=False)
class Network:
    """Roads by name, each a chain of lane segments that a vehicle follows."""

    network: Any
    segments: dict[str, list[tuple[str, str]]]

    def at(self, road: str, lane: int, position: float) -> tuple[LaneIndex, float]:
        """The lane, and the distance along it, `position` metres along a road."""
        for start, end in self.segments[road]:
            index = (start, end, lane)
            length = float(self.network.get_lane(index).length)
            if position < length or (start, end) == self.segments[road][-1]:
                return index, position
            position -= length
        raise AssertionError("a road has a segment")


def lay(forms: dict[str, RoadForm]) -> Network:
    """The road network in highway-env's frame."""
    network = highway.RoadNetwork()
    segments = {}
    for name, form in forms.items():
        if form.leads_to is not None and form.leads_to not in forms:
            raise InputError(
                f"road '{name}' leads to no road",
                field=f"scene.roads.{name}.leads_to",
                got=form.leads_to,
                hint=nearest_hint(form.leads_to, forms, "road"),
            )
        straight = form.start is not None and form.end is not None
        arc = None not in (form.centre, form.radius, form.from_deg, form.to_deg)
        if straight == arc or (straight and form.start == form.end):
            raise InputError(
                f"road '{name}' is neither straight nor an arc",
                field=f"scene.roads.{name}",
                expected="start and end, or centre, radius, from_deg and to_deg",
            )
        end_node = f"{name}.end" if form.leads_to is None else f"{form.leads_to}.0"
        pieces = 1
        if arc:
            assert form.from_deg is not None
            assert form.to_deg is not None
            # Local coordinates on an arc wrap at half a turn, so no piece may come near it.
            pieces = max(1, int(np.ceil(abs(form.to_deg - form.from_deg) / 90.0)))
        nodes = [f"{name}.{i}" for i in range(pieces)] + [end_node]
        segments[name] = list(itertools.pairwise(nodes))
        for piece, (start, end) in enumerate(segments[name]):
            for lane in range(form.lanes):
                network.add_lane(start, end, _lane(form, lane, piece, pieces))
    return Network(network, segments)


def _lane(form: RoadForm, lane: int, piece: int, pieces: int) -> AbstractLane:
    offset = lane * form.width
    if form.start is not None:
        start, end = np.array(form.start) * (1, -1), np.array(form.end) * (1, -1)
        along = (end - start) / np.hypot(*(end - start))
        aside = offset * np.array([-along[1], along[0]])
        return StraightLane(
            start + aside, end + aside, width=form.width, speed_limit=form.speed_limit
        )
    assert form.centre is not None
    assert form.radius is not None
    assert form.from_deg is not None
    assert form.to_deg is not None
    turn = form.to_deg - form.from_deg
    first, last = (np.deg2rad(form.from_deg + turn * (piece + i) / pieces) for i in (0, 1))
    left = turn > 0
    return CircularLane(
        np.array(form.centre) * (1, -1),
        form.radius + (offset if left else -offset),
        -first,
        -last,
        clockwise=not left,
        width=form.width,
        speed_limit=form.speed_limit,
    )
