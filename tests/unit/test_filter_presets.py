"""The paper's deviations from the textbook filter, one by one, and what switches them off."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from filter_problems import KEEP_ALL, plain_sensor, scan_of

from pmbm.errors import InputError
from pmbm.filter import (
    ConstantVelocity,
    DetectionFromScores,
    EveryScore,
    FirstScore,
    FixedDetection,
    LastingScores,
    PMBMConfig,
    PMBMTracker,
    Sensor,
)
from pmbm.filter.association import associate
from pmbm.filter.density import Density, Marks, Mixture
from pmbm.filter.prediction import Transition, predict
from pmbm.filter.update import update
from pmbm.score import ScoreModel
from pmbm.study.configured import from_table
from pmbm.tracking import make_tracker, tracker_factory
from pmbm.types import Detections, Site


def frames(seed, score=None, count=40, raw=None):
    rng = np.random.default_rng(seed)
    start, velocity = rng.uniform(-30, 30, (5, 2)), rng.normal(0, 6, (5, 2))
    for k in range(count):
        z = np.concatenate(
            [
                (start + 0.1 * k * velocity)[rng.random(5) < 0.9],
                rng.uniform(-50, 50, (rng.poisson(3), 2)),
            ]
        )
        n = len(z)
        yield Detections(
            time=0.1 * k,
            position=np.column_stack([z + rng.normal(0, 0.3, z.shape), np.ones(n)]),
            size=np.ones((n, 3)),
            yaw=np.zeros(n),
            score=rng.random(n) if score is None else np.full(n, score),
            label=np.zeros(n, int),
            raw_score=None if raw is None else np.full(n, raw),
        )


def outputs(config, detections):
    tracker = PMBMTracker(config)
    return [tracker.step(one) for one in detections], tracker


def assert_equal_bits(a, b):
    for one, other in zip(a, b, strict=True):
        assert one.id.tolist() == other.id.tolist()
        for name in ("position", "velocity", "score", "covariance"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()


ONE_P_D = FixedDetection(probability=0.9)
PAPER_SCORES_ALONE = {"sensor.miss_rule": "bayes", "sensor.detection": ONE_P_D}
KEPT = replace(KEEP_ALL, gate=20.0, max_hypotheses=9, clustering=True)


def textbook(**changes):
    return replace(PMBMConfig.textbook(), **changes)


def paper_scores_alone(**changes):
    return replace(PMBMConfig.paper().changed(PAPER_SCORES_ALONE), **changes)


def test_scores_that_say_nothing_give_the_textbook_bit_for_bit():
    seen = list(frames(0, score=0.5))
    plain, _ = outputs(textbook(), seen)
    paper, _ = outputs(paper_scores_alone(), seen)
    everywhere, _ = outputs(textbook(scores=EveryScore()), seen)
    assert sum(map(len, plain)) > 50
    assert_equal_bits(paper, plain)
    assert_equal_bits(everywhere, plain)
    dull = paper_scores_alone(scores=FirstScore(score_model=ScoreModel.uninformative()))
    random_scores = list(frames(1))
    assert_equal_bits(outputs(dull, random_scores)[0], outputs(textbook(), random_scores)[0])


def test_scores_that_say_something_change_the_outcome():
    seen = list(frames(1))
    plain, _ = outputs(textbook(), seen)
    for changes in (
        {"scores": FirstScore()},
        {"scores": EveryScore()},
        {"sensor.miss_rule": "scaled"},
        {"sensor.detection": DetectionFromScores(rising=True, undetected=0.9)},
        {"sensor.detection": DetectionFromScores(rising=False, undetected=0.9)},
    ):
        other, _ = outputs(textbook().changed(changes), seen)
        with pytest.raises(AssertionError):
            assert_equal_bits(other, plain)


@pytest.mark.parametrize("score", [0.2, 0.9, 0.0, 1.0])
def test_a_first_detection_by_the_papers_rule(score):
    """r = s e / (s e + (1 - s) lambda_c)."""
    one = next(iter(frames(2, score=score)))
    kept = {"reduction.recycle_below": 0.0}
    plain, unscored = outputs(textbook().changed(kept), [one])
    _, paper = outputs(paper_scores_alone().changed(kept), [one])
    s = np.clip(score, 1e-3, 1 - 1e-3)
    r = unscored.density.local.existence
    odds = r / (1 - r) * s / (1 - s)
    assert paper.density.local.existence == pytest.approx(odds / (1 + odds), rel=1e-6)
    assert len(plain[0]) <= len(one)


def test_the_papers_weight_of_a_first_detection():
    """2 (s e + (1 - s) lambda_c); all other branches unscaled."""
    ppp = Mixture(np.log([0.4]), np.zeros((1, 4)), np.diag([9.0, 9, 1, 1])[None])
    sensor = plain_sensor(0.1 * np.eye(2), 0.9, 0.02)
    scan = scan_of([[0.5, 0.0], [1.0, 1.0]])
    s = np.array([0.3, 0.8])
    scored = replace(scan, first=np.column_stack([2 * s, 2 * (1 - s)]))
    start = Density.initial(ppp)
    plain, paper = (associate(start, one, sensor, KEPT) for one in (scan, scored))
    e = np.exp(plain.log_birth_evidence)
    assert np.exp(paper.log_new) == pytest.approx(2 * (s * e + (1 - s) * 0.02))
    assert np.exp(plain.log_new) == pytest.approx(e + 0.02)


def test_likelihood_ratios_speak_in_every_branch():
    """Weights and existence as if e and the track's likelihood were multiplied by the ratio."""
    ppp = Mixture(np.log([0.4]), np.zeros((1, 4)), np.diag([9.0, 9, 1, 1])[None])
    sensor = plain_sensor(0.1 * np.eye(2), 0.9, 0.02)
    first = scan_of([[0.5, 0.0]])
    start = Density.initial(ppp)
    found = associate(start, first, sensor, KEPT)
    prior = predict(
        update(start, first, found, sensor),
        Transition(*ConstantVelocity(acceleration_density=1.0).transition(0.1), 0.99),
        Mixture.empty(),
    )
    scan = scan_of([[0.6, 0.1]])
    scored = replace(scan, evidence=np.array([[4.0]]))
    plain, paper = (associate(prior, one, sensor, KEPT) for one in (scan, scored))
    assert paper.known.log_weight == pytest.approx(plain.known.log_weight + math.log(4))
    assert paper.log_birth_evidence == pytest.approx(plain.log_birth_evidence + math.log(4))
    assert np.exp(paper.log_new) == pytest.approx(4 * np.exp(plain.log_birth_evidence) + 0.02)
    assert paper.log_missed == pytest.approx(plain.log_missed, abs=0)


def test_two_rules_for_a_miss():
    r, P_D = np.array([0.5, 1.0, 0.0]), np.array([0.9, 0.8, 0.7])
    bayes = plain_sensor(np.eye(2), 0.9, 0.1).missed(r, P_D)
    scaled = plain_sensor(np.eye(2), 0.9, 0.1, scaled_misses=True).missed(r, P_D)
    assert bayes[0] == pytest.approx([0.05 / 0.55, 1.0, 0.0])
    assert bayes[1] == pytest.approx([0.55, 0.2, 1.0])
    assert scaled[0] == pytest.approx([0.05, 0.2, 0.0])
    assert scaled[1] == pytest.approx([0.1, 0.2, 0.3])


def test_detection_probability_from_past_scores():
    rising = DetectionFromScores(low=0.6, high=0.9, rising=True, newest=0.3)
    falling = replace(rising, rising=False)
    marks = replace(Marks.neutral(3), confidence=np.array([0.0, 0.5, 1.0]))
    assert rising.of_tracks(marks) == pytest.approx([0.6, 0.75, 0.9])
    assert falling.of_tracks(marks) == pytest.approx([0.9, 0.75, 0.6])
    before = replace(Marks.neutral(1), confidence=np.array([0.5]))
    assert rising.if_detected(before, np.array([1.0])).confidence == pytest.approx([0.65])


@pytest.mark.parametrize("rule", ["rising", "falling"])
def test_a_clear_track_survives_misses_shorter_or_longer(rule):
    lifetimes = {}
    for score in (0.05, 0.95):
        from_scores = DetectionFromScores(rising=rule == "rising", undetected=0.9)
        tracker = PMBMTracker(textbook().changed({"sensor.detection": from_scores}))
        for k in range(10):
            one = Detections(
                time=0.1 * k,
                position=[[10.0, 0, 1]],
                size=[[4, 2, 1.5]],
                yaw=[0.0],
                score=[score],
                label=[0],
            )
            tracker.step(one)
        gone = 0
        while len(tracker.step(Detections.empty(1.0 + 0.1 * gone))):
            gone += 1
        lifetimes[score] = gone
    assert (lifetimes[0.95] < lifetimes[0.05]) == (rule == "rising")


@pytest.mark.parametrize(("score", "reported"), [(0.2, False), (0.45, True), (0.9, True)])
def test_what_scores_low_again_and_again_is_no_object(score, reported):
    """A pole beside four cars; its scores scatter about the one given."""
    random = np.random.default_rng(0)
    places = np.array([[10.0, 0, 1], [20, 5, 1], [30, -5, 1], [15, 10, 1], [25, -15, 1]])
    seen = {}
    for rule, scores in (("everywhere", EveryScore()), ("lasting", LastingScores())):
        tracker = PMBMTracker(PMBMConfig(scores=scores))
        for k in range(40):
            own = np.clip(random.normal(score, 0.08), 0.05, 0.95)
            tracks = tracker.step(
                Detections(
                    time=0.1 * k,
                    position=places + random.normal(0, 0.2, (5, 3)),
                    size=np.tile([4, 2, 1.5], (5, 1)),
                    yaw=np.zeros(5),
                    score=[own, 0.9, 0.8, 0.85, 0.9],
                    label=np.zeros(5, int),
                )
            )
        seen[rule] = np.linalg.norm(tracks.position - places[0], axis=1).min() < 1
        assert len(tracks) == 4 + seen[rule]
    assert seen == {"everywhere": True, "lasting": reported}


@pytest.mark.parametrize(("score", "within"), [(0.95, 2), (0.7, 4), (0.5, 15)])
def test_the_first_object_after_a_long_empty_time_is_believed(score, within):
    """However long nothing was there but clutter, and of whatever even odds or better the scores:
    the object is reported within so many frames, and stays so."""
    rng = np.random.default_rng(3)
    tracker = PMBMTracker()
    reported = []
    for k in range(3_060):
        came = k - 3_000
        position = np.column_stack([rng.uniform(-70, 70, (5, 2)), np.full(5, 0.8)])
        scores = 1 - np.sqrt(rng.uniform(size=5))
        if came >= 0:
            position = np.vstack([position, [20 + came, 3.0, 0.8]])
            scores = np.append(scores, score)
        n = len(position)
        tracks = tracker.step(
            Detections(
                time=0.1 * k,
                position=position,
                size=np.tile([4.5, 1.9, 1.6], (n, 1)),
                yaw=np.zeros(n),
                score=scores,
                label=np.zeros(n, int),
                sensor_pose=np.zeros(3),
            )
        )
        if came >= 0:
            near = np.hypot(*(tracks.position[:, :2] - position[-1, :2]).T) < 2
            reported.append(near.any())
    first = reported.index(True)
    assert first < within
    assert np.mean(reported[first:]) > 0.95


def test_a_new_source_is_as_likely_as_its_score_says():
    """Whatever its level may be: weighted by the shares of the levels, the evidence is the odds."""
    score = np.linspace(0.03, 0.97, 9)
    levels = LastingScores()
    one = replace(next(iter(frames(2))).take(np.zeros(9, int)), score=score)
    own, log_odds = levels.own(one)
    assert len(own) == 9
    assert np.exp(log_odds) == pytest.approx(score / (1 - score), rel=1e-3)
    assert levels.evidence(log_odds) @ levels.birth == pytest.approx(np.exp(log_odds), rel=1e-9)
    # Of one score, one level is the likelier the nearer it is.
    low, _, high = (levels.evidence(log_odds) / levels.evidence(log_odds).sum(1)[:, None]).T
    assert (np.diff(low) < 0).all()
    assert (np.diff(high) > 0).all()
    extreme = replace(one, score=np.r_[0.0, np.full(8, 1.0)])
    assert np.abs(levels.own(extreme)[1]).max() == 4.0


def test_raw_scores_are_read_where_the_model_asks_for_them():
    model = ScoreModel(knot=[-5.0, 5.0], log_odds=[-5.0, 5.0], base_rate=0.5, scale="raw_score")
    config = textbook(scores=EveryScore(score_model=model))
    with_raw = list(frames(4, score=0.1, raw=0.0))
    assert_equal_bits(outputs(config, with_raw)[0], outputs(textbook(), with_raw)[0])
    with pytest.raises(InputError, match="raw_score"):
        outputs(config, frames(4))


def test_presets_take_changes_and_refuse_nonsense():
    assert PMBMConfig.paper().changed({"reduction.gate": 9.0}).reduction.gate == 9.0
    assert PMBMConfig.textbook().sensor.miss_rule == "bayes"
    for part, bad in (
        (PMBMConfig, {"scores": "fist"}),
        (Sensor, {"miss_rule": "none"}),
        (DetectionFromScores, {"rising": "falling"}),
        (EveryScore, {"score_model": 0.5}),
        (FirstScore, {"score_model": 0.5}),
        (DetectionFromScores, {"low": 0.99, "high": 0.5}),
    ):
        with pytest.raises(InputError, match=next(iter(bad))):
            part(**bad)
    with pytest.raises(InputError, match="did you mean 'first'"):
        from_table(PMBMConfig, {"scores": {"kind": "fist"}})


def test_presets_can_be_named_wherever_a_tracker_is():
    site = Site(max_range=50.0)
    for name, config in (
        ("pmbm", PMBMConfig()),
        ("pmbm-textbook", PMBMConfig.textbook()),
        ("pmbm-paper", PMBMConfig.paper()),
    ):
        tracker = make_tracker(tracker_factory(name), site)
        assert tracker.config == config
        assert tracker.site is site
