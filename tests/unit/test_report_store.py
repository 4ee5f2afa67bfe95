"""From a store to a report: what was stored, what failed, and the worst trials played again."""

from dataclasses import dataclass

import pytest
from click.testing import CliRunner
from traffic import recording

from pmbm.errors import InputError
from pmbm.reports.study_report import study_markdown, study_page
from pmbm.reports.study_source import stored_report, worst_trials
from pmbm.study import Cell, ConfiguredTracker, Study, load_results, run_study
from pmbm.study.store import open_store


@dataclass(frozen=True)
class HandMade:
    """The tests' traffic, longer or shorter by the trial; one trial may fail."""

    name: str = "hand-made"
    stresses: str = "Five objects, one of them hidden."
    frames: int = 12
    fails_at: int = -1

    def record(self, seed, trial=0):
        if trial == self.fails_at:
            raise RuntimeError("no traffic <today>")
        return recording(frames=self.frames + trial, name=self.name)


def study(*sources, trials=3):
    trackers = {name: ConfiguredTracker(name) for name in ("pmbm", "argoverse")}
    cells = tuple(
        Cell(source.name, {"frames": source.frames}, source, trackers) for source in sources
    )
    return Study(name="night", cells=cells, trials=trials, seed=5)


@pytest.fixture(scope="module")
def night():
    return study(HandMade(), HandMade(frames=16, fails_at=1))


@pytest.fixture(scope="module")
def stored(night, tmp_path_factory):
    store = tmp_path_factory.mktemp("study") / "night.sqlite"
    run_study(night, store)
    return store


def resolve(name, point):
    return HandMade(name=name, frames=point["frames"])


def test_a_report_is_what_was_stored(stored):
    report = stored_report(stored, resolve, worst=1)
    results = load_results(stored)
    assert (report.done, report.planned) == (5, 6)
    assert [len(cell.results) for cell in report.cells] == [3, 2]
    assert report.cells[0].stresses == "Five objects, one of them hidden."
    (failure,) = report.failures
    assert "no traffic <today>" in failure.what
    assert failure.command.endswith("night.toml --replay 3")
    assert report.provenance["digest of the results"] == results.digest
    page = study_page(report)
    assert "no traffic &lt;today&gt;" in page
    assert "5 of 6 trials" in page
    assert "replay-0" in page
    assert "no traffic &lt;today&gt;" in study_markdown(report)


def test_the_worst_trial_is_the_worst(stored):
    results = load_results(stored)
    gospa = sorted(t.scores["pmbm"]["gospa"] for ts in results.trials.values() for t in ts)
    worst, second = worst_trials(results, "pmbm", 2)
    assert [worst.value, second.value] == gospa[:-3:-1]
    assert len(worst_trials(results, "pmbm", 50)) == 5
    report = stored_report(stored, resolve, worst=1)
    assert len(report.worst) == 1
    replayed = report.worst[0].replay
    assert replayed.recording.digest() == worst.trial.recording
    assert list(replayed.tracks) == ["pmbm", "argoverse"]
    values = replayed.series["pmbm"]["gospa_observable"]
    assert values[replayed.start] == max(values[11:])  # after the first second


def test_other_traffic_is_not_shown_as_the_trial(stored):
    report = stored_report(
        stored, lambda name, point: HandMade(name=name, frames=point["frames"] + 1), worst=1
    )
    assert report.worst[0].replay is None
    assert "other traffic" in report.worst[0].why
    assert "other traffic" in study_page(report)


def test_scenarios_that_are_gone_leave_the_figures(stored):
    def gone(name, point):
        raise InputError(f"no scenario '{name}'")

    report = stored_report(stored, gone, worst=1)
    assert report.done == 5
    assert "cannot be played again" in report.worst[0].why
    assert report.cells[0].stresses == ""


def test_a_report_may_be_read_while_the_study_runs(stored, night):
    with open_store(stored, night) as driver:
        driver.start([5])
        assert stored_report(stored, resolve, worst=0).done == 5
        driver.land()


def test_scenario_files_are_found_beside_the_study_file(tmp_path):
    store = tmp_path / "elsewhere" / "night.sqlite"
    store.parent.mkdir()
    run_study(study(HandMade(name="own.toml"), trials=1), store)
    asked = []

    def remember(name, point):
        asked.append(name)
        return resolve(name, point)

    file = tmp_path / "studies" / "n.toml"
    report = stored_report(store, remember, study=file, worst=1)
    assert set(asked) == {str(tmp_path / "studies" / "own.toml")}
    assert str(file) in report.worst[0].command


def test_the_reference_can_be_chosen(stored):
    assert stored_report(stored, resolve, worst=0, reference="argoverse").worst == []
    page = study_page(stored_report(stored, resolve, worst=0, reference="argoverse"))
    assert "pmbm − argoverse" in page
    with pytest.raises(InputError, match="no tracker 'sort'"):
        stored_report(stored, resolve, reference="sort")


def test_the_command(stored, tmp_path):
    from pmbm.cli.report import command

    text = tmp_path / "night.md"
    arguments = [str(stored), "--out", str(tmp_path / "out"), "--worst", "0"]
    done = CliRunner().invoke(command, [*arguments, "--markdown", str(text)])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "out" / "night.html").read_text(encoding="utf-8").startswith("<!doctype")
    assert text.read_text(encoding="utf-8").startswith("### night")
    missing = CliRunner().invoke(command, [str(tmp_path / "none.sqlite")])
    assert isinstance(missing.exception, InputError)
