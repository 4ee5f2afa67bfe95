"""The pytest plugin, as pytest's own tool for testing plugins sees it."""

import importlib
import json
import re
import shlex
import sys
import types
from pathlib import Path

import pytest

from pmbm.testing import outcome_of

# Runs in this process forget what they imported, and numpy cannot be imported twice.
for name in (
    "pmbm.regression",
    "pmbm.testing",
    "pmbm.reports.replays",
    "pmbm.sim.detector.model",
    "pmbm.sim.scenario.scenario",
):
    importlib.import_module(name)

pytest_plugins = ["pytester"]

SCENARIO = """
name = "parked"
stresses = "Nothing at all: one parked car in plain sight."
duration = 1.0
rate = 5
[scene]
kind = "scripted"
[scene.tracks.car]
start = [20.0, 0.0]
jitter = { x = 5.0, y = 5.0 }
[detector]
profile = "perfect"
"""

TRACKERS = """
import numpy as np
from pmbm import Tracks


class Exact:
    shift = 0.0

    def step(self, detections):
        n = len(detections)
        return Tracks(time=detections.time, id=np.arange(n),
                      position=detections.position + np.array([self.shift, 0.0, 0.0]),
                      size=detections.size, yaw=detections.yaw, velocity=np.zeros((n, 2)),
                      score=detections.score, label=detections.label)


class Worse(Exact):
    shift = 1.5


class Raises(Exact):
    def step(self, detections):
        raise RuntimeError("lost my way")


class Noisy(Exact):
    def step(self, detections):
        self.shift = np.random.normal()
        return super().step(detections)
"""

SUITE = """
import pytest
from trackers_here import Exact, Worse


@pytest.mark.scenario("parked.toml", trials=3)
@pytest.mark.tracker(Exact, Worse)
def test_follows(outcome):
    assert outcome.mean("ospa") < 1.0
"""


@pytest.fixture
def project(pytester, monkeypatch):
    """A user's folder."""
    pytester.makefile(".toml", parked=SCENARIO)
    pytester.makepyfile(trackers_here=TRACKERS)
    pytester.makeini("[pytest]\naddopts = --strict-markers\n")
    pytester.syspathinsert()
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    return pytester


def test_every_scenario_meets_every_tracker(project):
    project.makepyfile(test_mine=SUITE)
    result = project.runpytest("-v")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines_random(
        ["*test_follows?parked.toml-Exact? PASSED*", "*test_follows?parked.toml-Worse? FAILED*"]
    )


def test_a_failure_shows_its_worst_trial(project):
    project.makepyfile(test_mine=SUITE)
    result = project.runpytest("--pmbm-report-dir", "shown")
    result.assert_outcomes(passed=1, failed=1)
    text = result.stdout.str()
    trial = int(re.search(r"worst trial by ospa: (\d) of seed 0", text)[1])
    page = Path(re.search(r"replay: (.*\.html)", text)[1])
    assert page.parent == project.path / "shown"
    assert "</html>" in page.read_text()
    command = f"pytest 'test_mine.py::test_follows[parked.toml-Worse]' --pmbm-replay {trial}"
    assert command in text
    assert "where mean = Outcome('Worse' over 3 trials of 'parked', seed 0).mean" in text
    assert re.search(r"^ospa in 3 trials \(m\): 1\.5 1\.5 1\.5$", text, re.M)
    assert re.search(r"^mean 1\.5", text, re.M)
    assert "replays of worst trials" in text
    assert len(list((project.path / "shown").iterdir())) == 1

    # The command does what it says: that trial alone, and its page.
    page.unlink()
    node = "test_mine.py::test_follows[parked.toml-Worse]"
    again = project.runpytest(node, "--pmbm-replay", str(trial), "--pmbm-report-dir", "shown")
    again.assert_outcomes(failed=1)
    assert page.exists()
    assert f"trial {trial} of seed 0" in page.read_text()


def test_the_command_of_a_failure_shows_the_number_that_failed(project):
    """Of a tracker that draws from numpy's global generator."""
    project.makepyfile(
        test_mine="""
        import pytest
        from trackers_here import Noisy

        @pytest.mark.scenario("parked.toml", trials=3)
        @pytest.mark.tracker(Noisy)
        def test_follows(outcome):
            worst = outcome.max("ospa")
            assert not worst, f"worst is {worst!r}."
        """
    )
    result = project.runpytest_subprocess()
    (command,) = set(re.findall(r"^pytest .* --pmbm-replay \d$", result.stdout.str(), re.M))
    again = project.runpytest_subprocess(*shlex.split(command)[1:])
    first, second = (
        re.search(r"worst is (\d+\.\d+)\.", each.stdout.str())[1] for each in (result, again)
    )
    assert first == second


def test_a_replay_that_cannot_be_written_hides_no_failure(project):
    project.makepyfile(test_mine=SUITE)
    (project.path / "taken").write_text("a file, not a folder")
    result = project.runpytest("--pmbm-report-dir", "taken")
    result.assert_outcomes(passed=1, failed=1)
    result.stdout.fnmatch_lines(["*no replay: *"])


def test_the_questions_an_outcome_answers(project):
    project.makepyfile(
        test_mine="""
        import pytest
        from pmbm.errors import InputError

        pytestmark = pytest.mark.tracker("trackers_here:Worse")

        @pytest.mark.scenario("parked.toml", trials=4, seed=3)
        class TestAll:
            def test_numbers(self, outcome):
                assert len(outcome.runs) == 4 and outcome.seed == 3
                assert outcome.mean("ospa") == pytest.approx(1.5)
                assert outcome.min("ospa") <= outcome.mean("ospa") <= outcome.max("ospa")
                low, high = outcome.interval("ospa")
                assert low <= 1.5 <= high
                assert outcome.values("recall") == [1.0] * 4
                assert outcome.measure(lambda recording, tracks: len(tracks)) == [5] * 4
                assert outcome.tracker == "trackers_here:Worse"

            def test_undefined(self, outcome):
                assert outcome.values("coasting_error") == [None] * 4
                with pytest.raises(AssertionError, match="undefined in all 4 trials"):
                    outcome.mean("coasting_error")
                with pytest.raises(AssertionError, match="no interval"):
                    outcome.interval("coasting_error")

            def test_unknown(self, outcome):
                with pytest.raises(InputError, match="did you mean 'ospa'"):
                    outcome.mean("opsa")
        """
    )
    project.runpytest().assert_outcomes(passed=3)


def test_trials_and_tracker_from_the_command_line(project):
    project.makepyfile(
        test_mine="""
        import pytest

        @pytest.mark.scenario("parked.toml", trials=50)
        @pytest.mark.tracker("nosuch")
        def test_it(outcome):
            assert len(outcome.runs) == 2
            assert outcome.mean("ospa") == 0.0
        """
    )
    options = ("--pmbm-trials", "2", "--pmbm-tracker", "trackers_here:Exact")
    project.runpytest(*options).assert_outcomes(passed=1)


def test_a_source_of_ones_own(project):
    project.makepyfile(
        test_mine="""
        import pytest
        from pmbm.sim import load_scenario
        from trackers_here import Exact

        class Mine:
            name = "mine"
            def record(self, seed, trial=0):
                return load_scenario("parked.toml").record(seed, trial)

        @pytest.mark.scenario(Mine(), trials=2)
        @pytest.mark.tracker(Exact)
        def test_it(outcome):
            assert outcome.source.name == "mine"
            assert outcome.mean("ospa") == 0.0
        """
    )
    result = project.runpytest("-v")
    result.assert_outcomes(passed=1)
    result.stdout.fnmatch_lines(["*test_it?mine-Exact?*"])


@pytest.mark.parametrize(
    ("marks", "words"),
    [
        ('@pytest.mark.tracker("pmbm")', "outcome needs @pytest.mark.scenario"),
        ('@pytest.mark.scenario("parked.toml")', "outcome needs @pytest.mark.tracker"),
        (
            '@pytest.mark.tracker("pmbm")\n@pytest.mark.scenario("parked.toml", trails=3)',
            "knows trials, seed and level, not trails",
        ),
    ],
)
def test_a_wrong_marker_is_said_at_collection(project, marks, words):
    project.makepyfile(test_mine=f"import pytest\n{marks}\ndef test_it(outcome): pass\n")
    result = project.runpytest()
    assert result.ret != 0
    assert words in result.stdout.str() + result.stderr.str()


def test_an_unknown_scenario_or_tracker_is_one_named_error(project):
    project.makepyfile(
        test_mine="""
        import pytest

        @pytest.mark.scenario("crosing")
        @pytest.mark.tracker("pmbm")
        def test_scenario(outcome): pass

        @pytest.mark.scenario("parked.toml", trials=1)
        @pytest.mark.tracker("pmbn")
        def test_tracker(outcome): pass
        """
    )
    result = project.runpytest()
    result.assert_outcomes(errors=2)
    result.stdout.fnmatch_lines_random(["*did you mean 'crossing'*", "*did you mean 'pmbm'*"])


def test_a_module_of_the_users_called_sim_hides_nothing(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "sim", types.ModuleType("sim"))
    outcome = outcome_of("crossing", "pmbm", tracker_name="pmbm", folder=tmp_path, trials=1)
    assert outcome.mean("misses") is not None


GATE = """
from trackers_here import {tracker} as Mine

OPTIONS = dict(scenario="parked.toml", metric="ospa", bounds=[0, 2], margin=0.5,
               alpha=0.05, rarest=0.2, max_trials=20)

def test_no_regression(tracking_gate):
    report = tracking_gate.check(Mine, **OPTIONS)
    assert report.verdict == "pass"
"""


def test_the_gate_needs_a_baseline_and_says_how_to_store_one(project):
    project.makepyfile(test_mine=GATE.format(tracker="Exact"))
    result = project.runpytest()
    result.assert_outcomes(failed=1)
    result.stdout.fnmatch_lines(
        ["*no stored baseline*pytest test_mine.py::test_no_regression --pmbm-update-baselines*"]
    )
    # One traceback, and none of it from within.
    assert "During handling" not in result.stdout.str()
    assert "FileNotFoundError" not in result.stdout.str()


def test_the_gate_passes_fails_and_accepts(project):
    project.makepyfile(test_mine=GATE.format(tracker="Exact"))
    stored = project.runpytest("--pmbm-update-baselines")
    stored.assert_outcomes(passed=1)
    stored.stdout.fnmatch_lines(["*stored baselines*"])
    files = list((project.path / "baselines").iterdir())
    assert len(files) == 1
    # As many trials as the margin takes, not as many as there may be.
    assert len(json.loads(files[0].read_text())["trials"]["parked"]["values"]) == 18
    project.runpytest().assert_outcomes(passed=1)

    project.makepyfile(test_mine=GATE.format(tracker="Worse"))
    red = project.runpytest()
    red.assert_outcomes(failed=1)
    red.stdout.fnmatch_lines(
        [
            "*fail  parked: ospa 0 -> 1.5, loss +1.5 in *margin 0.5*trials*",
            "*accept the change: pytest test_mine.py::test_no_regression --pmbm-update-baselines*",
            "*replay: *.html*",
        ]
    )
    # The printed command shows that trial, and judges nothing.
    text = red.stdout.str()
    trial, command = re.search(
        r"worst is trial (\d+) .*: (pytest .* --pmbm-replay \d+)", text
    ).groups()
    page = Path(re.search(r"replay: (.*\.html)", text)[1])
    page.unlink()
    shown = project.runpytest(*shlex.split(command)[1:])
    shown.assert_outcomes(skipped=1)
    assert f"trial {trial} of seed 0" in page.read_text()
    assert "In handling" not in text
    assert "pmbm/regression" not in text

    # A worse tracker is stored, and not called passed.
    worse = project.runpytest("--pmbm-update-baselines")
    worse.assert_outcomes(failed=1)
    worse.stdout.fnmatch_lines(["*parked: ospa 0 -> 1.5, worse; 18 trials*"])
    project.runpytest().assert_outcomes(passed=1)
    project.makepyfile(test_mine=GATE.format(tracker="Exact"))
    better = project.runpytest("--pmbm-update-baselines")
    better.assert_outcomes(passed=1)
    better.stdout.fnmatch_lines(["*.json: parked: ospa 1.5 -> 0, no worse; 18 trials"])


def test_the_gate_beside_another_tracker(project):
    project.makepyfile(
        test_mine="""
        import pytest
        from trackers_here import Exact, Raises, Worse

        OPTIONS = dict(scenario="parked.toml", bounds=[0, 2], margin=0.5,
                       alpha=0.05, rarest=0.2, max_trials=20)

        def test_better(tracking_gate):
            tracking_gate.check(Exact, against=Worse, **OPTIONS)

        def test_worse(tracking_gate):
            with pytest.raises(AssertionError, match="fail: 1 fail"):
                tracking_gate.check(Worse, against=Exact, **OPTIONS)

        def test_too_few(tracking_gate):
            with pytest.raises(AssertionError, match="undecided: 1 undecided"):
                tracking_gate.check(Exact, against=Exact, **{**OPTIONS, "max_trials": 5})

        def test_raises(tracking_gate):
            with pytest.raises(AssertionError, match="the candidate raised in trial 0: RuntimeE"):
                tracking_gate.check(Raises, against=Exact, **OPTIONS)
        """
    )
    project.runpytest().assert_outcomes(passed=4)


@pytest.mark.slow
def test_under_xdist(project):
    pytest.importorskip("xdist")
    project.makepyfile(test_mine=SUITE, test_gated_inside=GATE.format(tracker="Exact"))
    result = project.runpytest_subprocess("-n", "2", "--pmbm-update-baselines")
    result.assert_outcomes(passed=2, failed=1)
    result.stdout.fnmatch_lines(["*replays of worst trials*", "*.html", "*stored baselines*"])
    project.runpytest("test_gated_inside.py").assert_outcomes(passed=1)


def test_loading_the_plugin_imports_nothing_heavy(project):
    project.makeconftest(
        """
        import sys

        HEAVY = ("numpy", "scipy", "highway_env", "gymnasium", "pandas", "matplotlib", "pydantic")

        def pytest_sessionfinish(session):
            plugins = [name for name, _ in session.config.pluginmanager.list_name_plugin()]
            print("loaded:", "pmbm" in plugins, [m for m in HEAVY if m in sys.modules])
        """
    )
    project.makepyfile(test_mine="def test_it(): pass")
    result = project.runpytest_subprocess("-p", "no:hypothesispytest", "-p", "no:xdist")
    result.assert_outcomes(passed=1)
    assert "loaded: True []" in result.stdout.str()
    collected = project.makepyfile(
        test_mine="""
        import pytest
        @pytest.mark.scenario("crossing")
        @pytest.mark.tracker("pmbm")
        def test_it(outcome): pass
        """
    )
    result = project.runpytest_subprocess("--collect-only", "-p", "no:hypothesispytest", collected)
    assert "loaded: True []" in result.stdout.str()


def test_help_and_markers(project):
    project.runpytest("--help").stdout.fnmatch_lines(["*--pmbm-trials=N*", "*--pmbm-report-dir*"])
    project.runpytest("--markers").stdout.fnmatch_lines(["@pytest.mark.scenario*"])
