"""The gate on trackers whose loss is known; stored baselines; what is printed."""

import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import pytest
from gate_worlds_small import Breaks, OneCar, Shifted, exact, metre_off

from pmbm.errors import BaselineMismatch, InputError
from pmbm.regression import GateEntry, Rules, Verdict, gated_metric, load_baseline, run_gate
from pmbm.regression.stored import StoredBaseline
from pmbm.regression.wording import Commands, github, in_words, junit

METRIC = gated_metric("ospa", [0.0, 2.0])
RULES = Rules(margin=0.5, alpha=0.05, rarest=0.2, max_trials=40)
COMMANDS = Commands(lambda name, trial: f"show {name} {trial}", "pmbm gate scene --accept")


def gate(candidate, baseline=exact, rules=RULES, **options):
    entries = {"scene": GateEntry(OneCar(), baseline, candidate)}
    return run_gate(entries, options.pop("metric", METRIC), rules, **options)


def stored(values=None, **changes):
    """The exact tracker's values over 40 trials, or `values`."""
    source = OneCar()
    trials = tuple((source.record(0, t).digest(), 0.0) for t in range(40))
    whole = StoredBaseline(
        metric="ospa",
        bounds=(0.0, 2.0),
        seed=0,
        tracker="exact",
        code="",
        scenarios={"scene": trials},
        accept="pytest --pmbm-update-baselines",
    )
    return replace(whole, **changes)


def test_the_same_tracker_passes_after_the_least_trials():
    report = gate(exact)
    assert report.verdict is Verdict.PASS
    assert report.scenes[0].decision.trials == 14
    assert report.scenes[0].decision.equal


def test_a_metre_of_error_fails_and_the_worst_trial_is_named():
    report = gate(metre_off)
    scene = report.scenes[0]
    assert report.verdict is Verdict.FAIL
    assert scene.decision.loss == pytest.approx(1.0, abs=0.1)
    values = [METRIC_value(trial) for trial in range(scene.decision.trials)]
    assert scene.values == pytest.approx(values)
    assert values[scene.worst] == max(values)
    assert scene.alongside["gospa"][0] == 0.0 < scene.alongside["gospa"][1]


def METRIC_value(trial):
    """The error of `metre_off` in a trial, by hand."""
    x = OneCar().record(0, trial).truth[0].position[0, 0]
    return abs(metre_off().step(OneCar().record(0, trial).detections[0]).position[0, 0] - x)


def test_too_few_trials_are_undecided():
    report = gate(exact, rules=replace(RULES, max_trials=13))
    assert report.verdict is Verdict.UNDECIDED
    assert "needs at least 14 trials" in in_words(report, COMMANDS)


def test_the_report_does_not_depend_on_processes():
    rules = Rules(margin=0.5, alpha=0.05, rarest=0.2, max_trials=20)
    entries = {
        name: GateEntry(OneCar(name), exact, candidate)
        for name, candidate in (("same", exact), ("worse", metre_off), ("breaks", Breaks))
    }
    serial = run_gate(entries, METRIC, rules)
    assert [scene.verdict for scene in serial.scenes] == [Verdict.PASS, Verdict.FAIL, Verdict.FAIL]
    assert run_gate(entries, METRIC, rules, jobs=2) == serial


def test_two_scenarios_share_alpha():
    entries = {
        "a": GateEntry(OneCar("a"), exact, exact),
        "b": GateEntry(OneCar("b"), exact, metre_off),
    }
    report = run_gate(entries, METRIC, RULES)
    assert report.verdict is Verdict.FAIL
    passed, failed = report.scenes
    assert (passed.verdict, failed.verdict) == (Verdict.PASS, Verdict.FAIL)
    assert passed.decision.trials == 17, "alpha / 2 needs log(.025) / log(.8) trials"
    assert len(failed.values) == failed.decision.trials < 17, "a decided scenario stops"


def test_a_candidate_that_raises_fails():
    report = gate(Breaks)
    scene = report.scenes[0]
    assert report.verdict is Verdict.FAIL
    assert "RuntimeError: lost my way" in scene.error
    assert OneCar().record(0, scene.worst).truth[0].position[0, 0] > 21.0
    text = in_words(report, COMMANDS)
    assert f"the candidate raised in trial {scene.worst}" in text
    assert f"show scene {scene.worst}" in text


def test_a_baseline_that_raises_is_no_verdict():
    with pytest.raises(InputError, match="the baseline raised RuntimeError in trial"):
        gate(exact, baseline=Breaks)


def test_stored_values_stand_in_for_the_baseline():
    assert gate(metre_off, baseline=stored()).verdict is Verdict.FAIL
    beside, alone = gate(metre_off), gate(metre_off, baseline=stored())
    assert beside.scenes[0].decision == alone.scenes[0].decision


def test_stored_values_of_another_world_are_refused():
    other = replace(stored(), scenarios={"scene": (("0" * 64, 0.0),) * 150})
    with pytest.raises(BaselineMismatch, match=r"another recording.*--pmbm-update-baselines"):
        gate(exact, baseline=other)
    with pytest.raises(BaselineMismatch, match=r"no stored baseline.*did you mean 'scene'"):
        run_gate({"scen": GateEntry(OneCar(), stored(), exact)}, METRIC, RULES)
    with pytest.raises(BaselineMismatch, match="seed is 0, not 5"):
        stored().check(METRIC, 5)
    with pytest.raises(BaselineMismatch, match="metric is ospa, not gospa"):
        stored().check(gated_metric("gospa"), 0)


def test_fewer_stored_trials_than_needed_are_undecided():
    short = replace(stored(), scenarios={"scene": stored().scenarios["scene"][:13]})
    assert gate(exact, baseline=short).verdict is Verdict.UNDECIDED


def test_a_baseline_file_gives_back_the_same_bits(tmp_path):
    file = tmp_path / "deep" / "baseline.json"
    trials = (("ab" * 32, 0.1 + 0.2), ("cd" * 32, 1e-300))
    stored(scenarios={"scene": trials}).write(file)
    back = load_baseline(file)
    assert [v for _, v in back.scenarios["scene"]] == [0.1 + 0.2, 1e-300]
    assert back.value("scene", 0, "ab" * 32) == 0.1 + 0.2
    assert file.read_text().count("\n") < 45
    before = file.read_bytes()
    back.write(file)
    assert file.read_bytes() == before


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"schema": 99}', "\x00", '{"schema": 1, "bounds": 3}']
)
def test_a_damaged_baseline_file_is_named(tmp_path, text):
    file = tmp_path / "baseline.json"
    file.write_text(text)
    with pytest.raises(InputError, match=r"not a stored baseline.*baseline\.json"):
        load_baseline(file)


def test_a_missing_baseline_says_how_to_make_one(tmp_path):
    with pytest.raises(BaselineMismatch, match="store one: do this"):
        load_baseline(tmp_path / "none.json", accept="do this")


def test_a_red_gate_says_all_that_helps():
    report = gate(metre_off)
    scene = report.scenes[0]
    text = in_words(report, COMMANDS)
    first = text.splitlines()[0]
    assert re.fullmatch(
        r"fail  scene: ospa 0 -> 1\.0\d+, loss \+1\.\d+ in \[0\.\d+, \d\.\d+\], margin 0\.5, "
        rf"{scene.decision.trials} trials",
        first,
    )
    worst = f"trial {scene.worst} (loss {scene.worst_loss:.4g}): show scene {scene.worst}"
    assert f"worst is {worst}" in text
    assert f"accept the change: {COMMANDS.accept}" in text
    assert text.splitlines()[-1] == "fail: 1 fail"


def test_a_pass_says_what_it_cannot_exclude():
    text = in_words(gate(exact), COMMANDS)
    assert "disasters in less than 19 % of trials are not excluded" in text
    assert "all values are equal" in text
    assert "accept" not in text


def test_a_metric_that_is_better_higher_reads_as_people_know_it():
    report = gate(Shifted, baseline=metre_off, metric=gated_metric("recall"))
    assert "recall 1 -> 1" in in_words(report, COMMANDS)


def test_junit_counts_every_verdict():
    entries = {
        "good <&>": GateEntry(OneCar("a"), exact, exact),
        "bad": GateEntry(OneCar("b"), exact, metre_off),
    }
    report = run_gate(entries, METRIC, RULES)
    suite = ElementTree.fromstring(junit(report, COMMANDS, "night")).find("testsuite")
    assert [suite.get(key) for key in ("tests", "failures", "errors", "skipped")] == list("2100")
    cases = {case.get("name"): case for case in suite}
    assert "loss" in cases["bad"].find("failure").get("message")
    assert cases["good <&>"].find("failure") is None
    undecided = gate(exact, rules=replace(RULES, max_trials=5))
    suite = ElementTree.fromstring(junit(undecided, COMMANDS, "night")).find("testsuite")
    assert suite.get("skipped") == "1"


def test_github_annotations_stay_on_one_line_each():
    lines = github(gate(metre_off), COMMANDS).splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("::error title=pmbm gate%3A scene fail::fail  scene")
    assert "%0A" in lines[0]
    assert github(gate(exact), COMMANDS).startswith("::notice ")


def test_the_document_is_json_and_begins_with_what_a_person_reads(tmp_path):
    file = tmp_path / "b.json"
    stored().write(file)
    document = json.loads(file.read_text())
    assert list(document)[:4] == ["schema", "metric", "tracker", "scenarios"]
    assert list(document)[-1] == "trials"
    assert {"versions", "platform"} == set(document["provenance"])
