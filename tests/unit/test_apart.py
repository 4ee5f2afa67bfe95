"""Solid objects: what overlaps, who brakes, which births wait."""

import itertools

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from pmbm.errors import InputError
from pmbm.geometry import corners
from pmbm.labels import Label
from pmbm.sim import Scenario
from pmbm.sim.world.apart import GAP, first_meeting, followed, marked_crashed, overlaps, separation
from pmbm.sim.world.trajectory import Trajectory

RATE = 20
HERE = np.zeros((400, 3))
"""A sensor that stands at the origin for 20 s."""


def path(start, yaw_deg, speed, *, id=0, first=0, ticks=400, size=(5.0, 2.0, 1.5)):
    """A straight path at a steady speed."""
    yaw = np.deg2rad(yaw_deg)
    way = speed / RATE * np.arange(ticks)[:, None] * np.array([np.cos(yaw), np.sin(yaw)])
    return Trajectory(
        id=id,
        name=f"object {id}",
        label=Label.CAR,
        size=size,
        first=first,
        position=np.array(start, dtype=float) + way,
        yaw=np.full(ticks, yaw),
        crashed=np.zeros(ticks, bool),
    )


def polygon(path, tick):
    row = tick - path.first
    if not 0 <= row < len(path.yaw):
        return shapely.Polygon()
    place = [[*path.position[row], 0.0]]
    return shapely.Polygon(corners(place, [path.size], [path.yaw[row]])[0])


def distances(one, other):
    return np.array([polygon(one, k).distance(polygon(other, k)) for k in range(400)])


def keep(*tracks, others=(), reach=500.0):
    return followed(list(tracks), list(others), HERE, reach, RATE)


def speeds(path):
    return np.hypot(*np.diff(path.position, axis=0).T) * RATE


angles = st.floats(-180.0, 180.0)
places = st.tuples(st.floats(-8.0, 8.0), st.floats(-8.0, 8.0))
sizes = st.tuples(st.floats(0.4, 14.0), st.floats(0.4, 3.0))


@given(places, angles, angles, sizes, sizes)
def test_boxes_are_apart_where_shapely_says_so(offset, yaw, other_yaw, size, other):
    got = separation(
        np.array(offset), *np.deg2rad([yaw, other_yaw]), np.array(size), np.array(other)
    )
    boxes = [
        shapely.Polygon(corners([[*at, 0.0]], [[*s, 1.0]], [np.deg2rad(a)])[0])
        for at, s, a in (((0.0, 0.0), size, yaw), (offset, other, other_yaw))
    ]
    if got < -1e-6:
        assert shapely.intersection(*boxes).area > 0.0
    elif got > 1e-6:
        # Along an axis of either box; corner to corner it may be more.
        assert got <= boxes[0].distance(boxes[1]) + 1e-9


def test_overlaps_are_those_of_every_pair_at_every_tick():
    rng = np.random.default_rng(3)
    paths = [
        path(
            rng.uniform(-30, 30, 2), rng.uniform(0, 360), rng.uniform(0, 20), id=n,
            first=int(rng.integers(200)), ticks=int(rng.integers(1, 200)),
        )
        for n in range(25)
    ]  # fmt: skip
    expected = []
    for i, j in itertools.combinations(range(len(paths)), 2):
        met = [
            k
            for k in range(400)
            if polygon(paths[i], k).intersection(polygon(paths[j], k)).area > 1e-9
        ]
        if met:
            expected.append((met[0], i, j))
    assert len(expected) > 5
    assert overlaps(paths) == sorted(expected)


def test_a_follower_brakes_to_its_leaders_speed_and_keeps_a_gap():
    leader, follower = path([0, 0], 0, 8.0), path([-45, 0.4], 0, 11.0, id=1)
    assert first_meeting(leader, follower, 0.0) is not None
    (same, braked), left = keep(leader, follower)
    assert left is None
    assert same is leader
    assert distances(leader, braked).min() >= GAP
    speed = speeds(braked)
    assert speed[0] == pytest.approx(11.0)
    assert speed[-1] == pytest.approx(8.0, abs=0.3)
    assert np.diff(speed).max() < 0.01, "it never speeds up again"
    assert np.diff(speed).min() * RATE > -3.0
    # On its own line, and on its script until it has to brake.
    assert np.ptp(braked.position[:, 1]) == 0.0
    assert np.array_equal(braked.position[:50], follower.position[:50])
    # Whichever is written first.
    (again, same), _ = keep(follower, leader)
    assert same is leader
    assert np.array_equal(again.position, braked.position)


def test_behind_what_stands_one_stops_and_the_next_behind_that():
    parked = path([60, 0.5], 20, 0.0)
    queue = [path([-25.0 * n, 0], 0, 9.0, id=n) for n in (1, 2)]
    (same, *stopped), left = keep(parked, *queue)
    assert left is None
    assert same is parked
    assert all(speeds(each)[-1] < 0.1 for each in stopped)
    for one, other in itertools.combinations([parked, *stopped], 2):
        assert distances(one, other).min() >= GAP - 1e-9
    assert 0.5 <= distances(*stopped)[-1] < 3.0


def test_whose_front_would_touch_the_others_side_waits_and_goes_on():
    first, second = path([-40, 0], 0, 8.0), path([0, -43], 90, 8.0, id=1)
    (same, waited), left = keep(first, second)
    assert left is None
    assert same is first
    assert distances(first, waited).min() >= GAP
    assert waited.position[-1, 1] > 60.0, "it went on"


def test_cars_that_drivers_steer_are_never_moved():
    car, walker = path([-40, 0], 0, 8.0), path([0, -7.5], 90, 1.5, id=1, size=(0.6, 0.6, 1.7))
    (waited,), left = keep(walker, others=[car])
    assert left is None
    assert distances(car, waited).min() >= GAP
    assert waited.position[-1, 1] > 10.0


def test_what_does_not_meet_or_not_in_sight_stays_as_it_is():
    apart = [path([0, 0], 0, 8.0), path([-30, 2.1], 0, 11.0, id=1)]
    assert keep(*apart) == (apart, None)
    far = [path([900, 0], 0, 8.0), path([870, 0], 0, 11.0, id=1)]
    assert keep(*far, reach=100.0) == (far, None)


def test_what_drives_into_each_other_head_on_is_told():
    _, left = keep(path([-40, 0], 0, 8.0), path([40, 0], 180, 8.0, id=1))
    tick, one, other = left
    assert (one.name, other.name) == ("object 0", "object 1")
    assert polygon(one, tick).intersects(polygon(other, tick))


def test_vehicles_in_one_place_have_crashed():
    paths = [path([0, 0], 0, 8.0), path([-10, 0], 0, 12.0, id=1), path([0, 9], 0, 8.0, id=2)]
    tick = first_meeting(paths[0], paths[1], 0.0)
    marked = marked_crashed(paths)
    for one in marked[:2]:
        assert not one.crashed[:tick].any()
        assert one.crashed[tick:].all()
    assert marked[2] is paths[2]


def scripted(**scene):
    return Scenario(
        {
            "name": "solid",
            "stresses": "Objects that would drive through each other.",
            "scene": {"kind": "scripted", **scene},
        }
    )


HEAD_ON = {
    "east": {"start": [-40.0, 0.0], "speed": 8.0},
    "west": {"start": [40.0, 0.0], "yaw_deg": 180.0, "speed": 8.0},
}


def test_a_scenario_refuses_overlaps_unless_it_declares_them():
    with pytest.raises(InputError, match=r"east and west overlap \(seed 4, trial 0, t = "):
        scripted(tracks=HEAD_ON).record(4)
    truth = scripted(tracks=HEAD_ON, overlaps="allowed").record(4).truth
    nearest = min(np.linalg.norm(np.diff(frame.position, axis=0)) for frame in truth)
    assert nearest < 1.0


def born(rate, overlaps="refused", **more):
    births = {"arriving": {"rate": rate, "speed": [6.0, 14.0], **more}}
    world = scripted(births=births, sensor={"max_range": 60.0}, overlaps=overlaps)
    found = {}
    for number, frame in enumerate(world.scene(0).truth):
        for object_id, position in zip(frame.id.tolist(), frame.position, strict=True):
            found.setdefault(object_id, {})[number] = tuple(position)
    return found


def test_a_higher_rate_only_adds_births_and_a_shorter_life_moves_none():
    few, many = born(0.5), born(2.0)
    assert len(many) > 2 * len(few) > 0
    assert all(many[object_id] == places for object_id, places in few.items())
    brief = born(2.0, vanish=1.0)
    assert all(places.items() <= many[object_id].items() for object_id, places in brief.items())


def test_births_that_would_meet_others_are_put_off():
    solid, loose = born(1.0), born(1.0, overlaps="allowed")
    assert solid.keys() <= loose.keys()
    assert len(solid) >= 0.8 * len(loose)
    delay = [min(solid[n]) - min(loose[n]) for n in solid]
    assert min(delay) == 0
    assert 0 < sum(d > 0 for d in delay) < len(delay) / 2
