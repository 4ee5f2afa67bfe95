"""Traffic on an integer clock: roads and vehicles from a scenario's form, stepped and recorded.

One tick is one step of `1 / rate` seconds.  Births, deaths and commands happen between ticks.  The
ego carries the sensor: it drives as an IDM car, and is no object of the scene.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.geometry import wrap_angle
from pmbm.sim.schema import Actor, Driver, GymnasiumScene, NetworkEntry, RoadEntry, RoadScene
from pmbm.sim.schema import Road as RoadForm
from pmbm.sim.streams import Purpose, Streams
from pmbm.sim.world.actors import as_car, label_of, vehicle_class
from pmbm.sim.world.highway import env as highway
from pmbm.sim.world.highway.env import AbstractLane, StraightLane, Vehicle
from pmbm.sim.world.highway.fast_road import adopt
from pmbm.sim.world.roads import LaneIndex, Network, lay
from pmbm.sim.world.scripted import own_stream
from pmbm.sim.world.trajectory import GROUP, REACH_MARGIN, Trajectory
from pmbm.types import BoolArray, FloatArray, IntArray

Hook = Callable[[int], bool | None]
_Form = TypeVar("_Form")

CLEARANCE = 15.0
"""m that an arriving car wants free around its centre, as in highway-env's intersection."""


@dataclass(eq=False)
class Traffic:
    """A road full of vehicles, and what happens on it between ticks.

    hooks : called with the tick's number before it is recorded, until they say True: done.
    named : vehicles that have a name, and so an id, of their own.
    """

    road: Any
    ego: Vehicle | None
    rate: int
    hooks: list[Hook] = field(default_factory=list)
    named: dict[Vehicle, tuple[int, str]] = field(default_factory=dict)
    heights: dict[Vehicle, float] = field(default_factory=dict)

    def free(self, position: FloatArray, clearance: float = CLEARANCE) -> bool:
        """Whether nobody's centre is within the clearance of a place (highway-env's frame)."""
        return all(np.hypot(*(v.position - position)) >= clearance for v in self.road.vehicles)

    def add(self, vehicle: Vehicle, object_id: int, name: str, height: float) -> None:
        self.road.vehicles.append(vehicle)
        self.named[vehicle] = (object_id, name)
        self.heights[vehicle] = height

    def remove(self, gone: set[Vehicle]) -> None:
        if gone:
            self.road.vehicles = [v for v in self.road.vehicles if v not in gone]

    def between_ticks(self, tick: int) -> None:
        """Run the hooks before a tick is recorded."""
        self.hooks = [hook for hook in self.hooks if not hook(tick)]

    def step(self) -> None:
        self.road.act()
        self.road.step(1.0 / self.rate)


@dataclass(eq=False)
class _Log:
    """The rows written down while the clock runs, one for each vehicle and tick."""

    number: dict[Vehicle, int] = field(default_factory=dict)
    """Of the vehicles in order of their first sight, held to the end: addresses are reused."""
    first: list[int] = field(default_factory=list)
    seen: BoolArray = field(default_factory=lambda: np.zeros(0, bool))
    """Of each: its first tick, and whether it has been in range."""
    rows: list[IntArray] = field(default_factory=list)
    states: list[FloatArray] = field(default_factory=list)
    """Of each tick: the vehicles' numbers, and x, y, heading and crashed (N,4)."""

    def write(
        self, tick: int, vehicles: list[Vehicle], sensor: FloatArray, max_range: float
    ) -> set[Vehicle]:
        """Write vehicles down, and return those that were in range and have left for good."""
        for vehicle in vehicles:
            if vehicle not in self.number:
                self.number[vehicle] = len(self.number)
                self.first.append(tick)
                self.seen = np.append(self.seen, False)
        if not vehicles:
            return set()
        rows = np.array([self.number[vehicle] for vehicle in vehicles])
        state = np.empty((len(vehicles), 4))
        state[:, :2] = np.concatenate([v.position for v in vehicles]).reshape(-1, 2)
        state[:, 2] = [v.heading for v in vehicles]
        state[:, 1:3] *= -1
        state[:, 3] = [v.crashed for v in vehicles]
        self.rows.append(rows)
        self.states.append(state)
        distance = np.hypot(state[:, 0] - sensor[0], state[:, 1] - sensor[1])
        self.seen[rows] |= distance <= max_range
        gone = self.seen[rows] & (distance > max_range + REACH_MARGIN)
        return {vehicles[k] for k in gone.nonzero()[0].tolist()}

    def paths(self, traffic: Traffic) -> list[Trajectory]:
        """The path of every vehicle."""
        if not self.rows:
            return []
        rows = np.concatenate(self.rows)
        states = np.concatenate(self.states)[np.argsort(rows, kind="stable")]
        tables = np.split(states, np.cumsum(np.bincount(rows))[:-1])
        return [
            _trajectory(traffic, vehicle, number, first, table)
            for (vehicle, number), first, table in zip(
                self.number.items(), self.first, tables, strict=True
            )
        ]


def drive(
    traffic: Traffic, ticks: int, warmup_ticks: int, max_range: float, sensor: FloatArray
) -> tuple[list[Trajectory], FloatArray]:
    """Run the clock and write down every vehicle but the ego, in our world frame.

    One that has been within `max_range` of the sensor and has left for good is taken off the road.

    sensor (ticks,3) : its poses where no ego carries it.
    Returns the paths and the sensor's poses (ticks,3).
    """
    log = _Log()
    poses = np.array(sensor)
    for tick in range(-warmup_ticks, ticks):
        if tick > -warmup_ticks:
            traffic.step()
        traffic.between_ticks(tick)
        if tick < 0:
            continue
        if traffic.ego is not None:
            x, y = traffic.ego.position
            poses[tick] = x, -y, wrap_angle(-float(traffic.ego.heading))
        others = [vehicle for vehicle in traffic.road.vehicles if vehicle is not traffic.ego]
        traffic.remove(log.write(tick, others, poses[tick], max_range))
    return log.paths(traffic), poses


def obstacles(traffic: Traffic) -> list[FloatArray]:
    """What stands on the road, as polygons in our world frame: it hides things, and is no object
    of the scene."""
    return [
        thing.polygon()[:-1] * (1, -1)
        for thing in traffic.road.objects
        if not isinstance(thing, highway.Landmark)
    ]


def drivable_area(traffic: Traffic) -> list[FloatArray]:
    """The lanes, one polygon each, in our world frame."""
    return [_outline(lane) * (1, -1) for lane in traffic.road.network.lanes_list()]


def _outline(lane: AbstractLane) -> FloatArray:
    length = float(lane.length)
    pieces = 1 if type(lane) is StraightLane else max(2, round(length / 2.0))
    along = np.linspace(0.0, length, pieces + 1)
    left = [lane.position(s, -lane.width_at(s) / 2) for s in along]
    right = [lane.position(s, lane.width_at(s) / 2) for s in along]
    return np.array(left + right[::-1], dtype=np.float64)


def _trajectory(
    traffic: Traffic, vehicle: Vehicle, number: int, first: int, table: FloatArray
) -> Trajectory:
    object_id, name = traffic.named.get(vehicle, (number, f"vehicle:{number}"))
    label = label_of(vehicle)
    height = traffic.heights.get(vehicle, label.default_height)
    return Trajectory(
        id=object_id,
        name=name,
        label=label,
        size=(float(vehicle.LENGTH), float(vehicle.WIDTH), height),
        first=first,
        position=table[:, :2],
        yaw=table[:, 2],
        crashed=table[:, 3] > 0,
    )


# --- scenes that highway-env registers ---------------------------------------------------------


def open_gymnasium(form: GymnasiumScene, rate: int, streams: Streams) -> Traffic:
    """A registered scene, ready to drive: its ego made an IDM car, its births on our clock."""
    intersection = form.id.startswith("intersection")
    highway.check_environment(form.id, form.config)
    env = highway.make_environment(
        form.id,
        form.config,
        vehicle_type=f"pmbm.sim.world.actors.{'IntersectionCar' if intersection else 'Car'}",
        rate=rate,
        seed=int(streams.generator(Purpose.TRAFFIC).integers(2**31)),
    ).unwrapped
    ego = as_car(env.vehicle)
    env.road.vehicles[env.road.vehicles.index(env.vehicle)] = ego
    env.controlled_vehicles = [ego]
    traffic = Traffic(road=adopt(env.road), ego=ego, rate=rate)
    if intersection:
        traffic.hooks.append(_intersection_clock(env, traffic))
    for number, (name, entry) in enumerate(form.entries.items(), start=1):
        lane_index = _checked_lane(name, entry, env.road.network, form.id)
        traffic.hooks.append(_arrivals(number * GROUP, name, entry, lane_index, traffic, streams))
    return traffic


def _intersection_clock(env: Any, traffic: Traffic) -> Hook:
    """Births and deaths of the intersection, once a second, as in its own step."""

    def hook(tick: int) -> None:
        if tick % traffic.rate == 0:
            env._clear_vehicles()
            env._spawn_vehicle(spawn_probability=env.config["spawn_probability"])

    return hook


def _checked_lane(name: str, entry: NetworkEntry, network: Any, env_id: str) -> LaneIndex:
    lanes = {f"{a} {b} {i}": (a, b, i) for a, b, i in network.lanes_dict()}
    given = " ".join(map(str, entry.lane))
    if given not in lanes:
        raise InputError(
            f"{env_id} has no such lane",
            field=f"scene.entries.{name}.lane",
            got=entry.lane,
            hint=nearest_hint(given, lanes, "lane"),
        )
    for node in entry.destinations:
        if node not in {end for _, end, _ in lanes.values()}:
            raise InputError(
                f"{env_id} has no such node",
                field=f"scene.entries.{name}.destinations",
                got=node,
                hint=nearest_hint(node, {end for _, end, _ in lanes.values()}, "node"),
            )
    return lanes[given]


# --- our own roads -----------------------------------------------------------------------------


def open_roads(form: RoadScene, rate: int, streams: Streams) -> Traffic:
    """Our own roads and actors, ready to drive."""
    roads = lay(form.roads)
    road = highway.Road(
        network=roads.network,
        np_random=streams.generator(Purpose.TRAFFIC),
        neighbour_vehicles_connected_lanes=True,
    )
    traffic = Traffic(road=adopt(road), ego=None, rate=rate)
    if form.ego is not None:
        _check_place("ego", form.ego, form.roads)
        traffic.ego = _place(form.ego, roads, road, own_stream(streams, "ego").random(3))
        road.vehicles.append(traffic.ego)
        _command(form.ego, traffic, traffic.ego)
    for number, (name, actor) in enumerate(form.actors.items(), start=1):
        _check_place(f"actors.{name}", actor, form.roads)
        for copy in range(actor.count):
            _enter(number * GROUP + copy, name, actor, copy, roads, traffic, streams)
    for number, (name, entry) in enumerate(form.entries.items(), start=1 + len(form.actors)):
        _check_place(f"entries.{name}", entry, form.roads)
        index, _ = roads.at(entry.road, entry.lane, entry.position)
        traffic.hooks.append(_arrivals(number * GROUP, name, entry, index, traffic, streams))
    return traffic


def _check_place(where: str, place: Driver | RoadEntry, roads: dict[str, RoadForm]) -> None:
    if place.road not in roads:
        raise InputError(
            "no such road",
            field=f"scene.{where}.road",
            got=place.road,
            hint=nearest_hint(place.road, roads, "road"),
        )
    lanes = [(f"scene.{where}.lane", place.lane)]
    if isinstance(place, Driver):
        lanes += [(f"scene.{where}.commands", c.lane) for c in place.commands if c.lane is not None]
    for key, lane in lanes:
        if lane >= roads[place.road].lanes:
            raise InputError(
                f"road '{place.road}' has no such lane",
                field=key,
                expected=f"0 to {roads[place.road].lanes - 1}",
                got=lane,
            )


def _place(
    driver: Driver, roads: Network, road: Any, luck: FloatArray, ahead: float = 0.0
) -> Vehicle:
    """A new vehicle on its lane, with its own draws `luck` (>= 2,) in [0, 1)."""
    sway = 2 * luck - 1
    index, along = roads.at(
        driver.road, driver.lane, driver.position + ahead + driver.jitter.position * sway[0]
    )
    lane = roads.network.get_lane(index)
    change = driver.jitter.speed * sway[1]
    speed = max(driver.speed + change, 0.0)
    options: dict[str, Any] = {}
    if driver.driver == "idm":
        options["enable_lane_change"] = driver.lane_changes
    target = driver.speed if driver.target_speed is None else driver.target_speed
    length, width, _ = driver.size
    return vehicle_class(driver.driver, driver.kind, length, width)(
        road,
        lane.position(along, 0.0),
        heading=float(lane.heading_at(along)),
        speed=speed,
        target_lane_index=index,
        target_speed=max(target + change, 0.1),
        **options,
    )


def _enter(
    object_id: int,
    name: str,
    actor: Actor,
    copy: int,
    roads: Network,
    traffic: Traffic,
    streams: Streams,
) -> None:
    """Drive one copy of an actor from its time of spawning to that of despawning."""
    luck = own_stream(streams, f"{name}:{copy}").random(3)
    born = max(round((actor.spawn + actor.jitter.spawn * (2 * luck[2] - 1)) * traffic.rate), 0)
    full_name = name if actor.count == 1 else f"{name}:{copy}"
    entered: list[Vehicle] = []

    def hook(tick: int) -> bool:
        if not entered and (tick >= born or actor.spawn == 0):
            vehicle = _place(actor, roads, traffic.road, luck, copy * actor.spacing)
            # One that arrives in running traffic waits until its place is free.
            if actor.spawn == 0 or traffic.free(vehicle.position, 0.5 * vehicle.LENGTH + 5.0):
                entered.append(vehicle)
                traffic.add(vehicle, object_id, full_name, actor.size[2])
                _command(actor, traffic, vehicle)
        if entered and actor.despawn is not None and tick == round(actor.despawn * traffic.rate):
            traffic.remove({entered[0]})
        return bool(entered) and actor.despawn is None

    traffic.hooks.append(hook)


def _command(driver: Driver, traffic: Traffic, vehicle: Vehicle) -> None:
    for command in driver.commands:
        due = round(command.time * traffic.rate)

        def hook(tick: int, command: Any = command, due: int = due) -> bool:
            if tick != due:
                return tick > due
            if command.lane is not None:
                start, end, _ = vehicle.target_lane_index
                vehicle.target_lane_index = (start, end, command.lane)
            if command.speed is not None:
                vehicle.target_speed = max(command.speed, 0.1)
            return True

        traffic.hooks.append(hook)


def _arrivals(
    group: int,
    name: str,
    entry: RoadEntry | NetworkEntry,
    lane_index: LaneIndex,
    traffic: Traffic,
    streams: Streams,
) -> Hook:
    """Cars that arrive at a lane as a Poisson process; one whose place is taken waits."""
    rng = own_stream(streams, name)
    waiting: list[float] = []
    count = 0
    length, width, height = entry.size
    kind = vehicle_class("idm", entry.kind, length, width)

    def hook(tick: int) -> None:
        nonlocal count
        if entry.rate == 0:
            return
        if not waiting:
            waiting.append(max(tick, 0) / traffic.rate + rng.exponential(1.0 / entry.rate))
        if tick < waiting[0] * traffic.rate:
            return
        lane = traffic.road.network.get_lane(lane_index)
        position = lane.position(entry.position, 0.0)
        if not traffic.free(position):
            return
        waiting[0] += rng.exponential(1.0 / entry.rate)
        speed = entry.speed + entry.speed_jitter * (2 * rng.random() - 1)
        options = {}
        if isinstance(entry, RoadEntry):
            options["enable_lane_change"] = entry.lane_changes
        vehicle = kind(
            traffic.road,
            position,
            heading=float(lane.heading_at(entry.position)),
            speed=speed,
            target_lane_index=lane_index,
            target_speed=speed,
            **options,
        )
        if isinstance(entry, NetworkEntry) and entry.destinations:
            vehicle.plan_route_to(entry.destinations[int(rng.integers(len(entry.destinations)))])
        traffic.add(vehicle, group + count, f"{name}:{count}", height)
        count += 1

    return hook
