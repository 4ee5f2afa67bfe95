"""One tracker against the others: verdicts by Holm, and the bound beside them."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pmbm.cli import main
from pmbm.errors import InputError
from pmbm.reports.versus import compare, versus_markdown
from pmbm.sim import load_scenario
from pmbm.study import ConfiguredTracker, TrialResult, run_trial, summarise
from pmbm.study.trial import StepTime
from pmbm.tracking import make_tracker, tracker_factory
from pmbm.types import Site


def summary(shifts, trials=12, seed=0, metric="gospa"):
    """Tracker `a`, and others that are `shifts` above it, give or take."""
    rng = np.random.default_rng(seed)
    results = []
    for trial in range(trials):
        scores = {"a": {metric: 2.0 + rng.normal()}}
        for name, shift in shifts.items():
            scores[name] = {metric: scores["a"][metric] + shift + 0.1 * rng.normal()}
        times = {name: StepTime(0, 0, 0) for name in scores}
        results.append(TrialResult("scene", 0, trial, "digest", scores, times))
    return summarise(results)


def test_less_gospa_is_better_and_more_mota_is():
    shifts = {"more": 1.0, "same": 0.0, "less": -1.0}
    by_name = {one.tracker: one.verdict for one in compare([summary(shifts)], "gospa")}
    assert by_name == {"more": "better", "same": "tie", "less": "worse"}
    found = compare([summary(shifts, metric="mota")], "mota")
    assert [one.verdict for one in found] == ["worse", "tie", "better"]


def counted(values):
    """One setting: tracker `a` has no id switch, `b` has these."""
    times = {name: StepTime(0, 0, 0) for name in "ab"}
    return summarise(
        [
            TrialResult(
                *("scene", 0, trial, "digest"),
                {"a": {"id_switches": 0.0}, "b": {"id_switches": value}},
                times,
            )
            for trial, value in enumerate(values)
        ]
    )


def test_verdicts_on_counts_are_those_of_their_intervals():
    cells = [counted(each) for each in ([0.0] * 20, [0, 1] * 10, [1, 2] * 10, [1, 0])]
    found = compare(cells, "id_switches")
    assert [one.verdict for one in found] == ["tie", "better", "better", "tie"]
    for one in found:
        assert one.difference.low < one.difference.mean < one.difference.high
        assert (one.difference.low > 0) == (one.verdict == "better")


def test_an_equal_difference_in_two_trials_is_no_verdict():
    pair = [
        TrialResult("scene", 0, trial, "digest", {"a": {"gospa": 1.0}, "b": {"gospa": 1.5}}, {})
        for trial in range(20)
    ]
    (two,) = compare([summarise(pair[:2])], "gospa")
    assert (two.verdict, two.difference.low) == ("tie", None)
    (twenty,) = compare([summarise(pair)], "gospa")
    assert twenty.verdict == "better"


def test_intervals_have_the_level_that_holm_judged_at():
    shifts = {"b": 1.0, "c": 0.1, "d": 0.06, "e": 0.0, "f": 0.01}
    cells = [summary(shifts, seed=seed) for seed in range(3)]
    found = compare([cells[0], None, *cells[1:]], "gospa")
    assert {one.cell for one in found} == {0, 2, 3}
    m = len(found)
    assert m == 15
    p = [stats.ttest_1samp(differences(one), 0).pvalue for one in paired(cells, found)]
    order = np.argsort(p)
    clear = sum(one.verdict != "tie" for one in found)
    assert 3 < clear < m
    for place, index in enumerate(order):
        one = found[index]
        # Holm's step-down, and intervals that exclude zero exactly where it rejects.
        assert (one.verdict != "tie") == (place < clear)
        assert (abs(one.difference.mean) > one.difference.half) == (place < clear)
        level = 0.05 / (m - min(place, clear))
        assert one.difference.half == pytest.approx(
            stats.t.ppf(1 - level / 2, one.difference.n - 1) * one.difference.sem
        )


def paired(cells, found):
    return [(cells[{0: 0, 2: 1, 3: 2}[one.cell]], one.tracker, one) for one in found]


def differences(pair):
    """Values with the mean and the standard error that the summary says."""
    _, _, one = pair
    z = np.random.default_rng(1).normal(size=one.difference.n)
    z = (z - z.mean()) / z.std(ddof=1)
    return one.difference.mean + z * one.difference.sem * np.sqrt(len(z))


def test_a_bound_is_run_by_studies_and_is_no_tracker():
    scene = load_scenario("single_straight")
    trackers = {"pmbm": "pmbm", "knowing": ConfiguredTracker("clairvoyant")}
    found = run_trial(scene, trackers, seed=1, metrics=["gospa", "id_switches"])
    assert found.scores["knowing"]["id_switches"] == 0
    rough = ConfiguredTracker("clairvoyant", (("position_sd", 5.0),))
    other = run_trial(scene, {"rough": rough}, seed=1, metrics=["gospa"])
    assert other.scores["rough"]["gospa"] != found.scores["knowing"]["gospa"]
    with pytest.raises(InputError, match="reads the truth"):
        make_tracker(tracker_factory("clairvoyant"), Site())
    with pytest.raises(InputError, match="did you mean 'position_sd'"):
        ConfiguredTracker("clairvoyant", (("positon_sd", 5.0),)).bound()


@pytest.fixture(scope="module")
def store(tmp_path_factory):
    """Two trials of a scene with a parameter swept, three trackers and the bound."""
    folder = tmp_path_factory.mktemp("versus")
    (folder / "small.toml").write_text(
        'scenarios = ["single_straight"]\ntrackers = ["pmbm", "argoverse", "clairvoyant"]\n'
        'trials = 2\nseed = 1\nmetrics = ["gospa", "mota"]\n'
        '[sweep.grid]\n"detector.clutter.rate" = [0.0, 5.0]\n"duration" = [2.0]\n'
    )
    with pytest.raises(SystemExit) as stop:
        main(["study", str(folder / "small.toml")])
    assert stop.value.code == 0
    return folder / "small.sqlite"


def versus(*arguments):
    with pytest.raises(SystemExit) as stop:
        main(["versus", *map(str, arguments)])
    return stop.value.code


def test_the_page_of_a_store(store, tmp_path, capsys):
    assert versus(store) == 0
    text = capsys.readouterr().out
    assert "4 of 4 trials, seed 1; 0 without result" in text
    assert "over all 2 comparisons" in text
    assert "the intervals are not simultaneous" in text
    assert "| pmbm against | pmbm better | no different | pmbm worse |" in text
    rows = [line for line in text.splitlines() if line.startswith("| single_straight")]
    assert len(rows) == 2
    assert all(row.count("±") == 1 for row in rows)
    out = tmp_path / "page.md"
    assert versus(store, "--metric", "mota", "--reference", "argoverse", "--out", out) == 0
    assert "argoverse against each, MOTA" in out.read_text()
    assert "--metric mota --reference argoverse" in out.read_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--metric", "gopsa"), "did you mean 'gospa'"),
        (("--reference", "argoverze"), "did you mean 'argoverse'"),
    ],
)
def test_bad_arguments(store, capsys, arguments, message):
    assert versus(store, *arguments) == 2
    assert message in capsys.readouterr().err


def test_a_cell_says_of_its_own_tracker_whether_it_is_better():
    """Where a tracker has less GOSPA than the reference, it is better, and stands out."""
    shift = {"reference": 0.0, "good": -1.0, "bad": 1.0}
    rng = np.random.default_rng(0)
    noise = {name: rng.normal(5.0, 0.01, 8) for name in shift}
    results = [
        TrialResult(
            *("s", 0, trial, "d"),
            {name: {"gospa": float(noise[name][trial]) + by} for name, by in shift.items()},
            {},
        )
        for trial in range(8)
    ]
    page = versus_markdown(
        SimpleNamespace(
            name="s",
            trackers=tuple(shift),
            cells={"label": ["s"]},
            summary=lambda cell, reference: summarise(results, reference),
            done=8,
            total=8,
            seed=0,
            failures=(),
            provenance={},
            digest="d",
        ),
        "gospa",
    )
    (row,) = (line for line in page.splitlines() if line.startswith("| s |"))
    *_, good, bad, _ = (cell.strip() for cell in row.split("|"))
    assert "(-1.0" in good
    assert good.endswith(" **better**")
    assert "(+0.9" in bad or "(+1.0" in bad
    assert bad.endswith(" worse")
    assert "| reference against | reference better | no different | reference worse |" in page
