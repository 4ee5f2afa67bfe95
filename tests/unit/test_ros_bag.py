"""The way from a ROS 2 bag into a table, as docs/guide/viewers.md shows it, on a bag of our own."""

import re
from pathlib import Path

import numpy as np
import pytest

from pmbm.datasets import open_dataset

rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
PAGE = Path(__file__).parents[2] / "docs" / "guide" / "viewers.md"
VISION = {
    "ObjectHypothesis": "string class_id\nfloat64 score",
    "ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose",
    "BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size",
    "Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id",
    "Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections",
}


def write_bag(folder, frames):
    """A bag of one detection a frame, at x = 1, 2, ..., turned by half a radian."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in VISION.items():
        store.register(get_types_from_msg(text, f"vision_msgs/msg/{name}"))

    def make(name, *values):
        return store.types[name.replace("/", "/msg/")](*values)

    kind = "vision_msgs/msg/Detection3DArray"
    with rosbags.Writer(folder, version=9) as bag:
        connection = bag.add_connection("/detections", kind, typestore=store)
        for k in range(frames):
            stamp = make("builtin_interfaces/Time", k, 350_000_000)
            header = make("std_msgs/Header", stamp, "world")
            turn = make("geometry_msgs/Quaternion", 0.0, 0.0, np.sin(0.25), np.cos(0.25))
            pose = make("geometry_msgs/Pose", make("geometry_msgs/Point", 1.0 + k, 2.0, 0.8), turn)
            guesses = [
                make(
                    "vision_msgs/ObjectHypothesisWithPose",
                    make("vision_msgs/ObjectHypothesis", label, score),
                    make("geometry_msgs/PoseWithCovariance", pose, np.zeros(36)),
                )
                for label, score in (("truck", 0.1), ("car", 0.9))
            ]
            size = make("geometry_msgs/Vector3", 4.5, 1.9, 1.6)
            box = make("vision_msgs/BoundingBox3D", pose, size)
            found = make("vision_msgs/Detection3D", header, guesses, box, "")
            message = make("vision_msgs/Detection3DArray", header, [found])
            content = store.serialize_cdr(message, kind)
            bag.write(connection, k * 1_000_000_000, content)


def test_a_bag_becomes_a_table(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "drive1", 5)
    (tmp_path / "logs" / "detections").mkdir(parents=True)
    (program,) = (
        block
        for block in re.findall(r"```py\n(.*?)```", PAGE.read_text(), re.DOTALL)
        if "rosbags" in block
    )
    exec(compile(program, str(PAGE), "exec"), {})
    dataset = open_dataset("table", root=Path("logs"), detections="logs/detections")
    recording = dataset.recording("drive1", truth=False)
    assert [frame.time for frame in recording.detections] == [0.35, 1.35, 2.35, 3.35, 4.35]
    for k, frame in enumerate(recording.detections):
        np.testing.assert_allclose(frame.position, [[1.0 + k, 2.0, 0.8]])
        np.testing.assert_allclose(frame.size, [[4.5, 1.9, 1.6]])
        np.testing.assert_allclose(frame.yaw, [0.5])
        assert frame.score.tolist() == [0.9]
        assert frame.label.tolist() == [0]
