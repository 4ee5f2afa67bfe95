"""Sources of recordings of a user's own: named as MODULE:SOURCE wherever a scenario is named."""

import pickle
import sys

import pytest

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.study import NamedSource, load_results, recorded
from pmbm.testing import outcome_of

MODULE = """
from pmbm.sim import load_scenario

WORLD = load_scenario("single_straight")


class Drives:
    name = "drives"

    def record(self, seed, trial=0):
        return WORLD.record(seed, trial)


class SeedAlone:
    name = "alone"

    def record(self, seed):
        return WORLD.record(seed)


drives = Drives()


def no_source():
    return 3
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "my_drives.py").write_text(MODULE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_drives", raising=False)
    return tmp_path


def call(*arguments):
    with pytest.raises(SystemExit) as stop:
        main([*map(str, arguments)])
    return stop.value.code


def test_a_seed_alone_makes_another_recording_of_every_trial(folder):
    source = NamedSource("my_drives:SeedAlone")
    digests = {recorded(source, 5, trial).digest() for trial in (0, 1, 0)}
    assert len(digests) == 2
    assert recorded(source, 6, 0).digest() not in digests
    drives = NamedSource("my_drives:drives")
    assert drives.name == "drives"
    assert recorded(drives, 5, 1).digest() == drives.source.record(5, 1).digest()
    assert pickle.loads(pickle.dumps(drives)) == drives


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("my_drives:nobody", "cannot be imported"),
        ("no_such_module:x", "cannot be imported"),
        ("my_drives:no_source", r"no source of recordings.*record\(seed, trial\).*got 'int'"),
    ],
)
def test_what_is_no_source_is_refused(folder, place, words):
    with pytest.raises(InputError, match=words):
        NamedSource(place)


def test_commands_take_a_source(folder, capsys):
    """Also in workers, which look its module up in the current folder as trackers' are."""
    quick = ("--trials", "2", "--tracker", "argoverse", "--out", folder, "--no-map")
    assert call("run", "my_drives:SeedAlone", *quick, "--jobs", "2") == 0
    assert "alone: 2 trials" in capsys.readouterr().out
    (folder / "night.toml").write_text(
        'scenarios = ["my_drives:Drives"]\ntrackers = ["argoverse"]\ntrials = 2\n'
        'metrics = ["gospa"]\n'
    )
    assert call("study", "night.toml") == 0
    results = load_results(folder / "night.sqlite")
    assert results.done == 2
    assert "my_drives" in results.document["code"]["sources"]
    gate = ("gate", "my_drives:drives", "--tracker", "argoverse", "--against", "argoverse")
    assert call(*gate, "--margin", "3", "--max-trials", "2") == 3
    assert call("run", "my_drives:drives", "--level", "3") == 2
    assert "has no levels" in capsys.readouterr().err


def test_scenario_tests_take_a_source(folder):
    outcome = outcome_of(
        "my_drives:drives", "argoverse", tracker_name="argoverse", folder=folder, trials=1
    )
    assert outcome.source.name == "drives"
    assert outcome.mean("gospa") > 0


def test_a_tracker_gets_parameters_on_the_command_line(folder, capsys):
    (folder / "gated.py").write_text(
        "from pmbm.baselines import ArgoverseTracker\n"
        "def Mine(gate=1.0, kind='x'):\n"
        "    assert (gate, kind) == (4, 'plain')\n"
        "    return ArgoverseTracker()\n"
    )
    quick = ("--out", folder, "--no-map")
    named = ("--tracker", "gated:Mine", "--set", "gate=4", "--set", "kind=plain")
    assert call("run", "single_straight", *named, *quick) == 0
    assert "gated:Mine (gate=4, kind=plain)" in " ".join(capsys.readouterr().out.split())
    one = ("run", "single_straight", "--tracker", "pmbm", *quick)
    assert call(*one, "--set", "reduction.gaet=4") == 2
    assert "did you mean 'gate'" in capsys.readouterr().err
    assert call(*one, "--set", "gate") == 2
    assert "expected KEY=VALUE, got 'gate'" in capsys.readouterr().err
    gate = (
        "gate",
        "single_straight",
        "--against",
        "gated:Mine",
        "--margin",
        "3",
        "--set",
        "gate=4",
    )
    assert call(*gate, "--max-trials", "2", "--tracker", "gated:Mine") == 2
    assert "the baseline raised AssertionError" in capsys.readouterr().err
