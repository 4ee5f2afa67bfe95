"""What a tracker draws from global random state is its trial's, wherever the trial is run."""

import functools
import json
import random

import numpy as np
import pytest
from click.testing import CliRunner
from noisy_trackers import Noisy, Raises, Seeded

from pmbm.cli.falsify import badness_of
from pmbm.cli.run import command as run_command
from pmbm.cli.track import tracked
from pmbm.cli.tuning import Simulated
from pmbm.regression import GateEntry, Rules, gated_metric, run_gate
from pmbm.reports.replays import trial_replay
from pmbm.seeding import seeded, tracker_seed
from pmbm.sim import Scenario
from pmbm.study import Cell, ConfiguredTracker, Study, read_store, run_study, run_trial, run_trials
from pmbm.study import study as study_module
from pmbm.tracking import make_tracker, track
from pmbm.types import Label, Site

BRIEF = {
    "name": "brief",
    "stresses": "Nothing: a car that drives by for a second.",
    "duration": 1.0,
    "scene": {"kind": "scripted", "tracks": {"car": {"start": [10.0, 5.0], "speed": 10.0}}},
    "detector": {"profile": "nominal"},
}
WORLD = Scenario(BRIEF)
NOISY = ConfiguredTracker("noisy_trackers:Noisy")
SEEDED = ConfiguredTracker("noisy_trackers:Seeded")


def states():
    kind, keys, *rest = np.random.get_state()  # noqa: NPY002
    return random.getstate(), kind, keys.tolist(), rest


@pytest.fixture(autouse=True)
def _state_that_is_another_each_time():
    """Nothing here may rest on what the process drew before."""
    random.seed()
    np.random.seed()  # noqa: NPY002


def scores(trackers, trial=0):
    found = run_trial(WORLD, trackers, seed=1, trial=trial, metrics=["gospa", "ospa"]).scores
    return {name: dict(values) for name, values in found.items()}


@pytest.mark.parametrize("tracker", [Noisy, Seeded])
def test_a_trial_is_the_same_again_and_another_trial_is_not(tracker):
    assert scores({"a": tracker}) == scores({"a": tracker})
    recording = WORLD.record(1)
    one, other = (track(tracker, recording, tracker_seed(1, trial)) for trial in (0, 1))
    assert not np.array_equal(one[0].position, other[0].position)


def test_no_other_tracker_and_no_name_moves_what_one_draws():
    alone = scores({"a": Noisy})["a"]
    beside = scores({"z": Seeded, "b": Noisy, "c": Noisy})
    assert beside["b"] == beside["c"] == alone


@pytest.mark.parametrize("tracker", [Noisy, Raises])
def test_the_state_is_afterwards_as_it_was_before(tracker):
    np.random.normal()  # noqa: NPY002  # of the pair that the generator makes, one is kept
    before = states()
    try:
        scores({"a": tracker})
    except RuntimeError:
        assert tracker is Raises
    assert states() == before


def test_seeds_differ_by_study_trial_and_sequence():
    runs = [*range(200), "0001", "0002"]
    assert len({tracker_seed(seed, run) for seed in (0, 1) for run in runs}) == 2 * len(runs)
    assert all(0 <= tracker_seed(0, run) < 2**32 for run in runs)


def test_ones_own_metrics_draw_from_the_trial_too():
    def metric(recording, tracks):
        return {"mine": np.random.random()}  # noqa: NPY002

    first, again = (run_trial(WORLD, {"a": Noisy}, seed=1, metrics=metric) for _ in range(2))
    assert first.scores == again.scores


def test_a_seed_that_is_set_stays():
    def draws(tracker):
        return tracker.rng.random()

    wanted = np.random.default_rng(7).random()
    assert draws(make_tracker(Seeded, Site(), 7)) == wanted
    assert draws(make_tracker(functools.partial(Seeded, seed=7), Site(), 8)) == wanted
    fixed = ConfiguredTracker("noisy_trackers:Seeded", (("seed", 7),))
    assert draws(fixed(Site(), 8)) == wanted
    assert draws(make_tracker(fixed, Site(), 8)) == wanted


def test_a_study_has_one_digest(tmp_path, monkeypatch):
    monkeypatch.setattr(study_module, "code_version", lambda modules: {})
    cells = (Cell("brief", {}, WORLD, {"noisy": NOISY, "seeded": SEEDED}),)
    study = Study(name="s", cells=cells, trials=3, seed=1, metrics=("ospa",))
    digests = set()
    for number, jobs in enumerate((0, 0, 1, 2)):
        file = tmp_path / f"{number}.sqlite"
        assert run_study(study, file, jobs=jobs).failed == 0
        digests.add(read_store(file).digest())
    assert len(digests) == 1


def test_a_run_prints_the_same_twice(tmp_path):
    file = tmp_path / "brief.toml"
    from pmbm.sim.toml_tables import toml_text

    file.write_text(toml_text(BRIEF))
    options = ["--tracker", "noisy_trackers:Noisy", "--trials", "3", "--out", str(tmp_path)]
    found = []
    for jobs in ("1", "1", "2"):
        json_file = tmp_path / "figures.json"
        arguments = [str(file), *options, "--jobs", jobs, "--json", str(json_file)]
        done = CliRunner().invoke(run_command, arguments, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        found.append(json.loads(json_file.read_text()))
    assert found[0] == found[1] == found[2]


def test_a_replay_and_a_search_score_as_a_study_does():
    studied = run_trials(WORLD, {"a": Noisy}, 1, 2, metrics=["gospa"])
    values = [result.scores["a"]["gospa"] for result in studied]
    _, replayed = trial_replay(WORLD, {"a": Noisy}, 1, 1)
    assert replayed.scores["a"]["gospa"] == values[1]
    problem = Simulated.of([WORLD], NOISY, "gospa", 1, 2)
    assert problem.values(NOISY) == values
    badness = badness_of("noisy_trackers:Noisy", "gospa", 1.0, 2, 1)
    assert badness(BRIEF) == np.mean(values)


def test_a_gate_draws_alike_on_both_sides():
    rules = Rules(margin=0.5, max_trials=5)
    entries = {"brief": GateEntry(WORLD, "noisy_trackers:Noisy", Noisy)}
    (first,), (again,) = (
        run_gate(entries, gated_metric("ospa"), rules, jobs=jobs).scenes for jobs in (1, 2)
    )
    assert first.worst_loss == 0.0
    assert first.values == again.values


def test_a_sequence_of_a_dataset_is_tracked_the_same_twice():
    recording = WORLD.record(1)
    first, again, other = (
        tracked(name, recording, {Label.CAR: NOISY}, "online")[0].position
        for name in ("0001", "0001", "0002")
    )
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_threads_wait_for_each_other():
    """A Dask worker has several: their trials would draw from one another's state."""
    from concurrent.futures import ThreadPoolExecutor

    def draw(seed):
        with seeded(seed):
            return [random.random() + np.random.random() for _ in range(2000)]  # noqa: NPY002

    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(draw, range(8)))
    assert found == [draw(seed) for seed in range(8)]
