"""A configuration made of parts: how it is told, how it is refused, and the step that it drives."""

from __future__ import annotations

import pickle
import re
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from filter_problems import scan_of
from mark_builders import PLAIN
from test_filter_tracker import drive, equal

import pmbm.filter
from pmbm.errors import InputError
from pmbm.filter import (
    BirthMap,
    BroadBirth,
    ConstantVelocity,
    DetectionChain,
    DetectionFromScores,
    EveryScore,
    FirstScore,
    FixedDetection,
    IgnoreScores,
    LastingScores,
    ObjectClasses,
    PMBMConfig,
    PMBMTracker,
    Reduction,
    Report,
    ScoreLevels,
    Sensor,
    State,
    Survival,
    step,
)
from pmbm.filter.config import RENAMED
from pmbm.score import ScoreModel
from pmbm.study import ConfiguredTracker
from pmbm.study.configured import from_table, merged, nested
from pmbm.types import Site

FLAT = {
    "survival": 0.99,
    "survival_interval": 0.2,
    "spectral_density": 1.0,
    "measurement_sd": 0.3,
    "detection_probability": 0.9,
    "clutter_rate": 2.0,
    "occlusion": False,
    "scores": "everywhere",
    "score_model": None,
    "detection_from_scores": "rising",
    "detection_low": 0.6,
    "detection_high": 0.9,
    "newest_score": 0.5,
    "miss_rule": "scaled",
    "kinds": None,
    "levels": None,
    "visibility": None,
    "newest_box": 0.4,
    "birth_rate": 1.0,
    "initial_objects": 2.0,
    "birth_components": 5,
    "birth_speed_sd": 8.0,
    "undetected_detail": 3.5,
    "gate": 16.0,
    "max_hypotheses": 100,
    "prune_hypothesis": 1e-4,
    "recycle_below": 0.02,
    "recycle": False,
    "prune_undetected": 1e-4,
    "merge_undetected": 2.0,
    "max_tracks": 1000,
    "max_undetected": 1000,
    "clustering": False,
    "split_below": 0.0,
    "report_above": 0.4,
    "exclusive": False,
    "keep_above": 0.4,
    "history": 3,
}
"""Every keyword that PMBMConfig had before it was made of parts."""


@pytest.mark.parametrize("name", FLAT)
def test_an_old_keyword_gets_one_line_that_names_its_new_place(name):
    ways = (
        lambda: PMBMConfig(**{name: FLAT[name]}),
        lambda: replace(PMBMConfig(), **{name: FLAT[name]}),
        lambda: from_table(PMBMConfig, {name: FLAT[name]}),
        lambda: ConfiguredTracker("pmbm", ((name, FLAT[name]),)).bound(),
    )
    for way in ways:
        with pytest.raises(InputError) as caught:
            way()
        assert caught.value.field == name
        assert f"it is now {RENAMED[name]}" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_every_new_place_is_one():
    """Dotted names are fields, and names of classes are classes."""
    assert RENAMED.keys() == FLAT.keys()
    for place in RENAMED.values():
        words = re.findall(r"[\w.]*\w", place)
        dotted = [word for word in words if "." in word]
        classes = [word for word in words if word[0].isupper()]
        assert dotted or classes
        for word in classes:
            assert hasattr(pmbm.filter, word)
        for word in dotted:
            *path, last = word.split(".")
            part = PMBMConfig()
            for name in path:
                part = getattr(part, name)
            own = {field.name for field in fields(part)}
            assert last in own | {"kind"} or (path, last) == (
                ["sensor", "detection"],
                "probability",
            )


def test_an_old_name_in_a_part_is_told_as_well():
    with pytest.raises(InputError, match=r"it is now sensor\.position_sd"):
        from_table(PMBMConfig, {"sensor": {"measurement_sd": 0.3}})


@pytest.mark.parametrize(
    ("old", "new"),
    [("Kinds", "ObjectClasses"), ("Levels", "ScoreLevels"), ("Visibility", "DetectionChain")],
)
def test_an_old_class_gets_one_line_that_names_the_new_one(old, new):
    with pytest.raises(InputError, match=f"no '{old}'; it is now {new}$"):
        getattr(pmbm.filter, old)
    assert hasattr(pmbm.filter, new)
    with pytest.raises(AttributeError):
        pmbm.filter.Clutters  # noqa: B018


def test_other_trackers_are_not_told_of_our_old_names():
    with pytest.raises(InputError) as caught:
        ConfiguredTracker("argoverse", (("gate", 3.0),)).bound()
    assert "it is now" not in str(caught.value)


def test_a_name_that_there_never_was_gets_the_nearest():
    with pytest.raises(InputError, match="did you mean 'sensor'"):
        PMBMConfig(sensr=Sensor())


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("motion", 3),
        ("motion", ConstantVelocity),
        ("survival", Sensor()),
        ("birth", FixedDetection()),
        ("sensor", {"clutter_rate": 2.0}),
        ("scores", EveryScore),
        ("reduction", None),
        ("report", Reduction()),
    ],
)
def test_a_value_that_is_no_such_part_is_refused_by_name(field, value):
    with pytest.raises(InputError) as caught:
        PMBMConfig(**{field: value})
    assert caught.value.field == field


def test_a_chain_around_a_chain_means_nothing():
    with pytest.raises(InputError, match="base"):
        DetectionChain(base=DetectionChain())


def test_a_change_is_made_where_its_name_says_and_nowhere_else():
    config = PMBMConfig()
    changed = config.changed(
        {
            "sensor.clutter_rate": 2.0,
            "sensor.detection.base.probability": 0.8,
            "birth": BirthMap(),
            "birth.spacing": 2.0,
            "reduction.gate": 9,
        }
    )
    assert changed == PMBMConfig(
        sensor=Sensor(
            clutter_rate=2.0, detection=DetectionChain(base=FixedDetection(probability=0.8))
        ),
        birth=BirthMap(spacing=2.0),
        reduction=Reduction(gate=9),
    )
    assert config == PMBMConfig()
    assert config.changed({}) == config


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("sensor.clutter_rate", -1.0, "at least 0, got -1"),
        ("sensor.cluter_rate", 1.0, "did you mean 'clutter_rate'"),
        ("sensor.detection.probability", 0.9, "DetectionChain has no 'probability'"),
        ("sensor.detection.base.probability", 1.5, "at most 1, got 1.5"),
        ("sensor.detection.stay_detectable", 0.1, "at least as probable as changing"),
        ("sensor.clutter_rate.of", 1.0, "float has no 'of'"),
        ("clutter_rate", 1.0, "it is now sensor.clutter_rate"),
        ("scores.scatter", 0.0, "scatter"),
        ("motion", 3, "expected a Motion, got 3"),
    ],
)
def test_a_change_that_does_not_fit_is_refused_by_its_whole_name(name, value, words):
    with pytest.raises(InputError) as caught:
        PMBMConfig().changed({name: value})
    assert caught.value.field == name
    assert words in str(caught.value)


def test_tables_are_parts_and_what_they_leave_out_is_the_default():
    assert from_table(PMBMConfig, {}) == PMBMConfig()
    made = from_table(
        PMBMConfig,
        {
            "motion": {"acceleration_density": 0.5},
            "birth": {"kind": "map", "spacing": 2},
            "sensor": {"clutter_rate": 2.0, "detection": {"base": {"probability": 0.8}}},
            "scores": {"kind": "ignore"},
            "report": {},
        },
    )
    assert made == PMBMConfig(
        motion=ConstantVelocity(acceleration_density=0.5),
        birth=BirthMap(spacing=2),
        sensor=Sensor(
            clutter_rate=2.0, detection=DetectionChain(base=FixedDetection(probability=0.8))
        ),
        scores=IgnoreScores(),
    )


LEVELS = {
    "label": 0,
    "level": [-1.0, 1.0],
    "scatter": 1.0,
    "birth": [0.5, 0.5],
    "object": [0.1, 0.9],
    "clutter": [0.8, 0.2],
    "calibration": {"offset": [0.0] * 7, "slope": [1.0] * 7, "per_metre": [0.0] * 7},
}
CLASSES = {
    "birth": [1 / 14] * 14,
    "confusion": [[1 / 7] * 7] * 14,
    "clutter": [1 / 7] * 7,
    "score": {"knot": [0.0], "log_odds": [0.0], "base_rate": 0.5},
    "persistent_score": {"knot": [0.0], "log_odds": [0.0], "base_rate": 0.5},
}


@pytest.mark.parametrize(
    ("part", "table", "member"),
    [
        ("motion", {"kind": "constant_velocity"}, ConstantVelocity()),
        ("birth", {"kind": "broad"}, BroadBirth()),
        ("birth", {"kind": "map"}, BirthMap()),
        ("sensor.detection", {"kind": "fixed"}, FixedDetection()),
        ("sensor.detection", {"kind": "from_scores"}, DetectionFromScores()),
        ("sensor.detection", {"kind": "chain"}, DetectionChain()),
        (
            "sensor.detection",
            {"kind": "chain", "base": {"kind": "from_scores", "low": 0.5}},
            DetectionChain(base=DetectionFromScores(low=0.5)),
        ),
        ("scores", {"kind": "ignore"}, IgnoreScores()),
        ("scores", {"kind": "first"}, FirstScore()),
        ("scores", {"kind": "every"}, EveryScore()),
        ("scores", {"kind": "lasting"}, LastingScores()),
        ("scores", {"kind": "levels", **LEVELS}, ScoreLevels(**{**LEVELS, "calibration": PLAIN})),
        ("scores", {"kind": "classes", **CLASSES}, ObjectClasses.neutral()),
    ],
    ids=lambda value: value.get("kind") if isinstance(value, dict) else "",
)
def test_a_kind_is_the_member_that_it_names(part, table, member):
    """Also by dotted names, as a study or a tuner has them."""
    expected = PMBMConfig().changed({part: member})
    assert from_table(PMBMConfig, nested({part: table})) == expected
    by_name = {f"{part}.{name}": value for name, value in table.items()}
    assert from_table(PMBMConfig, nested(by_name)) == expected


@pytest.mark.parametrize(
    ("table", "field", "words"),
    [
        ({"scores": {"kind": "lastin"}}, "scores.kind", "did you mean 'lasting'"),
        ({"scores": {"kind": 3}}, "scores.kind", "valid kinds"),
        ({"birth": {"kind": "map", "max_component": 3}}, "birth.max_component", "max_components"),
        ({"birth": {"rate": -1.0}}, "birth.rate", "at least 0"),
        ({"sensor": {"detection": {"kind": "chian"}}}, "sensor.detection.kind", "'chain'"),
        (
            {"sensor": {"detection": {"base": {"probability": 2.0}}}},
            "sensor.detection.base.probability",
            "at most 1",
        ),
        (
            {"sensor": {"detection": {"kind": "from_scores", "low": 0.9, "high": 0.5}}},
            "sensor.detection.low",
            "at most high",
        ),
        ({"scores": {"kind": "levels", "scatter": 1.0}}, "scores.label", "missing parameter"),
        ({"sensr": {}}, "sensr", "did you mean 'sensor'"),
        ({"motion": 3.0}, "motion", "a Motion"),
    ],
)
def test_a_table_that_does_not_fit_is_refused_by_the_dotted_name(table, field, words):
    with pytest.raises(InputError) as caught:
        from_table(PMBMConfig, table)
    assert caught.value.field == field
    assert words in str(caught.value)


def test_tables_over_tables():
    """What is above counts; a table of another kind stands alone."""
    under = {"birth": {"components": 5, "rate": 1.0}, "report": {"above": 0.4}}
    over = nested({"birth.rate": 2.0, "sensor.clutter_rate": 3.0})
    assert merged(under, over) == {
        "birth": {"components": 5, "rate": 2.0},
        "report": {"above": 0.4},
        "sensor": {"clutter_rate": 3.0},
    }
    mapped = merged(under, {"birth": {"kind": "map"}})
    assert mapped["birth"] == {"kind": "map"}
    assert from_table(PMBMConfig, mapped).birth == BirthMap()


MODELS = {
    "default": PMBMConfig(),
    "textbook": PMBMConfig.textbook(),
    "paper": PMBMConfig.paper(),
    "map": PMBMConfig(birth=BirthMap(spacing=4.0)),
    "classes": PMBMConfig(
        scores=ObjectClasses.simple(
            persistent_clutter=0.3,
            score=ScoreModel(knot=[0.0, 1.0], log_odds=[-2.0, 2.0], base_rate=0.5),
        )
    ),
    "chain around scores": PMBMConfig(
        sensor=Sensor(detection=DetectionChain(base=DetectionFromScores()), occlusion=False),
        report=Report(history=4),
    ),
}
SITE = Site(max_range=40.0)


def leaves(value):
    """Every number of a value, bit by bit, in order."""
    if isinstance(value, np.ndarray):
        yield value.dtype.str, value.shape, value.tobytes()
    elif is_dataclass(value):
        for field in fields(value):
            yield from leaves(getattr(value, field.name))
    else:
        yield repr(value)


@pytest.mark.parametrize("name", MODELS)
def test_a_step_is_a_pure_function(name):
    """The same twice from the same, and what it was given is as it was."""
    model, state = MODELS[name], State.initial(MODELS[name])
    for detections in drive(2, frames=8):
        before, seen = list(leaves(state)), list(leaves(detections))
        after, tracks, trace = step(model, SITE, state, detections)
        again, told, looked = step(model, SITE, state, detections)
        assert list(leaves(state)) == before
        assert list(leaves(detections)) == seen
        assert list(leaves(after)) == list(leaves(again))
        assert list(leaves(tracks)) == list(leaves(told))
        assert list(leaves(trace.before)) == list(leaves(looked.before))
        assert trace.removed == looked.removed
        state = after
    assert len(tracks) > 0


@pytest.mark.parametrize("name", MODELS)
def test_a_pickled_state_continues_bit_for_bit(name):
    model, frames = MODELS[name], drive(4, frames=20)
    tracker = PMBMTracker(model, SITE)
    for one in frames[:9]:
        tracker.step(one)
    kept = pickle.dumps((model, tracker.state))
    expected = [tracker.step(one) for one in frames[9:]]
    model, state = pickle.loads(kept)
    assert model == MODELS[name]
    for one, tracks in zip(frames[9:], expected, strict=True):
        state, again, _ = step(model, SITE, state, one)
        equal(again, tracks)
    assert list(leaves(state)) == list(leaves(tracker.state))


def test_a_tracker_is_its_state_and_the_step():
    """Beside each other, frame by frame; a failed step leaves it."""
    tracker, state = PMBMTracker(site=SITE), State.initial(PMBMConfig())
    for one in drive(5, frames=10):
        state, tracks, _ = step(PMBMConfig(), SITE, state, one)
        equal(tracker.step(one), tracks)
    assert list(leaves(tracker.state)) == list(leaves(state))
    with pytest.raises(InputError, match="time"):
        tracker.step(drive(5, frames=1)[0])
    assert list(leaves(tracker.state)) == list(leaves(state))


def test_the_state_is_frozen():
    state = State.initial(PMBMConfig())
    assert not state.started
    with pytest.raises(AttributeError):
        state.time = 1.0


@pytest.mark.parametrize("rising", [False, True])
def test_scores_may_be_ignored_where_detection_depends_on_them(rising):
    """What a score says of P_D it says of that alone: first detections are the textbook's."""
    from_scores = DetectionFromScores(rising=rising, undetected=0.9)
    config = PMBMConfig.textbook().changed({"sensor.detection": from_scores})
    assert isinstance(config.scores, IgnoreScores)
    one = drive(6, frames=1, objects=3, clutter=0.0)[0]
    n = len(one)
    one = replace(one, score=np.linspace(0.2, 0.9, n))
    plain, scored = PMBMTracker(PMBMConfig.textbook()), PMBMTracker(config)
    equal(scored.step(one), plain.step(one))
    local = scored.density.local
    assert local.marks.source.shape == (len(local), 1)
    np.testing.assert_array_equal(local.marks.source, 1.0)
    np.testing.assert_allclose(np.sort(local.marks.confidence), one.score, rtol=2e-4)
    np.testing.assert_array_equal(plain.density.local.marks.confidence, 0.0)
    # One miss later, who scored low and is detected rather is there less probably, or the reverse.
    scored.step(one.take(np.zeros(0, int)))
    missed = scored.density.local
    order = np.argsort(missed.marks.confidence)
    rises = np.diff(missed.existence[order]) > 0
    assert (~rises if rising else rises).all()


def test_what_a_scan_leaves_out_says_nothing():
    """The tests' bare scan is the one that a frame gives whose scores are ignored."""
    one = drive(7, frames=1)[0]
    scored = IgnoreScores().read(one, State.initial(PMBMConfig()).scene)
    bare = scan_of(one.position[:, :2])
    for name in ("evidence", "birth", "first"):
        np.testing.assert_array_equal(getattr(bare, name), getattr(scored, name))
    np.testing.assert_array_equal(bare.confidence, FixedDetection().confidence(one))


def test_survival_and_births_of_the_default_are_those_of_their_parts():
    """What is printed is what runs: the parts are in the text of a configuration."""
    text = repr(PMBMConfig.paper())
    for part in ("FirstScore", "DetectionFromScores", "miss_rule='scaled'", "BroadBirth"):
        assert part in text
    assert "LastingScores" in repr(PMBMConfig())
    assert "DetectionChain" in repr(PMBMConfig())
    assert Survival() == PMBMConfig().survival


def test_configurations_hash_by_their_values():
    one, other = PMBMConfig(), PMBMConfig()
    assert hash(one) == hash(other)
    assert len({one, other, PMBMConfig.paper(), PMBMConfig.textbook()}) == 3
    zero = LastingScores(level=[-1.2, 0.0, 1.3])
    minus = LastingScores(level=[-1.2, -0.0, 1.3])
    assert zero == minus
    assert hash(zero) == hash(minus)
