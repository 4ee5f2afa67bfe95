"""Classes with persistent clutter, and misses in runs: exact, neutral where they should be, and
worth it."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from mark_builders import chained, frame

from pmbm.errors import InputError
from pmbm.filter import (
    BroadBirth,
    DetectionChain,
    ObjectClasses,
    PMBMConfig,
    PMBMTracker,
    Sensor,
    Survival,
)
from pmbm.score import ScoreModel
from pmbm.types import Label

OBJECTS = len(Label)
"""Classes that are objects; their persistent clutter comes after them."""
SCORES = ScoreModel(knot=[0.0, 1.0], log_odds=[-3.0, 3.0], base_rate=0.5)


def traffic(seed, frames=40, poles=0, burst=0.0):
    """Three cars with good scores, poles with bad ones, and now and then a run of misses."""
    rng = np.random.default_rng(seed)
    start, velocity = rng.uniform(-40, 40, (3, 2)), rng.normal(0, 5, (3, 2))
    pole = rng.uniform(-50, 50, (poles, 2))
    hidden = np.zeros(3, int)
    truth, made = [], []
    for k in range(frames):
        cars = start + 0.1 * k * velocity
        hidden = np.where((hidden == 0) & (rng.random(3) < burst), 6, np.maximum(hidden - 1, 0))
        seen = (rng.random(3) < 0.95) & (hidden == 0)
        standing = pole[rng.random(poles) < 0.9]
        clutter = rng.uniform(-60, 60, (rng.poisson(1), 2))
        z = np.concatenate([cars[seen], standing, clutter])
        score = np.concatenate(
            [
                rng.beta(8, 3, seen.sum()),
                rng.beta(3, 5, len(standing)),
                rng.beta(2, 5, len(clutter)),
            ]
        )
        made.append(frame(0.1 * k, z + rng.normal(0, 0.2, z.shape), score=score))
        truth.append(cars)
    return truth, made


def errors(config, truth, frames):
    """Missed cars and false tracks, summed over the frames after the first ten."""
    tracker, missed, false = PMBMTracker(config), 0, 0
    for k, (cars, one) in enumerate(zip(truth, frames, strict=True)):
        xy = tracker.step(one).position[:, :2]
        near = np.hypot(*(cars[:, None] - xy).transpose(2, 0, 1)) < 3.0
        if k >= 10:
            missed += int((~near.any(axis=1)).sum())
            false += int((~near.any(axis=0)).sum())
    return missed, false


def test_neutral_marks_are_the_plain_filter():
    _, frames = traffic(0, poles=2, burst=0.05)
    plain = PMBMTracker(PMBMConfig.textbook())
    chain = chained(0.9, undetectable=1.0, stay_detectable=0.9, stay_undetectable=0.8)
    marked = PMBMTracker(PMBMConfig.textbook().changed({"sensor.detection": chain}))
    neutral = {"scores": ObjectClasses.neutral(), "report.above": 0.5}
    classes = PMBMTracker(PMBMConfig.textbook().changed(neutral))
    for one in frames:
        a, b = plain.step(one), marked.step(one)
        classes.step(one)
        assert a.id.tolist() == b.id.tolist()
        np.testing.assert_allclose(b.score, a.score, rtol=1e-12)
        np.testing.assert_allclose(b.position, a.position, rtol=1e-12)
        np.testing.assert_allclose(
            classes.density.local.existence, plain.density.local.existence, rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(classes.density.local.marks.source, 1 / 14, rtol=1e-9)


def test_visibility_is_a_hidden_markov_model():
    """Existence and P(detectable) through detections and misses, against a sum over all state
    paths."""
    chain = chained(0.95, undetectable=0.2 / 0.95, stay_detectable=0.9, stay_undetectable=0.7)
    config = PMBMConfig.textbook().changed(
        {
            "sensor.detection": chain,
            "sensor.clutter_rate": 1e-9,
            "birth": BroadBirth(rate=0.0, initial=1.0),
            "survival": Survival(probability=0.98),
            "reduction.recycle_below": 0.0,
            "reduction.prune_hypothesis": 0.01,
        }
    )
    tracker = PMBMTracker(config)
    events = [1, 0, 0, 1, 0, 0, 0]
    for k, event in enumerate(events):
        tracker.step(frame(0.1 * k, [[5.0, 0.0]] if event else []))
    step = np.array([[0.7, 0.3], [0.1, 0.9]])
    detection = np.array([0.2, 0.95])
    usual = np.array([1 - chain.stationary, chain.stationary])
    alive_paths = np.zeros(2)
    dead = 0.0
    for last_alive in range(len(events)):
        for path in itertools.product([0, 1], repeat=last_alive + 1):
            p = usual[path[0]]
            for k, state in enumerate(path):
                if k:
                    p *= 0.98 * step[path[k - 1], state]
                p *= detection[state] if events[k] else 1 - detection[state]
            rest = events[last_alive + 1 :]
            if last_alive == len(events) - 1:
                alive_paths[path[-1]] += p
            elif not any(rest):
                dead += p * 0.02
    existence = alive_paths.sum() / (alive_paths.sum() + dead)
    local = tracker.density.local
    row = int(np.argmax(tracker.density.hypothesis_probability()))
    assert local.existence[row] == pytest.approx(existence, rel=1e-6)
    assert local.marks.detectable[row] == pytest.approx(
        alive_paths[1] / alive_paths.sum(), rel=1e-6
    )


def test_misses_in_a_run_say_less_and_less():
    chain = chained(0.95, undetectable=0.1, stay_detectable=0.95, stay_undetectable=0.8)
    lifetimes = {}
    for name, changes in {
        "plain": {"sensor.detection.probability": chain.of_undetected()},
        "chain": {"sensor.detection": chain},
    }.items():
        tracker = PMBMTracker(PMBMConfig.textbook().changed(changes))
        for k in range(10):
            tracker.step(frame(0.1 * k, [[5.0, 0.0]]))
        lifetimes[name] = 0
        while len(tracker.step(frame(1.0 + 0.1 * lifetimes[name], []))):
            lifetimes[name] += 1
    assert lifetimes["chain"] > lifetimes["plain"]


def test_classes_follow_bayes_rule():
    classes = ObjectClasses.simple(persistent_clutter=0.4, score=SCORES, mislabelled=0.12)
    told = {"scores": classes, "sensor.clutter_rate": 1e-9}
    tracker = PMBMTracker(PMBMConfig.textbook().changed(told))
    scores, labels = [0.9, 0.3, 0.7], [Label.CAR, Label.TRUCK, Label.CAR]
    for k, (score, label) in enumerate(zip(scores, labels, strict=True)):
        tracks = tracker.step(frame(0.1 * k, [[5.0, 0.0]], label=label, score=score))
    weight = classes.birth.copy()
    for score, label in zip(scores, labels, strict=True):
        ratio = np.exp(6 * score - 3)
        weight *= classes.confusion[:, label] * np.where(np.arange(14) < OBJECTS, ratio, 1.0)
    expected = weight / weight.sum()
    row = int(np.argmax(tracker.density.hypothesis_probability()))
    assert tracker.density.local.marks.source[row] == pytest.approx(expected, rel=1e-9)
    assert tracks.label.tolist() == [Label.CAR]
    assert tracks.score == pytest.approx(
        tracker.density.local.existence[row] * expected[:OBJECTS].sum(), rel=1e-5
    )


def test_poles_are_not_reported_as_cars():
    classes = ObjectClasses.simple(persistent_clutter=0.5, score=SCORES)
    told = PMBMConfig.textbook().changed({"scores": classes})
    plain = marked = (0, 0)
    for seed in range(4):
        truth, frames = traffic(seed, poles=4)
        plain = np.add(plain, errors(PMBMConfig.textbook(), truth, frames))
        marked = np.add(marked, errors(told, truth, frames))
    print(f"missed, false: plain {plain}, with persistent clutter {marked}")
    assert marked[1] < 0.2 * plain[1]
    assert marked[0] <= plain[0] + 10


def test_cars_are_kept_through_runs_of_misses():
    chain = chained(0.9, undetectable=0.02, stay_detectable=0.98, stay_undetectable=0.83)
    told = PMBMConfig.textbook().changed({"sensor.detection": chain})
    plain = marked = (0, 0)
    for seed in range(4):
        truth, frames = traffic(seed, burst=0.03)
        plain = np.add(plain, errors(PMBMConfig.textbook(), truth, frames))
        marked = np.add(marked, errors(told, truth, frames))
    print(f"missed, false: plain {plain}, with the chain {marked}")
    assert marked.sum() < 0.7 * plain.sum()


def test_marked_output_is_causal():
    truth, frames = traffic(3, poles=3, burst=0.03)
    config = PMBMConfig(scores=ObjectClasses.simple(persistent_clutter=0.3, score=SCORES))
    whole, part = PMBMTracker(config), PMBMTracker(config)
    expected = [whole.step(one) for one in frames]
    for one, tracks in zip(frames[:20], expected, strict=False):
        again = part.step(one)
        assert again.id.tolist() == tracks.id.tolist()
        assert again.position.tobytes() == tracks.position.tobytes()
    assert len(truth) == len(frames)


def test_impossible_marks_are_refused_by_name():
    good = {"undetectable": 0.1, "stay_detectable": 0.9, "stay_undetectable": 0.8}
    for bad in (
        {"undetectable": 1.2},
        {"stay_detectable": 1.0},
        {"stay_undetectable": 0.05},
        {"interval": 0},
    ):
        with pytest.raises(InputError) as caught:
            DetectionChain(**{**good, **bad})
        assert next(iter(bad)) in str(caught.value)
    with pytest.raises(InputError, match="birth"):
        ObjectClasses(
            birth=np.full(14, 0.2),
            confusion=np.full((14, 7), 1 / 7),
            clutter=np.full(7, 1 / 7),
            score=SCORES,
            persistent_score=SCORES,
        )
    with pytest.raises(InputError, match="scores"):
        PMBMConfig(scores="first")
    with pytest.raises(InputError, match="detection"):
        Sensor(detection=0.9)
