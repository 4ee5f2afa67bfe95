"""`pmbm gate` as a user calls it: exit codes, outputs, stored baselines, commits."""

import json
import re
import shlex
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import pytest

from pmbm.cli import main

SCENARIO = """
name = "parked"
stresses = "Nothing at all: one parked car in plain sight."
duration = 0.6
rate = 5
[scene]
kind = "scripted"
[scene.tracks.car]
start = [20.0, 0.0]
jitter = { x = 5.0, y = 5.0 }
[detector]
profile = "perfect"
"""

TRACKER = """
import numpy as np
from pmbm.types import Tracks


class Mine:
    shift = {shift}

    def step(self, detections):
        n = len(detections)
        return Tracks(time=detections.time, id=np.arange(n),
                      position=detections.position + np.array([self.shift, 0.0, 0.0]),
                      size=detections.size, yaw=detections.yaw, velocity=np.zeros((n, 2)),
                      score=detections.score, label=detections.label)


class Worse(Mine):
    shift = 1.5
"""

STUDY = """
scenarios = ["parked.toml"]
trackers = ["mine_gated:Mine", "mine_gated:Worse"]

[gate]
metric = "ospa"
bounds = [0.0, 2.0]
margin = 0.5
alpha = 0.05
rarest = 0.2
max_trials = 20
"""


def git(folder, *arguments):
    settings = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *settings, *arguments], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "parked.toml").write_text(SCENARIO)
    (tmp_path / "night.toml").write_text(STUDY)
    (tmp_path / "mine_gated.py").write_text(TRACKER.format(shift=0.0))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "mine_gated", raising=False)
    monkeypatch.delenv("GITHUB_ACTIONS", raising=False)
    return tmp_path


def pmbm(capsys, *arguments):
    """Exit code, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as stop:
        main(list(arguments))
    said = capsys.readouterr()
    return stop.value.code, said.out, said.err


def test_pass_fail_and_undecided_are_0_1_and_3(folder, capsys):
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--against", "mine_gated:Mine")
    assert (code, out.splitlines()[-1]) == (0, "pass: 1 pass")
    code, out, _ = pmbm(
        capsys,
        "gate",
        "night.toml",
        "--against",
        "mine_gated:Mine",
        "--tracker",
        "mine_gated:Worse",
    )
    assert (code, out.splitlines()[-1]) == (1, "fail: 1 fail")
    # Beside another tracker there is no change to accept.
    assert "accept" not in out
    code, out, _ = pmbm(
        capsys, "gate", "night.toml", "--against", "mine_gated:Mine", "--max-trials", "5"
    )
    assert (code, out.splitlines()[-1]) == (3, "undecided: 1 undecided")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nigth.toml", "--against", "pmbm"], "nigth.toml"),
        (["night.toml", "--against", "no-such-ref"], "git"),
        (["night.toml", "--tracker", "nobody", "--against", "pmbm"], "no tracker 'nobody'"),
        (["night.toml", "--margin", "-1", "--against", "pmbm"], "margin"),
        (["night.toml", "--metric", "opsa", "--against", "pmbm"], "did you mean 'ospa'"),
        (["parked.toml", "--against", "pmbm"], "unknown key"),
        (["crossing", "--against", "argoverse"], "say --margin"),
        (["crosing", "--against", "argoverse", "--margin", "1"], "did you mean 'crossing'"),
        (["night.toml"], "no stored baseline"),
        (["night.toml", "--bisect", "HEAD"], "GOOD..BAD"),
        (["night.toml", "--bisect=--output=stolen..HEAD"], "no dash in front"),
        (["night.toml", "--bisect=HEAD..--output=stolen"], "no dash in front"),
        (["night.toml", "--against=--output=stolen"], "no dash in front"),
    ],
)
def test_bad_input_is_one_line_and_2(folder, capsys, arguments, words):
    code, out, err = pmbm(capsys, "gate", *arguments)
    assert code == 2, err
    assert out == ""
    assert words in err
    assert err.count("\n") == 1
    assert err.startswith("pmbm: ")
    assert not list(Path.cwd().glob("stolen*"))


def test_reports_for_machines(folder, capsys):
    arguments = ["--against", "mine_gated:Mine", "--junit", "gate.xml", "--github"]
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--tracker", "mine_gated:Worse", *arguments)
    assert code == 1
    assert "::error title=pmbm gate" in out
    suite = ElementTree.parse(folder / "gate.xml").getroot().find("testsuite")
    assert suite.get("failures") == "1"


REPLAY = r"worst is trial (\d+)[^:]*: (pmbm gate .*)"


@pytest.mark.parametrize(
    "arguments",
    [
        # Seven trials are looked at; the study plans one.
        ("night.toml", "--against", "mine_gated:Mine", "--tracker", "mine_gated:Worse"),
        ("night.toml", "--against", "mine_gated:Mine", "--tracker", "mine_gated:Worse", "--seed=4"),
        ("night.toml", "--against", "mine_gated:Mine", "--tracker", "mine_gated:Raises"),
        ("parked.toml", "--against", "mine_gated:Mine", "--tracker", "mine_gated:Worse"),
    ],
)
def test_the_printed_replay_shows_the_trial(folder, capsys, arguments):
    if arguments[0] == "parked.toml":
        # A second cell, so that an index is not a trial.
        text = (folder / "night.toml").read_text()
        (folder / "night.toml").write_text(text + "[sweep.grid]\nduration = [0.4, 0.6]\n")
        arguments = ("night.toml", *arguments[1:])
    (folder / "mine_gated.py").write_text(TRACKER.format(shift=0.0) + RAISES)
    code, out, err = pmbm(capsys, "gate", *arguments)
    assert code == 1, err
    seed = 4 if "--seed=4" in arguments else 0
    for trial, command in re.findall(REPLAY, out):
        assert pmbm(capsys, *shlex.split(command)[1:])[0] == ("Raises" in command)
        (page,) = (folder / "reports").glob("*.html")
        shown = page.read_text()
        assert f"trial {trial}</h1>" in shown
        assert f"trial {trial} of seed {seed}" in shown
        assert ("mine_gated:Raises raised in trial 0: RuntimeError: lost" in shown) == (
            "Raises" in command
        )
        page.unlink()
    assert re.search(REPLAY, out)


RAISES = """

class Raises(Mine):
    def step(self, detections):
        raise RuntimeError("lost")
"""


def test_a_stored_baseline_can_be_reviewed(folder, capsys):
    """What a person reads of the file comes first: whose it is, the mean, its interval."""
    pmbm(capsys, "gate", "night.toml", "--tracker", "mine_gated:Worse", "--accept")
    document = json.loads((folder / "night.baseline.json").read_text())
    assert list(document)[:4] == ["schema", "metric", "tracker", "scenarios"]
    summary = document["scenarios"]["parked.toml"]
    # 14 trials of a pass at this margin, and a quarter more for spread: no more than that.
    assert summary | {"digest": ""} == {
        "mean": 1.5,
        "interval": summary["interval"],
        "trials": 18,
        "digest": "",
    }
    assert len(document["trials"]["parked.toml"]["values"]) == 18
    assert (folder / "night.baseline.json").read_text().count("\n") < 45
    text = (folder / "night.baseline.json").read_text().replace("1.5,", "0.5,", 3)
    (folder / "night.baseline.json").write_text(text)
    code, _, err = pmbm(capsys, "gate", "night.toml")
    assert code == 2
    assert "the trials of 'parked.toml' do not fit their digest" in err


def test_accepting_says_what_it_changes(folder, capsys):
    accept = ("gate", "night.toml", "--accept", "--tracker")
    _, out, _ = pmbm(capsys, *accept, "mine_gated:Mine")
    assert "parked.toml: ospa 0, 18 trials; nothing was stored before" in out
    _, out, _ = pmbm(capsys, *accept, "mine_gated:Worse")
    assert "parked.toml: ospa 0 -> 1.5, worse; 18 trials" in out
    _, out, _ = pmbm(capsys, *accept, "mine_gated:Mine")
    assert "parked.toml: ospa 1.5 -> 0, no worse; 18 trials" in out
    (folder / "parked.toml").write_text(SCENARIO.replace("20.0, 0.0", "25.0, 0.0"))
    _, out, _ = pmbm(capsys, *accept, "mine_gated:Mine")
    assert "what was stored is of other recordings" in out


def test_undecided_by_stored_values_says_what_to_do(folder, capsys):
    arguments = ("gate", "night.toml", "--max-trials", "5")
    assert pmbm(capsys, *arguments, "--accept")[0] == 0
    code, out, _ = pmbm(capsys, *arguments)
    assert code == 3
    assert "night.baseline.json holds no more trials: --against GITREF" in out


def test_no_values_of_a_tracker_that_raises_are_stored(folder, capsys):
    (folder / "mine_gated.py").write_text(TRACKER.format(shift=0.0) + RAISES)
    code, _, err = pmbm(capsys, "gate", "night.toml", "--accept", "--tracker", "mine_gated:Raises")
    assert code == 2
    assert "tracker 'mine_gated:Raises' raised in trial 0 of 'parked', seed 0: RuntimeErr" in err
    assert not (folder / "night.baseline.json").exists()


def test_accepted_values_become_the_baseline(folder, capsys):
    worse = ("gate", "night.toml", "--tracker", "mine_gated:Worse")
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--accept")
    assert code == 0
    assert "night.baseline.json: stored" in out
    code, out, _ = pmbm(capsys, "gate", "night.toml")
    assert code == 0
    assert "all values are equal" in out
    assert pmbm(capsys, *worse)[0] == 1
    assert pmbm(capsys, *worse, "--accept")[0] == 0
    assert pmbm(capsys, *worse)[0] == 0
    # What was accepted by a person also passes beside the old tracker.
    code, out, _ = pmbm(capsys, *worse, "--against", "mine_gated:Mine")
    assert (code, "accepted in night.baseline.json" in out) == (0, True)


def test_a_plan_says_what_a_gate_takes_and_runs_none(folder, capsys):
    code, out, _ = pmbm(
        capsys, "gate", "night.toml", "--plan", "--against", "mine_gated:Mine", "--jobs", "2"
    )
    lines = out.splitlines()
    assert code == 0
    assert lines[0] == "ospa: range 2, alpha 0.05 over 1 scenario"
    assert lines[1] == (
        "margin 0.5, 25 % of the range: at least 14 trials, unless the candidate is better"
    )
    assert re.fullmatch(
        r"parked\.toml: spread 0 over 10 trials: a pass takes about 14 without change, \S+ s each",
        lines[2],
    )
    assert re.fullmatch(r"in all about \S+ s with 2 processes", lines[3])


def test_a_plan_says_what_is_missing(folder, capsys):
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--plan", "--max-trials", "5")
    assert code == 0
    assert "at least 14 trials, more than max_trials, 5" in out
    assert "spread unknown: no stored baseline" in out
    assert "undecided after max_trials, 5" in out
    code, out, _ = pmbm(
        capsys,
        *("gate", "night.toml", "--plan", "--relative-margin", "0.5"),
        *("--against", "mine_gated:Worse"),
    )
    assert code == 0
    assert "parked.toml: margin 0.75: at least " in out
    code, out, err = pmbm(
        capsys,
        *("gate", "night.toml", "--plan", "--relative-margin", "0.5"),
        *("--against", "mine_gated:Mine"),
    )
    assert code == 2
    assert "mean is zero in 'parked.toml'" in err
    assert "say margin" in err


def test_a_share_of_a_perfect_baseline_is_refused(folder, capsys):
    arguments = ("--against", "mine_gated:Mine", "--relative-margin", "0.5")
    code, out, err = pmbm(capsys, "gate", "night.toml", *arguments)
    assert (code, out) == (2, "")
    assert "mean is zero in 'parked.toml'" in err
    assert "say margin" in err


def test_another_world_is_a_mismatch(folder, capsys):
    pmbm(capsys, "gate", "night.toml", "--accept")
    (folder / "parked.toml").write_text(SCENARIO.replace("20.0, 0.0", "25.0, 0.0"))
    code, _, err = pmbm(capsys, "gate", "night.toml")
    assert code == 2
    assert "another recording than the baseline's" in err
    assert "--against GITREF" in err
    assert "pmbm gate night.toml --tracker mine_gated:Mine --accept" in err


@pytest.fixture
def history(folder):
    """Commits whose tracker is off by 0, 0, 1.5, 1.5 metres, tagged c0 to c3."""
    git(folder, "init", "-q")
    for number, shift in enumerate([0.0, 0.0, 1.5, 1.5]):
        (folder / "mine_gated.py").write_text(TRACKER.format(shift=shift))
        (folder / "note").write_text(str(number))
        git(folder, "add", ".")
        git(folder, "commit", "-q", "-m", f"step {number}")
        git(folder, "tag", f"c{number}")
    return folder


def test_against_a_commit(history, capsys):
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--against", "c1")
    assert code == 1
    assert "ospa 0 -> 0\n" not in out
    # The printed replay shows both.
    ((trial, command),) = re.findall(REPLAY, out)
    assert "--against c1" in command
    assert pmbm(capsys, *shlex.split(command)[1:])[0] == 0
    (page,) = (history / "reports").glob("*.html")
    assert f"trial {trial} of seed 0" in page.read_text()
    assert '<span class="key t1"><span>c1</span>' in page.read_text()
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--against", "c3")
    assert (code, out) == (0, "pass: both trackers are the same code\n")


@pytest.mark.slow
def test_bisect_names_the_first_bad_commit(history, capsys):
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--bisect", "c0..c3")
    assert code == 1
    assert out.splitlines()[-1].endswith("step 2")
    assert out.splitlines()[-1].startswith("first bad commit: ")
    code, out, _ = pmbm(capsys, "gate", "night.toml", "--bisect", "c2..c3")
    assert (code, "does not fail" in out) == (3, True)
