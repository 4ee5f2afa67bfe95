"""Levels of scores, in the filter and beside other labels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mark_builders import PLAIN, frame, levels, street

from pmbm.filter import PMBMConfig, PMBMTracker, Report
from pmbm.filter.models.protocols import SceneDensity
from pmbm.score import Calibration
from pmbm.types import Detections, Label

ALL = Report(above=0.0, exclusive=False)
STREET = {"sensor.clutter_rate": 1.0, "sensor.position_sd": 0.1}


def textbook(**changes):
    return replace(PMBMConfig.textbook(), **changes)


def test_a_level_is_learned_by_bayes_rule():
    """P(object) after three detections, against the sum over levels written out."""
    config = textbook(scores=levels()).changed({"sensor.clutter_rate": 1e-9})
    tracker = PMBMTracker(config)
    given = [1.5, -0.5, 0.7]
    for k, raw in enumerate(given):
        tracks = tracker.step(frame(0.1 * k, [[5.0, 0.0]], raw))
    weight = np.array([0.6, 0.2, 0.2])
    for raw in given:
        weight *= np.exp(-0.5 * (raw - np.array([-2.0, 0.0, 2.0])) ** 2)
    expected = weight @ [0.02, 0.5, 0.98] / weight.sum()
    row = int(np.argmax(tracker.density.hypothesis_probability()))
    assert tracks.score[0] == pytest.approx(tracker.density.local.existence[row] * expected)
    assert tracker.inspect().object[0] == pytest.approx(tracks.score[0])


def test_a_long_life_makes_no_object():
    """A pole that stands at the level where half are objects stays a matter of even odds."""
    tracker = PMBMTracker(textbook(scores=levels(), report=ALL))
    rng = np.random.default_rng(0)
    scores = [
        tracker.step(frame(0.1 * k, [[5.0, 0.0]], rng.normal(0, 0.3))).score[:1] for k in range(80)
    ]
    assert scores[-1] == pytest.approx(0.5, abs=0.02)


def test_one_level_says_nothing_and_is_the_plain_filter():
    flat = levels(level=[0.0], birth=[1.0], clutter=[1.0], object=[1.0])
    plain = PMBMTracker(textbook())
    marked = PMBMTracker(textbook(scores=flat))
    for one in street(3).detections[:15]:
        a, b = plain.step(one), marked.step(one)
        assert a.id.tolist() == b.id.tolist()
        assert b.score == pytest.approx(a.score, rel=1e-12)
        assert b.position == pytest.approx(a.position, rel=1e-12)


def test_the_number_of_objects_of_a_scene_is_a_gamma_variable():
    """Shape mean_objects x prior_seconds, rate prior_seconds, both raised by what was seen: its
    mean, over mean_objects."""
    assert SceneDensity().abundance(mean_objects=0.4, prior_seconds=30.0) == 1.0
    seen = SceneDensity().after(2.0, 0.0, 150.0).after(10.0, 3.0, 150.0)
    assert seen.abundance(0.4, 30.0) == pytest.approx((0.4 * 30 + 30) / (30 + 12) / 0.4)
    crowd = SceneDensity(looked=1e6, objects=8e6)
    assert crowd.abundance(0.4, 30.0) == pytest.approx(20, rel=1e-3)


def test_a_scene_is_never_known_for_good():
    """An hour of an empty road is worth five times the prior, and what is new still counts."""
    empty = SceneDensity()
    for _ in range(36_000):
        empty = empty.after(0.1, 0.0, 10.0)
    assert (empty.looked, empty.objects) == (pytest.approx(10.0), 0.0)
    assert empty.abundance(1.5, 2.0) == pytest.approx(1 / 6)
    busier = empty.after(1.0, 3.0, 10.0)
    assert (busier.looked, busier.objects) == pytest.approx((10.0, 3.0 * 10 / 11))


def test_fewer_objects_come_where_few_have_been():
    """Births of each level are those of objects and of others: the one scales with the scene, up to
    what is usual, the other stays."""
    marks = levels(mean_objects=0.5, prior_seconds=3.0)
    scarce = SceneDensity(looked=15.0, objects=0.0)
    share = scarce.abundance(0.5, 3.0)
    assert share == pytest.approx(1 / 6)
    objects, others = marks.birth * marks.object, marks.birth * (1 - marks.object)
    anywhere = np.zeros(1)
    assert marks.birth_after(scarce, anywhere) == pytest.approx(share * objects + others)
    # The posterior of both views of a source is one: which level, and whether an object.
    after = share * objects / (share * objects + others)
    assert marks.object_share(scarce) == pytest.approx(after)
    many = SceneDensity(looked=15.0, objects=90.0)
    assert marks.birth_after(many, anywhere) == pytest.approx(marks.birth)
    assert replace(marks, mean_objects=None).birth_after(scarce, anywhere) == pytest.approx(
        marks.birth
    )


def test_what_comes_into_view_depends_on_where():
    """Linear between two distances, constant beyond; the tracker's first detections weigh it."""
    near, far = [0.8, 0.1, 0.1], [0.2, 0.2, 0.6]
    marks = levels(birth=[near, far], birth_at=[20.0, 60.0])
    births = marks.birth_after(SceneDensity(), np.array([5.0, 30.0, 40.0, 90.0]))
    assert births == pytest.approx(np.array([near, [0.65, 0.125, 0.225], [0.5, 0.15, 0.35], far]))
    scarce = SceneDensity(looked=15.0, objects=0.0)
    scaled = replace(marks, mean_objects=0.5, prior_seconds=3.0).birth_after(
        scarce, np.array([90.0])
    )
    object_share = np.array(marks.object)
    assert scaled[0] == pytest.approx(np.array(far) * (object_share / 6 + 1 - object_share))

    both = frame(0.0, [[10.0, 0.0], [0.0, 70.0]], 1.0)
    tracker = PMBMTracker(textbook(scores=marks))
    tracker.step(both)
    local = tracker.density.local
    said = marks.evidence(marks.own(both)[1])
    order = np.argsort(local.mean[:, 1])
    expected = np.array([near, far]) * said
    assert local.marks.source[order] == pytest.approx(
        expected / expected.sum(axis=1, keepdims=True)
    )
    one_each = [tracker_of_one(marks, place) for place in ([10.0, 0.0], [0.0, 70.0])]
    assert one_each[1] > one_each[0]


def tracker_of_one(marks, place):
    tracker = PMBMTracker(textbook(scores=marks))
    tracker.step(frame(0.0, [place], 1.0))
    return float(tracker.density.local.existence[0])


def test_the_tracker_expects_fewer_objects_where_few_have_been():
    """The odds of a first detection are those of the scene's births."""
    marks = levels(mean_objects=0.5, prior_seconds=3.0)
    one = frame(0.1, [[5.0, 0.0]], 0.0)
    said = marks.evidence(marks.own(one)[1])[0]
    odds, births = [], []
    for seen in (SceneDensity(), SceneDensity(looked=14.0, objects=0.0)):
        tracker = PMBMTracker(textbook(scores=marks))
        tracker.step(frame(0.0, [], 0.0))
        tracker.state = replace(tracker.state, scene=seen)
        births.append(said @ marks.birth_after(seen, one.distance))
        tracker.step(one)
        (r,) = tracker.density.local.existence
        odds.append(r / (1 - r))
    assert odds[1] < 0.7 * odds[0]
    assert odds[1] / odds[0] == pytest.approx(births[1] / births[0], rel=1e-6)


def test_an_uncertain_source_is_rather_an_object_where_there_are_many():
    """Five sure objects raise the odds of a sixth, at a level of even odds, with their number."""
    marks = levels(mean_objects=0.5, prior_seconds=3.0)
    sure = [[10.0 * k, 10.0] for k in range(1, 6)]
    score = {}
    for name, others in (("alone", []), ("crowd", sure)):
        tracker = PMBMTracker(textbook(scores=marks, report=ALL))
        for k in range(40):
            raw = np.r_[0.0, np.full(len(others), 3.0)]
            tracks = tracker.step(frame(0.1 * k, [[5.0, -20.0], *others], raw))
        score[name] = tracks.score[np.argmin(tracks.position[:, 1])]
        scene = tracker.state.scene
        count = scene.objects / scene.looked
        assert count == pytest.approx(len(others) + 0.5, abs=0.3)
        odds = scene.abundance(0.5, 3.0)
        assert score[name] == pytest.approx(odds / (1 + odds), abs=0.05)
    assert score["crowd"] > 0.8 > 0.55 > score["alone"]


def test_rivals_share_the_odds_of_a_place():
    one, other = frame(0, [[10, 0]], 1.0, Label.PEDESTRIAN), frame(0, [[10.5, 0]], 2.0)
    far = frame(0, [[12, 0]], 3.0)
    both = Detections(
        time=0.0,
        **{
            name: np.concatenate([getattr(part, name) for part in (one, other, far)])
            for name in ("position", "size", "yaw", "score", "raw_score", "label")
        },
    )
    a, b = np.exp(1.0), np.exp(2.0)
    expected = np.log([a / (1 + b), b / (1 + a), np.exp(3.0)])
    assert PLAIN.log_odds(both) == pytest.approx(expected, rel=1e-12)
    # Two of one label are no rivals.
    assert PLAIN.log_odds(frame(0, [[0, 0], [0.1, 0]], 1.0)) == pytest.approx([1.0, 1.0])


def test_range_counts_between_its_bounds():
    ranged = Calibration(
        offset=np.zeros(7), slope=np.ones(7), per_metre=np.full(7, 0.1), near=10, far=60
    )
    found = ranged.log_odds(frame(0, [[3, 0], [30, 0], [90, 0]], 1.0))
    assert found == pytest.approx([2.0, 4.0, 7.0])


def test_a_tracker_of_one_label_is_told_of_rivals():
    """A pedestrian's detection inside a surer cyclist's is not followed."""
    score = []
    for rival in (-9.0, 9.0):
        mark = levels(label=Label.PEDESTRIAN)
        tracker = PMBMTracker(textbook(scores=mark, report=ALL))
        for k in range(5):
            own, other = (
                frame(0.1 * k, [[5.0, 0.0]], 2.0, Label.PEDESTRIAN),
                frame(0.1 * k, [[5.3, 0.0]], rival, Label.CYCLIST),
            )
            names = ("position", "size", "yaw", "score", "raw_score", "label")
            joined = {n: np.concatenate([getattr(own, n), getattr(other, n)]) for n in names}
            tracks = tracker.step(Detections(time=0.1 * k, **joined))
        assert set(tracks.label.tolist()) <= {Label.PEDESTRIAN}
        score.append(tracks.score.max(initial=0.0))
    assert score[0] > 0.8
    assert score[1] < 0.2
