"""Clutter, scores and whole frames: each knob does what its docstring says.

Seeds are fixed; every test of a hypothesis has alpha 1e-4, so that a change of seeds seldom fails.
"""

from dataclasses import replace

import numpy as np
import pytest
from detector_scenes import clutter, detected, pairs, still
from scipy import integrate, special, stats

from pmbm import run
from pmbm.errors import InputError
from pmbm.geometry import to_local, to_world, wrap_angle
from pmbm.sim.detector.boxes import TYPICAL_SIZE
from pmbm.sim.detector.calibration import reliability
from pmbm.sim.detector.model import load_profile
from pmbm.types import Label, Site, Tracks

ALPHA = 1e-4
FRAMES = 1000
NOBODY = still([], frames=FRAMES)
SOME = np.linspace(5, 95, 40)


def record(scene, seed=1, **overrides):
    return load_profile({}, overrides).detect(scene, seed)


def polar(scene, found):
    pose = scene.sensor_pose[found["frame"]]
    offset = found["position"][:, :2] - pose[:, :2]
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - pose[:, 2]
    return np.hypot(*offset.T), wrap_angle(bearing)


@pytest.mark.parametrize("rate", [0.3, 2.0, 35.0])
def test_clutter_counts_are_poisson(rate):
    found = clutter(record(NOBODY, clutter={"rate": rate}))
    count = np.bincount(found["frame"], minlength=FRAMES)
    low, high = stats.poisson.ppf([ALPHA / 2, 1 - ALPHA / 2], rate * FRAMES)
    assert low <= count.sum() <= high
    # The index of dispersion of a Poisson sample is chi-square.
    index = np.sum(np.square(count - count.mean())) / count.mean()
    assert ALPHA / 2 < stats.chi2.cdf(index, FRAMES - 1) < 1 - ALPHA / 2
    assert stats.pearsonr(count[1:], count[:-1]).pvalue > ALPHA


def test_clutter_is_uniform_over_the_field_of_view():
    site = Site(max_range=60.0, fov_centre=0.5, fov_half_angle=0.8)
    scene = still([], frames=FRAMES, site=site)
    found = clutter(record(scene, clutter={"rate": 5.0}))
    distance, bearing = polar(scene, found)
    assert stats.kstest(np.square(distance / 60), "uniform").pvalue > ALPHA
    assert stats.kstest((bearing - 0.5 + 0.8) / 1.6, "uniform").pvalue > ALPHA
    assert stats.kstest((found["yaw"] + np.pi) / (2 * np.pi), "uniform").pvalue > ALPHA
    assert stats.spearmanr(distance, bearing).pvalue > ALPHA


def test_clutter_follows_a_profile_over_range():
    profile = {"at": [0.0, 50.0], "value": [1.0, 0.0]}
    found = clutter(record(NOBODY, clutter={"rate": 5.0, "range_profile": profile}))
    distance, _ = polar(NOBODY, found)

    def share(r):
        # The density per square metre falls linearly to nothing at 50 m.
        r = np.minimum(r, 50.0)
        return (r**2 / 2 - r**3 / 150) / (50**2 / 6)

    assert stats.kstest(share(distance), "uniform").pvalue > ALPHA


def test_clutter_has_the_labels_sizes_and_scores_it_should():
    labels = {"car": 3.0, "pedestrian": 1.0}
    knobs = {"rate": 5.0, "labels": labels, "score_mean": 0.2, "score_concentration": 5.0}
    found = clutter(record(NOBODY, clutter=knobs))
    walking = found["label"] == Label.PEDESTRIAN
    assert set(found["label"].tolist()) == {Label.CAR, Label.PEDESTRIAN}
    assert stats.binomtest(int(walking.sum()), len(walking), 0.25).pvalue > ALPHA
    for label, rows in ((Label.PEDESTRIAN, walking), (Label.CAR, ~walking)):
        ratio = found["size"][rows] / np.array(TYPICAL_SIZE[label])
        assert stats.kstest((ratio.ravel() - 1) / 0.1, "norm").pvalue > ALPHA
    assert stats.kstest(found["score"], stats.beta(1, 4).cdf).pvalue > ALPHA
    np.testing.assert_allclose(found["position"][:, 2], found["size"][:, 2] / 2)


def test_false_boxes_of_a_label_can_be_of_their_own_kind():
    walking = {"range_profile": {"at": [20.0, 20.1], "value": [1.0, 0.0]}, "score_mean": 0.6}
    walking |= {"typical_size": [1.0, 1.0, 2.0], "size_spread": [0.0, 0.0, 0.0]}
    knobs = {
        "rate": 5.0,
        "labels": {"car": 1.0, "pedestrian": 1.0},
        "score_mean": 0.2,
        "score_concentration": 5.0,
        "label": {
            "pedestrian": {
                **walking,
                "typical_size": [1.0, 1.0, 2.0],
                "size_spread": [0.0, 0.0, 0.0],
            }
        },
    }
    found = clutter(record(NOBODY, clutter=knobs))
    distance, _ = polar(NOBODY, found)
    foot = found["label"] == Label.PEDESTRIAN
    assert distance[foot].max() < 20.2
    assert stats.kstest(np.square(distance[~foot] / 100), "uniform").pvalue > ALPHA
    np.testing.assert_array_equal(found["size"][foot], np.tile([1, 1, 2], (foot.sum(), 1)))
    assert stats.kstest(found["score"][foot], stats.beta(3, 2).cdf).pvalue > ALPHA
    assert stats.kstest(found["score"][~foot], stats.beta(1, 4).cdf).pvalue > ALPHA


def test_false_boxes_may_lie_along_the_sensors_axis_and_be_larger_or_smaller_as_a_whole():
    knobs = {"rate": 5.0, "aligned_share": 0.6, "size_correlation": 0.7}
    found = clutter(record(NOBODY, clutter=knobs))
    aside = np.abs(wrap_angle(2 * (found["yaw"] - NOBODY.sensor_pose[0, 2]))) / 2
    spread = 2 * stats.norm.cdf(0.4 / 0.2) - 1  # within 0.4 rad, whichever way
    share = 0.6 * spread + 0.4 * 0.8 / np.pi
    assert stats.binomtest(int((aside < 0.4).sum()), len(aside), share).pvalue > ALPHA
    ahead = np.abs(wrap_angle(found["yaw"] - NOBODY.sensor_pose[0, 2])) < np.pi / 2
    assert stats.binomtest(int(ahead.sum()), len(ahead), 0.5).pvalue > ALPHA
    error = (found["size"] / np.array(TYPICAL_SIZE[Label.CAR]) - 1) / 0.1
    np.testing.assert_allclose(np.corrcoef(error.T)[np.triu_indices(3, 1)], 0.7, atol=0.04)
    assert stats.kstest(error[:, 1], "norm").pvalue > ALPHA


def test_false_boxes_may_lie_across_the_axis_and_keep_closer_to_it():
    knobs = {"rate": 5.0, "aligned_share": 0.5, "across_share": 0.3, "aligned_spread": 0.05}
    found = clutter(record(NOBODY, clutter=knobs))
    off_axis = wrap_angle(found["yaw"] - NOBODY.sensor_pose[0, 2])
    near = 2 * stats.norm.cdf(2.0) - 1  # within two standard deviations
    uniform = 0.2 * 0.1 / np.pi
    for direction, share in ((0.0, 0.25), (np.pi, 0.25), (np.pi / 2, 0.15), (-np.pi / 2, 0.15)):
        close = np.abs(wrap_angle(off_axis - direction)) < 0.1
        expected = share * near + uniform
        assert stats.binomtest(int(close.sum()), len(close), expected).pvalue > ALPHA


def test_the_confidence_of_false_boxes_may_fall_with_range():
    knobs = {"rate": 5.0, "score_mean": {"at": [0.0, 100.0], "value": [0.7, 0.1]}}
    found = clutter(record(NOBODY, clutter=knobs | {"score_concentration": 12.0}))
    mean = 0.7 - 0.6 * polar(NOBODY, found)[0] / 100
    level = stats.beta(12 * mean, 12 * (1 - mean)).cdf(found["score"])
    assert stats.kstest(level, "uniform").pvalue > ALPHA


@pytest.mark.slow
def test_persistent_clutter_follows_the_profile_over_range_too():
    stands = 150
    pose = np.zeros((stands, 3))
    pose[:, 0] = 300.0 * np.arange(stands)
    scene = replace(still([], frames=stands), sensor_pose=pose)
    knobs = {
        "rate": 6.0,
        "persistent_share": 1.0,
        "persistent_noise": 0.0,
        "labels": {"car": 1.0, "pedestrian": 2.0},
        "label": {"pedestrian": {"range_profile": {"at": [0.0, 50.0], "value": [1.0, 0.0]}}},
    }
    found = clutter(record(scene, clutter=knobs))
    distance, _ = polar(scene, found)
    foot = found["label"] == Label.PEDESTRIAN
    for rows, rate in ((foot, 4.0), (~foot, 2.0)):
        low, high = stats.poisson.ppf([ALPHA / 2, 1 - ALPHA / 2], rate * stands)
        assert low <= rows.sum() <= high
    assert stats.kstest(np.square(distance[~foot] / 100), "uniform").pvalue > ALPHA
    r = np.minimum(distance[foot], 50.0)
    assert stats.kstest((r**2 / 2 - r**3 / 150) / (50**2 / 6), "uniform").pvalue > ALPHA


@pytest.mark.slow
def test_persistent_clutter_keeps_its_places_and_the_mean_rate():
    # The number of places is itself Poisson: many far-apart stands of one sensor.
    stands = 150
    pose = np.zeros((stands, 3))
    pose[:, 0] = 300.0 * np.arange(stands)
    scene = replace(still([], frames=stands), sensor_pose=pose)
    knobs = {"rate": 4.0, "persistent_share": 0.75, "persistent_detection": 0.6}
    count = np.bincount(clutter(record(scene, clutter=knobs))["frame"], minlength=stands)
    low, high = stats.poisson.ppf([ALPHA / 2, 1 - ALPHA / 2], 4.0 * stands)
    assert low <= count.sum() <= high
    # Standing still: the same few places again and again, each in its share of the frames.
    only = {**knobs, "persistent_share": 1.0, "persistent_noise": 0.05}
    stay = clutter(record(NOBODY, clutter=only))
    place = np.unique(np.round(stay["position"][:, :2] / 8.0), axis=0)
    assert len(place) < 40
    first = stay["position"][0, :2]
    visits = np.linalg.norm(stay["position"][:, :2] - first, axis=1) < 0.5
    assert stats.binomtest(int(visits.sum()), FRAMES, 0.6).pvalue > ALPHA
    assert np.std(stay["position"][visits, 0]) == pytest.approx(0.05, rel=0.1)
    assert len(np.unique(stay["label"][visits])) == 1


def test_places_belong_to_the_world_not_to_the_sensor():
    knobs = {"rate": 6.0, "persistent_share": 1.0, "persistent_noise": 0.0}
    here = clutter(record(NOBODY, clutter=knobs))["position"]
    moved = still([], frames=FRAMES, sensor_pose=(23.0, 9.0, -2.0))
    there = clutter(record(moved, clutter=knobs))["position"]
    both = set(map(tuple, here[:, :2])) & set(map(tuple, there[:, :2]))
    assert len(both) >= 3


def calibrated(temperature=1.0, offset=0.0):
    """Boxes whose score is the share of true ones among them: three true boxes a frame to two
    false ones, of densities 20 s^3 (1 - s) and 30 s^2 (1 - s)^2, are as s to 1 - s."""
    scene = still(np.full(3, 20.0), frames=FRAMES)
    return record(
        scene,
        objects={"score_mean": 4 / 6, "score_concentration": 6.0},
        clutter={"rate": 2.0, "score_mean": 3 / 6, "score_concentration": 6.0},
        score_temperature=temperature,
        score_offset=offset,
    )


def test_scores_are_calibrated_where_the_betas_make_them_so():
    curve = reliability(calibrated())
    score, true_share = curve.curve
    count = curve.count[curve.count > 0]
    z = (true_share - score) / np.sqrt(score * (1 - score) / count)
    assert np.abs(z).max() < stats.norm.isf(ALPHA / 2 / len(z))
    assert curve.expected_error < 0.02
    assert curve.count.sum() == sum(map(len, calibrated().detections))


@pytest.mark.parametrize(("temperature", "offset"), [(0.25, 0.0), (4.0, 0.0), (1.0, 1.5)])
def test_temperature_and_offset_miscalibrate_as_much_as_they_should(temperature, offset):
    true, false = stats.beta(4, 2).pdf, stats.beta(3, 3).pdf

    def said(s):
        return special.expit(special.logit(s) / temperature + offset)

    def distance(s):
        true_share, density = 0.6 * true(s), 0.6 * true(s) + 0.4 * false(s)
        return abs(said(s) * density - true_share)

    expected, _ = integrate.quad(distance, 0, 1, limit=200)
    recording = calibrated(temperature, offset)
    curve = reliability(recording, bins=40)
    assert curve.expected_error == pytest.approx(expected, abs=0.02)
    assert expected > 0.05
    base = np.concatenate([frame.score for frame in calibrated().detections])
    made = np.concatenate([frame.score for frame in recording.detections])
    np.testing.assert_allclose(np.sort(made), np.sort(said(base)), atol=1e-9)
    reported = recording.provenance["detector"]["score_error"]
    assert reported == reliability(recording).expected_error


def test_a_second_box_of_an_object_is_no_true_one():
    twice = record(
        still(np.full(10, 20.0)),
        objects={"duplicate_probability": 1.0, "score_mean": 0.9, "score_concentration": 50.0},
    )
    curve = reliability(twice, bins=1)
    assert curve.curve[1].tolist() == [0.5]
    with pytest.raises(InputError, match="origin"):
        reliability(replace(twice, origin=None))


FAULTLESS = {"clutter": {"rate": 10.0}, "objects": {"radial_noise": 0.3}}


def rows_of(recording):
    return {
        (frame, *position)
        for detections, frame in zip(recording.detections, recording.frame.tolist(), strict=True)
        for position in detections.position.tolist()
    }


def test_a_lost_sector_reports_nothing_and_the_rest_as_ever():
    scene = still(SOME)
    outage = {"outage_start": 2.0, "outage_duration": 3.0}
    sector = {**outage, "outage_centre": 1.0, "outage_half_angle": np.pi / 4}
    base, lost = record(scene, **FAULTLESS), record(scene, sensor=sector, **FAULTLESS)
    assert rows_of(lost) < rows_of(base)
    pose = scene.sensor_pose[0]
    gone = np.array(sorted(rows_of(base) - rows_of(lost)))
    kept = np.array(sorted(rows_of(lost)))
    for rows, inside in ((gone, True), (kept, False)):
        bearing = np.arctan2(rows[:, 2] - pose[1], rows[:, 1] - pose[0]) - pose[2] - 1.0
        blind = np.abs(wrap_angle(bearing)) <= np.pi / 4
        out = (rows[:, 0] >= 20) & (rows[:, 0] < 50)
        assert ((blind & out) == inside).all()
    assert set(gone[:, 0]) == set(range(20, 50))
    # A blackout is a sector of everything; its frames are delivered, and empty.
    black = record(scene, sensor=outage, **FAULTLESS)
    assert black.frame.tolist() == list(range(100))
    empty = [len(detections) == 0 for detections in black.detections]
    assert empty == [20 <= frame < 50 for frame in range(100)]


def test_dropped_frames_are_never_delivered():
    scene = still(SOME[:2], frames=FRAMES)
    recording = record(scene, sensor={"drop_probability": 0.2}, **FAULTLESS)
    lost = FRAMES - len(recording.detections)
    assert stats.binomtest(lost, FRAMES, 0.2).pvalue > ALPHA
    assert (np.diff(recording.frame) > 0).all()
    assert rows_of(recording) < rows_of(record(scene, **FAULTLESS))


class Silent:
    def __init__(self):
        self.times = []

    def step(self, detections):
        self.times.append(detections.time)
        return Tracks.empty(detections.time)


def test_late_frames_arrive_after_those_that_overtake_them():
    scene = still(SOME[:2], frames=FRAMES)
    recording = record(scene, sensor={"late_probability": 0.1, "late_by": 3}, **FAULTLESS)
    assert sorted(recording.frame.tolist()) == list(range(FRAMES))
    arrival = np.argsort(recording.frame)
    overtaken = np.array([np.sum(arrival[f + 1 :] < arrival[f]) for f in range(FRAMES)])
    late = overtaken > 0
    # A late frame is overtaken by the next three, but for those that are late themselves.
    assert stats.binomtest(int(late.sum()), FRAMES, 0.1 * (1 - 0.1**3)).pvalue > ALPHA
    assert overtaken.max() == 3
    assert all(
        detections.time == recording.truth[frame].time
        for detections, frame in zip(recording.detections, recording.frame, strict=True)
    )
    tracks = run(Silent(), recording)
    assert tracks.dropped == late.sum()
    assert rows_of(recording) == rows_of(record(scene, **FAULTLESS))


def test_jitter_measures_at_another_moment_than_the_stamp_says():
    speed = 20.0
    scene = still(np.full(3, 30.0), bearing=np.array([0.0, 1.0, 2.0]), velocity=(speed, 0.0),
                  frames=FRAMES)  # fmt: skip
    seen = pairs(record(scene, sensor={"time_jitter": 0.01}))
    late = (seen["position"] - seen["true_position"]) / speed
    np.testing.assert_array_equal(late[:, 1:], 0)
    by_frame = late[:, 0].reshape(FRAMES, 3)
    np.testing.assert_allclose(by_frame, by_frame[:, :1].repeat(3, axis=1), atol=1e-12)
    assert stats.kstest(by_frame[:, 0] / 0.01, "norm").pvalue > ALPHA


def test_a_wrong_pose_moves_all_boxes_of_a_frame_as_one():
    pose = np.stack([np.linspace(0, 50, FRAMES), np.zeros(FRAMES), np.linspace(0, 2, FRAMES)], 1)
    scene = replace(still(SOME[:5], frames=FRAMES), sensor_pose=pose)
    knobs = {"ego_position_noise": 0.2, "ego_yaw_noise": 0.01}
    base, wrong = record(scene, **FAULTLESS), record(scene, sensor=knobs, **FAULTLESS)
    for true, said, at in list(zip(base.detections, wrong.detections, pose, strict=True))[::50]:
        np.testing.assert_allclose(
            to_local(said.position[:, :2], said.sensor_pose),
            to_local(true.position[:, :2], at),
            atol=1e-9,
        )
        turn = said.sensor_pose[2] - at[2]
        np.testing.assert_allclose(wrap_angle(said.yaw - true.yaw - turn), 0, atol=1e-12)
    error = np.array([frame.sensor_pose for frame in wrong.detections]) - pose
    for axis, deviation in enumerate((0.2, 0.2, 0.01)):
        assert stats.kstest(error[:, axis] / deviation, "norm").pvalue > ALPHA
    assert np.abs(to_world([[0.0, 0.0]], pose[0]) - pose[0, :2]).max() == 0


def test_only_the_field_of_view_is_seen():
    site = Site(max_range=60.0, fov_centre=0.0, fov_half_angle=1.0)
    bearing = np.linspace(-np.pi, np.pi, 40, endpoint=False)
    scene = still(SOME, bearing=bearing, site=site)
    inside = (SOME <= 60) & (np.abs(wrap_angle(bearing - 0.7)) <= 1.0)
    assert 3 < inside.sum() < 20
    np.testing.assert_array_equal(detected(record(scene)), np.tile(inside, (100, 1)))


def test_trials_and_objects_are_independent():
    model = load_profile({}, {"objects": {"radial_noise": 0.3, "score_mean": 0.5}})
    scene = still(SOME)
    one, other = (pairs(model.detect(scene, 1, trial)) for trial in (0, 1))
    errors = []
    for seen in (one, other):
        order = np.lexsort((seen["object"], seen["frame"]))
        errors.append(seen["error"][order, 0].reshape(100, len(SOME)))
    assert stats.pearsonr(errors[0].ravel(), errors[1].ravel()).pvalue > ALPHA
    assert stats.pearsonr(errors[0][:, 1:].ravel(), errors[0][:, :-1].ravel()).pvalue > ALPHA
    # What is common to all objects of a frame would widen the spread of the frames' means.
    mean = errors[0].mean(axis=1) / (0.3 / np.sqrt(len(SOME)))
    assert ALPHA / 2 < stats.chi2.cdf(np.sum(np.square(mean)), len(mean)) < 1 - ALPHA / 2


@pytest.mark.parametrize("persistent", [0.0, 1.0])
def test_companions_and_echoes_of_false_boxes_come_on_top(persistent):
    alone = {
        "rate": 4.0,
        "labels": {"pedestrian": 1.0},
        "persistent_share": persistent,
        "persistent_noise": 0.0,
        "persistent_detection": 0.02,
    }
    scene = still(np.zeros((400, 0)))
    company = {"companion_probability": 0.3, "companion_spread": 1.0, "echo": {"cyclist": 0.2}}
    before = clutter(record(scene, clutter=alone))
    after = clutter(record(scene, clutter=alone | company))
    count = len(before["frame"])
    people, echoes = after["label"] == Label.PEDESTRIAN, after["label"] == Label.CYCLIST
    kept = {tuple(row) for row in np.c_[before["frame"], before["position"]].tolist()}
    own = np.array(
        [tuple(row) in kept for row in np.c_[after["frame"], after["position"]].tolist()]
    )
    assert own.sum() == count  # what was there stays to the bit
    # Places live long: so many fewer draws.
    draws = count if persistent == 0 else len({tuple(p) for p in before["position"].tolist()})
    for found, share in ((people & ~own, 0.3), (echoes, 0.2)):
        assert abs(found.sum() / count - share) < 5 * np.sqrt(share * (1 - share) / draws)
    aside, near = [], []
    for frame in range(400):
        here = after["frame"] == frame
        parents = after["position"][here & own, :2]
        for rows, into in ((here & people & ~own, aside), (here & echoes, near)):
            apart = after["position"][rows, None, :2] - parents
            closest = np.linalg.norm(apart, axis=2).argmin(axis=1) if len(parents) else []
            into += [apart[k, c] for k, c in enumerate(closest)]
    assert np.std(aside) == pytest.approx(1.0, rel=0.2)
    assert np.abs(near).max() < 0.6
