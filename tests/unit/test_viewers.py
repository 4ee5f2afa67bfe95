"""Logs for viewers: written, read back by the formats' own readers, and counted."""

import base64
import dataclasses
import json
import re
import sys
import threading
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from google.protobuf import json_format
from mcap.reader import make_reader

from pmbm import run
from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.external.program import close_programs
from pmbm.reports.replays import trial_replay
from pmbm.reports.values import ReplayPage
from pmbm.reports.viewers import check_log, write_log
from pmbm.reports.viewers.layout import nanoseconds
from pmbm.sim import load_scenario
from pmbm.tracking import tracker_factory

PASSING = Path(__file__).parents[1] / "examples" / "my_program" / "passing.toml"


def replay_of(seed, trackers=("pmbm", "argoverse"), **more):
    scenario = load_scenario(str(PASSING))
    return trial_replay(scenario, {name: name for name in trackers}, seed, 0, **more)[0]


@pytest.fixture(scope="module")
def replay():
    return replay_of(3)


def moved(replay, shift):
    """The same trial elsewhere in the world."""
    shift = np.array([*shift, 0.0])

    def there(value):
        more = {}
        if hasattr(value, "sensor_pose"):
            more["sensor_pose"] = value.sensor_pose + shift
        return dataclasses.replace(value, position=value.position + shift, **more)

    recording = replay.recording
    elsewhere = dataclasses.replace(
        recording,
        truth=tuple(map(there, recording.truth)),
        detections=tuple(map(there, recording.detections)),
    )
    tracks = {
        name: dataclasses.replace(
            sequence, steps=tuple(dataclasses.replace(there(s), undetected=None) for s in sequence)
        )
        for name, sequence in replay.tracks.items()
    }
    return ReplayPage(recording=elsewhere, tracks=tracks)


def messages(file):
    """Topic -> (schema's name, schema, stamp, value) of each message."""
    found = {}
    with file.open("rb") as stream:
        for schema, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            assert channel.message_encoding == "json"
            assert schema.encoding == "jsonschema"
            assert message.publish_time == message.log_time
            value = json.loads(message.data)
            found.setdefault(channel.topic, []).append(
                (schema.name, json.loads(schema.data), message.log_time, value)
            )
    return found


def metadata(file):
    with file.open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
    return record.metadata


@pytest.fixture(scope="module")
def logged(replay, tmp_path_factory):
    file = tmp_path_factory.mktemp("logs") / "run.mcap"
    write_log(replay, file)
    return file


def test_every_frame_delivery_and_step_is_there(replay, logged):
    recording, found = replay.recording, messages(logged)
    counts = {topic: len(values) for topic, values in found.items()}
    assert counts == {
        "/tf": 1 + len(recording.detections),
        "/site": 1,
        "/truth": len(recording.truth),
        "/detections": len(recording.detections),
        "/tracks/pmbm": len(replay.tracks["pmbm"]),
        "/tracks/argoverse": len(replay.tracks["argoverse"]),
        "/metrics/pmbm": len(replay.tracks["pmbm"]),
        "/metrics/argoverse": len(replay.tracks["argoverse"]),
        "/unseen/pmbm": len(replay.tracks["pmbm"]),
    }
    boxes = {
        "/truth": recording.truth,
        "/detections": recording.detections,
        "/tracks/pmbm": replay.tracks["pmbm"],
        "/tracks/argoverse": replay.tracks["argoverse"],
    }
    for topic, tables in boxes.items():
        for (_, _, stamp, value), table in zip(found[topic], tables, strict=True):
            assert stamp == nanoseconds(table.time)
            assert len(value["entities"]) == len(table)
            for row, entity in enumerate(value["entities"]):
                (cube,) = entity["cubes"]
                pose = cube["pose"]
                assert list(pose["position"].values()) == table.position[row].tolist()
                assert list(cube["size"].values()) == table.size[row].tolist()
                turn = pose["orientation"]
                yaw = 2 * np.arctan2(turn["z"], turn["w"])
                assert np.cos(yaw - table.yaw[row]) == pytest.approx(1.0, abs=1e-12)
    tracks = replay.tracks["pmbm"][-1]
    entities = found["/tracks/pmbm"][-1][3]["entities"]
    assert [entity["id"] for entity in entities] == [str(i) for i in tracks.id.tolist()]
    for entity, score in zip(entities, tracks.score, strict=True):
        assert {"key": "score", "value": repr(float(score))} in entity["metadata"]
        assert [len(line["points"]) for line in entity["lines"]] == [2, 24]
    assert metadata(logged)["digest"] == recording.digest()


def test_the_ellipse_is_two_standard_deviations(replay, logged):
    tracks = replay.tracks["pmbm"][-1]
    entity = messages(logged)["/tracks/pmbm"][-1][3]["entities"][0]
    corners = np.array([[p["x"], p["y"]] for p in entity["lines"][1]["points"]])
    away = corners - tracks.position[0, :2]
    inverse = np.linalg.inv(tracks.covariance[0, :2, :2])
    squared = np.einsum("vi,ij,vj->v", away, inverse, away)
    np.testing.assert_allclose(squared, 4.0, rtol=1e-9)


def test_metrics_and_the_map_of_the_unseen_are_those_of_the_page(replay, logged):
    found = messages(logged)
    series = replay.series["pmbm"]["gospa"]
    assert [value["gospa"] for *_, value in found["/metrics/pmbm"]] == series.tolist()
    seen = 0
    for (*_, value), tracks in zip(found["/unseen/pmbm"], replay.tracks["pmbm"], strict=True):
        n, cell = value["column_count"], value["cell_size"]["x"]
        content = np.frombuffer(base64.b64decode(value["data"]), "<f4").reshape(n, n)
        corner = np.array([value["pose"]["position"][axis] for axis in "xy"])
        for place in np.argsort(content, axis=None)[-3:]:
            row, column = divmod(int(place), n)
            low = corner + cell * np.array([column, row])
            square = low + cell * np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
            # Neighbouring codes of the page's grid are 5.6 % apart.
            expected = tracks.undetected.expected_count(square) / cell**2
            if expected < 1e-6:  # the grid's least
                continue
            seen += 1
            assert content[row, column] == pytest.approx(expected, rel=0.03)
    assert seen > 30


def test_messages_are_what_their_schemas_say(logged):
    for topic, values in messages(logged).items():
        for name, schema, _, value in (values[0], values[-1]):
            assert schema["title"] == name, topic
            jsonschema.Draft202012Validator(schema).validate(value)


def _as_protobuf(value, key=""):
    """Times as protobuf's JSON has them."""
    if isinstance(value, dict):
        if set(value) == {"sec", "nsec"}:
            if key == "lifetime":
                return f"{value['sec']}.{value['nsec']:09}s"
            assert value["sec"] < 60
            return f"1970-01-01T00:00:{value['sec']:02}.{value['nsec']:09}Z"
        return {k: _as_protobuf(v, k) for k, v in value.items()}
    if isinstance(value, list):
        return [_as_protobuf(v) for v in value]
    return value


def test_foxgloves_own_schemas_take_every_field(logged):
    import importlib

    for values in messages(logged).values():
        for name, schema, _, value in (values[0], values[-1]):
            if not name.startswith("foxglove."):
                continue
            kind = name.removeprefix("foxglove.")
            module = importlib.import_module(f"foxglove_schemas_protobuf.{kind}_pb2")
            message = json_format.ParseDict(_as_protobuf(value), getattr(module, kind)())
            back = json_format.MessageToDict(
                message, preserving_proto_field_name=True, always_print_fields_with_no_presence=True
            )
            assert set(back) == set(schema["properties"])


def walk(value):
    if isinstance(value, dict):
        yield value
        value = list(value.values())
    if isinstance(value, list):
        for each in value:
            yield from walk(each)


def test_nothing_is_transparent_or_turned_by_no_quaternion(logged):
    turns = colours = 0
    for values in messages(logged).values():
        for *_, value in values:
            for table in walk(value):
                if set(table) == set("xyzw"):
                    assert sum(v * v for v in table.values()) == pytest.approx(1.0)
                    turns += 1
                if set(table) == set("rgba"):
                    assert table["a"] > 0
                    colours += 1
    assert min(turns, colours) > 1000


def test_what_was_shown_before_goes(replay, logged):
    for topic in ("/truth", "/detections", "/tracks/pmbm"):
        for *_, value in messages(logged)[topic]:
            (deletion,) = value["deletions"]
            assert deletion["type"] == 1
    nothing = [len(value["entities"]) for *_, value in messages(logged)["/tracks/argoverse"]]
    assert min(nothing) == 0


def test_times_are_rounded_to_nanoseconds_never_cut():
    assert nanoseconds(4.35) == 4_350_000_000
    for tick in range(2000):
        assert nanoseconds(tick / 100) == tick * 10_000_000
    assert nanoseconds(-0.05) == -50_000_000


def test_times_before_zero_are_moved_and_the_file_says_so(replay, tmp_path):
    def earlier(value):
        return dataclasses.replace(value, time=value.time - 2.0)

    recording = dataclasses.replace(
        replay.recording,
        truth=tuple(map(earlier, replay.recording.truth)),
        detections=tuple(map(earlier, replay.recording.detections)),
    )
    file = tmp_path / "early.mcap"
    write_log(ReplayPage(recording=recording, tracks={}), file)
    assert messages(file)["/truth"][0][2] == 0
    first = min(recording.truth[0].time, recording.detections[0].time)
    assert json.loads(metadata(file)["time_offset"]) == first


def test_equal_seeds_give_equal_bytes(logged, tmp_path):
    write_log(replay_of(3), tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == logged.read_bytes()
    write_log(replay_of(4), tmp_path / "other.mcap")
    assert (tmp_path / "other.mcap").read_bytes() != logged.read_bytes()


def test_two_logs_at_a_time_do_not_mix(replay, logged, tmp_path):
    other = replay_of(4, ("argoverse",))
    files = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    threads = [
        threading.Thread(target=write_log, args=pair)
        for pair in zip((replay, other), files, strict=True)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    write_log(other, tmp_path / "alone.mcap")
    assert files[0].read_bytes() == logged.read_bytes()
    assert files[1].read_bytes() == (tmp_path / "alone.mcap").read_bytes()


UTM = (691_603.0, 5_335_420.0)


def test_far_from_zero_positions_are_told_from_a_near_origin(replay, tmp_path):
    far, file = moved(replay, UTM), tmp_path / "far.mcap"
    write_log(far, file)
    found = messages(file)
    shift = found["/tf"][0][3]
    assert (shift["parent_frame_id"], shift["child_frame_id"]) == ("world", "scene")
    origin = np.array(list(shift["translation"].values()))
    for (*_, value), truth in zip(found["/truth"], far.recording.truth, strict=True):
        told = [list(e["cubes"][0]["pose"]["position"].values()) for e in value["entities"]]
        # float32, as viewers hold them.
        near = np.array(told).reshape(-1, 3).astype(np.float32)
        assert np.abs(near).max(initial=0.0) < 1e4
        np.testing.assert_allclose(near + origin, truth.position, atol=1e-3)


def test_what_cannot_be_written_is_said_first(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=r"ends in \.mcap or"):
        check_log(tmp_path / "run.bag")
    monkeypatch.setitem(sys.modules, "mcap", None)
    with pytest.raises(InputError, match=r"pip install 'pmbm\[mcap\]'"):
        check_log(tmp_path / "run.mcap")


def test_run_writes_the_replayed_trial(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arguments = ["run", str(PASSING), "--seed", "3", "--no-map", "--log", "logs/run.mcap"]
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    assert "logs/run.mcap" in capsys.readouterr().err
    assert metadata(Path("logs/run.mcap"))["trackers"] == '["pmbm", "argoverse"]'
    with pytest.raises(SystemExit) as caught:
        main(["run", "crossing", str(PASSING), "--log", "run.mcap"])
    assert caught.value.code == 2
    assert "a log holds one trial" in capsys.readouterr().err


def test_export_writes_a_log_without_tracks(tmp_path, capsys):
    arguments = ["export", str(PASSING), "--seed", "3", "--format", "mcap", "--out", str(tmp_path)]
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    (line,) = capsys.readouterr().out.splitlines()
    found = messages(Path(line))
    assert set(found) == {"/tf", "/site", "/truth", "/detections"}
    assert len(found["/truth"]) == 50


ROS = """
import json, sys, types

class String:
    def __init__(self, data=""):
        self.data = data

class Node:
    def __init__(self, name):
        self.heard = []
    def create_publisher(self, kind, topic, depth):
        return types.SimpleNamespace(publish=self.heard.append)
    def create_subscription(self, kind, topic, callback, depth):
        self.callback = callback

def spin_once(node, timeout_sec):
    line = json.loads(node.heard.pop().data)
    if line["type"] == "start":
        answer = {"type": "ready", "protocol": 1}
    else:
        names = "id x y z length width height yaw vx vy score label".split()
        answer = {"type": "tracks", "step": line["step"], **{name: [] for name in names}}
    node.callback(String(json.dumps(answer)))

def module(name, **content):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__dict__.update(content)

module("rclpy", init=lambda: None, spin_once=spin_once)
module("rclpy.node", Node=Node)
module("std_msgs")
module("std_msgs.msg", String=String)
"""


def test_the_bridge_to_ros_hands_lines_on_and_back(replay, tmp_path):
    """With a stand-in for rclpy: what is tested is the page's program."""
    page = (Path(__file__).parents[2] / "docs" / "guide" / "viewers.md").read_text()
    program, *_ = re.findall(r"```py\n(.*?)```", page, re.DOTALL)
    file = tmp_path / "bridge.py"
    file.write_text(ROS + program)
    tracker = tracker_factory(f"exec:{sys.executable} {file}")(replay.recording.site)
    assert len(run(tracker, replay.recording)) == len(replay.recording.detections)
    close_programs()


def test_track_writes_a_log_for_each_sequence(tmp_path, capsys):
    data = Path(__file__).parents[1] / "data" / "kitti"
    arguments = [
        *("track", "kitti", "--root", data / "training", "--classes", "Car", "Pedestrian"),
        *("--detections", data / "detections_ab3dmot", "--out", tmp_path / "out"),
        *("--sequences", "0000", "--tracker", "argoverse"),
        *("--log", tmp_path / "logs" / "{sequence}.mcap"),
    ]
    with pytest.raises(SystemExit) as caught:
        main([str(argument) for argument in arguments])
    assert caught.value.code == 0, capsys.readouterr().err
    found = messages(tmp_path / "logs" / "0000.mcap")
    boxes = sum(len(value["entities"]) for *_, value in found["/detections"])
    assert boxes > 0
    assert "/tracks/argoverse" in found
