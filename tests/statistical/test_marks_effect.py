"""What each knob of the marks is worth where it should be: paired trials of a street with
persistent clutter, and of one where misses come in runs."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mark_builders import chained, fit_logistic
from scipy import stats

from pmbm.filter import (
    EveryScore,
    FixedDetection,
    IgnoreScores,
    LastingScores,
    ObjectClasses,
    PMBMConfig,
    PMBMTracker,
    Report,
    Sensor,
)
from pmbm.metrics import evaluate
from pmbm.score import ScoreModel
from pmbm.sim import load_scenario
from pmbm.tracking import run
from pmbm.types import CLUTTER

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
TRIALS = int(os.environ.get("PMBM_MARKS_TRIALS", "10"))
FITTED_ON, MEASURED_ON = 101, 102
"""Seeds of development: of the score model, and of the trials."""
METRICS = ["gospa", "gospa_missed", "gospa_false"]
CHAIN = {"undetectable": 0.1, "stay_detectable": 0.97, "stay_undetectable": 0.8}


def scores_of(scene):
    """What the scores of a scene's detections say, fitted on trials that are not measured on."""
    recordings = [scene.record(FITTED_ON, trial) for trial in range(3)]
    score = np.concatenate([one.score for each in recordings for one in each.detections])
    origin = np.concatenate([rows for each in recordings for rows in each.origin])
    return fit_logistic(score, origin != CLUTTER)


def measured(scene, configs):
    """Of each configuration, its scores (TRIALS, metrics); all see the same recordings."""
    found = {name: [] for name in configs}
    for trial in range(TRIALS):
        recording = scene.record(MEASURED_ON, trial)
        for name, config in configs.items():
            tracks = run(PMBMTracker(config, recording.site), recording)
            scalars = evaluate(recording, tracks, METRICS).scalars()
            found[name].append([scalars[metric] for metric in METRICS])
    return {name: np.array(rows, float) for name, rows in found.items()}


def table(title, found, plain, verified):
    """Print every configuration beside the plain one; GOSPA's paired differences are returned."""
    print(f"\n{title}: mean of {TRIALS} trials, difference from '{plain}' with its 95 % interval")
    differences = {}
    for name, rows in found.items():
        gain = rows[:, 0] - found[plain][:, 0]
        half = stats.t.ppf(0.975, TRIALS - 1) * gain.std(ddof=1) / np.sqrt(TRIALS)
        differences[name] = gain.mean(), half
        gospa, missed, false = rows.mean(axis=0)
        print(
            f"  {name:32} GOSPA {gospa:6.3f}  missed {missed:6.3f}  false {false:6.3f}"
            f"  {gain.mean():+7.3f} +- {half:.3f}"
        )
        if name != plain:
            figure = f"{gain.mean():+.3f} +- {half:.3f}"
            verified("marks", f"{title}, {name}: GOSPA against {plain}", figure)
    return differences


def test_what_kinds_are_worth_in_persistent_clutter(verified):
    scene = load_scenario(HERE / "street_of_poles.toml")
    score = scores_of(scene)
    base = PMBMConfig(scores=EveryScore(score_model=score), report=Report(exclusive=False))

    def classes(**changes):
        given = {"persistent_clutter": 0.4, "score": score, **changes}
        return replace(base, scores=ObjectClasses.simple(**given))

    halfway = ScoreModel(knot=score.knot, log_odds=0.5 * score.log_odds, base_rate=0.5)
    configs = {
        "scores alone": base,
        "no scores": replace(base, scores=IgnoreScores()),
        "scores that last": replace(base, scores=LastingScores(calibration=score)),
        "neutral kinds": classes(
            persistent_clutter=0.0, score=ScoreModel.uninformative(), mislabelled=6 / 7
        ),
        "ghosts .4": classes(),
        "ghosts 0": classes(persistent_clutter=0.0),
        "ghosts .1": classes(persistent_clutter=0.1),
        "ghosts .7": classes(persistent_clutter=0.7),
        "ghosts .4, mislabelled .2": classes(mislabelled=0.2),
        "ghosts .4, ghosts score higher": classes(persistent_score=halfway),
    }
    found = measured(scene, configs)
    differences = table("persistent clutter", found, "scores alone", verified)
    np.testing.assert_allclose(found["neutral kinds"], found["no scores"], rtol=1e-9, atol=1e-9)
    mean, half = differences["ghosts .4"]
    assert mean + half < 0


def test_what_the_chain_of_being_seen_is_worth_in_runs_of_misses(verified):
    scene = load_scenario(HERE / "street_of_bursts.toml")
    base = PMBMConfig(
        sensor=Sensor(detection=FixedDetection(probability=0.8)),
        scores=EveryScore(),
        report=Report(exclusive=False),
    )

    def chain(P_D=0.95, **changes):
        return base.changed({"sensor.detection": chained(P_D, **{**CHAIN, **changes})})

    configs = {
        "independent misses": base,
        "neutral chain": chain(P_D=0.8, undetectable=1.0),
        "the default's chain": chain(),
        "unseen .02": chain(undetectable=0.02),
        "unseen .3": chain(undetectable=0.3),
        "stay_seen .9": chain(stay_detectable=0.9),
        "stay_seen .99": chain(stay_detectable=0.99),
        "stay_unseen .5": chain(stay_undetectable=0.5),
        "stay_unseen .95": chain(stay_undetectable=0.95),
    }
    found = measured(scene, configs)
    differences = table("runs of misses", found, "independent misses", verified)
    np.testing.assert_allclose(
        found["neutral chain"], found["independent misses"], rtol=1e-9, atol=1e-9
    )
    mean, half = differences["the default's chain"]
    assert mean + half < 0
