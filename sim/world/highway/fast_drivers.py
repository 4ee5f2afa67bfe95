"""Decisions and controls of all vehicles of a road together, to the bit of stock highway-env.

See `pmbm.sim.world.highway.fast_road` for what makes it exact.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from typing import TYPE_CHECKING, Any

import numpy as np

from pmbm.sim.world.highway.env import ControlledVehicle, IDMVehicle, Vehicle
from pmbm.sim.world.highway.lane_table import REACH, wrap
from pmbm.types import FloatArray, IntArray

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


def _not_zero(x: float) -> float:
    if abs(x) > 1e-2:
        return x
    return 1e-2 if x >= 0 else -1e-2


def _all_not_zero(x: FloatArray) -> FloatArray:
    return np.where(np.abs(x) > 1e-2, x, np.where(x >= 0, 1e-2, -1e-2))


def column_of(values: list[Any]) -> FloatArray:
    return np.array(values, dtype=np.float64)


class Places:
    """Where everything on a road is, for one setting of positions: vehicles, then objects."""

    def __init__(self, road: FastRoad, moved: FloatArray | None = None) -> None:
        """`moved` (N,2) : of the vehicles, where they are known."""
        self.things = road.vehicles + road.objects
        if moved is None or road.objects:
            self.position = positions(self.things)
        else:
            self.position = moved
        self.along, self.aside = road.table.coordinates(self.position)

    def hold(self, road: FastRoad) -> bool:
        """Whether everything is still where it was."""
        things = road.vehicles + road.objects
        return (
            len(things) == len(self.things)
            and all(map(_same, things, self.things))
            and np.array_equal(self.position, positions(things))
        )


def positions(things: list[Any]) -> FloatArray:
    return np.concatenate([thing.position for thing in things]).reshape(-1, 2)


def _same(a: object, b: object) -> bool:
    return a is b


class Line:
    """Who is on a lane, and on those that a search from it looks at, in order of place.

    place : m along the lane.  row : of the thing.  tied : whether any two places are equal.
    """

    def __init__(self, road: FastRoad, column: int, places: Places) -> None:
        table = road.table
        free = road.visible.copy()
        found_places, found_rows = [], []
        for searched, offset in table.searched(column, road.neighbour_vehicles_connected_lanes):
            along, aside = places.along[:, searched], places.aside[:, searched]
            on_lane = (
                free
                & (np.abs(aside) <= table.half_width[searched] + 1)
                & (along >= -REACH)
                & (along < table.length[searched] + REACH)
            )
            rows = np.flatnonzero(on_lane)
            free[rows] = False
            found_rows.append(rows)
            found_places.append(along[rows] + offset)
        rows, place = np.concatenate(found_rows), np.concatenate(found_places)
        order = np.lexsort((rows, place))
        self.place, self.row = place[order], rows[order]
        self.tied = bool((self.place[1:] == self.place[:-1]).any())
        self.place_list, self.row_list = self.place.tolist(), self.row.tolist()

    def neighbours(self, row: int, at: float) -> tuple[int, int]:
        """Rows of the front and of the rear neighbour of a thing at a place; -1 is nobody."""
        here = bisect_left(self.place_list, at)
        return self._front(row, here), self._rear(row, here)

    def _front(self, row: int, here: int) -> int:
        best, best_place = -1, math.inf
        for k in range(here, len(self.row_list)):
            if self.row_list[k] == row:
                continue
            if best >= 0 and self.place_list[k] > best_place:
                break
            best, best_place = self.row_list[k], self.place_list[k]
        return best

    def _rear(self, row: int, here: int) -> int:
        best, best_place = -1, -math.inf
        for k in range(here - 1, -1, -1):
            if self.row_list[k] == row:
                continue
            if best >= 0 and self.place_list[k] < best_place:
                break
            best, best_place = self.row_list[k], self.place_list[k]
        return best

    def fronts(self, rows: IntArray, at: FloatArray) -> IntArray:
        """The front neighbours of many things."""
        if self.tied:
            pairs = zip(rows.tolist(), at.tolist(), strict=True)
            return np.array([self.neighbours(row, place)[0] for row, place in pairs], np.int64)
        padded = np.append(self.row, (-1, -1))
        here = np.searchsorted(self.place, at)
        # Without equals, only the thing itself can stand where the search begins.
        return padded[here + (padded[here] == rows)]


class Act:
    """One `act` of a road: lane decisions one by one, then all controls together.

    Rows are the road's vehicles, then its objects; `lane` and `target` hold a vehicle's current and
    target lane as a column of the table.
    """

    def __init__(self, road: FastRoad) -> None:
        self.road, self.table, self.vehicles = road, road.table, road.vehicles
        self.places = road.places()
        things = self.places.things
        self.speed = [float(thing.speed) for thing in things]
        self.heading = column_of([thing.heading for thing in things])
        self.direction = np.stack([np.cos(self.heading), np.sin(self.heading)], axis=1)
        self.velocity = column_of(self.speed)[:, None] * self.direction
        self.lines: dict[int, Line] = {}

    def run(self) -> bool:
        """False, with nothing done, where a vehicle is on a lane that the table does not have."""
        column = self.table.column
        try:
            self.lane = [column[tuple(vehicle.lane_index)] for vehicle in self.vehicles]
            self.target = [column[tuple(vehicle.target_lane_index)] for vehicle in self.vehicles]
        except (KeyError, TypeError):
            return False
        drivers, cruisers = [], []
        ends = (self.table.length - REACH / 2).tolist()
        count = len(self.vehicles)
        past_end = (
            self.places.along[np.arange(count), self.target] > np.array(ends)[self.target]
        ).tolist()
        for row, vehicle in enumerate(self.vehicles):
            driver = kind_of(vehicle) is IDMVehicle
            if driver and vehicle.crashed:
                continue
            if past_end[row]:
                self._follow_road(row, vehicle)
            if driver:
                drivers.append(row)
                if vehicle.enable_lane_change:
                    self._change_lane(row, vehicle)
            else:
                cruisers.append(row)
        self._control(np.array(drivers, np.int64), np.array(cruisers, np.int64))
        return True

    def line(self, column: int) -> Line:
        found = self.lines.get(column)
        if found is None:
            found = self.lines[column] = Line(self.road, column, self.places)
        return found

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
            if (
                self._reachable(row, column)
                and abs(vehicle.speed) >= 1
                and self._worth_it(row, vehicle, side, column)
            ):
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

    def _reachable(self, row: int, column: int) -> bool:
        if self.table.lanes[column].forbidden:
            return False
        along, aside = self.places.along[row, column], self.places.aside[row, column]
        return bool(
            abs(aside) <= 2 * self.table.lanes[column].width
            and 0 <= along < self.table.length[column] + REACH
        )

    def _worth_it(self, row: int, vehicle: Vehicle, side: Any, column: int) -> bool:
        """MOBIL: whether a change gains more than it costs, and brakes nobody unsafely."""
        ahead, behind = self.line(column).neighbours(row, float(self.places.along[row, column]))
        behind_then = self._acceleration(vehicle, behind, row)
        if behind_then < -vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED:
            return False
        own_then = self._acceleration(vehicle, row, ahead)
        if vehicle.route and vehicle.route[0][2] is not None:
            aim = vehicle.target_lane_index[2]
            right_way = np.sign(side[2] - aim) == np.sign(vehicle.route[0][2] - aim)
            return bool(right_way) and not own_then < -vehicle.LANE_CHANGE_MAX_BRAKING_IMPOSED
        lane = self.lane[row]
        old_ahead, old_behind = self.line(lane).neighbours(row, float(self.places.along[row, lane]))
        behind_now = self._acceleration(vehicle, behind, ahead)
        own_now = self._acceleration(vehicle, row, old_ahead)
        left_now = self._acceleration(vehicle, old_behind, row)
        left_then = self._acceleration(vehicle, old_behind, old_ahead)
        gain = (
            own_then
            - own_now
            + vehicle.POLITENESS * (behind_then - behind_now + left_then - left_now)
        )
        return not gain < vehicle.LANE_CHANGE_MIN_ACC_GAIN

    def _acceleration(self, model: Vehicle, row: int, front: int) -> float:
        """What `model` takes to be the acceleration of a vehicle behind another; rows or -1."""
        if row < 0 or row >= len(self.vehicles):
            return 0
        vehicle, lane = self.vehicles[row], self.lane[row]
        target, limit = vehicle.target_speed, self.table.limit[lane]
        if limit is not None:
            target = min(max(target, 0), limit)
        ratio = max(self.speed[row], 0) / abs(_not_zero(target))
        value = model.COMFORT_ACC_MAX * (1 - float(np.power(ratio, model.DELTA)))
        if front >= 0:
            gap = float(self.places.along[front, lane]) - float(self.places.along[row, lane])
            share = self._wanted_gap(model, row, front) / _not_zero(gap)
            value -= model.COMFORT_ACC_MAX * float(np.power(share, 2))
        return value

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
        vehicles = [self.vehicles[row] for row in rows.tolist()]
        target = np.array(self.target)[rows]
        along, aside = self.places.along[rows, target], self.places.aside[rows, target]
        speed, heading = column_of(self.speed)[rows], self.heading[rows]
        ahead = along + speed * column_of([v.TAU_PURSUIT for v in vehicles])
        future = self._lane_headings(target, ahead)
        pace = _all_not_zero(speed)
        command = np.arcsin(_clip(-column_of([v.KP_LATERAL for v in vehicles]) * aside / pace, 1))
        reference = future + _clip(command, np.pi / 4)
        rate = column_of([v.KP_HEADING for v in vehicles]) * wrap(reference - heading)
        slip = np.arcsin(_clip(column_of([v.LENGTH / 2 for v in vehicles]) / pace * rate, 1))
        most = column_of([v.MAX_STEERING_ANGLE for v in vehicles])
        return _clip(np.arctan(2 * np.tan(slip)), most)

    def _lane_headings(self, columns: IntArray, along: FloatArray) -> FloatArray:
        table = np.zeros((len(columns), len(self.table.lanes)))
        each = np.arange(len(columns))
        table[each, columns] = along
        return np.asarray(self.table.headings(table)[each, columns])

    def _driven(self, rows: IntArray) -> FloatArray:
        """The accelerations of IDM: behind the leader, and in a change of lane behind that on the
        target lane too."""
        vehicles = [self.vehicles[row] for row in rows.tolist()]
        lane, target = np.array(self.lane)[rows], np.array(self.target)[rows]
        most = column_of([v.COMFORT_ACC_MAX for v in vehicles])
        speed = column_of(self.speed)[rows]
        aim = column_of([v.target_speed for v in vehicles])
        limits = [self.table.limit[column] for column in lane.tolist()]
        limit = column_of([math.inf if value is None else value for value in limits])
        lowest = column_of([-math.inf if value is None else 0.0 for value in limits])
        aim = np.minimum(np.maximum(aim, lowest), limit)
        ratio = np.maximum(speed, 0) / np.abs(_all_not_zero(aim))
        free = most * (1 - np.power(ratio, column_of([v.DELTA for v in vehicles])))
        behind = self._behind(rows, vehicles, lane, lane, most, free)
        changing = np.flatnonzero(lane != target)
        if len(changing):
            some = [vehicles[k] for k in changing.tolist()]
            other = self._behind(
                rows[changing], some, lane[changing], target[changing], most[changing],
                free[changing],
            )  # fmt: skip
            behind[changing] = np.minimum(behind[changing], other)
        return _clip(behind, column_of([v.ACC_MAX for v in vehicles]))

    def _behind(
        self,
        rows: IntArray,
        vehicles: list[Vehicle],
        lane: IntArray,
        searched: IntArray,
        most: FloatArray,
        free: FloatArray,
    ) -> FloatArray:
        """Accelerations behind the leaders found on the lanes `searched`; gaps are measured along
        the current lanes."""
        front = np.full(len(rows), -1)
        for column in np.unique(searched).tolist():
            here = np.flatnonzero(searched == column)
            at = self.places.along[rows[here], column]
            front[here] = self.line(column).fronts(rows[here], at)
        led = np.flatnonzero(front >= 0)
        if len(led) == 0:
            return free.copy()
        rows, front, lane = rows[led], front[led], lane[led]
        followers = [vehicles[k] for k in led.tolist()]
        along = self.places.along
        gap = along[front, lane] - along[rows, lane]
        closing = np.vecdot(self.velocity[rows] - self.velocity[front], self.direction[rows])
        speed = column_of(self.speed)[rows]
        brake = column_of([-v.COMFORT_ACC_MAX * v.COMFORT_ACC_MIN for v in followers])
        wanted = (
            column_of([v.DISTANCE_WANTED for v in followers])
            + speed * column_of([v.TIME_WANTED for v in followers])
            + speed * closing / (2 * np.sqrt(brake))
        )
        result = free.copy()
        result[led] -= most[led] * np.power(wanted / _all_not_zero(gap), 2)
        return result


def _clip(x: FloatArray, most: Any) -> FloatArray:
    return np.minimum(np.maximum(x, -most), most)
