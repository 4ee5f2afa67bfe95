"""Ground truth from highway-env: each way in which it can be silently wrong is closed."""

import copy
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.labels import Label
from pmbm.sim import schema
from pmbm.sim.scenario.scenario import catalogue_folder, simulate
from pmbm.sim.toml_tables import read_toml


def form(name, **changes):
    """A catalogue file's form, with dotted keys changed."""
    document = read_toml(catalogue_folder() / f"{name}.toml")
    document.pop("sweep", None)
    for key, value in changes.items():
        *path, last = key.split("__")
        table = document
        for part in path:
            table = table.setdefault(part, {})
        table[last] = value
    return schema.parse(document)


def road_form(**scene):
    base = {
        "kind": "road",
        "roads": {"main": {"start": [0.0, 0.0], "end": [1000.0, 0.0], "lanes": 2}},
        "sensor": {"pose": [100.0, 20.0, 0.0], "max_range": 500.0},
    }
    document = {"name": "test", "stresses": "a test of its own", "duration": 5.0}
    return schema.parse({**document, "scene": {**base, **scene}})


def gymnasium_form(env_id, duration=10.0, **scene):
    return schema.parse(
        {
            "name": "test",
            "stresses": "a test of its own",
            "duration": duration,
            "scene": {"kind": "gymnasium", "id": env_id, **scene},
        }
    )


def tracks_of(scene):
    """id -> (frames, rows of truth) of each object."""
    found = {}
    for frame, truth in enumerate(scene.truth):
        for row, object_id in enumerate(truth.id.tolist()):
            found.setdefault(object_id, []).append(
                (frame, truth.position[row], truth.velocity[row], truth.yaw[row])
            )
    return {
        object_id: tuple(np.array(column) for column in zip(*rows, strict=True))
        for object_id, rows in found.items()
    }


@pytest.fixture(scope="module")
def roundabout():
    return simulate(form("roundabout"), seed=1)


@pytest.fixture(scope="module")
def intersection():
    sparse = {"spawn_probability": 0.15, "initial_vehicle_count": 8}
    return simulate(gymnasium_form("intersection-v2", 30.0, config=sparse), seed=4)


def test_ids_are_stable_and_never_used_again(intersection):
    tracks = tracks_of(intersection)
    assert len(tracks) >= 8
    for frames, position, _, _ in tracks.values():
        assert np.array_equal(frames, np.arange(frames[0], frames[0] + len(frames)))
        steps = np.hypot(*np.diff(position[:, :2], axis=0).T)
        assert steps.max(initial=0.0) < 4.5
    assert len(set(intersection.object_name.values())) == len(tracks)


def test_velocity_is_the_change_of_position_in_bends(roundabout):
    slip = []
    for _, position, velocity, yaw in tracks_of(roundabout).values():
        between = (velocity[1:] + velocity[:-1]) / 2
        moved = np.diff(position[:, :2], axis=0) * roundabout.rate
        assert np.median(np.hypot(*(moved - between).T)) < 0.1
        speed = np.hypot(*velocity.T)
        along = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
        slip.extend(np.hypot(*(velocity - along).T))
    # The simulator's own velocity points along the heading; the true one does not in a bend.
    assert np.quantile(slip, 0.95) > 0.8


def test_the_clock_counts_ticks():
    scene = simulate(
        road_form(actors={"car": {"road": "main", "position": 10.0, "speed": 13.0,
                                  "driver": "cruise"}}), 0
    )  # fmt: skip
    assert [frame.time for frame in scene.truth] == [k / 10 for k in range(50)]
    assert scene.stamp.tolist() == [k * 100_000_000 for k in range(50)]
    x = [frame.position[0, 0] for frame in scene.truth]
    assert np.allclose(x, 10.0 + 13.0 * np.arange(50) / 10, rtol=0, atol=1e-9)


def test_the_sensor_rate_divides_the_simulation_rate(tmp_path):
    from pmbm.sim.scenario.scenario import load_scenario

    text = (catalogue_folder() / "single_straight.toml").read_text()
    (tmp_path / "odd.toml").write_text(
        text.replace("[scene]", "rate = 10\nsimulation_rate = 15\n[scene]")
    )
    with pytest.raises(InputError, match=r"rate.*1, 3, 5, 15, got 10"):
        load_scenario(tmp_path / "odd.toml")


def test_scenes_leave_no_trace_on_each_other():
    """Intersections rewrite the driver model of the class they are given; the class is ours, and
    a foreign one made in this process changes nothing of ours either."""
    import gymnasium

    from pmbm.sim.world.actors import Car
    from pmbm.sim.world.highway import env as highway

    names = [name for name in vars(highway.IDMVehicle) if name.isupper()]
    pristine = {name: getattr(highway.IDMVehicle, name) for name in names}
    own = {name: getattr(Car, name) for name in names}
    assert {k: list(v) if isinstance(v, tuple) else v for k, v in own.items()} == pristine
    before = simulate(form("roundabout", duration=8.0), 5).truth_digest()
    simulate(gymnasium_form("intersection-v2", 3.0), 0)
    assert {name: getattr(highway.IDMVehicle, name) for name in names} == pristine
    try:
        gymnasium.make("intersection-v2", disable_env_checker=True)
        assert pristine["COMFORT_ACC_MAX"] != highway.IDMVehicle.COMFORT_ACC_MAX
        assert {name: getattr(Car, name) for name in names} == own
        assert simulate(form("roundabout", duration=8.0), 5).truth_digest() == before
    finally:
        for name, value in pristine.items():
            setattr(highway.IDMVehicle, name, value)


def test_our_world_is_right_handed(roundabout):
    scene = simulate(
        road_form(
            roads={
                "main": {"start": [0.0, 5.0], "end": [300.0, 5.0], "lanes": 2},
                "bend": {"centre": [0.0, 100.0], "radius": 30.0, "from_deg": -90.0, "to_deg": 270.0,
                         "leads_to": "bend"},
            },
            actors={
                "right": {"road": "main", "lane": 1, "position": 50.0, "speed": 10.0},
                "turning": {"road": "bend", "speed": 8.0},
            },
        ),
        0,
    )  # fmt: skip
    first, last = scene.truth[0], scene.truth[-1]
    assert first.position[0, 1] == pytest.approx(1.0)  # lane 1 is a lane to the right of y = 5
    assert first.position[1] == pytest.approx([0.0, 70.0, 0.8])
    assert first.yaw[1] == pytest.approx(0.0, abs=1e-9)
    assert last.position[1, 0] > 20.0  # counter-clockwise from the bottom: to the right, and up
    assert 0.8 < last.yaw[1] < 1.6
    # Traffic that keeps to the right circulates counter-clockwise.
    for _, position, velocity, _ in tracks_of(roundabout).values():
        ring = (np.hypot(*position[:, :2].T) < 26) & (np.hypot(*velocity.T) > 3)
        turning = position[ring, 0] * velocity[ring, 1] - position[ring, 1] * velocity[ring, 0]
        assert ring.sum() < 20 or np.mean(turning > 0) > 0.8


def test_headings_are_wrapped_and_follow_the_motion(roundabout):
    for _, _, velocity, yaw in tracks_of(roundabout).values():
        assert np.all((yaw >= -np.pi) & (yaw < np.pi))
        moving = np.hypot(*velocity.T) > 3
        course = np.arctan2(velocity[moving, 1], velocity[moving, 0])
        assert np.median(np.abs(np.angle(np.exp(1j * (course - yaw[moving]))))) < 0.3


def test_what_has_left_is_gone_for_good():
    traffic_form = gymnasium_form(
        "highway-v0", 12.0, sensor={"max_range": 60.0}, config={"vehicles_count": 25}
    )
    scene = simulate(traffic_form, 2)
    for frames, position, _, _ in tracks_of(scene).values():
        assert np.array_equal(frames, np.arange(frames[0], frames[0] + len(frames)))
        offset = position[:, :2] - scene.sensor_pose[frames, :2]
        assert np.hypot(*offset.T).max() <= 65.0
        assert np.hypot(*offset[0]) <= 60.0 + 1e-9


def test_departed_vehicles_leave_the_road():
    from pmbm.sim.streams import Streams
    from pmbm.sim.world import traffic

    scene = road_form(
        sensor={"pose": [0.0, 5.0, 0.0], "max_range": 50.0},
        actors={"car": {"road": "main", "speed": 25.0, "count": 3, "spacing": 20.0}},
    ).scene
    opened = traffic.open_roads(scene, 20, Streams(0))
    traffic.drive(opened, 200, 0, 50.0, np.tile([0.0, 5.0, 0.0], (200, 1)))
    assert opened.road.vehicles == []


def test_hashes_are_equal_across_processes():
    forms = [form(name, duration=4.0) for name in ("roundabout", "truck_occlusion")]
    here = [simulate(each, 11, trial=2).truth_digest() for each in forms]
    code = (
        "import json, sys; from pmbm.sim import schema;"
        "from pmbm.sim.scenario.scenario import simulate;"
        "forms = map(schema.parse, json.loads(sys.argv[1]));"
        "print(*(simulate(form, 11, trial=2).truth_digest() for form in forms))"
    )
    there = subprocess.run(
        [sys.executable, "-c", code, json.dumps([each.model_dump() for each in forms])],
        env={**os.environ, "PYTHONHASHSEED": "1"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert there.stdout.split() == here


def test_seeds_and_trials_make_different_scenes_and_touch_no_global_state():
    state = np.random.get_state()[1].copy()  # noqa: NPY002
    digests = {
        simulate(form(name, duration=3.0), seed, trial).truth_digest()
        for name in ("roundabout", "crossing", "truck_occlusion", "single_straight")
        for seed, trial in ((0, 0), (0, 1), (1, 0))
    }
    assert len(digests) == 12
    assert np.array_equal(np.random.get_state()[1], state)  # noqa: NPY002


def test_roads_are_given_a_seeded_generator():
    from pmbm.sim.streams import Streams
    from pmbm.sim.world import traffic

    for opened in (
        traffic.open_roads(road_form().scene, 20, Streams(1)),
        traffic.open_gymnasium(gymnasium_form("merge-v1").scene, 20, Streams(1)),
    ):
        assert isinstance(opened.road.np_random, np.random.Generator)


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ({"vehicles_cuont": 3}, ["scene.config.vehicles_cuont", "'vehicles_count'"]),
        ({"vehicles_count": "many"}, ["vehicles_count", "int", "'many'"]),
        ({"simulation_frequency": 15}, ["simulation_frequency", "set by the recorder"]),
    ],
)
def test_settings_that_highway_env_would_swallow_are_refused(config, words):
    with pytest.raises(InputError) as caught:
        simulate(gymnasium_form("highway-v0", config=config), 0)
    for word in words:
        assert word in str(caught.value)


def test_unknown_environments_and_lanes_are_refused_with_the_nearest():
    with pytest.raises(InputError, match="roundabout-v1"):
        simulate(gymnasium_form("roundabout-v0"), 0)
    entry = {"lane": ["eer", "ees", 7], "rate": 0.1, "speed": 8.0}
    with pytest.raises(InputError, match="eer ees 0"):
        simulate(gymnasium_form("roundabout-v1", entries={"east": entry}), 0)


def test_every_size_has_its_own_collision_radius():
    from pmbm.sim.world.actors import vehicle_class
    from pmbm.sim.world.highway import env as highway

    road = highway.Road(
        highway.RoadNetwork.straight_road_network(1), np_random=np.random.default_rng(0)
    )
    for driver in ("idm", "cruise"):
        truck = vehicle_class(driver, Label.TRUCK, 14.0, 2.6)(road, [0.0, 0.0])
        assert truck.diagonal == np.hypot(14.0, 2.6)
        assert vehicle_class(driver, Label.TRUCK, 14.0, 2.6) is type(truck)


def test_the_ego_carries_the_sensor_and_drives():
    """It is no object, hides nothing, and follows its leader where an idle one would crash."""
    ego = {"road": "main", "position": 100.0, "speed": 20.0}
    leader = {"road": "main", "position": 130.0, "speed": 5.0}
    parked = {"road": "main", "lane": 1, "position": 102.0, "speed": 0.0}
    scene = simulate(
        road_form(
            sensor={"max_range": 200.0},
            ego=ego,
            actors={"leader": leader, "parked": parked},
        ),
        0,
    )
    assert scene.sensor_pose[0] == pytest.approx([100.0, 0.0, 0.0])
    assert all(len(frame) == 2 for frame in scene.truth)
    assert all(frame.visibility.min() == 1.0 for frame in scene.truth)
    gap = [
        frame.position[0, 0] - pose[0]
        for frame, pose in zip(scene.truth, scene.sensor_pose, strict=True)
    ]
    assert min(gap) > 6.0
    speed = np.diff(scene.sensor_pose[:, 0]) * scene.rate
    assert speed[0] > 15.0 > 8.0 > speed[-1]


def test_the_ego_of_a_registered_scene_drives_as_an_idm_car():
    from pmbm.sim.streams import Streams
    from pmbm.sim.world import traffic
    from pmbm.sim.world.actors import Car

    opened = traffic.open_gymnasium(gymnasium_form("merge-v1").scene, 20, Streams(4))
    assert type(opened.ego) is Car
    assert opened.ego in opened.road.vehicles
    scene = simulate(gymnasium_form("merge-v1", 12.0), 4)
    travelled = np.hypot(*np.diff(scene.sensor_pose[:, :2], axis=0).T).sum()
    assert travelled > 150.0
    for truth, pose in zip(scene.truth, scene.sensor_pose, strict=True):
        assert np.all(np.hypot(*(truth.position[:, :2] - pose[:2]).T) > 1.5)


def head_on(**scene):
    return road_form(
        actors={
            "fast": {"road": "main", "position": 50.0, "speed": 20.0, "driver": "cruise"},
            "slow": {"road": "main", "position": 80.0, "speed": 5.0, "driver": "cruise"},
        },
        **scene,
    )


def test_crashes_are_recorded_where_allowed_and_refused_elsewhere():
    scene = simulate(head_on(crashes="allowed"), 0)
    flags = np.array([frame.crashed for frame in scene.truth])
    assert not flags[0].any()
    assert flags[-1].all()
    assert np.all(np.diff(flags.astype(int), axis=0) >= 0)
    with pytest.raises(InputError, match=r"refuses crashes.*seed 0.*crashes = \"allowed\""):
        simulate(head_on(), 0)


def test_the_intersection_is_born_and_dies_on_our_clock(intersection):
    born = {frames[0] for frames, *_ in tracks_of(intersection).values()} - {0}
    died = {frames[-1] + 1 for frames, *_ in tracks_of(intersection).values()} - {300}
    assert len(born) >= 4
    assert len(died) >= 3
    # Once a second; those that the range lets in or out may come and go at any frame.
    near = [
        frames
        for frames, position, *_ in tracks_of(intersection).values()
        if np.hypot(*(position[-1, :2] - intersection.sensor_pose[frames[-1], :2])) < 95
    ]
    assert len(near) >= 3
    for frames in near:
        assert (frames[-1] + 1) % 10 == 0


def test_commands_change_lane_and_speed():
    scene = simulate(
        road_form(
            actors={
                "car": {
                    "road": "main",
                    "position": 100.0,
                    "speed": 20.0,
                    "commands": [{"time": 1.0, "lane": 1}, {"time": 2.0, "speed": 10.0}],
                }
            }
        ),
        0,
    )
    y = np.array([frame.position[0, 1] for frame in scene.truth])
    speed = np.array([frame.velocity[0, 0] for frame in scene.truth])
    assert np.all(y[:11] == 0.0)
    assert y[-1] == pytest.approx(-4.0, abs=0.1)
    assert speed[15] > 19.0
    assert speed[-1] < 14.0


def test_arrivals_wait_for_room_and_grow_with_the_rate():
    def arrived(rate):
        entry = {"road": "main", "position": 5.0, "rate": rate, "speed": 10.0}
        scene = simulate(road_form(entries={"in": entry}), 3)
        for frame in scene.truth:
            x = np.sort(frame.position[:, 0])
            assert np.all(np.diff(x) > 5.0)
        return len(scene.object_name)

    assert arrived(0.0) == 0
    assert 1 <= arrived(0.8) < arrived(3.0) <= 5


def test_trucks_hide_cars_for_seconds():
    document = read_toml(catalogue_folder() / "truck_occlusion.toml")
    sweep = document.pop("sweep")
    level = sweep["levels"].index(2.5)
    for key, values in sweep["set"].items():
        table = document
        for part in key.split(".")[:-1]:
            table = table[part]
        table[key.split(".")[-1]] = values[level]
    scene = simulate(schema.parse(document), 0)
    hidden = {}
    for truth in scene.truth:
        for object_id, share in zip(truth.id.tolist(), truth.visibility, strict=True):
            hidden.setdefault(object_id, []).append(share == 0.0)
    longest = [
        len(run) / scene.rate
        for flags in hidden.values()
        for run in "".join("x" if flag else " " for flag in flags).split()
    ]
    assert sum(1.0 <= seconds <= 4.0 for seconds in longest) >= 4


def test_more_copies_move_nobody_else():
    few = road_form(
        actors={
            "a": {"road": "main", "position": 300.0, "speed": 10.0, "jitter": {"position": 3.0}},
            "b": {"road": "main", "lane": 1, "position": 100.0, "speed": 10.0,
                  "jitter": {"position": 3.0}},
        }
    ).model_dump()  # fmt: skip
    many = copy.deepcopy(few)
    many["scene"]["actors"]["a"]["count"] = 3
    few, many = (simulate(schema.parse(document), 6) for document in (few, many))
    shared = np.isin(many.truth[0].id, few.truth[0].id)
    assert shared.sum() == 2
    assert np.array_equal(many.truth[0].position[shared], few.truth[0].position)


def test_a_recording_loads_neither_tables_nor_pictures(tmp_path):
    done = subprocess.run(
        [
            *(sys.executable, "-c"),
            "import sys\n"
            "from pmbm.sim.scenario.scenario import load_scenario\n"
            "load_scenario('merge').record(0)\n"
            "loaded = {'pandas', 'matplotlib', 'scipy.signal', 'scipy.stats'} & set(sys.modules)\n"
            "from highway_env.envs.common import observation\n"
            "from highway_env.vehicle import dynamics\n"
            "print(sorted(loaded), observation.pd.DataFrame, dynamics.plt.figure.__name__)",
        ],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PMBM_CACHE": str(tmp_path)},
    )
    assert done.stdout == "[] <class 'pandas.DataFrame'> figure\n"
