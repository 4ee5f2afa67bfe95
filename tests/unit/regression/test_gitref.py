"""Trackers from other commits: a repository made for the test, with a history that is known."""

import os
import runpy
import subprocess
from pathlib import Path

import numpy as np
import pytest
from gate_worlds_small import OneCar

from pmbm.errors import InputError
from pmbm.filter import PMBMTracker
from pmbm.regression import GateEntry, Rules, Verdict, gated_metric, gitref, run_gate
from pmbm.regression.gitref import GitTracker, checked_out, same_sources
from pmbm.tracking import make_tracker, run, track

ROOT = Path(__file__).parents[3]
TRACKER = """
import os
import random
import numpy as np
from pmbm.types import Tracks

SHIFT = {shift}


class Mine:
    def __init__(self, extra=0.0):
        self.extra = extra

    def step(self, detections):
        if SHIFT is None:
            raise RuntimeError("half done")
        n = len(detections)
        return Tracks(time=detections.time, id=np.arange(n),
                      position=detections.position + np.array([SHIFT + self.extra, 0.0, 0.0]),
                      size=detections.size, yaw=detections.yaw, velocity=np.zeros((n, 2)),
                      score=detections.score, label=detections.label)


class Draws(Mine):
    def __init__(self, seed):
        self.extra = np.random.default_rng(seed).random() + np.random.random() + random.random()


class Dies(Mine):
    def step(self, detections):
        os._exit(9)
"""


def git(folder, *arguments):
    settings = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    return subprocess.run(
        ["git", *settings, *arguments], cwd=folder, check=True, capture_output=True, text=True
    ).stdout.strip()


@pytest.fixture
def repository(tmp_path, monkeypatch):
    """Six commits of mine_in_git.py: shifts 0, 0, 0, 1, 1, 1; a tag on each."""
    folder = tmp_path / "repository"
    folder.mkdir()
    git(folder, "init", "-q")
    for number, shift in enumerate([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]):
        (folder / "mine_in_git.py").write_text(TRACKER.format(shift=shift))
        (folder / "notes.txt").write_text(f"note {number}")
        git(folder, "add", ".")
        git(folder, "commit", "-q", "-m", f"step {number}")
        git(folder, "tag", f"c{number}")
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(folder)
    return folder


def tracks_of(factory):
    recording = OneCar().record(0)
    tracks = run(make_tracker(factory, recording.site), recording)
    return tracks[0].position[0, 0] - recording.truth[0].position[0, 0]


def test_the_tracker_of_another_commit_runs(repository):
    with checked_out("c1") as old, checked_out("c4") as new:
        assert tracks_of(GitTracker(old, "mine_in_git:Mine")) == 0.0
        assert tracks_of(GitTracker(new, "mine_in_git:Mine")) == 1.0
        more = GitTracker(new, "mine_in_git:Mine", (("extra", 0.5),))
        assert tracks_of(more) == 1.5
    assert not os.path.exists(old)
    assert git(repository, "worktree", "list").count("\n") == 0


def test_each_recording_gets_a_fresh_tracker(repository):
    with checked_out("c1") as old:
        factory = GitTracker(old, "pmbm")
        first = [t.id.tolist() for t in run(factory(OneCar().record(0).site), OneCar().record(0))]
        again = [t.id.tolist() for t in run(factory(OneCar().record(0).site), OneCar().record(0))]
    assert first == again


def test_what_a_tracker_of_another_commit_draws_is_what_it_draws_here(repository):
    """Its seed and its process's random state are the trial's, so that both sides of a gate share
    them."""
    draws = runpy.run_path("mine_in_git.py")["Draws"]
    recording = OneCar().record(0)
    here = [track(draws, recording, seed)[0].position for seed in (5, 6)]
    with checked_out("c5") as old:
        factory = GitTracker(old, "mine_in_git:Draws")
        there = [track(factory, recording, seed)[0].position for seed in (5, 6, 5)]
    np.testing.assert_array_equal(there, [*here, here[0]])
    assert not np.array_equal(*here)


def test_what_goes_wrong_in_the_other_process_is_told(repository):
    with checked_out("c1") as old:
        with pytest.raises(RuntimeError, match="no parameter 'nonsense'"):
            GitTracker(old, "mine_in_git:Mine", (("nonsense", 1),))(OneCar().record(0).site)
        with pytest.raises(RuntimeError, match="cannot be imported"):
            GitTracker(old, "mine_in_git:Nobody")(OneCar().record(0).site)
        with pytest.raises(RuntimeError, match="died"):
            tracks_of(GitTracker(old, "mine_in_git:Dies"))


@pytest.mark.parametrize(
    ("ref", "words"), [("nosuch", "git knows"), ("-n", "no dash"), ("c1^{tree}", "git knows")]
)
def test_an_unknown_commit_is_refused(repository, ref, words):
    with pytest.raises(InputError, match=words), checked_out(ref):
        pass


def test_a_folder_without_a_repository_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    with pytest.raises(InputError, match="git repository"), checked_out("main"):
        pass


def test_the_same_sources_are_recognised(repository):
    with checked_out("c3") as same, checked_out("c2") as other:
        assert same_sources(same, "mine_in_git:Mine")
        assert not same_sources(other, "mine_in_git:Mine")


@pytest.mark.slow
def test_the_gate_runs_a_commit_beside_the_candidate(repository):
    metric, rules = (
        gated_metric("ospa", [0.0, 2.0]),
        Rules(margin=0.5, alpha=0.05, rarest=0.2, max_trials=20),
    )
    with checked_out("c0") as good, checked_out("c5") as bad:
        entry = GateEntry(
            OneCar(), GitTracker(good, "mine_in_git:Mine"), GitTracker(bad, "mine_in_git:Mine")
        )
        serial = run_gate({"scene": entry}, metric, rules)
        parallel = run_gate({"scene": entry}, metric, rules, jobs=2)
    assert serial.verdict is Verdict.FAIL
    assert serial == parallel
    assert np.allclose(serial.scenes[0].values, 1.0)


def test_this_projects_own_tracker_runs_from_a_checkout(tmp_path):
    if not (ROOT / ".git").exists():
        pytest.skip("not a checkout")
    recording = OneCar(frames=6).record(3)
    here = run(PMBMTracker(site=recording.site), recording)
    with checked_out("HEAD", ROOT) as folder:
        there = run(GitTracker(folder, "pmbm")(recording.site), recording)
        # Not the tree at hand in disguise: without its tracker the checkout has none.
        os.rename(f"{folder}/pmbm/filter", f"{folder}/pmbm/elsewhere")
        with pytest.raises(RuntimeError, match="cannot be imported"):
            GitTracker(folder, "pmbm", (("reduction.gate", 20.0),))(recording.site)
    assert [t.id.tolist() for t in here] == [t.id.tolist() for t in there]


def test_git_takes_no_name_for_an_option(repository, monkeypatch):
    """Also where nobody refused it before."""
    monkeypatch.setattr(gitref, "check_ref", lambda ref: None)
    for name in ("--output=stolen", "--git-dir"):
        with pytest.raises(InputError, match="git knows nothing"), checked_out(name):
            pass
        with pytest.raises(InputError, match="git knows nothing"):
            gitref.commits_of(repository, f"{name}..HEAD")
        with pytest.raises(InputError, match="git knows nothing"):
            gitref.subject_of(repository, name)
    assert not list(repository.glob("stolen*"))
    assert len(gitref.commits_of(repository, "c2..c5")) == 3
    assert gitref.subject_of(repository, "c3").endswith("step 3")


def test_a_commit_is_meant_where_a_file_has_its_name(repository):
    (repository / "c1").write_text("a file")
    (repository / "c0..c2").write_text("another")
    assert gitref.subject_of(repository, "c1").endswith("step 1")
    assert len(gitref.commits_of(repository, "c0..c2")) == 2
