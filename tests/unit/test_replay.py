"""Truth from anywhere through the detector model."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from pmbm.errors import InputError
from pmbm.sim.detector.model import load_profile
from pmbm.sim.detector.replay import Replay, replay
from pmbm.sim.search.strategies import Mover, traffic
from pmbm.sim.world.scene import make_scene
from pmbm.study import Source
from pmbm.types import Site

SCENE = traffic([Mover(), Mover(distance=30, bearing=90, speed=8, heading=10)], frames=12)


def test_a_replayed_recording_is_its_scene_again():
    recording = load_profile("harsh", {"sensor": {"ego_yaw_noise": 0, "ego_position_noise": 0}})
    again = replay(recording.detect(SCENE, 1))
    assert again.truth_digest() == SCENE.truth_digest()
    np.testing.assert_allclose(again.sensor_pose, SCENE.sensor_pose)
    assert again.rate == pytest.approx(SCENE.rate)
    assert load_profile("nominal").detect(again, 4).digest() == (
        load_profile("nominal").detect(SCENE, 4).digest()
    )


def test_it_is_a_source_that_pickles():
    source = Replay(SCENE, load_profile("nominal"))
    assert isinstance(source, Source) or callable(source.record)
    copy = pickle.loads(pickle.dumps(source))
    assert copy.record(3, 2).digest() == source.record(3, 2).digest()
    assert source.record(3, 2).digest() != source.record(3, 1).digest()
    assert source.name == "traffic"


def test_the_pose_turns_through_pi_where_frames_are_missing():
    frames = 5
    pose = np.zeros((frames, 3))
    pose[:, 0] = np.arange(frames)
    pose[:, 2] = [3.0, 3.1, -3.08, -2.98, -2.88]
    moving = replace(SCENE, truth=SCENE.truth[:5], stamp=SCENE.stamp[:5], sensor_pose=pose)
    recording = load_profile("perfect").detect(moving, 0)
    rows = [0, 3, 4]
    thinned = replace(
        recording,
        detections=[recording.detections[row] for row in rows],
        frame=recording.frame[rows],
        origin=[recording.origin[row] for row in rows],
    )
    again = replay(thinned).sensor_pose
    np.testing.assert_allclose(again[:, 0], pose[:, 0])
    gap = 2 * np.pi - 5.98
    np.testing.assert_allclose(again[1:3, 2], [3.0 + gap / 3, 3.0 + 2 * gap / 3])


def test_shadows_are_worked_out_when_asked_for():
    behind = [Mover(distance=10), Mover(distance=20)]
    scene = traffic(behind, frames=3)
    assert scene.truth[0].visibility.tolist() == [1.0, 0.0]
    blank = tuple(replace(frame, visibility=np.ones(2), observable=[True] * 2)
                  for frame in scene.truth)  # fmt: skip
    recording = load_profile("perfect").detect(replace(scene, truth=blank), 0)
    assert replay(recording).truth[0].visibility.tolist() == [1.0, 1.0]
    assert replay(recording, shadows=True).truth_digest() == scene.truth_digest()


def test_arrays_of_a_users_own_are_a_scene():
    frames = [
        {
            "id": [4],
            "position": [[10.0 + f, 0, 0.8]],
            "size": [[4, 2, 1.6]],
            "yaw": [0.0],
            "velocity": [[10.0, 0.0]],
            "label": [0],
        }
        for f in range(3)
    ]
    scene = make_scene("mine", Site(), 10.0, (0, 0, 0), frames)
    recording = Replay(scene, load_profile("perfect")).record(0)
    assert [d.position[0, 0] for d in recording.detections] == [10.0, 11.0, 12.0]


def test_what_cannot_be_replayed_is_refused():
    recording = load_profile("perfect").detect(SCENE, 0)
    with pytest.raises(InputError, match="cannot be replayed"):
        replay(replace(recording, detections=(), frame=[], origin=()))
