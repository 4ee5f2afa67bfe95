"""One knob, object or clutter box more moves no other draw of the detector model."""

import subprocess
import sys
from itertools import pairwise

import numpy as np
import pytest
from scipy import signal

from pmbm.sim.detector.model import load_profile
from pmbm.sim.streams import Purpose, StreamMembers, Streams
from pmbm.sim.world.scene import make_scene
from pmbm.types import CLUTTER, Label, Site

FRAMES = 40
ALL_FAULTS = {
    "objects": {"miss_burst_length": 2.0},
    "sensor": {"drop_probability": 0.1, "late_probability": 0.1},
}


def street(objects=6, frames=FRAMES, sensor_yaw=0.3):
    """Cars, a truck and a pedestrian drifting past a sensor, with ids in no order."""
    rng = np.random.default_rng(1)
    start, velocity = rng.uniform(-50, 50, (9, 2)), rng.uniform(-6, 6, (9, 2))
    ids = np.array([7, 3, 20, 4, 11, 90, 2, 33, 5])[:objects]
    label = np.array([0, 0, 1, 0, 5, 0, 0, 4, 0])[:objects]
    return make_scene(
        "street",
        Site(max_range=80.0, occluders=([[10, 5], [30, 5], [30, 8], [10, 8]],)),
        10.0,
        [0.0, 0.0, sensor_yaw],
        [
            {
                "id": ids,
                "position": np.c_[(start + 0.1 * f * velocity)[:objects], np.full(objects, 0.8)],
                "size": np.tile([4.4, 1.8, 1.6], (objects, 1)),
                "yaw": np.arctan2(velocity[:objects, 1], velocity[:objects, 0]),
                "velocity": velocity[:objects],
                "label": label,
            }
            for f in range(frames)
        ],
    )


def boxes(recording, keep=lambda origin_id: True):
    """Every box as a tuple of bits: frame, whose it is, and all its values."""
    found = set()
    for delivery, frame, origin in zip(
        recording.detections, recording.frame.tolist(), recording.origin, strict=True
    ):
        for row in range(len(delivery)):
            whose = (
                CLUTTER if origin[row] == CLUTTER else int(recording.truth[frame].id[origin[row]])
            )
            if keep(whose):
                values = np.concatenate(
                    [
                        delivery.position[row],
                        delivery.size[row],
                        [delivery.yaw[row], delivery.score[row], delivery.label[row]],
                    ]
                )
                found.add((frame, whose, values.tobytes()))
    return found


def values(recording, what, whose):
    """One quantity of one object, frame by frame."""
    found = {}
    for delivery, frame, origin in zip(
        recording.detections, recording.frame.tolist(), recording.origin, strict=True
    ):
        ids = recording.truth[frame].id
        for row in np.flatnonzero(origin != CLUTTER):
            if ids[origin[row]] == whose:
                found[frame] = getattr(delivery, what)[row].tolist()
    return found


def detect(scene, seed=5, trial=0, profile="harsh", **overrides):
    return load_profile(profile, overrides).detect(scene, seed, trial)


def test_same_seed_same_bits_other_seed_or_trial_other_bits():
    scene = street()
    digests = [detect(scene, *key).digest() for key in ((5, 0), (5, 0), (5, 1), (6, 0))]
    assert digests[0] == digests[1]
    assert len(set(digests)) == 3


def test_equal_hashes_across_processes():
    program = (
        "import sys; sys.path.insert(0, 'tests/unit');"
        "from test_detector_streams import *;"
        "print(detect(street(), **ALL_FAULTS).digest())"
    )
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == detect(street(), **ALL_FAULTS).digest()


def test_more_clutter_only_adds_boxes():
    scene = street()
    sets = [boxes(detect(scene, clutter={"rate": rate})) for rate in (0.0, 2.0, 7.5, 40.0, 90.0)]
    for fewer, more in pairwise(sets):
        assert fewer < more


def test_more_persistent_clutter_only_adds_to_the_places():
    scene = street()
    sets = [
        boxes(detect(scene, clutter={"rate": rate, "persistent_share": 1.0}))
        for rate in (0.0, 2.0, 20.0)
    ]
    assert sets[0] < sets[1] < sets[2]


def test_an_object_more_moves_nothing_of_the_others():
    few, many = street(objects=6), street(objects=9)
    # The added objects hide others in some frames; without shadows only streams could couple.
    alike = {"visibility_factor": 1.0, "hidden_noise": 0.0, "hidden_size_bias": 0.0}
    alike |= {"hidden_score_loss": 0.0}
    known = {CLUTTER, *few.truth[0].id.tolist()}
    first = boxes(detect(few, objects=alike))
    assert first == boxes(detect(many, objects=alike), keep=known.__contains__)
    assert len(first) > 100


def test_a_longer_scene_begins_with_the_shorter_one():
    short = boxes(detect(street(frames=20), **ALL_FAULTS))
    long = boxes(detect(street(frames=40), **ALL_FAULTS))
    assert short <= long


@pytest.mark.parametrize(
    ("knob", "value", "changes"),
    [
        ("radial_noise", 1.0, {"position"}),
        ("vertical_noise", 1.0, {"position"}),
        ("length_noise", 1.0, {"size"}),
        ("hidden_size_bias", -0.1, {"size", "position"}),
        ("yaw_noise", 0.5, {"yaw"}),
        ("flip_probability", 0.7, {"yaw"}),
        ("score_mean", 0.5, {"score"}),
    ],
)
def test_a_knob_changes_what_it_is_about_and_nothing_else(knob, value, changes):
    scene = street()
    whole = {"split_probability": 0.0}  # halves lie where length and heading put them
    base, other = detect(scene, objects=whole), detect(scene, objects={**whole, knob: value})
    ids = scene.truth[0].id.tolist()
    for what in ("position", "size", "yaw", "score", "label"):
        before = {i: values(base, what, i) for i in ids}
        after = {i: values(other, what, i) for i in ids}
        assert (before != after) == (what in changes), what
        assert {i: set(v) for i, v in before.items()} == {i: set(v) for i, v in after.items()}
    assert boxes(base, CLUTTER.__eq__) == boxes(other, CLUTTER.__eq__)


def test_places_that_keep_their_scores_differ_in_nothing_else():
    """Some places score high, frame after frame, as far as their share of the variance goes."""
    scene = street(frames=200)
    stay = {"rate": 12.0, "persistent_share": 1.0, "persistent_noise": 0.0}
    plain, kept, better = (
        detect(scene, clutter={**stay, **{f"persistent_score_{name}": x for name, x in more}})
        for more in ((), [("share", 0.8)], [("share", 0.8), ("shift", 1.0)])
    )
    for what in ("position", "size", "yaw", "label"):
        for before, after in zip(plain.detections, kept.detections, strict=True):
            assert np.array_equal(
                np.sort(getattr(before, what), axis=0), np.sort(getattr(after, what), axis=0)
            )

    def by_place(recording):
        found = {}
        for delivery, origin in zip(recording.detections, recording.origin, strict=True):
            false = origin == CLUTTER
            for place, score in zip(
                delivery.position[false, :2], delivery.score[false], strict=True
            ):
                found.setdefault(tuple(np.round(place / 2)), []).append(score)
        return [np.array(scores) for scores in found.values() if len(scores) > 20]

    def share_between(places):
        return np.var([one.mean() for one in places]) / np.var(np.concatenate(places))

    assert len(by_place(plain)) >= 8
    assert share_between(by_place(plain)) < 0.1
    assert share_between(by_place(kept)) > 0.6
    means = [np.concatenate(by_place(one)).mean() for one in (kept, better)]
    assert means[1] > means[0] + 0.1


def test_a_lower_probability_only_takes_boxes_away():
    scene = street()
    for extra in ({}, {"miss_burst_length": 1.0}):
        high = detect(scene, objects={"detection_probability": 0.9, **extra})
        low = detect(scene, objects={"detection_probability": 0.5, **extra})
        if extra:
            assert boxes(low) < boxes(high)
        assert boxes(low, CLUTTER.__eq__) == boxes(high, CLUTTER.__eq__)


def test_the_clutter_of_a_frame_does_not_hear_of_objects():
    with_objects = boxes(detect(street(objects=6)), CLUTTER.__eq__)
    assert with_objects == boxes(detect(street(objects=1)), CLUTTER.__eq__)


def test_streams_are_told_apart_by_every_part_of_their_key():
    keys = [
        (seed, trial, purpose, object_id)
        for seed in (0, 1)
        for trial in (0, 1)
        for purpose in (Purpose.MISS, Purpose.SCORE)
        for object_id in (0, 1, -1)
    ]
    draws = {Streams(s, t).uniforms(p, 3, 2, i).tobytes() for s, t, p, i in keys}
    assert len(draws) == len(keys)
    long = Streams(1).uniforms(Purpose.MISS, 9, 2, 4)
    np.testing.assert_array_equal(long[:3], Streams(1).uniforms(Purpose.MISS, 3, 2, 4))
    assert ((long > 0) & (long < 1)).all()


@pytest.mark.parametrize("persistence", [0.3, 0.95])
def test_errors_that_persist_are_scipys_filter_bit_for_bit(persistence):
    members = StreamMembers(frame=np.arange(60), object_id=np.full(60, 4))
    fresh = np.sqrt(1 - persistence**2)
    innovation = members.normals(Streams(3), Purpose.SCORE, 2)
    innovation[0] /= fresh
    expected = signal.lfilter([fresh], [1.0, -persistence], innovation, axis=0)
    found = members.normals(Streams(3), Purpose.SCORE, 2, persistence)
    np.testing.assert_array_equal(found, expected)


def test_the_nulls_of_all_knobs_leave_the_perfect_detector():
    scene = street()
    recording = detect(scene, profile="perfect")
    for truth, detections, origin in zip(
        scene.truth, recording.detections, recording.origin, strict=True
    ):
        seen = truth.take(origin)
        np.testing.assert_array_equal(detections.position, seen.position)
        np.testing.assert_array_equal(detections.size, seen.size)
        np.testing.assert_array_equal(detections.yaw, seen.yaw)
        assert set(origin.tolist()) == set(np.flatnonzero(truth.observable).tolist())
    assert Label.TRUCK in recording.detections[0].label
