"""Saving a tracker in mid-run: what is pickled in one process goes on in another, bit for bit."""

import pickle
import subprocess
import sys

import numpy as np
import pytest

from pmbm import PMBMConfig, PMBMTracker, run
from pmbm.sim import load_scenario
from pmbm.types import Detections, digest_of

GO_ON = """
import pickle, sys
with open(sys.argv[1], "rb") as file:
    tracker, frames = pickle.load(file)
with open(sys.argv[2], "wb") as file:
    pickle.dump([tracker.step(frame) for frame in frames], file)
"""


def made(name, recording):
    if name == "map":
        return PMBMTracker.with_map(recording.site)
    return PMBMTracker(getattr(PMBMConfig, name, PMBMConfig)(), recording.site)


def elsewhere(tmp_path, tracker, frames):
    """What the tracker says of the frames in a process of its own."""
    before, after = tmp_path / "before.pkl", tmp_path / "after.pkl"
    before.write_bytes(pickle.dumps((tracker, frames)))
    subprocess.run([sys.executable, "-c", GO_ON, str(before), str(after)], check=True)
    return pickle.loads(after.read_bytes())


@pytest.mark.parametrize("name", ["default", "textbook", "map"])
def test_a_pickled_tracker_goes_on_bit_for_bit_in_another_process(tmp_path, name):
    recording = load_scenario("truck_occlusion").record(4)
    frames = recording.detections[:40]
    whole, half = made(name, recording), made(name, recording)
    expected = [whole.step(frame) for frame in frames]
    for frame in frames[:20]:
        half.step(frame)
    found = elsewhere(tmp_path, half, frames[20:])
    assert digest_of(*found) == digest_of(*expected[20:])
    assert sum(map(len, found)) > 20
    # Another copy, and the one that was saved, are not moved by it.
    again = [half.step(frame) for frame in frames[20:]]
    assert digest_of(*again) == digest_of(*expected[20:])


def test_a_copy_is_another_tracker():
    recording = load_scenario("crossing").record(4)
    tracker = PMBMTracker(PMBMConfig(), recording.site)
    for frame in recording.detections[:10]:
        tracker.step(frame)
    copy = pickle.loads(pickle.dumps(tracker))
    one = tracker.step(recording.detections[10])
    other = copy.step(Detections.empty(recording.detections[10].time))
    assert digest_of(one) != digest_of(other)


def test_steps_of_any_length_are_the_same_motion():
    """A car at 10 m/s, detected without noise at uneven times: place and velocity at the end are
    the same as at even ones, and the covariance is that of the time that has passed."""
    uneven = np.array([0.0, 0.1, 0.15, 0.4, 0.5, 0.55, 0.9, 1.0, 1.05, 1.5, 1.9, 2.0])
    ends = []
    for times in (uneven, np.linspace(0, 2, 12)):
        tracker = PMBMTracker(PMBMConfig())
        for time in times:
            frame = Detections(
                time=time,
                position=[[10 * time, 5.0, 0.8]],
                size=[[4.5, 1.8, 1.6]],
                yaw=[0.0],
                score=[0.95],
                label=[0],
            )
            tracks = tracker.step(frame)
        assert len(tracks) == 1
        ends.append(tracks)
    for tracks in ends:
        np.testing.assert_allclose(tracks.position[0, :2], [20, 5], atol=0.15)
        np.testing.assert_allclose(tracks.velocity[0], [10, 0], atol=0.5)


def test_an_empty_frame_is_a_step_and_a_dropped_one_is_none():
    """Looked and saw nothing costs existence; not having looked costs none but that of survival."""
    recording = load_scenario("single_straight").record(1)
    scores = []
    for empty in (True, False):
        tracker = PMBMTracker(PMBMConfig(), recording.site)
        for frame in recording.detections[:10]:
            tracker.step(frame)
        last = recording.detections[9]
        if empty:
            for k in (1, 2):
                tracker.step(Detections.empty(last.time + 0.1 * k, last.sensor_pose))
        final = tracker.step(Detections.empty(last.time + 0.3, last.sensor_pose))
        scores.append(max(final.score, default=0.0))
    assert scores[0] < scores[1]


def test_a_run_over_dropped_frames_equals_a_run_over_what_is_left():
    recording = load_scenario("frames_dropped").record(2)
    tracks = run(PMBMTracker(PMBMConfig(), recording.site), recording)
    times = [step.time for step in tracks]
    assert len(set(np.diff(times).round(6))) > 1
    assert len(tracks) == len(recording.detections)
