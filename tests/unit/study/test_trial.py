"""One trial, many trials, and their statistics."""

import pickle

import numpy as np
import pytest
import scipy.stats
from study_worlds import Blind, Convoy, Echo, biased, toy_scores

from pmbm.errors import InputError
from pmbm.intervals import COUNT, MEASURED, SHARE
from pmbm.study import StepTime, TrialResult, estimate, run_trial, run_trials, summarise

TRACKERS = {"echo": Echo, "biased": biased, "blind": Blind}


def result(trial, **scores):
    return TrialResult(
        "hand", 0, trial, "digest", scores, {name: StepTime(0, 0, 0) for name in scores}
    )


def same(left, right):
    """Equal but for times."""
    return [(r.source, r.seed, r.trial, r.recording, dict(r.scores)) for r in left] == [
        (r.source, r.seed, r.trial, r.recording, dict(r.scores)) for r in right
    ]


def test_a_trial_scores_every_tracker_on_one_recording():
    found = run_trial(Convoy(), TRACKERS, seed=5, trial=2, metrics=toy_scores)
    recording = Convoy().record(5, 2)
    assert (found.source, found.seed, found.trial) == ("convoy", 5, 2)
    assert found.recording == recording.digest() != Convoy().record(5, 1).digest()
    noise = np.concatenate(
        [
            d.position[:, :2] - t.position[:, :2]
            for d, t in zip(recording.detections, recording.truth, strict=True)
        ]
    )
    assert found.scores["echo"]["error"] == pytest.approx(np.linalg.norm(noise, axis=1).mean())
    assert found.scores["biased"]["error"] == pytest.approx(
        np.linalg.norm(noise + np.array([1.0, 0.0]), axis=1).mean()
    )
    assert found.scores["blind"] == {"error": None, "reports": 0.0}
    assert all(time.mean > 0 and time.p99 >= time.median for time in found.time.values())


def test_metrics_by_name_and_in_full():
    found = run_trial(Convoy(), {"echo": Echo}, seed=5, metrics=["ospa", "mota"])
    assert list(found.scores["echo"]) == ["ospa", "mota"]
    assert found.scores["echo"]["mota"] == 1.0
    everything = run_trial(Convoy(), {"echo": Echo}, seed=5)
    assert {"gospa", "id_switches", "hota"} < set(everything.scores["echo"])
    with pytest.raises(InputError, match="did you mean 'ospa'"):
        run_trial(Convoy(), {"echo": Echo}, seed=5, metrics=["opsa"])


def test_a_result_is_frozen_and_travels():
    found = run_trial(Convoy(), TRACKERS, seed=5, metrics=toy_scores)
    with pytest.raises(TypeError):
        found.scores["echo"]["error"] = 0.0
    assert pickle.loads(pickle.dumps(found)) == found


class Raises:
    def step(self, detections):
        raise RuntimeError(f"no\nidea at {detections.time:g} s")


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_tracker_that_raises_loses_its_own_scores_and_nobody_elses(jobs):
    alone = run_trials(Convoy(), TRACKERS, 5, 2, metrics=toy_scores)
    found = run_trials(Convoy(), {"bad": Raises, **TRACKERS}, 5, 2, jobs=jobs, metrics=toy_scores)
    for one, other in zip(alone, found, strict=True):
        assert {name: dict(other.scores[name]) for name in TRACKERS} == {
            name: dict(scores) for name, scores in one.scores.items()
        }
        assert other.scores["bad"] == {}
        assert other.errors["bad"].message == "RuntimeError: no idea at 0 s"
        assert "in step" in other.errors["bad"].traceback
        with pytest.raises(InputError, match=f"'bad' raised in trial {other.trial} of .*: Runtim"):
            other.of("bad")
    summary = summarise(found)
    assert summary.trackers == ("bad", *TRACKERS)
    assert summary.estimates["bad"] == {}


def test_step_times_are_those_of_numpy():
    seconds = np.random.default_rng(0).uniform(size=37)
    assert StepTime.of(seconds) == StepTime(
        seconds.mean(), np.median(seconds), np.percentile(seconds, 99)
    )
    assert StepTime.of(np.zeros(0)) == StepTime(0.0, 0.0, 0.0)


def test_results_do_not_depend_on_processes():
    told = []
    serial = run_trials(
        Convoy(), TRACKERS, 3, 5, metrics=toy_scores, progress=lambda *step: told.append(step)
    )
    assert told == [(done, 5) for done in range(6)]
    told.clear()
    # Factories that are not importable travel too.
    trackers = {**TRACKERS, "echo": lambda: Echo()}
    parallel = run_trials(
        Convoy(),
        trackers,
        3,
        5,
        jobs=2,
        metrics=toy_scores,
        progress=lambda *step: told.append(step),
    )
    assert told == [(done, 5) for done in range(6)]
    assert same(serial, parallel)
    assert len({r.recording for r in serial}) == 5


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_a_trial_raises_is_raised(jobs):
    with pytest.raises(InputError, match="nosuch"):
        run_trials(Convoy(), {"nosuch": "nosuch"}, 0, 2, jobs=jobs, metrics=toy_scores)


@pytest.mark.parametrize("n", [2, 3, 40])
def test_the_interval_is_students(n):
    values = np.random.default_rng(n).normal(3.0, 2.0, n)
    found = estimate(values)
    low, high = scipy.stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert (found.low, found.high) == pytest.approx((low, high))
    assert found.mean == pytest.approx(values.mean())
    assert found.sem == pytest.approx(scipy.stats.sem(values))
    assert (found.n, found.undefined) == (n, 0)


def test_undefined_values_are_left_out_and_counted():
    found = estimate([1.0, None, 3.0, None])
    assert (found.mean, found.n, found.undefined) == (2.0, 2, 2)
    assert found.sem == pytest.approx(1.0)
    one = estimate([None, 4.0])
    assert (one.mean, one.sem, one.low, one.high, one.n, one.undefined) == (
        4.0,
        None,
        None,
        None,
        1,
        1,
    )
    none = estimate([None])
    assert (none.mean, none.n, none.undefined) == (None, 0, 1)


def test_differences_are_paired():
    rows = [
        result(0, a={"m": 1.0, "only_a": 5.0}, b={"m": 2.0}),
        result(1, a={"m": 10.0, "only_a": 5.0}, b={"m": 11.5}),
        result(2, a={"m": None, "only_a": 5.0}, b={"m": 100.0}),
    ]
    table = summarise(rows)
    assert (table.reference, table.trials, table.trackers) == ("a", 3, ("a", "b"))
    assert table.metrics == ("m", "only_a")
    assert table.estimates["a"]["m"].mean == 5.5
    assert table.estimates["b"]["m"].n == 3
    difference = table.differences["b"]["m"]
    assert (difference.mean, difference.n, difference.undefined) == (1.25, 2, 1)
    low, high = scipy.stats.ttest_rel([2.0, 11.5], [1.0, 10.0]).confidence_interval(0.95)
    assert (difference.low, difference.high) == pytest.approx((low, high))
    assert "only_a" not in table.differences["b"]
    assert "a" not in table.differences
    assert summarise(rows, reference="b").differences["a"]["m"].mean == -1.25


def test_one_value_in_all_trials_has_no_standard_error():
    for scale in (MEASURED, SHARE, COUNT):
        assert estimate([1.0] * 20, scale).sem is None


def test_a_sum_of_many_is_exact():
    assert estimate([1e16, 1.0, -1e16]).mean == pytest.approx(1 / 3)


def test_what_cannot_be_summarised_is_named():
    with pytest.raises(InputError, match="at least one trial"):
        summarise([])
    with pytest.raises(InputError, match="did you mean 'echo'"):
        summarise([result(0, echo={"m": 1.0})], reference="ecoh")
