"""Stock highway-env traffic to the bit, all vehicles at once.

`adopt` turns a stock road into one that steps its vehicles together, on arrays.  What makes it
exact:

- Positions change in `step` alone, so that who is where on which lane holds through `act`.
- What a driver decides depends on others' places, speeds and target lanes, never on their actions:
  lane decisions are taken one by one in the road's order, all controls after them together.
- Among equals the front neighbour is the last in the road's list and the rear one the first.
- Pairs reach the stock collision routine in the stock order, because impacts are overwritten.
- Sums, products, remainders and roots are the same everywhere; dot products, powers and
  trigonometry stay numpy's, whose last bit differs from `math`'s.

Vehicles and lanes must be exactly what they are taken for; a road that holds any other runs the
stock code.  The vehicles stay the stock objects: everything is written back to them.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from pmbm.sim.world.highway.collisions import near_pairs
from pmbm.sim.world.highway.env import (
    ControlledVehicle,
    MDPVehicle,
    RegulatedRoad,
    Road,
    Vehicle,
    utils,
)
from pmbm.sim.world.highway.fast_drivers import Act, Fleet, Places, column_of, positions, rows_of
from pmbm.sim.world.highway.lane_table import LaneTable
from pmbm.types import FloatArray


@functools.cache
def _kernels_agree() -> bool:
    """Whether numpy's kernels give one number the bits that they give it within an array."""
    x = np.linspace(-0.999, 0.999, 397)
    same = all(
        f(x * scale).tolist() == [float(f(v)) for v in (x * scale).tolist()]
        for f, scale in ((np.sin, 4), (np.cos, 4), (np.tan, 1), (np.arctan, 3), (np.arcsin, 1))
    )
    up = x + 1.0
    same &= np.power(up, 3.7 + x / 5).tolist() == [
        float(np.power(a, b)) for a, b in zip(up.tolist(), (3.7 + x / 5).tolist(), strict=True)
    ]
    same &= np.power(7 * x, 2).tolist() == [float(np.power(v, 2)) for v in (7 * x).tolist()]
    same &= np.arctan2(x, up).tolist() == [
        float(np.arctan2(a, b)) for a, b in zip(x.tolist(), up.tolist(), strict=True)
    ]
    pairs, others = np.stack([x, up], axis=1), np.stack([up[::-1], x * 1.7], axis=1)
    dots = [float(np.dot(a, b)) for a, b in zip(pairs, others, strict=True)]
    return bool(same) and np.vecdot(pairs, others).tolist() == dots


class FastRoad(Road):  # type: ignore[misc]
    """A stock road that acts and steps all its vehicles together."""

    @property
    def table(self) -> LaneTable:
        known: LaneTable | None = self.__dict__.get("_table")
        if known is None:
            known = self._table = LaneTable(self.network)
        return known

    @property
    def fleet(self) -> Fleet:
        known: Fleet | None = self.__dict__.get("_fleet")
        if known is None or not known.same(self.vehicles, self.objects):
            known = self._fleet = Fleet(self.vehicles, self.objects)
        return known

    def act(self) -> None:
        if not self.fleet.known or not Act(self).run():
            super().act()

    def step(self, dt: float) -> None:
        fleet = self.fleet
        if not fleet.known or self.record_history:
            Road.step(self, dt)
            return
        places = self._places = Places(self, _advance(fleet, dt))
        count = len(fleet.vehicles)
        heading = column_of([thing.heading for thing in fleet.things])
        closest = self.table.closest(places.along[:count], places.aside[:count], heading[:count])
        table = self.table
        for vehicle, column in zip(fleet.vehicles, closest.tolist(), strict=True):
            vehicle.lane_index = table.index[column]
            vehicle.lane = table.lanes[column]
        speed = column_of([thing.speed for thing in fleet.things])
        pairs = near_pairs(
            places.position, heading, speed, fleet.half_length, fleet.half_width, count, dt
        )
        for i, j in zip(*(rows.tolist() for rows in pairs), strict=True):
            fleet.things[i].handle_collisions(fleet.things[j], dt)

    def places(self) -> Places:
        """The places of everything, worked out again where somebody else has moved something."""
        known: Places | None = self.__dict__.get("_places")
        if known is None or not known.hold(self):
            known = self._places = Places(self)
        return known


class FastRegulatedRoad(FastRoad, RegulatedRoad):  # type: ignore[misc]
    """The stock right of way; each vehicle's future is foreseen once, not once for each other."""

    def step(self, dt: float) -> None:
        self.steps += 1
        if self.steps % int(1 / dt / self.REGULATION_FREQUENCY) == 0:
            self.enforce_road_rules()
        FastRoad.step(self, dt)

    def enforce_road_rules(self) -> None:
        for vehicle in self.vehicles:
            if getattr(vehicle, "is_yielding", False):
                if vehicle.yield_timer >= self.YIELD_DURATION * self.REGULATION_FREQUENCY:
                    vehicle.target_speed = vehicle.lane.speed_limit
                    delattr(vehicle, "color")
                    vehicle.is_yielding = False
                else:
                    vehicle.yield_timer += 1
        for one, other in self._conflicts():
            yielding = self.respect_priorities(one, other)
            if isinstance(yielding, ControlledVehicle) and not isinstance(yielding, MDPVehicle):
                yielding.color = self.YIELDING_COLOR
                yielding.target_speed = 0
                yielding.is_yielding = True
                yielding.yield_timer = 0

    def _conflicts(self) -> list[tuple[Vehicle, Vehicle]]:
        """Pairs whose foreseen boxes meet, in the stock order; yielding changes no future."""
        times = np.arange(0.25, 3, 0.25)
        futures = [v.predict_trajectory_constant_speed(times) for v in self.vehicles]
        if not futures:
            return []
        places = np.array([positions for positions, _ in futures])
        found = []
        for i, vehicle in enumerate(self.vehicles):
            apart = np.sqrt(((places[i + 1 :] - places[i]) ** 2).sum(axis=2))
            near = (apart <= vehicle.LENGTH + 1e-6).any(axis=1)
            found += [
                (vehicle, self.vehicles[j])
                for j in (np.flatnonzero(near) + i + 1).tolist()
                if _meet(vehicle, futures[i], self.vehicles[j], futures[j])
            ]
        return found


def adopt(road: Any) -> Any:
    """Make a stock road fast, in place; any other road stays as it is."""
    fast = {Road: FastRoad, RegulatedRoad: FastRegulatedRoad}.get(type(road))
    if fast is not None and LaneTable.knows(road.network) and _kernels_agree():
        road.__class__ = fast
    return road


def _advance(fleet: Fleet, dt: float) -> FloatArray:
    """The stock vehicle dynamics over a step, without finding the lanes anew; the places (N,2)."""
    vehicles = fleet.vehicles
    for vehicle in fleet.drivers:
        vehicle.timer += dt
    speed = column_of([v.speed for v in vehicles])
    clipped = np.array([v.crashed for v in vehicles], bool)
    clipped |= (speed > fleet.fastest) | (speed < fleet.slowest)
    for row in rows_of(clipped).tolist():
        vehicles[row].clip_actions()
    actions = [v.action for v in vehicles]
    beta = np.arctan(1 / 2 * np.tan(column_of([action["steering"] for action in actions])))
    acceleration = column_of([action["acceleration"] for action in actions])
    heading = column_of([v.heading for v in vehicles])
    position = positions(vehicles)
    course = heading + beta
    position += speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1) * dt
    half = fleet.half_length[: len(vehicles)]
    headings = (heading + speed * np.sin(beta) / half * dt).tolist()
    speeds = (speed + acceleration * dt).tolist()
    for vehicle, place, new_heading, new_speed in zip(
        vehicles, position, headings, speeds, strict=True
    ):
        vehicle.position = place
        if vehicle.impact is not None:
            vehicle.position += vehicle.impact
            vehicle.crashed = True
            vehicle.impact = None
        vehicle.heading = new_heading
        vehicle.speed = new_speed
    # The vehicles hold rows of it, which others may write to.
    return position.copy()


def _meet(one: Vehicle, future_one: Any, other: Vehicle, future_other: Any) -> bool:
    """The stock check of two foreseen paths."""
    for place, heading, other_place, other_heading in zip(*future_one, *future_other, strict=False):
        if np.linalg.norm(other_place - place) > one.LENGTH:
            continue
        if utils.rotated_rectangles_intersect(
            (place, 1.5 * one.LENGTH, 0.9 * one.WIDTH, heading),
            (other_place, 1.5 * other.LENGTH, 0.9 * other.WIDTH, other_heading),
        ):
            return True
    return False
