"""Each knob of how objects are detected does what its docstring says.

Seeds are fixed; every test of a hypothesis has alpha 1e-4, so that a change of seeds seldom fails.
"""

import numpy as np
import pytest
from detector_scenes import clutter, detected, pairs, still
from scipy import stats

from pmbm.errors import InputError
from pmbm.geometry import corners
from pmbm.sim.detector.boxes import TYPICAL_SIZE
from pmbm.sim.detector.model import load_profile
from pmbm.types import CLUTTER, Label

ALPHA = 1e-4
RNG = np.random.default_rng(11)
MANY = RNG.uniform(5, 95, 300)
"""Distances of three hundred objects, m."""


def record(scene, seed=1, **objects):
    return load_profile({}, {"objects": objects}).detect(scene, seed)


def same_mean(values, mean, deviation):
    """Whether the mean of values with known standard deviations fits the expected mean."""
    z = (np.mean(values) - np.mean(mean)) / (
        np.sqrt(np.sum(np.square(deviation))) / np.size(values)
    )
    return abs(z) < stats.norm.isf(ALPHA / 2)


def same_spread(values, deviation):
    """Whether normal values of mean zero have that standard deviation."""
    n = len(values)
    low, high = stats.chi2.ppf([ALPHA / 2, 1 - ALPHA / 2], n)
    return low < np.sum(np.square(values / deviation)) < high


PROBABILITY = {"at": [20.0, 60.0, 90.0], "value": [0.98, 0.7, 0.2]}
FACTOR = {"at": [0.1, 0.6], "value": [0.0, 1.0]}


def test_recall_follows_range_and_visibility():
    visibility = RNG.uniform(0, 1, len(MANY))
    scene = still(MANY, visibility=visibility)
    found = detected(
        record(scene, detection_probability=PROBABILITY, visibility_factor=FACTOR)
    ).mean(axis=0)
    expected = np.interp(MANY, [20, 60, 90], [0.98, 0.7, 0.2]) * np.interp(
        visibility, [0.1, 0.6], [0.0, 1.0]
    )
    deviation = np.sqrt(expected * (1 - expected) / len(scene))
    for low, high in ((0, 30), (30, 60), (60, 80), (80, 100)):
        for dim, clear in ((0.1, 0.35), (0.35, 0.6), (0.6, 1.0)):
            at = (low <= MANY) & (high > MANY) & (visibility >= dim) & (visibility <= clear)
            assert at.sum() >= 3
            assert same_mean(found[at], expected[at], deviation[at]), (low, dim)
    assert not found[visibility < 0.1].any()


def test_hiding_may_work_on_the_odds_of_detection():
    visibility = np.where(np.arange(len(MANY)) % 2, 1.0, 0.3)
    scene = still(MANY, visibility=visibility)
    knobs = {"detection_probability": 0.9, "visibility_odds": {"at": [0.3, 1.0], "value": [0.2, 1]}}
    found = detected(record(scene, **knobs)).mean(axis=0)
    hidden = visibility < 1
    for rows, expected in ((hidden, 1.8 / 2.8), (~hidden, 0.9)):  # odds of 9 become 1.8
        deviation = np.full(rows.sum(), np.sqrt(expected * (1 - expected) / len(scene)))
        assert same_mean(found[rows], np.full(rows.sum(), expected), deviation)


def test_misses_are_independent_at_burst_length_one():
    found = detected(record(still(MANY), detection_probability=0.7))
    missed_before = ~found[:-1]
    share = stats.binomtest(int(found[1:][missed_before].sum()), int(missed_before.sum()), 0.7)
    assert share.pvalue > ALPHA


@pytest.mark.parametrize(("probability", "length"), [(0.8, 5.0), (0.5, 10.0), (0.95, 2.0)])
def test_bursts_have_their_mean_length_and_leave_recall_alone(probability, length):
    found = detected(
        record(still(MANY), detection_probability=probability, miss_burst_length=length)
    )
    # Objects are independent of each other, the frames of one are not.
    test = stats.ttest_1samp(found.mean(axis=0), probability)
    assert test.pvalue > ALPHA
    # Runs of misses end with probability 1 / length in each frame, whatever their age.
    missed = ~found[:-1]
    ends = found[1:]
    assert stats.binomtest(int(ends[missed].sum()), int(missed.sum()), 1 / length).pvalue > ALPHA
    old = missed[1:] & missed[:-1]
    assert stats.binomtest(int(ends[1:][old].sum()), int(old.sum()), 1 / length).pvalue > ALPHA


def test_a_burst_shorter_than_chance_is_no_burst():
    iid = record(still(MANY), detection_probability=0.25)
    short = record(still(MANY), detection_probability=0.25, miss_burst_length=3.9)
    assert iid.digest() == short.digest()


def test_bursts_keep_recall_where_the_probability_changes_with_time():
    receding = np.linspace(10, 90, 100)
    scene = still(np.broadcast_to(receding[:, None], (100, 400)))
    found = detected(record(scene, detection_probability=PROBABILITY, miss_burst_length=4.0))
    expected = np.interp(receding, [20, 60, 90], [0.98, 0.7, 0.2])
    z = (found.mean(axis=1) - expected) / np.sqrt(expected * (1 - expected) / 400)
    assert np.abs(z).max() < stats.norm.isf(ALPHA / 2 / len(z))


def test_position_noise_lies_in_the_sensor_frame_and_grows():
    visibility = np.where(np.arange(len(MANY)) % 2, 1.0, 0.4)
    seen = pairs(
        record(
            still(MANY, visibility=visibility),
            radial_noise={"at": [0.0, 100.0], "value": [0.1, 0.6]},
            lateral_noise=0.2,
            vertical_noise=0.05,
            position_noise_scale=1.5,
            hidden_noise=0.8,
        )
    )
    factor = 1.5 * (1 + 0.8 * (1 - seen["visibility"]))
    radial = factor * (0.1 + 0.005 * seen["distance"])
    deviations = np.stack([radial, factor * 0.2, factor * 0.05], axis=1)
    for low, high in ((0, 30), (30, 60), (60, 100)):
        for hidden in (True, False):
            at = (seen["distance"] >= low) & (seen["distance"] < high)
            at &= (seen["visibility"] < 1) == hidden
            for axis in range(3):
                assert same_spread(seen["error"][at, axis], deviations[at, axis]), (low, axis)
    standard = seen["error"] / deviations
    for axis in range(3):
        assert stats.kstest(standard[:, axis], "norm").pvalue > ALPHA
    for first, second in ((0, 1), (0, 2), (1, 2)):
        assert stats.pearsonr(standard[:, first], standard[:, second]).pvalue > ALPHA
    # White: the error of a frame says nothing of the next one's.
    series = np.stack([standard[seen["object"] == number, 0] for number in range(len(MANY))])
    assert stats.pearsonr(series[:, 1:].ravel(), series[:, :-1].ravel()).pvalue > ALPHA


def test_size_noise_and_heading():
    seen = pairs(
        record(
            still(MANY),
            length_noise=0.3,
            width_noise={"at": [0.0, 100.0], "value": [0.05, 0.2]},
            height_noise=0.1,
            yaw_noise=0.1,
            flip_probability=0.2,
        )
    )
    error = seen["size"] - seen["true_size"]
    assert same_spread(error[:, 0], 0.3)
    assert same_spread(error[:, 1], 0.05 + 0.0015 * seen["distance"])
    assert same_spread(error[:, 2], 0.1)
    flipped = np.abs(seen["yaw_error"]) > np.pi / 2
    assert stats.binomtest(int(flipped.sum()), len(flipped), 0.2).pvalue > ALPHA
    assert same_spread(seen["yaw_error"][~flipped], 0.1)
    left = np.angle(np.exp(1j * (seen["yaw_error"][flipped] - np.pi)))
    assert same_spread(left, 0.1)


def test_bias_shrinks_toward_the_visible_side():
    visibility = np.where(np.arange(len(MANY)) % 2, 1.0, 0.5)
    scene = still(MANY, visibility=visibility, frames=1)
    knobs = {"size_bias": -0.1, "hidden_size_bias": -0.4}
    anchored = pairs(record(scene, near_side_anchor=1.0, **knobs))
    factor = np.where(anchored["visibility"] < 1, 0.7, 0.9)
    np.testing.assert_allclose(anchored["size"][:, 0], 4.4 * factor)
    np.testing.assert_allclose(anchored["size"][:, 1], 1.8 * factor)
    np.testing.assert_allclose(anchored["size"][:, 2], 1.6)
    # The corner nearest to the sensor stays, and no other corner does.
    before = corners(*(anchored[f"true_{name}"] for name in ("position", "size", "yaw")))
    after = corners(*(anchored[name] for name in ("position", "size", "yaw")))
    sensor = scene.sensor_pose[0, :2]
    nearest = np.linalg.norm(before - sensor, axis=2).argmin(axis=1)
    stays = np.linalg.norm(after - before, axis=2) < 1e-9
    rows = np.arange(len(nearest))
    side_on = np.abs(np.sort(np.linalg.norm(before - sensor, axis=2), axis=1) @ [-1, 1, 0, 0]) < 0.3
    assert stays[rows, nearest][~side_on].all()
    assert (stays.sum(axis=1) == 1).all()
    assert (anchored["error"][:, 0] < 0.05).all()
    centred = pairs(record(scene, near_side_anchor=0.0, **knobs))
    np.testing.assert_array_equal(centred["position"], centred["true_position"])
    half = pairs(record(scene, near_side_anchor=0.5, **knobs))
    np.testing.assert_allclose(half["error"], anchored["error"] / 2, atol=1e-12)


def test_confidence_is_a_beta_variable_that_falls_with_range_and_hiding():
    visibility = np.where(np.arange(len(MANY)) % 2, 1.0, 0.5)
    seen = pairs(
        record(
            still(MANY, visibility=visibility),
            score_mean={"at": [0.0, 100.0], "value": [0.9, 0.5]},
            hidden_score_loss=0.4,
            score_concentration=7.0,
        )
    )
    mean = (0.9 - 0.004 * seen["distance"]) * (1 - 0.4 * (1 - seen["visibility"]))
    uniform = stats.beta.cdf(seen["score"], 7 * mean, 7 * (1 - mean))
    assert stats.kstest(uniform, "uniform").pvalue > ALPHA


def test_quality_couples_errors_to_the_score_and_keeps_their_spread():
    knobs = {"radial_noise": 0.3, "lateral_noise": 0.1, "yaw_noise": 0.1, "length_noise": 0.2}
    knobs |= {"score_mean": 0.7, "score_concentration": 8.0}
    loose = pairs(record(still(MANY), **knobs))
    tight = pairs(record(still(MANY), quality_coupling=0.3, **knobs))
    for error in (tight["error"][:, 0], 3 * tight["error"][:, 1], 3 * tight["yaw_error"]):
        # Heavier tails than normal: the variance of the sample variance from its own moments.
        square = np.square(error)
        z = (square.mean() - 0.09) / (square.std() / np.sqrt(len(square)))
        assert abs(z) < stats.norm.isf(ALPHA / 2)
        assert stats.spearmanr(np.abs(error), tight["score"]).statistic < -0.15
    assert stats.spearmanr(np.abs(loose["error"][:, 0]), loose["score"]).pvalue > ALPHA
    np.testing.assert_array_equal(loose["score"], tight["score"])


def test_labels_are_confused_as_often_as_said():
    seen = pairs(record(still(MANY), confusion={"truck": 0.1, "pedestrian": 0.05}))
    for label, probability in ((Label.TRUCK, 0.1), (Label.PEDESTRIAN, 0.05), (Label.CAR, 0.85)):
        count = int((seen["label"] == label).sum())
        assert stats.binomtest(count, len(seen["label"]), probability).pvalue > ALPHA


def test_duplicates_are_extra_boxes_close_to_the_first():
    scene = still(MANY)
    knobs = {"radial_noise": 0.2, "detection_probability": 0.8, "score_mean": 0.7}
    knobs |= {"score_concentration": 8.0}
    base = pairs(record(scene, **knobs))
    more = pairs(record(scene, duplicate_probability=0.25, duplicate_spread=0.6, **knobs))
    key = more["frame"] * 1000 + more["object"]
    # Falling score inside a frame puts the first box before its duplicate.
    _, first = np.unique(key, return_index=True)
    extra = np.setdiff1d(np.arange(len(key)), first)
    assert len(first) == len(base["score"])
    np.testing.assert_array_equal(
        np.sort(more["position"][first], axis=0), np.sort(base["position"], axis=0)
    )
    assert stats.binomtest(len(extra), len(first), 0.25).pvalue > ALPHA
    mother = first[np.searchsorted(key[first], key[extra])]
    aside = more["position"][extra] - more["position"][mother]
    assert same_spread(aside[:, :2].ravel(), 0.6)
    np.testing.assert_array_equal(aside[:, 2], 0)
    share = more["score"][extra] / more["score"][mother]
    assert stats.kstest(share, "uniform").pvalue > ALPHA


def test_trucks_split_into_halves_that_tile_them():
    scene = still(MANY, label=Label.TRUCK)
    whole = pairs(record(scene))
    model = load_profile({}, {"label": {"truck": {"split_probability": 0.3}}})
    split = pairs(model.detect(scene, 1))
    key = split["frame"] * 1000 + split["object"]
    _, start, count = np.unique(key, return_index=True, return_counts=True)
    assert set(count.tolist()) == {1, 2}
    assert stats.binomtest(int((count == 2).sum()), len(count), 0.3).pvalue > ALPHA
    one, two = start[count == 2], np.flatnonzero(~np.isin(np.arange(len(key)), start))
    two = two[np.argsort(key[two])]
    np.testing.assert_array_equal(key[one], key[two])
    np.testing.assert_allclose(
        split["size"][one] + split["size"][two], [[4.4, 3.6, 3.2]] * len(one)
    )
    middle = (split["position"][one] + split["position"][two]) / 2
    np.testing.assert_allclose(middle, split["true_position"][one])
    apart = np.linalg.norm(split["position"][one] - split["position"][two], axis=1)
    np.testing.assert_allclose(apart, 2.2)
    car = load_profile({}, {"label": {"truck": {"split_probability": 0.3}}}).detect(still(MANY), 1)
    assert len(pairs(car)["score"]) == len(whole["score"])


def test_labels_have_knobs_of_their_own():
    label = np.where(np.arange(len(MANY)) % 2, Label.CAR, Label.PEDESTRIAN)
    model = load_profile(
        {},
        {
            "objects": {"radial_noise": 0.4},
            "label": {"pedestrian": {"radial_noise": 0.1, "detection_probability": 0.5}},
        },
    )
    seen = pairs(model.detect(still(MANY, label=label), 1))
    walking = seen["true_label"] == Label.PEDESTRIAN
    assert same_spread(seen["error"][walking, 0], 0.1)
    assert same_spread(seen["error"][~walking, 0], 0.4)
    assert stats.binomtest(int(walking.sum()), 100 * 150, 0.5).pvalue > ALPHA


def lagged(seen, column, lag=1):
    """A column of values, object by object, and the same `lag` frames later."""
    order = np.lexsort((seen["frame"], seen["object"]))
    table = column[order].reshape(len(MANY), -1)
    return table[:, lag:].ravel(), table[:, :-lag].ravel()


def test_errors_and_scores_persist_as_said_and_keep_their_spread():
    seen = pairs(
        record(
            still(MANY),
            radial_noise=0.3,
            length_noise=0.2,
            yaw_noise=0.1,
            score_mean=0.7,
            score_concentration=8.0,
            error_persistence=0.8,
            score_persistence=0.5,
        )
    )
    length = seen["size"][:, 0] - 4.4
    for error, deviation in ((seen["error"][:, 0], 0.3), (length, 0.2), (seen["yaw_error"], 0.1)):
        first = error[seen["frame"] % 25 == 0]  # far enough apart to count as independent
        assert same_spread(first, deviation)
        for lag in (1, 3):
            later, earlier = lagged(seen, error, lag)
            assert np.corrcoef(later, earlier)[0, 1] == pytest.approx(0.8**lag, abs=0.03)
    quality = stats.norm.ppf(stats.beta.cdf(seen["score"], 8 * 0.7, 8 * 0.3))
    assert stats.kstest(quality[seen["frame"] % 10 == 0], "norm").pvalue > ALPHA
    for lag in (1, 3):
        assert np.corrcoef(*lagged(seen, quality, lag))[0, 1] == pytest.approx(0.5**lag, abs=0.03)


def test_sizes_are_pulled_toward_the_typical_one():
    scene = still(MANY, frames=1)
    pull = {"at": [20.0, 80.0], "value": [0.0, 0.6]}
    seen = pairs(record(scene, size_pull=pull, typical_size=[3.4, 1.6, 1.5]))
    share = np.interp(seen["distance"], [20, 80], [0, 0.6])
    typical = np.array([3.4, 1.6, 1.5])
    expected = seen["true_size"] + share[:, None] * (typical - seen["true_size"])
    np.testing.assert_allclose(seen["size"], expected)
    usual = pairs(record(scene, size_pull=1.0))
    np.testing.assert_allclose(usual["size"], np.tile(TYPICAL_SIZE[Label.CAR], (len(MANY), 1)))
    np.testing.assert_array_equal(usual["position"], usual["true_position"])


def test_errors_of_size_are_correlated_as_said_and_keep_their_spread():
    knobs = {"length_noise": 0.3, "width_noise": 0.1, "height_noise": 0.2}
    seen = pairs(record(still(MANY), size_correlation=0.6, **knobs))
    error = seen["size"] - seen["true_size"]
    for axis, deviation in enumerate((0.3, 0.1, 0.2)):
        assert same_spread(error[:, axis], deviation)
    np.testing.assert_allclose(np.corrcoef(error.T)[np.triu_indices(3, 1)], 0.6, atol=0.02)


def test_sizes_that_go_together_and_three_correlations_are_as_said():
    scene = still(MANY, frames=1)
    typical, response = (
        np.array([3.9, 1.6, 1.5]),
        np.array([[0.7, 0.4, 0.0], [0.1, 0.3, 0.0], [0.0, 0.1, 0.6]]),
    )
    seen = pairs(
        record(
            scene,
            typical_size=typical.tolist(),
            size_response=response.tolist(),
            size_pull=0.5,
        )
    )
    expected = typical + 0.5 * (seen["true_size"] - typical) @ response.T
    np.testing.assert_allclose(seen["size"], expected)
    noisy = pairs(
        record(
            still(MANY),
            length_noise=0.3,
            width_noise=0.1,
            height_noise=0.2,
            size_correlation=[0.7, -0.2, 0.3],
        )
    )
    error = noisy["size"] - noisy["true_size"]
    found = np.corrcoef(error.T)[np.triu_indices(3, 1)]
    np.testing.assert_allclose(found, [0.7, -0.2, 0.3], atol=0.02)
    for axis, deviation in enumerate((0.3, 0.1, 0.2)):
        assert same_spread(error[:, axis], deviation)
    for impossible in ([0.9, 0.9, -0.9], -0.1):
        with pytest.raises(InputError, match="impossible size_correlation"):
            record(scene, size_correlation=impossible)


def test_the_lasting_share_of_size_errors_stays_with_an_object():
    knobs = {"length_noise": 0.2, "width_noise": 0.2, "height_noise": 0.2}
    seen = pairs(
        record(still(MANY, frames=40), lasting_size_error=0.6, error_persistence=0.3, **knobs)
    )
    error = (seen["size"] - seen["true_size"]) / 0.2
    assert error.std() == pytest.approx(1.0, abs=0.03)
    order = np.lexsort((seen["frame"], seen["object"]))
    # Every object is seen in every frame: (objects, frames, 3).
    runs = error[order].reshape(-1, 40, 3)
    for lag, expected in ((1, 0.6 + 0.4 * 0.3), (20, 0.6)):
        correlation = (runs[:, lag:] * runs[:, :-lag]).mean() / np.square(runs).mean()
        assert correlation == pytest.approx(expected, abs=0.04)


def test_the_side_that_faces_the_sensor_stays_where_the_box_errs_in_size():
    scene = still(MANY, yaw=np.random.default_rng(2).uniform(-3, 3, len(MANY)), frames=1)
    knobs = {"length_noise": 0.3, "width_noise": 0.1, "size_pull": 0.3}
    free, held = (pairs(record(scene, facing_anchor=anchor, **knobs)) for anchor in (0.0, 1.0))
    np.testing.assert_array_equal(free["size"], held["size"])
    np.testing.assert_array_equal(free["position"], free["true_position"])
    to_sensor = scene.sensor_pose[0, :2] - held["true_position"][:, :2]
    to_sensor /= np.linalg.norm(to_sensor, axis=1)[:, None]
    move = held["position"] - held["true_position"]
    for axis, turn in ((0, 0.0), (1, np.pi / 2)):
        heading = held["true_yaw"] + turn
        forward = np.stack([np.cos(heading), np.sin(heading)], axis=1)
        faces = (forward * to_sensor).sum(axis=1)
        smaller = (held["true_size"] - held["size"])[:, axis]
        # Seen end on, the face stays: the centre moves toward it by half of what is lost.
        expected = faces * smaller / 2
        np.testing.assert_allclose((forward * move[:, :2]).sum(axis=1), expected, atol=1e-12)
    half = pairs(record(scene, facing_anchor=0.5, **knobs))
    np.testing.assert_allclose(half["error"], held["error"] / 2, atol=1e-12)


def test_echoes_come_as_often_as_said_where_the_box_is_and_last():
    knobs = {"echo": {"pedestrian": 0.2, "cyclist": 0.1}, "score_persistence": 0.8}
    scene = still(MANY, frames=60)
    recording = record(scene, **knobs)
    plain = record(scene)
    false = clutter(recording)
    boxes = len(MANY) * 60
    for label, share in ((Label.PEDESTRIAN, 0.2), (Label.CYCLIST, 0.1)):
        found = np.count_nonzero(false["label"] == label)
        # Five standard errors of a share whose draws last as long as an AR(1) of 0.8 lets them.
        assert abs(found / boxes - share) < 5 * np.sqrt(share * (1 - share) / boxes * 9)
    for detections, first, origin in zip(
        recording.detections, plain.detections, recording.origin, strict=True
    ):
        true = origin != CLUTTER
        np.testing.assert_array_equal(
            np.sort(detections.position[true], axis=0), np.sort(first.position, axis=0)
        )
        apart = np.linalg.norm(
            detections.position[~true, None, :2] - detections.position[true, :2], axis=2
        )
        assert (apart.min(axis=1) < 0.6).all()
    assert set(false["label"].tolist()) == {Label.PEDESTRIAN, Label.CYCLIST}
