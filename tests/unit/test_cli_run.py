"""`pmbm run`, as a user calls it."""

import importlib.util
import json
import os
import subprocess
import sys

import pytest
from short_road import short_road

from pmbm.cli import main
from pmbm.cli.settings import named

QUICK = short_road(2.0)


@pytest.fixture
def short(tmp_path):
    path = tmp_path / "short.toml"
    path.write_text(QUICK)
    return path


def call(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([str(argument) for argument in arguments])
    return stop.value.code


def refused(capsys, *arguments):
    """The one line on stderr that a refusal gives."""
    assert call(*arguments) == 2
    message = capsys.readouterr().err.strip().splitlines()
    assert len(message) == 1, message
    assert message[0].startswith("pmbm: ")
    assert "Traceback" not in message[0]
    return message[0]


def test_a_tracker_that_raises_costs_no_other_its_table(short, tmp_path, capsys, monkeypatch):
    (tmp_path / "raising_here.py").write_text(
        "class Mine:\n    def step(self, detections):\n        raise ValueError('no idea')\n"
    )
    monkeypatch.chdir(tmp_path)
    names = ("--tracker", "raising_here:Mine", "--tracker", "argoverse")
    assert call("run", short, *names, "--trials", 2, "--out", tmp_path) == 1
    said = capsys.readouterr()
    assert "short: raising_here:Mine raised in trial 1: ValueError: no idea" in said.err
    assert "ms per step" in said.out
    assert "raised in trial 0: ValueError" in (tmp_path / "short.html").read_text()


def test_a_run_gives_a_table_a_page_and_the_promised_json(short, tmp_path, capsys):
    code = call("run", short, "--trials", 2, "--seed", 3, "--out", tmp_path, "--json", "-")
    out, err = capsys.readouterr()
    figures = json.loads(out)
    assert code == 0
    assert "short: 2 trials" in err
    assert (tmp_path / "short.html").read_text().startswith("<!doctype html>")
    assert set(figures) == {"scenario", "trials", "seed", "trackers"}
    assert (figures["scenario"], figures["trials"], figures["seed"]) == ("short", 2, 3)
    assert list(figures["trackers"]) == ["pmbm", "argoverse"]
    for metrics in figures["trackers"].values():
        for name in ("gospa", "ospa", "mota", "id_switches", "false_positives", "misses"):
            assert set(metrics[name]) == {"mean", "sem", "n"}
            assert metrics[name]["n"] == 2
            assert metrics[name]["mean"] is not None


def test_equal_calls_give_equal_figures_and_workers_change_nothing(short, tmp_path):
    files = [tmp_path / f"{i}.json" for i in range(3)]
    for file, jobs in zip(files, (1, 1, 2), strict=True):
        arguments = ("--trials", 2, "--out", tmp_path, "--json", file, "--jobs", jobs)
        assert call("run", short, *arguments) == 0
    assert files[0].read_text() == files[1].read_text() == files[2].read_text()


def test_unknown_names_are_met_with_the_nearest_valid_one(short, capsys, tmp_path):
    assert "did you mean 'crossing'?" in refused(capsys, "run", "crosing")
    assert "did you mean 'argoverse'?" in refused(capsys, "run", short, "--tracker", "argovers")
    assert "did you mean 'run'?" in refused(capsys, "rum", "crossing")
    assert "no_such_module" in refused(capsys, "run", short, "--tracker", "no_such_module:make")


@pytest.mark.parametrize(
    ("was", "becomes", "words"),
    [
        ('profile = "nominal"', 'profile = "nominal', ["short.toml", "line"]),
        ('profile = "nominal"', "objects = { detection_probability = 1.3 }", ["1.3", "short.toml"]),
        ('profile = "nominal"', "clutter = { rate = -2.0 }", ["-2", "rate", "short.toml"]),
        ("duration", "durration", ["durration", "did you mean 'duration'?", "short.toml"]),
        ("speed = 5.0", 'speed = "fast"', ["speed", "short.toml", "fast"]),
    ],
)
def test_a_file_with_a_mistake_is_refused_by_its_place(short, capsys, was, becomes, words):
    short.write_text(QUICK.replace(was, becomes))
    message = refused(capsys, "run", short)
    for word in words:
        assert word in message


def test_a_place_that_cannot_be_written_is_refused_before_any_trial(short, capsys, tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    assert "cannot write there" in refused(capsys, "run", short, "--out", blocked / "deeper")
    assert "cannot write there" in refused(capsys, "run", short, "--json", blocked / "x.json")
    assert list(tmp_path.glob("*.html")) == []


def test_a_replay_must_be_of_a_trial_that_is_run(short, capsys):
    assert "--replay" in refused(capsys, "run", short, "--trials", 2, "--replay", 2)


def test_a_track_is_explained_in_plain_words(short, capsys, tmp_path):
    run = ("run", short, "--seed", 3, "--out", tmp_path)
    message = refused(capsys, *run, "--explain", 99999)
    assert "no such track" in message
    known = message.split("reported were ")[1].split(",")[0].split(";")[0]
    assert call(*run, "--explain", known, "--tracker", "pmbm") == 0
    told = capsys.readouterr().out.splitlines()
    told = told[told.index("pmbm, short, trial 0 of seed 3") :]
    assert told[1] == f"Track {known}"
    assert "born from detection" in told[2]
    assert "has no inspect(), which --explain needs" in refused(
        capsys, *run, "--explain", 0, "--tracker", "argoverse"
    )
    assert not list(tmp_path.glob("*.json"))


@pytest.mark.parametrize("name", ["pmbm.sim", "pmbm.reports"])
def test_a_checkout_without_links_is_named(capsys, monkeypatch, name):
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda asked: None if asked == name else found(asked)
    )
    assert f"{name} is missing: this checkout has no symbolic links" in refused(capsys, "scenarios")


def test_folders_of_a_users_own_hide_nothing(tmp_path):
    for name in ("sim", "reports"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('not ours')\n")
    done = subprocess.run(
        [sys.executable, "-m", "pmbm", "scenarios"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", ["run", "picture", "falsify"])
def test_parameters_on_the_command_line_are_checked(command, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as stop:
        main([command, "single_straight", "--tracker", "argoverse", "--set", "min_hts=3"])
    assert stop.value.code == 2
    assert "did you mean 'min_hits'" in capsys.readouterr().err


def test_parameters_are_those_of_the_first_tracker():
    found = named(["argoverse", "argoverse"], ["min_hits=5"])
    assert list(found) == ["argoverse (min_hits=5)", "argoverse"]
    assert found["argoverse (min_hits=5)"].parameters == (("min_hits", 5),)
