"""Decisions and controls of all vehicles of a road together, to the bit of stock highway-env.

See `pmbm.sim.world.highway.fast_road` for what makes it exact.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from pmbm.kernels import twin
from pmbm.sim.world.highway.env import (
    ControlledVehicle,
    IDMVehicle,
    Landmark,
    RoadObject,
    Vehicle,
)
from pmbm.sim.world.highway.lane_table import REACH, LaneTable, wrap
from pmbm.types import BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from pmbm.sim.world.highway.fast_road import FastRoad

_METHODS = (
    "act", "step", "clip_actions", "on_state_update", "follow_road", "steering_control",
    "speed_control", "lane_distance_to", "direction", "velocity", "handle_collisions", "polygon",
)  # fmt: skip
_DRIVER_METHODS = ("acceleration", "desired_gap", "change_lane_policy", "mobil")


_kinds: dict[Any, Any] = {}


def kind_of(vehicle: Any) -> Any:
    """The stock class of which a vehicle has every method of a step, or None."""
    cls = type(vehicle)
    if cls not in _kinds:
        _kinds[cls] = _kind(cls)
    return _kinds[cls]


def _kind(cls: Any) -> Any:
    for base in (IDMVehicle, ControlledVehicle):
        names = _METHODS + (_DRIVER_METHODS if base is IDMVehicle else ())
        if issubclass(cls, base) and all(
            getattr(cls, name) is getattr(base, name) for name in names
        ):
            return base
    return None


def _not_zero(x: FloatArray) -> FloatArray:
    return np.where(np.abs(x) > 1e-2, x, np.where(x >= 0, 1e-2, -1e-2))


def column_of(values: list[Any]) -> FloatArray:
    return np.array(values, dtype=np.float64)


def rows_of(mask: BoolArray) -> IntArray:
    """The rows (R,) at which a mask (N,) holds: a third of what `np.flatnonzero` costs."""
    found: IntArray = mask.nonzero()[0]
    return found


class Fleet:
    """The parameters of the things on a road, one a row, which do not change while these are the
    same.

    Rows are the road's vehicles, then its objects.
    known : whether the step of every vehicle and object is the stock one.
    driver (N,), changer (N,) : whether a vehicle drives by IDM, and changes lanes.
    seen (N,) : which things a search for neighbours sees: all but landmarks.
    """

    def __init__(self, vehicles: list[Any], objects: list[Any]) -> None:
        self.vehicles, self.objects = list(vehicles), list(objects)
        self.things = self.vehicles + self.objects
        kinds = [kind_of(vehicle) for vehicle in vehicles]
        self.known = (
            len(vehicles) > 0
            and None not in kinds
            and all(type(thing).__module__ == RoadObject.__module__ for thing in objects)
        )
        self.seen = np.array([not isinstance(thing, Landmark) for thing in self.things], bool)
        self.half_length = column_of([thing.LENGTH / 2 for thing in self.things])
        self.half_width = column_of([thing.WIDTH / 2 for thing in self.things])
        if not self.known:
            return
        self.driver = np.array([kind is IDMVehicle for kind in kinds])
        self.drivers = [v for v, driver in zip(vehicles, self.driver, strict=True) if driver]
        self.changer = np.array(
            [
                kind is IDMVehicle and v.enable_lane_change
                for v, kind in zip(vehicles, kinds, strict=True)
            ],
            bool,
        )
        self.delay = self.of_drivers("LANE_CHANGE_DELAY")
        self.slowest, self.fastest = self.of_all("MIN_SPEED"), self.of_all("MAX_SPEED")
        self.pursuit, self.lateral = self.of_all("TAU_PURSUIT"), self.of_all("KP_LATERAL")
        self.turning, self.steering = self.of_all("KP_HEADING"), self.of_all("MAX_STEERING_ANGLE")
        self.comfort, self.brake = (
            self.of_drivers(name) for name in ("COMFORT_ACC_MAX", "COMFORT_ACC_MIN")
        )
        self.exponent, self.most = self.of_drivers("DELTA"), self.of_drivers("ACC_MAX")
        self.gap, self.headway = self.of_drivers("DISTANCE_WANTED"), self.of_drivers("TIME_WANTED")
        # The names that were looked up last, and what was found.
        self._lanes: dict[str, tuple[list[Any], list[int]]] = {}

    def of_all(self, name: str) -> FloatArray:
        return column_of([getattr(vehicle, name) for vehicle in self.vehicles])

    def of_drivers(self, name: str) -> FloatArray:
        """A parameter of IDM, or nan where a vehicle has none."""
        return column_of([getattr(vehicle, name, math.nan) for vehicle in self.vehicles])

    def same(self, vehicles: list[Any], objects: list[Any]) -> bool:
        return self.vehicles == vehicles and self.objects == objects

    def columns(self, name: str, table: LaneTable) -> list[int]:
        """The columns of the lanes that an attribute of the vehicles names.

        Raises KeyError or TypeError where it names none of the table's.
        """
        names = list(map(attrgetter(name), self.vehicles))
        known = self._lanes.get(name)
        if known is None or known[0] != names:
            columns = [table.column[tuple(lane)] for lane in names]
            known = self._lanes[name] = names, columns
        return list(known[1])


class Places:
    """The places of everything on a road for one setting of positions: vehicles, then objects."""

    def __init__(self, road: FastRoad, moved: FloatArray | None = None) -> None:
        """`moved` (N,2) : of the vehicles, where they are known."""
        self.things = road.fleet.things
        if moved is None or road.objects:
            self.position = positions(self.things)
        else:
            self.position = moved
        self.along, self.aside = road.table.coordinates(self.position)

    def hold(self, road: FastRoad) -> bool:
        """Whether everything is still where it was."""
        things = road.fleet.things
        return things is self.things and np.array_equal(self.position, positions(things))


def positions(things: list[Any]) -> FloatArray:
    return np.concatenate([thing.position for thing in things]).reshape(-1, 2)


@twin("neighbours")
def neighbours(
    along: FloatArray,
    aside: FloatArray,
    seen: BoolArray,
    half_width: FloatArray,
    length: FloatArray,
    first: IntArray,
    searched: IntArray,
    offset: FloatArray,
    reach: float,
    row: IntArray,
    column: IntArray,
) -> tuple[IntArray, IntArray]:
    """The front and the rear neighbours (Q,) of things `row` (Q,) on lanes `column` (Q,); -1 is
    nobody.

    along, aside (N,M) : of N things on M lanes.  seen (N,) : by a search.
    half_width, length (M,) : of the lanes; a lane goes on for `reach` beyond its ends.
    first, searched, offset : as of `LaneTable.searches`.
    """
    front, rear = np.full(len(row), -1), np.full(len(row), -1)
    for lane in np.unique(column).tolist():
        free = seen.copy()
        found_places, found_rows = [], []
        for k in range(first[lane], first[lane + 1]):
            at, across = along[:, searched[k]], aside[:, searched[k]]
            on_lane = (
                free
                & (np.abs(across) <= half_width[searched[k]] + 1)
                & (at >= -reach)
                & (at < length[searched[k]] + reach)
            )
            free &= ~on_lane
            found_rows.append(np.flatnonzero(on_lane))
            found_places.append(at[on_lane] + offset[k])
        rows, places = np.concatenate(found_rows), np.concatenate(found_places)
        order = np.lexsort((rows, places))
        line = places[order].tolist(), rows[order].tolist()
        for query in np.flatnonzero(column == lane).tolist():
            own = int(row[query])
            here = bisect_left(line[0], float(along[own, lane]))
            front[query] = _nearest(*line, own, range(here, len(line[0])))
            rear[query] = _nearest(*line, own, range(here - 1, -1, -1))
    return front, rear


def _nearest(places: list[float], rows: list[int], own: int, order: range) -> int:
    """The row of the first in this order but the thing itself: of equals the last."""
    best, best_place = -1, math.nan
    for k in order:
        if rows[k] == own:
            continue
        if best >= 0 and places[k] != best_place:
            break
        best, best_place = rows[k], places[k]
    return best


class Act:
    """The `act` of a road at one time: lane decisions one by one, then all controls together.

    Rows are the road's vehicles, then its objects; `lane` and `target` hold a vehicle's current and
    target lane as a column of the table.
    """

    def __init__(self, road: FastRoad) -> None:
        self.road, self.table, self.fleet = road, road.table, road.fleet
        self.vehicles = self.fleet.vehicles
        self.places = road.places()
        things = self.places.things
        self.speeds = column_of([thing.speed for thing in things])
        self.speed = self.speeds.tolist()
        self.heading = column_of([thing.heading for thing in things])
        self.direction = np.stack([np.cos(self.heading), np.sin(self.heading)], axis=1)
        self.velocity = self.speeds[:, None] * self.direction

    def run(self) -> bool:
        """False, with nothing done, where a vehicle is on a lane that the table does not have."""
        fleet = self.fleet
        try:
            self.lane = fleet.columns("lane_index", self.table)
            self.target = fleet.columns("target_lane_index", self.table)
        except (KeyError, TypeError):
            return False
        lane, target = np.array(self.lane), np.array(self.target)
        crashed = np.array([vehicle.crashed for vehicle in self.vehicles], bool)
        timer = np.full(len(self.vehicles), math.nan)
        timer[fleet.driver] = [vehicle.timer for vehicle in fleet.drivers]
        past_end = self.places.along[np.arange(len(target)), target] > (
            self.table.length[target] - REACH / 2
        )
        idle = fleet.driver & crashed
        due = fleet.changer & (timer > fleet.delay)
        changes = due | (fleet.changer & ((lane != target) | past_end))
        self.gains = self._gains(rows_of(due & ~idle))
        for row in rows_of((past_end | changes) & ~idle).tolist():
            vehicle = self.vehicles[row]
            if past_end[row]:
                self._follow_road(row, vehicle)
            if fleet.changer[row]:
                self._change_lane(row, vehicle)
        self._control(rows_of(fleet.driver & ~idle), rows_of(~fleet.driver))
        return True

    def neighbours(self, rows: IntArray, columns: IntArray) -> tuple[IntArray, IntArray]:
        """Rows of the front and of the rear neighbours of things on lanes; -1 is nobody."""
        table, places = self.table, self.places
        return neighbours(
            places.along, places.aside, self.fleet.seen, table.half_width, table.length,
            *table.searches(self.road.neighbour_vehicles_connected_lanes), REACH, rows, columns,
        )  # fmt: skip

    # --- decisions, one vehicle at a time ------------------------------------------------------

    def _aim(self, row: int, vehicle: Vehicle, target: Any) -> None:
        vehicle.target_lane_index = target
        self.target[row] = self.table.column[tuple(target)]

    def _follow_road(self, row: int, vehicle: Vehicle) -> None:
        following = self.road.network.next_lane(
            vehicle.target_lane_index,
            route=vehicle.route,
            position=vehicle.position,
            np_random=self.road.np_random,
        )
        self._aim(row, vehicle, following)

    def _change_lane(self, row: int, vehicle: Vehicle) -> None:
        lane, target = self.lane[row], self.target[row]
        if lane != target:
            if vehicle.lane_index[:2] == vehicle.target_lane_index[:2]:
                self._perhaps_abort(row, vehicle)
            return
        if not vehicle.timer > vehicle.LANE_CHANGE_DELAY:
            return
        vehicle.timer = 0
        for side in self.road.network.side_lanes(vehicle.lane_index):
            column = self.table.column[side]
            if (row, column) in self.gains and self._worth_it(row, vehicle, side, column):
                self._aim(row, vehicle, side)

    def _perhaps_abort(self, row: int, vehicle: Vehicle) -> None:
        """Give up a change of lane where somebody ahead changes into the same lane."""
        lane, target = self.lane[row], self.target[row]
        along = self.places.along
        for other, aim in enumerate(self.target):
            if aim == target and other != row and self.lane[other] != target:
                gap = float(along[other, lane]) - float(along[row, lane])
                if 0 < gap < self._wanted_gap(vehicle, row, other):
                    self._aim(row, vehicle, vehicle.lane_index)
                    return

    def _gains(self, rows: IntArray) -> dict[tuple[int, int], list[float]]:
        """What MOBIL weighs where a vehicle may change to a lane beside its own, by row and column:
        the accelerations of the one behind there then and now, its own, and of the one left."""
        network, table, places = self.road.network, self.table, self.places
        pairs = [
            (row, table.column[side])
            for row in rows.tolist()
            if abs(self.speed[row]) >= 1
            for side in network.side_lanes(self.vehicles[row].lane_index)
        ]
        pairs = [
            (row, column)
            for row, column in pairs
            if not table.lanes[column].forbidden
            and abs(places.aside[row, column]) <= 2 * table.lanes[column].width
            and 0 <= places.along[row, column] < table.length[column] + REACH
        ]
        if not pairs:
            return {}
        own, column = np.array(pairs).T
        lane = np.array(self.lane)[own]
        front, rear = self.neighbours(np.tile(own, 2), np.concatenate([column, lane]))
        ahead, behind = front[: len(own)], rear[: len(own)]
        old_ahead, old_behind = front[len(own) :], rear[len(own) :]
        weighed = self._accelerations(
            np.tile(own, 6),
            np.concatenate([behind, behind, own, own, old_behind, old_behind]),
            np.concatenate([own, ahead, ahead, old_ahead, own, old_ahead]),
        )
        return dict(zip(pairs, weighed.reshape(6, -1).T.tolist(), strict=True))

    def _worth_it(self, row: int, vehicle: Vehicle, side: Any, column: int) -> bool:
        """MOBIL: whether a change gains more than it costs, and brakes nobody unsafely."""
        behind_then, behind_now, own_then, own_now, left_now, left_then = self.gains[row, column]
        if behind_then < -vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED:
            return False
        if vehicle.route and vehicle.route[0][2] is not None:
            aim = vehicle.target_lane_index[2]
            right_way = np.sign(side[2] - aim) == np.sign(vehicle.route[0][2] - aim)
            return bool(right_way) and not own_then < -vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
        gain = (
            own_then
            - own_now
            + vehicle.POLITENESS * (behind_then - behind_now + left_then - left_now)
        )
        return not gain < vehicle.LANE_CHANGE_MIN_ACC_GAIN

    def _accelerations(self, model: IntArray, row: IntArray, front: IntArray) -> FloatArray:
        """What the drivers `model` take to be the accelerations of things behind others; 0 of what
        is no vehicle, and of nobody."""
        result = np.zeros(len(row))
        some = rows_of((row >= 0) & (row < len(self.vehicles)))
        model, row, front = model[some], row[some], front[some]
        fleet, lane = self.fleet, np.array(self.lane)[row]
        aim = column_of([self.vehicles[k].target_speed for k in row.tolist()])
        aim = np.minimum(np.maximum(aim, self.table.lowest[lane]), self.table.highest[lane])
        ratio = np.maximum(self.speeds[row], 0) / np.abs(_not_zero(aim))
        free = fleet.comfort[model] * (1 - np.power(ratio, fleet.exponent[model]))
        result[some] = self._behind(model, row, front, lane, free)
        return result

    def _wanted_gap(self, model: Vehicle, row: int, front: int) -> float:
        brake = -model.COMFORT_ACC_MAX * model.COMFORT_ACC_MIN
        closing = float(np.dot(self.velocity[row] - self.velocity[front], self.direction[row]))
        speed = self.speed[row]
        return float(
            model.DISTANCE_WANTED
            + speed * model.TIME_WANTED
            + speed * closing / (2 * math.sqrt(brake))
        )

    # --- controls, all vehicles together -------------------------------------------------------

    def _control(self, drivers: IntArray, cruisers: IntArray) -> None:
        rows = np.concatenate([drivers, cruisers])
        if len(rows) == 0:
            return
        steering = self._steering(rows).tolist()
        acceleration = self._driven(drivers).tolist() if len(drivers) else []
        acceleration += [
            vehicle.KP_A * (vehicle.target_speed - vehicle.speed)
            for vehicle in (self.vehicles[row] for row in cruisers.tolist())
        ]
        for row, steer, accelerate in zip(rows.tolist(), steering, acceleration, strict=True):
            self.vehicles[row].action = {"steering": steer, "acceleration": accelerate}

    def _steering(self, rows: IntArray) -> FloatArray:
        fleet = self.fleet
        target = np.array(self.target)[rows]
        along, aside = self.places.along[rows, target], self.places.aside[rows, target]
        speed, heading = self.speeds[rows], self.heading[rows]
        ahead = along + speed * fleet.pursuit[rows]
        future = self.table.headings_of(target, ahead)
        pace = _not_zero(speed)
        command = np.arcsin(_clip(-fleet.lateral[rows] * aside / pace, 1))
        reference = future + _clip(command, np.pi / 4)
        rate = fleet.turning[rows] * wrap(reference - heading)
        slip = np.arcsin(_clip(fleet.half_length[rows] / pace * rate, 1))
        return _clip(np.arctan(2 * np.tan(slip)), fleet.steering[rows])

    def _driven(self, rows: IntArray) -> FloatArray:
        """The accelerations of IDM: behind the leader, and in a change of lane behind that on the
        target lane too."""
        fleet = self.fleet
        lane, target = np.array(self.lane)[rows], np.array(self.target)[rows]
        most, speed = fleet.comfort[rows], self.speeds[rows]
        aim = column_of([vehicle.target_speed for vehicle in self.vehicles])[rows]
        aim = np.minimum(np.maximum(aim, self.table.lowest[lane]), self.table.highest[lane])
        ratio = np.maximum(speed, 0) / np.abs(_not_zero(aim))
        free = most * (1 - np.power(ratio, fleet.exponent[rows]))
        # One that changes lane looks at both.
        changing = rows_of(lane != target)
        looking = np.concatenate([np.arange(len(rows)), changing])
        searched = np.concatenate([lane, target[changing]])
        front, _ = self.neighbours(rows[looking], searched)
        looking_rows = rows[looking]
        behind = self._behind(looking_rows, looking_rows, front, lane[looking], free[looking])
        result, other = behind[: len(rows)], behind[len(rows) :]
        result[changing] = np.minimum(result[changing], other)
        return _clip(result, fleet.most[rows])

    def _behind(
        self, model: IntArray, row: IntArray, front: IntArray, lane: IntArray, free: FloatArray
    ) -> FloatArray:
        """Accelerations behind the leaders `front`, -1 for none, as the drivers `model` take them
        to be; `free` without a leader.  Gaps are measured along the lanes."""
        led = rows_of(front >= 0)
        if len(led) == 0:
            return free
        model, row, front, lane = model[led], row[led], front[led], lane[led]
        fleet, along, speed = self.fleet, self.places.along, self.speeds[row]
        gap = along[front, lane] - along[row, lane]
        closing = np.vecdot(self.velocity[row] - self.velocity[front], self.direction[row])
        most = fleet.comfort[model]
        wanted = (
            fleet.gap[model]
            + speed * fleet.headway[model]
            + speed * closing / (2 * np.sqrt(-most * fleet.brake[model]))
        )
        free[led] -= most * np.power(wanted / _not_zero(gap), 2)
        return free


def _clip(x: FloatArray, most: Any) -> FloatArray:
    return np.minimum(np.maximum(x, -most), most)
