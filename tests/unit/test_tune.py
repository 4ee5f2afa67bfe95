"""Tuning finds what is better, is repeatable, and keeps its hands off what is reported on."""

import dataclasses
import math
import re
import shutil
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from pmbm.baselines import fit_statistics
from pmbm.cli import main
from pmbm.cli.fitting import fitted_tracker
from pmbm.cli.sources import resolve
from pmbm.cli.track import class_trackers
from pmbm.cli.tune import present_values
from pmbm.cli.tuning import Simulated
from pmbm.datasets import open_dataset
from pmbm.errors import InputError
from pmbm.filter import ObjectClasses, PMBMConfig, ScoreRecord
from pmbm.score import ScoreModel
from pmbm.sim.toml_tables import toml_text
from pmbm.study import ConfiguredTracker, run_trials, summarise
from pmbm.study.file import load_study
from pmbm.tune import (
    FIRST_HELD_BACK_SEED,
    FIRST_REPORTING_SEED,
    SPACES,
    Choice,
    Range,
    parse_space,
    refuse_reserved_seed,
    tune,
)
from pmbm.types import CLUTTER, Label, Site

SAMPLE = Path(__file__).parents[1] / "data" / "kitti"
BOWL = {"x": Range(-10.0, 10.0), "y": Range(0.01, 100.0, log=True)}
MIXED = {
    "x": Range(0.0, 1.0),
    "rate": Range(0.001, 10.0, log=True),
    "hits": Range(1, 5, whole=True),
    "rule": Choice(("off", [1, 2], None)),
}


def bowl(parameters):
    """Least, 0, at x = 3 and y = 1; 34 with the defaults, x = -2 and y = 1000."""
    p = {"x": -2.0, "y": 1000.0, **parameters}
    return (p["x"] - 3.0) ** 2 + math.log10(p["y"]) ** 2


def of_everything(parameters):
    if not parameters:
        return 9.0
    return parameters["x"] + parameters["hits"] + (parameters["rule"] is None)


def test_the_optimum_is_found():
    tuned = tune(bowl, BOWL, trials=80, seed=1)
    assert tuned.parameters["x"] == pytest.approx(3.0, abs=0.5)
    assert tuned.parameters["y"] == pytest.approx(1.0, rel=0.6)
    assert tuned.value == bowl(tuned.parameters) == min(a.value for a in tuned.attempts)
    assert tune(lambda p: -bowl(p), BOWL, trials=80, seed=1, maximise=True).value == -tuned.value


def test_the_defaults_come_first_and_are_the_value_to_beat():
    seen = []
    tuned = tune(lambda p: seen.append(dict(p)) or bowl(p), BOWL, trials=5, seed=1)
    assert len(seen) == len(tuned.attempts) == 5
    assert seen[0] == {}
    assert tuned.attempts[0].value == tuned.default_value == bowl({})
    flat = tune(lambda p: 1.0, BOWL, trials=5, seed=1)
    assert (dict(flat.parameters), flat.value) == ({}, 1.0)


def test_equal_seeds_give_equal_searches():
    first, again, other = (
        tune(of_everything, MIXED, trials=25, seed=seed).attempts for seed in (3, 3, 4)
    )
    assert first == again
    assert first != other


def test_the_search_learns_from_defaults_that_lie_in_the_space():
    def attempts(**defaults):
        return tune(bowl, BOWL, trials=30, seed=3, defaults=defaults).attempts

    assert attempts(x=2.9, y=1.1) != attempts()
    assert attempts(x=2.9, y=1000.0) == attempts()


def test_bounds_and_kinds_are_respected():
    for attempt in tune(of_everything, MIXED, trials=60, seed=1).attempts[1:]:
        assert all(attempt.parameters[name] in place for name, place in MIXED.items())
        assert isinstance(attempt.parameters["hits"], int)
    assert Range(0.123454, 0.2).rounded(0.1234541) == 0.123454
    assert Range(0.05, 1.5, log=True).rounded(0.0731239) == 0.07312
    assert Range(0.0, 0.9).rounded(0.4567891) == 0.4568


def test_an_undefined_value_is_never_the_best():
    tuned = tune(lambda p: bowl(p) if p.get("x", 9) > 0 else None, BOWL, trials=40, seed=2)
    assert None in [attempt.value for attempt in tuned.attempts]
    assert tuned.parameters["x"] > 0
    with pytest.raises(InputError, match="undefined with the default parameters"):
        tune(lambda p: float("nan"), BOWL, trials=3, seed=2)


def test_without_optuna_it_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(InputError, match=r"pip install 'pmbm\[tune\]'"):
        tune(bowl, BOWL, trials=3, seed=1)


def test_what_is_kept_for_reporting_is_refused():
    refuse_reserved_seed(FIRST_HELD_BACK_SEED - 1)
    for seed in (FIRST_HELD_BACK_SEED, FIRST_REPORTING_SEED - 1):
        with pytest.raises(InputError, match="held back"):
            refuse_reserved_seed(seed)
    with pytest.raises(InputError, match="kept for reporting"):
        refuse_reserved_seed(20_000_000)


@pytest.mark.parametrize("name", SPACES)
def test_a_shipped_space_holds_the_shipped_defaults(name):
    space = SPACES[name]
    present = present_values(ConfiguredTracker(name), space)
    assert all(present[parameter] in place for parameter, place in space.items())
    for bound in ("low", "high"):
        ends = {parameter: getattr(place, bound) for parameter, place in space.items()}
        ConfiguredTracker(name, tuple(ends.items()))(Site())


def test_a_space_is_read_from_a_file():
    text = "a = [true, 2]\nb = { low = 1, high = 3, whole = true }\nc = { low = 0.1, high = 2 }"
    assert parse_space(tomllib.loads(text)) == {
        "a": Choice((True, 2)),
        "b": Range(1, 3, whole=True),
        "c": Range(0.1, 2),
    }


BAD_SPACES = [
    ("sensor.cluter_rate = [1.0, 2.0]", "has no 'cluter_rate'.*did you mean 'clutter_rate'"),
    ("clutter_rate = [1.0, 2.0]", "has no 'clutter_rate'.*it is now sensor.clutter_rate"),
    (
        "[reduction]\ngate = { low = 1.0, hihg = 2.0 }",
        "unknown key.*gate.hihg.*did you mean 'high'",
    ),
    ("reduction.gate = { low = 1.0 }", "missing key.*reduction.gate.high"),
    ("reduction.gate = 3.0", "field reduction.gate.*expected .*low.*got 3.0"),
    ("reduction.gate = [3.0]", "field reduction.gate.*two values"),
    ("reduction.gate = { low = 3.0, high = 3.0 }", "gate.high.*above 3, got 3.0"),
    ("reduction.gate = { low = 0.0, high = 3.0, log = true }", "gate.low.*above 0.*got 0.0"),
    ("reduction.gate = { low = 1.0, high = nan }", "gate.high.*finite number, got nan"),
    ("reduction.gate = { low = 1, high = 2, log = 1 }", "gate.log.*true or false, got 1"),
    (
        "reduction.max_hypotheses = { low = 1.5, high = 3, whole = true }",
        "low.*whole number, got 1.5",
    ),
    (
        "survival.probability = { low = 0.9, high = 1.2 }",
        "survival.probability.*at least 0 and at most 1, got 1.2",
    ),
    ('scores.kind = ["first", "evrywhere"]', "scores.kind.*did you mean 'every'"),
    ("", "nothing to tune"),
    ("= 3", "not valid TOML"),
]


def pmbm(*arguments):
    """The exit code."""
    with pytest.raises(SystemExit) as stop:
        main(["tune", *map(str, arguments)])
    return stop.value.code


def refusal(capsys, *arguments):
    assert pmbm(*arguments) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith("pmbm: ")
    return line


@pytest.fixture
def scene(tmp_path):
    """A car for two seconds among ten times as much clutter as the tracker takes for granted."""
    scenario = resolve("single_straight", {"duration": 2.0, "detector.clutter.rate": 20.0})
    file = tmp_path / "brief_car.toml"
    file.write_text(toml_text({**scenario.document, "name": "brief_car"}))
    return file


@pytest.mark.parametrize(("text", "message"), BAD_SPACES)
def test_bad_spaces(scene, tmp_path, capsys, monkeypatch, text, message):
    # The space is judged before recordings are made.
    monkeypatch.setattr(Simulated, "of", lambda *a, **k: pytest.fail("recorded"))
    space = tmp_path / "space.toml"
    space.write_text(text)
    found = refusal(capsys, scene, "--space", space, "--recordings", 1)
    assert re.search(message, found), found
    assert "space.toml" in found


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((), "scenarios or on a dataset"),
        (("crossing", "--dataset", "kitti"), "scenarios or on a dataset"),
        (("crossing", "--seed", 20_000_000), "kept for reporting"),
        (("crossing", "--class", "Car"), "for a dataset only.*--class"),
        (("--dataset", "kitti", "--held-back", 4), "for scenarios only.*--held-back"),
        (("crossin",), "did you mean 'crossing'"),
        (("crossing", "--metric", "gopsa"), "did you mean 'gospa'"),
        (("crossing", "--tracker", "pmbn"), "did you mean 'pmbm'"),
        (("crossing", "--tracker", "pmbm.filter:PMBMTracker"), "expected a file"),
        (("--dataset", "kitti", "--root", "."), "missing option.*--class"),
    ],
)
def test_bad_arguments(capsys, arguments, message):
    found = refusal(capsys, *arguments)
    assert re.search(message, found), found


def test_the_file_is_one_that_track_and_studies_take(scene, tmp_path, capsys):
    space = tmp_path / "space.toml"
    space.write_text(
        "sensor.clutter_rate = { low = 15.0, high = 30.0 }\nreduction.max_hypotheses = [10, 50]"
    )
    config, out = tmp_path / "config.toml", tmp_path / "new" / "tuned.toml"
    config.write_text(
        "reduction.gate = 18.0\nsensor.clutter_rate = 300.0\n[sensor.detection]\n"
        "undetectable = 0.2\nstay_detectable = 0.9\nstay_undetectable = 0.6"
    )
    options = ("--space", space, "--config", config, "--recordings", 1, "--trials", 3)
    assert pmbm(scene, *options, "--held-back", 2, "--out", out) == 0
    shown, text = capsys.readouterr().out, out.read_text()
    values = tomllib.loads(text)
    assert 15 <= values["sensor"]["clutter_rate"] <= 30
    assert values["reduction"]["max_hypotheses"] in (10, 50)
    assert values["reduction"]["gate"] == 18.0
    for said in ("best of 3", "gospa on brief_car", "seed 1)", "held-back", "seed 10000001"):
        assert said in text
    assert "tuned - default" in shown
    assert shown.endswith(f"{out}\n")

    dataset = open_dataset("kitti", root=tmp_path, classes=("Car",))
    tracked = class_trackers(dataset, "pmbm", out)[Label.CAR](Site())
    study = tmp_path / "study.toml"
    study.write_text(
        'scenarios = ["brief_car.toml"]\ntrackers = ["tuned"]\n'
        f'[tracker.tuned]\nfactory = "pmbm"\nconfig = "{out}"\n'
    )
    studied = load_study(study, resolve).cells[0].trackers["tuned"](Site())
    assert isinstance(tracked.config, PMBMConfig)
    assert tracked.config == studied.config
    assert tracked.config.sensor.clutter_rate == values["sensor"]["clutter_rate"]
    assert tracked.config.sensor.detection.undetectable == 0.2

    # Without a file to write, the same goes to standard output, and nothing else does.
    assert pmbm(scene, *options, "--held-back", 2) == 0
    assert tomllib.loads(capsys.readouterr().out) == values


def test_noise_is_fitted_to_what_is_tuned_on(scene, tmp_path, capsys):
    out = tmp_path / "kf.toml"
    options = ("--recordings", 2, "--trials", 2, "--held-back", 2, "--fit", "--out", out)
    assert pmbm(scene, "--tracker", "probabilistic_kf", *options) == 0
    noise = tomllib.loads(out.read_text())["noise"]
    source = resolve(str(scene), {})
    fitted = fit_statistics([source.record(1, trial) for trial in range(2)])
    assert set(noise) == {label.name for label in fitted} == {"CAR"}
    for part, values in noise["CAR"].items():
        assert values == pytest.approx(getattr(fitted[Label.CAR], part), rel=1e-3, abs=1e-12)
    dataset = open_dataset("kitti", root=tmp_path, classes=("Car",))
    tracked = class_trackers(dataset, "probabilistic_kf", out)[Label.CAR](Site())
    assert tracked.config.noise_of(Label.CAR).measurement.tolist() == noise["CAR"]["measurement"]
    capsys.readouterr()
    found = refusal(capsys, scene, "--tracker", "argoverse", "--fit")
    assert "nothing of 'argoverse' can be fitted" in found


def test_what_scores_say_is_fitted_to_what_is_tuned_on(scene):
    source = resolve(str(scene), {})
    recordings = [source.record(1, trial) for trial in range(3)]
    tracker = fitted_tracker(ConfiguredTracker("pmbm", (("reduction.gate", 18.0),)), recordings)
    config = tracker(Site()).config
    assert config.reduction.gate == 18.0
    assert isinstance(config.scores, ObjectClasses)
    score = np.concatenate([d.score for r in recordings for d in r.detections])
    true = np.concatenate([o != CLUTTER for r in recordings for o in r.origin])
    model = ScoreModel.fit_isotonic(score, true)
    np.testing.assert_allclose(config.scores.score.log_odds, model.log_odds, rtol=1e-4)
    assert 0 < config.scores.birth[-1] < config.scores.birth[0]
    # What it says goes through a file.
    again = tomllib.loads(toml_text(dict(tracker.parameters)))
    assert ConfiguredTracker("pmbm", tuple(again.items()))(Site()).config.scores.score.scale
    with pytest.raises(InputError, match="origin"):
        fitted_tracker(tracker, [dataclasses.replace(recordings[0], origin=None)])


def test_gains_are_those_of_a_study_on_the_same_trials(scene):
    source = resolve(str(scene), {})
    default = ConfiguredTracker("pmbm")
    tuned = ConfiguredTracker("pmbm", (("sensor.clutter_rate", 20.0),))
    ((name, before, after, gain),) = Simulated.of([source], default, "gospa", 7, 3).gains(tuned)
    trackers = {"default": default, "tuned": tuned}
    summary = summarise(run_trials(source, trackers, 7, 3, metrics=["gospa"]))
    assert name == "brief_car"
    assert before == summary.estimates["default"]["gospa"]
    assert after == summary.estimates["tuned"]["gospa"]
    assert gain == summary.differences["tuned"]["gospa"]


def test_several_scenarios_are_compared_by_their_mean(scene):
    source = resolve(str(scene), {})
    other = resolve(str(scene), {"detector.clutter.rate": 0.0})
    default = ConfiguredTracker("pmbm")
    tuned = ConfiguredTracker("pmbm", (("sensor.clutter_rate", 20.0),))
    problem = Simulated.of([source, other], default, "gospa", 7, 2)
    one, two, mean = problem.gains(tuned)
    assert mean[0] == "mean of all"
    assert mean[3].mean == pytest.approx((one[3].mean + two[3].mean) / 2)
    assert mean[3].n == 2
    assert problem.value(tuned) == pytest.approx(mean[2].mean)


@pytest.fixture
def folder(tmp_path):
    """The KITTI sample over eight frames, with car detections."""
    root = tmp_path / "kitti"
    shutil.copytree(SAMPLE / "training", root)
    row = (SAMPLE / "detections_ab3dmot" / "0000.txt").read_text().splitlines()[0].split(",")
    (root / "dets").mkdir()
    rows = [",".join([str(k), "2", *row[2:]]) for k in range(8)]
    (root / "dets" / "0000.txt").write_text("\n".join(rows) + "\n")
    return root


@pytest.mark.parametrize("mode", ["online", "batch"])
def test_a_dataset_is_tuned_by_its_own_rule(folder, tmp_path, capsys, mode):
    out = tmp_path / "car.toml"
    given = ("--dataset", "kitti", "--root", folder, "--detections", folder / "dets")
    what = ("--class", "Car", "--metric", "MOTA", "--mode", mode, "--trials", 3)
    assert pmbm(*given, *what, "--sequences", "0000", "--out", out) == 0
    shown = capsys.readouterr().out
    assert "MOTA on kitti Car, 3D IoU of at least .25" in shown
    dataset = open_dataset("kitti", root=folder, classes=("Car",))
    tracker = class_trackers(dataset, "pmbm", out)[Label.CAR](Site())
    # What ships for this dataset and class is what there is to beat, and stays where not tuned.
    assert isinstance(tracker.config.scores, ScoreRecord)
    assert tracker.config.scores.label == Label.CAR
    found = refusal(capsys, *given, "--class", "Car", "--metric", "HOTTA")
    assert "did you mean 'HOTA'" in found
    assert "neither more nor less" in refusal(capsys, *given, "--class", "Car", "--metric", "GT")


@pytest.mark.slow
def test_tuned_parameters_beat_wrong_defaults_on_held_back_seeds():
    """The detector gives ten times the clutter that the default parameters assume; what is found on
    four recordings is significantly better on twenty others, by the paired interval."""
    rate = 10 * PMBMConfig().sensor.clutter_rate
    source = resolve("crossing", {"detector.clutter.rate": rate, "duration": 6.0})
    default = ConfiguredTracker("pmbm")
    problem = Simulated.of([source], default, "gospa", 1, 4)
    space = {name: SPACES["pmbm"][name] for name in ("sensor.clutter_rate", "sensor.position_sd")}
    tuned = tune(
        lambda p: problem.value(ConfiguredTracker("pmbm", tuple(p.items()))),
        space,
        trials=25,
        seed=1,
        defaults=present_values(default, space),
    )
    assert tuned.parameters["sensor.clutter_rate"] > 2 * PMBMConfig().sensor.clutter_rate
    held = Simulated.of([source], default, "gospa", 1 + FIRST_HELD_BACK_SEED, 20)
    ((_, before, after, gain),) = held.gains(
        ConfiguredTracker("pmbm", tuple(tuned.parameters.items()))
    )
    assert gain.n == 20
    assert gain.high < 0, (before.mean, after.mean, gain)
    # Half of what it gained where it was found is left.
    assert gain.mean < (tuned.value - tuned.default_value) / 2
