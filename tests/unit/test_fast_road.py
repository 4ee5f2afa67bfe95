"""Our roads and drivers against stock highway-env: every bit, every step, in one process."""

import contextlib

import numpy as np
import pytest

from pmbm import kernels
from pmbm.sim import schema
from pmbm.sim.scenario.scenario import load_scenario
from pmbm.sim.streams import Streams
from pmbm.sim.world import actors, traffic
from pmbm.sim.world.highway import env as highway
from pmbm.sim.world.highway import fast_drivers, fast_road

PARAMETERS = [name for name in vars(actors.Car) if name.isupper()]


@contextlib.contextmanager
def stock():
    """Within it, traffic is driven by stock roads."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(traffic, "adopt", lambda road: road)
        yield


def state(road):
    """All that a vehicle's future depends on."""
    return [
        (
            vehicle.position.tobytes(),
            float(vehicle.heading).hex(),
            float(vehicle.speed).hex(),
            float(vehicle.action["steering"]).hex(),
            float(vehicle.action["acceleration"]).hex(),
            tuple(vehicle.lane_index),
            tuple(vehicle.target_lane_index),
            float(vehicle.target_speed).hex(),
            float(getattr(vehicle, "timer", 0.0)).hex(),
            bool(vehicle.crashed),
            None if vehicle.impact is None else np.asarray(vehicle.impact).tobytes(),
        )
        for vehicle in road.vehicles
    ]


def history(form, seed, ticks):
    opened = (
        traffic.open_gymnasium if isinstance(form, schema.GymnasiumScene) else traffic.open_roads
    )(form, 20, Streams(seed))
    states = []
    for tick in range(ticks):
        if tick:
            opened.step()
        for hook in opened.hooks:
            hook(tick)
        states.append(state(opened.road))
    return states, opened.road


def assert_equal(form, seed, ticks):
    with stock():
        expected, stock_road = history(form, seed, ticks)
        assert type(stock_road) in (highway.Road, highway.RegulatedRoad)
    found, fast = history(form, seed, ticks)
    assert isinstance(fast, fast_road.FastRoad)
    assert fast.fleet.known
    for tick, (one, other) in enumerate(zip(expected, found, strict=True)):
        assert one == other, f"tick {tick}"
    return expected


def gymnasium(env_id, **config):
    return schema.GymnasiumScene(kind="gymnasium", id=env_id, config=config)


def road(**scene):
    base = {
        "kind": "road",
        "roads": {"main": {"start": [0.0, 0.0], "end": [3000.0, 0.0], "lanes": 4}},
        "crashes": "allowed",
    }
    return schema.RoadScene.model_validate({**base, **scene})


def crashes(states):
    return sum(vehicle[9] for vehicle in states[-1])


@pytest.mark.parametrize("env_id", highway.ENVIRONMENTS)
def test_registered_scenes(env_id):
    small = {"vehicles_count": 12} if env_id in ("highway-v0", "exit-v1") else {}
    assert_equal(gymnasium(env_id, **small), seed=3, ticks=50)


@pytest.mark.slow
@pytest.mark.parametrize("env_id", highway.ENVIRONMENTS)
@pytest.mark.parametrize("seed", range(3))
def test_registered_scenes_for_long(env_id, seed):
    small = {"vehicles_count": 20} if env_id in ("highway-v0", "exit-v1") else {}
    assert_equal(gymnasium(env_id, **small), seed, ticks=400)


@pytest.mark.parametrize("name", ["street", "crossing", "truck_occlusion", "ego_motion", "cut_in"])
def test_our_own_roads(name):
    assert_equal(load_scenario(name).form.scene, seed=1, ticks=60)


def test_ties_in_place_and_distance():
    """Cars abreast to the bit, on lanes and between them, so that every search has equals."""
    rows = {
        f"row{lane}": {"road": "main", "lane": lane, "position": 400.0, "speed": 20.0, "count": 5,
                       "spacing": -25.0, "lane_changes": True}
        for lane in range(4)
    }  # fmt: skip
    doubles = {
        f"double{lane}": {"road": "main", "lane": lane, "position": 375.0, "speed": 20.0}
        for lane in (1, 2)
    }
    states = assert_equal(road(actors={**rows, **doubles}), seed=0, ticks=80)
    places = [vehicle[0] for vehicle in states[0]]
    assert len(set(places)) < len(places)


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_neighbours_among_equals(seed, compiled, monkeypatch):
    """Everybody's neighbours on every lane, with places shared to the bit, on bent and connected
    lanes, as the stock search finds them."""
    if not compiled:
        monkeypatch.setattr(kernels, "native", None)
    elif kernels.native is None:
        pytest.skip("nothing is compiled")
    rng = np.random.default_rng(seed)
    roads = {
        "main": {"start": [0.0, 0.0], "end": [60.0, 12.0], "lanes": 3, "leads_to": "bend"},
        "bend": {"centre": [50.0, 40.0], "radius": 30.0, "from_deg": -70.0, "to_deg": 60.0,
                 "lanes": 2, "leads_to": "back"},
        "back": {"start": [60.0, 70.0], "end": [-40.0, 60.0]},
    }  # fmt: skip
    opened = traffic.open_roads(road(roads=roads), 20, Streams(0))
    network = opened.road.network
    for lane_index in network.lanes_dict():
        lane = network.get_lane(lane_index)
        for along in rng.choice([3.0, 3.0, 11.0, 20.0, lane.length - 1, lane.length + 2], 4):
            for aside in rng.choice([-2.5, 0.0, 2.5], 2):
                kind = actors.Car if rng.random() < 0.7 else actors.Cruiser
                opened.road.vehicles.append(kind(opened.road, lane.position(along, aside)))
    opened.road.objects.append(highway.Obstacle(opened.road, opened.road.vehicles[3].position))
    opened.road.objects.append(highway.Landmark(opened.road, opened.road.vehicles[5].position))
    act = fast_drivers.Act(opened.road)
    things, places, table = act.places.things, act.places, act.table
    everybody = np.arange(len(opened.road.vehicles))
    tied = 0
    for column, lane_index in enumerate(table.index):
        on_lane = np.abs(places.aside[:, column]) <= table.half_width[column]
        tied += len(set(places.along[on_lane, column].tolist())) < on_lane.sum()
        found = act.neighbours(everybody, np.full(len(everybody), column))
        for vehicle, *rows in zip(opened.road.vehicles, *found, strict=True):
            near = [things[k] if k >= 0 else None for k in rows]
            expected = highway.Road.neighbour_vehicles(opened.road, vehicle, lane_index)
            assert (near[0] is expected[0], near[1] is expected[1]) == (True, True)
    assert tied >= 2


def test_local_coordinates_and_headings_of_every_kind_of_lane():
    rng = np.random.default_rng(0)
    for env_id in ("roundabout-v1", "merge-v1", "intersection-v2", "u-turn-v1"):
        opened = traffic.open_gymnasium(gymnasium(env_id), 20, Streams(0))
        table = opened.road.table
        position = rng.uniform(-120, 320, (40, 2))
        heading = rng.uniform(-7, 7, 40)
        along, aside = table.coordinates(position)
        headings = table.headings(along)
        closest = table.closest(along, aside, heading)
        for row in range(len(position)):
            for column, lane in enumerate(table.lanes):
                s, r = lane.local_coordinates(position[row])
                assert (along[row, column], aside[row, column]) == (s, r)
                assert headings[row, column] == lane.heading_at(s)
            stock_index = opened.road.network.get_closest_lane_index(position[row], heading[row])
            assert table.index[closest[row]] == stock_index


def test_slanted_lanes_with_limits_of_their_own(monkeypatch):
    """Dot products whose last bit shows, and speed limits that a change of lane changes."""
    plain = traffic.open_roads

    def limited(form, rate, streams):
        opened = plain(form, rate, streams)
        for number, limit in enumerate((12.0, None, 25.0)):
            opened.road.network.get_lane(("main.0", "main.end", number)).speed_limit = limit
        return opened

    monkeypatch.setattr(traffic, "open_roads", limited)
    slanted = {"main": {"start": [3.0, 1.0], "end": [2000.0, 913.0], "lanes": 3}}
    cars = {
        f"lane{lane}": {"road": "main", "lane": lane, "position": 300.0, "speed": 12.0 + 4 * lane,
                        "target_speed": 30.0, "count": 4, "spacing": -28.0, "lane_changes": True,
                        "jitter": {"position": 6.0, "speed": 3.0}}
        for lane in range(3)
    }  # fmt: skip
    for lane in range(3):
        cars[f"lane{lane}"]["commands"] = [{"time": 0.7, "lane": (lane + 1) % 3}]
    assert_equal(road(roads=slanted, actors=cars), seed=0, ticks=120)


def test_lane_changes():
    slow = {
        "road": "main",
        "lane": 1,
        "position": 260.0,
        "speed": 6.0,
        "count": 3,
        "spacing": -60.0,
    }
    fast = {"road": "main", "lane": 1, "position": 230.0, "speed": 22.0, "count": 8,
            "spacing": -24.0, "lane_changes": True,
            "jitter": {"position": 5.0, "speed": 3.0}}  # fmt: skip
    states = assert_equal(road(actors={"slow": slow, "fast": fast}), seed=2, ticks=160)
    lanes = [{vehicle[5] for vehicle in tick} for tick in states]
    assert len(set.union(*lanes)) >= 3


@pytest.mark.parametrize("seed", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in (1, 2, 3))])
def test_pile_ups(seed):
    """Impacts overwrite each other, so that even the order of the pairs shows."""
    wall = {"road": "main", "lane": 1, "position": 240.0, "speed": 0.5, "count": 3, "spacing": -5.2}
    ram = {"road": "main", "lane": 1, "position": 205.0, "speed": 24.0, "driver": "cruise",
           "count": 6, "spacing": -7.0, "jitter": {"position": 1.0, "speed": 3.0}}  # fmt: skip
    swerve = {"road": "main", "lane": 2, "position": 220.0, "speed": 16.0, "driver": "cruise",
              "count": 5, "spacing": -6.0, "commands": [{"time": 0.5, "lane": 1}]}  # fmt: skip
    truck = {"road": "main", "lane": 0, "position": 214.0, "speed": 18.0, "driver": "cruise",
             "label": "truck", "commands": [{"time": 0.3, "lane": 1}]}  # fmt: skip
    scene = road(actors={"wall": wall, "ram": ram, "swerve": swerve, "truck": truck})
    assert crashes(assert_equal(scene, seed, ticks=50 if seed == 0 else 100)) >= 6


def test_obstacles(monkeypatch):
    """Things that stand on the road, between lanes and off it, and landmarks that nobody sees."""
    cars = {"road": "main", "lane": 1, "position": 200.0, "speed": 20.0, "count": 6,
            "spacing": -22.0, "lane_changes": True}  # fmt: skip
    blind = {"road": "main", "lane": 2, "position": 190.0, "speed": 20.0, "driver": "cruise"}
    plain = traffic.open_roads

    def with_obstacles(form, rate, streams):
        opened = plain(form, rate, streams)
        for kind, place in (
            (highway.Obstacle, (260.0, 4.0)),
            (highway.Landmark, (245.0, 4.0)),
            (highway.Obstacle, (270.0, 6.0)),
            (highway.Obstacle, (270.0, 8.0)),
            (highway.Obstacle, (270.0, 40.0)),
        ):
            opened.road.objects.append(kind(opened.road, place))
        return opened

    monkeypatch.setattr(traffic, "open_roads", with_obstacles)
    states = assert_equal(road(actors={"cars": cars, "blind": blind}), seed=1, ticks=160)
    assert crashes(states) >= 1


def dense(cars):
    lanes = {
        f"lane{lane}": {"road": "main", "lane": lane, "position": 1800.0 + 3 * lane,
                        "speed": 24.0 - lane, "count": cars // 4, "spacing": -16.0,
                        "lane_changes": True, "jitter": {"position": 4.0, "speed": 3.0}}
        for lane in range(4)
    }  # fmt: skip
    return road(actors=lanes)


def test_two_hundred_cars():
    assert_equal(dense(200), seed=0, ticks=4)


@pytest.mark.slow
def test_two_hundred_cars_for_long():
    assert_equal(dense(200), seed=1, ticks=120)


def test_a_vehicle_that_others_move_is_looked_up_again():
    """What is known of a place is forgotten when the place changes outside `step`."""
    scene = dense(12)

    def moved(opened):
        states = []
        for tick in range(30):
            opened.step()
            if tick == 10:
                opened.road.vehicles[3].position = np.add(
                    opened.road.vehicles[3].position, (9.0, 0.5)
                )
                opened.road.vehicles[4].position[0] += 6.0
                opened.road.vehicles[5].heading += 0.05
                opened.road.vehicles[6].speed *= 0.7
            states.append(state(opened.road))
        return states

    def opened():
        made = traffic.open_roads(scene, 20, Streams(0))
        for hook in made.hooks:
            hook(0)
        return made

    with stock():
        expected = moved(opened())
    assert moved(opened()) == expected


@pytest.mark.parametrize("seed", range(8))
def test_possible_collisions_as_plain(seed):
    """Crowds of boxes, some of them at one place, some standing, things behind the vehicles."""
    if kernels.native is None:
        pytest.skip("nothing is compiled")
    rng = np.random.default_rng(seed)
    count = int(rng.integers(0, 60))
    position = rng.uniform(-30, 30, (count, 2))
    position[: count // 5] = position[: count // 5].round(-1)
    crowd = (
        position,
        rng.uniform(-7, 7, count),
        rng.uniform(0, 40, count) * (rng.random(count) < 0.8),
        rng.uniform(0.3, 7, count),
        rng.uniform(0.3, 1.5, count),
        count - seed % 3 * count // 6,
        1 / 15,
    )
    fast, plain = kernels.native.near_pairs(*crowd), kernels.TWINS["near_pairs"](*crowd)
    assert [found.tolist() for found in fast] == [found.tolist() for found in plain]
    assert count < 20 or len(plain[0]) > 0


def test_other_classes_of_road_stay_as_they_are():
    class OwnRoad(highway.Road):
        pass

    network = highway.RoadNetwork.straight_road_network(1)
    own = OwnRoad(network, np_random=np.random.default_rng(0))
    assert type(fast_road.adopt(own)) is OwnRoad


def test_the_pinned_parameters_are_all_there():
    names = {name for name in vars(highway.IDMVehicle) if name.isupper()}
    assert names <= set(PARAMETERS)
