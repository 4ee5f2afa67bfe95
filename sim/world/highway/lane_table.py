"""All lanes of a road network as arrays: where many things are on every lane at once.

Every value has the bits that highway-env's lanes compute one by one: the same operations in the
same order, with `vecdot` for `dot` (one kernel under both), and numpy's trigonometry.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pmbm.sim.world.highway.env import AbstractLane, CircularLane, SineLane, StraightLane
from pmbm.types import FloatArray, IntArray

LaneIndex = tuple[str, str, int]
REACH = float(AbstractLane.VEHICLE_LENGTH)
"""m that a lane counts as going on beyond its ends."""
_KNOWN = (StraightLane, SineLane, CircularLane)


def wrap(angle: FloatArray) -> FloatArray:
    """Wrap angles as highway-env does, to the bit."""
    return np.asarray(((angle + np.pi) % (2 * np.pi)) - np.pi)


class LaneTable:
    """The lanes of a network in the network's order; M lanes, N things.

    index : the network's name of each lane.  column : name -> number.
    length, half_width (M,) : m.  limit (M,) : m/s, or None where there is none.
    lowest, highest (M,) : the same as bounds of a wanted speed.
    """

    def __init__(self, network: Any) -> None:
        lanes = network.lanes_dict()
        self.network = network
        self.index: list[LaneIndex] = list(lanes)
        self.lanes = list(lanes.values())
        self.column = {index: column for column, index in enumerate(self.index)}
        self.length = np.array([lane.length for lane in self.lanes], np.float64)
        self.half_width = np.array([lane.width / 2 for lane in self.lanes], np.float64)
        self.limit = [lane.speed_limit for lane in self.lanes]
        self.lowest = np.array([-np.inf if limit is None else 0.0 for limit in self.limit])
        self.highest = np.array([np.inf if limit is None else limit for limit in self.limit])
        self._searches: dict[bool, tuple[IntArray, IntArray, FloatArray]] = {}
        kinds = np.array([_KNOWN.index(type(lane)) for lane in self.lanes], np.int64)
        self._straight, self._sine, self._arc = (np.flatnonzero(kinds == k) for k in range(3))
        # A sine lane is a straight one with a swing.
        self._based = np.flatnonzero(kinds < 2)
        based = [self.lanes[k] for k in self._based]
        self._start = _table([lane.start for lane in based], 2)
        self._along = _table([lane.direction for lane in based], 2)
        self._aside = _table([lane.direction_lateral for lane in based], 2)
        self._heading = np.array([lane.heading for lane in based], np.float64)
        sines = [self.lanes[k] for k in self._sine]
        self._amplitude, self._pulsation, self._phase = (
            np.array([getattr(lane, name) for lane in sines], np.float64)
            for name in ("amplitude", "pulsation", "phase")
        )
        # Of each lane, its row in the tables of its kind.
        self._row = np.zeros(len(self.lanes), np.int64)
        for columns in (self._sine, self._arc):
            self._row[columns] = np.arange(len(columns))
        self._kind = kinds
        self._own_heading = np.zeros(len(self.lanes))
        self._own_heading[self._based] = self._heading
        arcs = [self.lanes[k] for k in self._arc]
        self._centre = _table([lane.center for lane in arcs], 2)
        self._radius, self._start_phase, self._turn = (
            np.array([getattr(lane, name) for lane in arcs], np.float64)
            for name in ("radius", "start_phase", "direction")
        )

    @staticmethod
    def knows(network: Any) -> bool:
        """Whether every lane is exactly of a class whose arithmetic stands here."""
        return all(type(lane) in _KNOWN for lane in network.lanes_list())

    def coordinates(self, position: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How far along (N,M) and to the right of (N,M) each lane's line things (N,2) are, m."""
        if len(self._straight) == len(self.lanes):
            delta = position[:, None, :] - self._start
            return np.vecdot(delta, self._along), np.vecdot(delta, self._aside)
        along = np.empty((len(position), len(self.lanes)))
        aside = np.empty_like(along)
        if len(self._based):
            delta = position[:, None, :] - self._start
            along[:, self._based] = np.vecdot(delta, self._along)
            aside[:, self._based] = np.vecdot(delta, self._aside)
        if len(self._sine):
            swing = np.sin(self._pulsation * along[:, self._sine] + self._phase)
            aside[:, self._sine] -= self._amplitude * swing
        if len(self._arc):
            delta = position[:, None, :] - self._centre
            phase = np.arctan2(delta[..., 1], delta[..., 0])
            phase = self._start_phase + wrap(phase - self._start_phase)
            distance = np.sqrt(np.vecdot(delta, delta))
            along[:, self._arc] = self._turn * (phase - self._start_phase) * self._radius
            aside[:, self._arc] = self._turn * (self._radius - distance)
        return along, aside

    def headings(self, along: FloatArray) -> FloatArray:
        """Headings (N,M) of the lanes at places (N,M) along them, rad."""
        heading = np.broadcast_to(self._own_heading, along.shape)
        if len(self._straight) == len(self.lanes):
            return heading
        heading = heading.copy()
        every = slice(None)
        if len(self._sine):
            heading[:, self._sine] += self._swing(every, along[:, self._sine])
        if len(self._arc):
            heading[:, self._arc] = self._tangent(every, along[:, self._arc])
        return heading

    def headings_of(self, columns: IntArray, along: FloatArray) -> FloatArray:
        """Headings (N,) of lanes (N,) at places (N,) along them, rad."""
        heading = self._own_heading[columns]
        if len(self._sine):
            at = self._kind[columns] == _KNOWN.index(SineLane)
            heading[at] += self._swing(self._row[columns[at]], along[at])
        if len(self._arc):
            at = self._kind[columns] == _KNOWN.index(CircularLane)
            heading[at] = self._tangent(self._row[columns[at]], along[at])
        return heading

    def _swing(self, row: Any, along: FloatArray) -> FloatArray:
        """The angle between sine lanes and the line that they swing about, rad."""
        slope = np.cos(self._pulsation[row] * along + self._phase[row])
        return np.arctan(self._amplitude[row] * self._pulsation[row] * slope)

    def _tangent(self, row: Any, along: FloatArray) -> FloatArray:
        """Headings of arcs."""
        phase = self._turn[row] * along / self._radius[row] + self._start_phase[row]
        return np.asarray(phase + np.pi / 2 * self._turn[row])

    def closest(self, along: FloatArray, aside: FloatArray, heading: FloatArray) -> Any:
        """The column of the lane (N,) that is closest in place and heading, the first of equals."""
        angle = np.abs(wrap(heading[:, None] - self.headings(along)))
        distance = np.abs(aside) + np.maximum(along - self.length, 0) + np.maximum(0 - along, 0)
        distance += angle
        return np.argmin(distance, axis=1)

    def searches(self, connected: bool) -> tuple[IntArray, IntArray, FloatArray]:
        """The lanes that a search for neighbours on each lane looks at in turn: `first` (M+1,) of
        lane m's in the others, columns and offsets."""
        found = self._searches.get(connected)
        if found is None:
            each = [self._search(column, connected) for column in range(len(self.lanes))]
            pairs = [pair for of_lane in each for pair in of_lane]
            found = self._searches[connected] = (
                np.cumsum([0, *map(len, each)]),
                np.array([column for column, _ in pairs], np.int64),
                np.array([offset for _, offset in pairs], np.float64),
            )
        return found

    def _search(self, column: int, connected: bool) -> list[tuple[int, float]]:
        graph, (start, end, number) = self.network.graph, self.index[column]
        own_length = float(self.length[column])
        found = [(column, 0.0)]
        if not connected:
            return found
        for node, following in graph.get(end, {}).items():
            if following:
                next_number = number if number < len(following) else 0
                found.append((self.column[end, node, next_number], own_length))
        for node, ends in graph.items():
            leading = ends.get(start)
            if leading:
                last = self.column[node, start, number if number < len(leading) else 0]
                found.append((last, -float(self.length[last])))
        return found


def _table(rows: list[Any], width: int) -> FloatArray:
    return np.array(rows, dtype=np.float64).reshape(-1, width)
