"""Several sensors of a scene: each on its own mount, clock, streams and detector; one recording."""

import pickle

import numpy as np
import pytest
import shapely

from pmbm import InputError, Recording, run
from pmbm.sim.scenario.scenario import Scenario
from pmbm.tracking import track, tracker_factory
from pmbm.types import CLUTTER, MountedSensor

PERFECT = {"profile": "perfect"}
RADAR = {"profile": "perfect", "radial_velocity": True, "objects": {"radial_velocity_noise": 0.0}}


def scenario(sensors, *, rate=10, duration=4.0, **scene):
    """An ego that turns at .3 rad/s past cars, one of them behind a wall."""
    return Scenario(
        {
            "name": "own_vehicle",
            "stresses": "several sensors on an ego that turns",
            "duration": duration,
            "rate": rate,
            "simulation_rate": 100,
            "scene": {
                "kind": "scripted",
                "sensor": {"max_range": 80.0},
                "ego": {
                    "start": [0.0, 0.0],
                    "speed": 10.0,
                    "moves": [{"seconds": 10.0, "turn_deg": 172.0}],
                },
                "tracks": {
                    "passing": {
                        "start": [-30.0, 25.0],
                        "yaw_deg": 20.0,
                        "speed": 9.0,
                        "count": 3,
                        "offset": [25.0, 12.0],
                    }
                },
                **scene,
            },
            "sensors": sensors,
        }
    )


def of(recording, sensor):
    return [
        (frame, one, origin)
        for frame, one, origin in zip(
            recording.frame.tolist(), recording.detections, recording.origin, strict=True
        )
        if one.sensor == sensor
    ]


def bits(deliveries):
    return [
        (frame, *(np.asarray(getattr(one, name)).tobytes() for name in one.__dataclass_fields__))
        for frame, one, _ in deliveries
        if one.sensor
    ]


def test_another_sensor_moves_no_draw_of_the_first():
    noisy = {"profile": "harsh"}
    alone = scenario({"roof": {"detector": noisy}}).record(5)
    beside = scenario(
        {"a": {"rate": 5, "detector": noisy}, "roof": {"detector": noisy}, "z": {}}
    ).record(5)
    assert bits(of(alone, "roof")) == bits(of(beside, "roof"))


def test_two_sensors_that_are_alike_but_in_name_draw_each_its_own():
    noisy = {"detector": {"profile": "harsh"}}
    recording = scenario({"left": noisy, "right": noisy}).record(5)
    left, right = (
        np.concatenate([one.score for _, one, _ in of(recording, name)])
        for name in ("left", "right")
    )
    assert len(np.intersect1d(left, right)) < 0.05 * len(left)


def test_the_order_in_the_file_makes_no_difference():
    one = scenario({"a": {}, "b": {"rate": 5}}).record(2)
    other = scenario({"b": {"rate": 5}, "a": {}}).record(2)
    assert one.detections_digest() == other.detections_digest()


def test_each_looks_at_its_own_rate_and_phase():
    recording = scenario({"fast": {"detector": PERFECT}, "slow": {"rate": 2, "phase": 0.3}}).record(
        0
    )
    times = {name: [one.time for _, one, _ in of(recording, name)] for name in ("fast", "slow")}
    np.testing.assert_allclose(times["fast"], np.arange(40) / 10)
    np.testing.assert_allclose(times["slow"], 0.3 + np.arange(8) / 2)


def test_a_slow_delivery_arrives_late_and_is_waited_for():
    recording = scenario({"fast": {}, "slow": {"rate": 5, "latency": 0.15}}).record(0)
    arrived = [(one.sensor, round(one.time, 3)) for one in recording.detections[:6]]
    assert arrived == [
        ("fast", 0.0),
        ("fast", 0.1),
        ("slow", 0.0),
        ("fast", 0.2),
        ("fast", 0.3),
        ("slow", 0.2),
    ]
    given = recording.handed_over()
    assert len(given) == len(recording.detections)
    time = [recording.detections[d].time for d in given]
    assert time == sorted(time)
    tracks = run(tracker_factory("pmbm")(site=recording.site), recording)
    assert tracks.dropped == 0
    assert tracks.frame.tolist() == list(range(40))


def test_a_sensor_that_fails_delivers_nothing_more():
    fails = {"detector": {"profile": "perfect", "sensor": {"fails_at": 1.5}}}
    recording = scenario({"sure": {}, "fails": fails}).record(1)
    assert [one.time for _, one, _ in of(recording, "fails")] == [k / 10 for k in range(15)]
    assert len(of(recording, "sure")) == 40


def test_what_comes_later_than_the_slowest_is_dropped():
    late = {"detector": {"profile": "perfect", "sensor": {"late_probability": 0.3, "late_by": 3}}}
    recording = scenario({"sure": {}, "late": late}).record(1)
    given = recording.handed_over()
    time = np.array([recording.detections[d].time for d in given])
    assert 3 < len(recording.detections) - len(given) < 40
    assert (np.diff(time) >= 0).all()


def test_a_poorly_placed_sensor_sees_less_than_another():
    """A wall ahead hides what stands behind it from the bumper, and not from a mast to the left."""
    wall = {"wall": {"box": [10.0, 0.0, 1.0, 6.0, 0.0]}}
    standing = {"car": {"start": [20.0, 0.0], "speed": 0.0}}
    recording = scenario(
        {
            "bumper": {"mount": [2.0, 0.0, 0.0], "detector": PERFECT},
            "mast": {"mount": [2.0, 20.0, 0.0], "detector": PERFECT},
        },
        occluders=wall,
        tracks=standing,
        ego={"start": [0.0, 0.0], "speed": 0.0},
    ).record(0)
    first = recording.truth[0]
    assert first.observable.tolist() == [True]
    assert first.visibility[0] == pytest.approx(1.0)
    assert not recording.observable_by["bumper"][0].any()
    assert recording.observable_by["mast"][0].all()
    assert not recording.seen_by("bumper").truth[0].observable.any()
    assert [len(one) for _, one, _ in of(recording, "mast")] == [1] * 40
    with pytest.raises(InputError, match="mast") as error:
        recording.seen_by("mats")
    assert "mast" in str(error.value)


def test_the_field_of_view_is_that_of_the_mount():
    recording = scenario(
        {"rear": {"mount": [-1.0, 0.0, 180.0], "fov_deg": 90.0, "detector": PERFECT}}
    ).record(0)
    for frame, one, _ in of(recording, "rear"):
        pose = one.sensor_pose
        offset = one.position[:, :2] - pose[:2]
        aside = np.arctan2(offset[:, 1], offset[:, 0]) - pose[2]
        assert (np.abs(np.mod(aside + np.pi, 2 * np.pi) - np.pi) <= np.pi / 4 + 1e-9).all()
        carrier = recording.site.sensors[0].carrier_of(pose)
        assert np.hypot(*(pose[:2] - carrier[:2])) == pytest.approx(1.0)
        assert carrier[2] == pytest.approx(0.3 * recording.truth[frame].time, abs=2e-3)


def ranges(recording, sensor, frame):
    """Distance from the sensor of every object in a frame, by its id."""
    (delivery,) = [one for f, one, _ in of(recording, sensor) if f == frame]
    truth = recording.truth[frame]
    offset = truth.position[:, :2] - delivery.sensor_pose[:2]
    return dict(zip(truth.id.tolist(), np.hypot(*offset.T).tolist(), strict=True))


def test_the_radial_velocity_is_the_derivative_of_the_range():
    """With an offset mount on a turning ego: without omega x r it would be off by metres a second.

    The reference is the range itself, a hundredth of a second before and after.
    """
    radar = {"mount": [3.0, 4.0, 30.0], "detector": RADAR}
    recording = scenario({"radar": radar}, rate=100, duration=2.0).record(0)
    turn_matters = 0.0
    for frame in range(20, 180, 20):
        ((_, delivery, origin),) = [one for one in of(recording, "radar") if one[0] == frame]
        before, after = ranges(recording, "radar", frame - 1), ranges(recording, "radar", frame + 1)
        ids = recording.truth[frame].id[origin]
        rate = np.array([(after[i] - before[i]) / 0.02 for i in ids.tolist()])
        np.testing.assert_allclose(delivery.radial_velocity, rate, atol=5e-3)
        heading = recording.site.sensors[0].carrier_of(delivery.sensor_pose)[2]
        carrier = 10.0 * np.array([np.cos(heading), np.sin(heading)])
        # v + omega x r, with r the mount turned into the world.
        x, y = recording.site.sensors[0].mount[:2]
        r = np.array(
            [x * np.cos(heading) - y * np.sin(heading), x * np.sin(heading) + y * np.cos(heading)]
        )
        expected = carrier + np.deg2rad(17.2) * np.array([-r[1], r[0]])
        np.testing.assert_allclose(delivery.sensor_velocity, expected, atol=0.03)
        turn_matters = max(turn_matters, np.hypot(*(expected - carrier)))
    assert turn_matters > 1.0


def test_a_radar_measures_range_and_azimuth_with_their_own_noise():
    noise = {"radial_noise": 0.2, "azimuth_noise": 0.03}
    radar = {"detector": {"profile": "perfect", "objects": noise}}
    recording = scenario({"radar": radar}, rate=50, duration=20.0).record(0)
    along, aside = [], []
    for frame, one, origin in of(recording, "radar"):
        truth = recording.truth[frame].position[origin, :2] - one.sensor_pose[:2]
        measured = one.position[:, :2] - one.sensor_pose[:2]
        along.append(np.hypot(*measured.T) - np.hypot(*truth.T))
        cross = truth[:, 0] * measured[:, 1] - truth[:, 1] * measured[:, 0]
        aside.append(np.arctan2(cross, (truth * measured).sum(axis=1)))
    along, aside = np.concatenate(along), np.concatenate(aside)
    # Four standard errors of a mean, and of a standard deviation.
    for error, sd in ((along, 0.2), (aside, 0.03)):
        assert abs(error.mean()) < 4 * sd / np.sqrt(len(error))
        assert abs(error.std() - sd) < 4 * sd / np.sqrt(2 * len(error))
    assert abs(np.corrcoef(along, aside)[0, 1]) < 4 / np.sqrt(len(along))


def test_false_boxes_of_a_radar_move_as_they_are_said_to():
    clutter = {"rate": 20.0, "speed_spread": 4.0}
    radar = {"detector": {"profile": "perfect", "radial_velocity": True, "clutter": clutter}}
    recording = scenario({"radar": radar}).record(0)
    speed = []
    for _, one, origin in of(recording, "radar"):
        false = origin == CLUTTER
        offset = one.position[false, :2] - one.sensor_pose[:2]
        sight = offset / np.hypot(*offset.T)[:, None]
        speed.append(one.radial_velocity[false] + sight @ one.sensor_velocity)
    speed = np.concatenate(speed)
    assert abs(speed.mean()) < 4 * 4.0 / np.sqrt(len(speed))
    assert abs(speed.std() - 4.0) < 4 * 4.0 / np.sqrt(2 * len(speed))


def test_every_tracker_and_the_bound_take_the_union_of_deliveries():
    recording = scenario({"front": {"fov_deg": 180.0}, "rear": {"rate": 5}}).record(3)
    for name in ("pmbm", "pmbm-paper", "argoverse", "waymo", "probabilistic_kf", "clairvoyant"):
        tracks = track(tracker_factory(name), recording, 0)
        assert tracks.frame.tolist() == list(range(40)), name


def test_a_recording_of_several_sensors_travels():
    recording = scenario({"a": {"detector": RADAR}, "b": {}}).record(3)
    again = pickle.loads(pickle.dumps(recording))
    assert again.digest() == recording.digest()
    assert again.observable_by.keys() == recording.observable_by.keys()
    assert [one.name for one in again.site.sensors] == ["a", "b"]


@pytest.mark.parametrize(
    ("sensors", "field", "says"),
    [
        ({"a": {"rate": 3}}, "sensors.a.rate", "divide"),
        ({"a": {"rate": 5, "phase": 0.25}}, "sensors.a.phase", "phase"),
        ({"a": {"rate": 5, "phase": 0.2}}, "sensors.a.phase", "phase"),
        ({"a": {"max_range": 90.0}}, "sensors.a.max_range", "farther"),
        ({"a": {"mount": [100.0, 0.0, 0.0]}}, "sensors.a.mount", "farther"),
        ({"a": {"mont": [1.0, 0.0, 0.0]}}, "sensors.a.mont", "mount"),
        ({"a": {"detector": {"profile": "nominl"}}}, "sensors.a.detector.profile", "nominal"),
        (
            {"a": {"detector": {"objects": {"azimuth_noise": -1.0}}}},
            "sensors.a.detector.objects.azimuth_noise",
            "at least 0",
        ),
    ],
)
def test_a_sensor_that_cannot_be_is_refused_by_its_key(sensors, field, says):
    with pytest.raises(InputError) as error:
        scenario(sensors)
    assert error.value.field == field
    assert says in str(error.value)


def test_a_sweep_reaches_a_sensor():
    base = scenario({"a": {}, "b": {}})
    sweep = {"parameter": "sensors.b.rate", "levels": [10, 5, 1]}
    swept = Scenario({**base.document, "sweep": sweep})
    found = [len(of(swept.record(0, level=level), "b")) for level in (10, 5, 1)]
    assert found == [40, 20, 4]
    with pytest.raises(InputError, match=r"no sensor 'c' in the scenario.*a or b"):
        Scenario({**base.document, "sweep": {**sweep, "parameter": "sensors.c.rate"}})
    reaching = {"parameter": "sensors.b.detector.objects.detection_probability", "levels": [1, 0]}
    swept = Scenario({**base.document, "sweep": reaching})
    found = [sum(len(one) for _, one, _ in of(swept.record(0, level=v), "b")) for v in (1, 0)]
    clutter_alone = sum(len(one) for _, one, o in of(swept.record(0, level=0), "b"))
    assert found[0] > 100
    assert found[1] == clutter_alone


def test_a_mount_takes_a_pose_there_and_back():
    rng = np.random.default_rng(0)
    for _ in range(20):
        sensor = MountedSensor(name="a", mount=rng.normal(0, 2, 3))
        carrier = rng.normal(0, 3, 3)
        np.testing.assert_allclose(sensor.carrier_of(sensor.pose_on(carrier)), carrier, atol=1e-12)


def test_the_replay_says_which_sensor_gave_what():
    from pmbm.reports.encode import encode_replay
    from pmbm.reports.values import ReplayPage

    recording = scenario(
        {"front": {"fov_deg": 90.0}, "rear": {"mount": [-2.0, 0.0, 180.0]}}
    ).record(0)
    tracks = run(tracker_factory("pmbm")(site=recording.site), recording)
    page = encode_replay(ReplayPage(recording=recording, tracks={"pmbm": tracks}))
    assert [one["name"] for one in page["site"]["sensors"]] == ["front", "rear"]
    assert page["site"]["sensors"][1]["mount"] == [-2.0, 0.0, 3.1416]
    given = page["detections"]
    assert "sensor" in given["columns"]
    assert given["rows"] == sum(len(one) for one in recording.detections)


def test_hidden_is_what_no_sensor_sees():
    """A wall ahead of the bumper, and a mast that sees behind it."""
    from pmbm.reports.shadows import hidden_region
    from pmbm.types import GroundTruth, Site

    empty = {name: np.zeros((0, 3)) for name in ("position", "size")}
    nothing = GroundTruth(
        time=0.0, id=[], yaw=[], velocity=np.zeros((0, 2)), label=[], visibility=[],
        observable=[], crashed=[], **empty,
    )  # fmt: skip
    wall = np.array([[10.0, -3.0], [11.0, -3.0], [11.0, 3.0], [10.0, 3.0]])
    bumper = MountedSensor(name="bumper", max_range=50.0)
    mast = MountedSensor(name="mast", mount=np.array([0.0, 30.0, 0.0]), max_range=50.0)

    def hides(sensors, x, y):
        site = Site(max_range=80.0, occluders=(wall,), sensors=sensors)
        return shapely.intersects_xy(hidden_region(nothing, site, np.zeros(3)), x, y)

    assert hides((bumper,), 20.0, 0.0)
    assert not hides((bumper, mast), 20.0, 0.0)
    assert hides((bumper, mast), -70.0, 0.0)


def test_the_picture_names_the_sensors():
    from pmbm.reports.figures import scene_picture

    recording = scenario(
        {"front": {"fov_deg": 90.0}, "rear": {"mount": [-2.0, 0.0, 180.0]}}
    ).record(0)
    tracks = run(tracker_factory("pmbm")(site=recording.site), recording)
    figure = scene_picture(recording, {"pmbm": tracks}, 10)
    said = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"detection, front", "detection, rear"} <= set(said)


def test_tables_give_every_sensor_back():
    recording = scenario({"a": {"detector": RADAR}, "b": {"rate": 5, "latency": 0.1}}).record(3)
    again = Recording.from_tables(recording.to_tables(), site=recording.site)
    assert again.digest() == recording.digest()
    assert again.observable_by.keys() == recording.observable_by.keys()
