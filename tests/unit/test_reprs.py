"""What a session or a failing test shows of a value: one line, at once."""

import time

import pytest

from pmbm import PMBMConfig, PMBMTracker, Site, evaluate, run
from pmbm.metrics import combine
from pmbm.regression import GateEntry, Rules, gated_metric, run_gate
from pmbm.sim import load_scenario
from pmbm.study import Cell, ConfiguredTracker, Study, load_results, run_study, run_trial, summarise
from pmbm.testing import outcome_of

LONGEST = 200


@pytest.fixture(scope="module")
def values(tmp_path_factory):
    """A value of each public kind, from a real run."""
    scenario = load_scenario("single_straight")
    recording = scenario.record(7)
    tracker = PMBMTracker(PMBMConfig())
    tracks = run(tracker, recording, record=True)
    evaluation = evaluate(recording, tracks)
    result = run_trial(scenario, {"pmbm": "pmbm"}, 7, metrics=["gospa"])
    cell = Cell("single_straight", {}, scenario, {"pmbm": ConfiguredTracker("pmbm")})
    study = Study(name="night", cells=(cell,), trials=2, metrics=("gospa",))
    store = tmp_path_factory.mktemp("store") / "night.sqlite"
    run_study(study, store, jobs=0)
    report = run_gate(
        {"single_straight": GateEntry(scenario, "argoverse", "pmbm")},
        gated_metric("ospa", None),
        Rules(margin=2.0, max_trials=2),
    )
    outcome = outcome_of(scenario, "pmbm", tracker_name="pmbm", folder=store.parent, trials=2)
    return {
        "recording": recording,
        "truth": recording.truth[50],
        "detections": recording.detections[50],
        "site": recording.site,
        "tracks": tracks,
        "step": tracks[50],
        "undetected": tracks[50].undetected,
        "inspection": tracks.inspections[50],
        "view": tracks.inspections[50].sensor_view,
        "tracker": tracker,
        "state": tracker.state,
        "density": tracker.state.density,
        "evaluation": evaluation,
        "combined": combine([evaluation, evaluation]),
        "metric value": evaluation["gospa"],
        "scenario": scenario,
        "scene": scenario.scene(7),
        "detector": scenario.detector(),
        "trial": result,
        "summary": summarise([result, result]),
        "cell": cell,
        "study": study,
        "results": load_results(store),
        "gate report": report,
        "outcome": outcome,
        "run": outcome.runs[0],
    }


def test_every_public_value_has_a_repr_of_one_line(values):
    shown = {name: repr(value) for name, value in values.items()}
    too_long = {name: text[:80] for name, text in shown.items() if len(text) > LONGEST}
    assert not too_long
    assert not [text for text in shown.values() if "\n" in text]


def test_a_repr_takes_no_time(values):
    start = time.process_time()
    for value in values.values():
        repr(value)
    assert time.process_time() - start < 0.5


def test_a_repr_says_what_it_is_of(values):
    assert repr(values["recording"]).startswith("Recording('single_straight': 200 frames, ")
    assert repr(values["outcome"]) == "Outcome('pmbm' over 2 trials of 'single_straight', seed 0)"
    assert repr(values["gate report"]).startswith("GateReport(undecided by ospa: single_straight")
    assert repr(values["study"]) == "Study('night': 1 cell of 2 trials, 1 tracker)"
    assert repr(values["combined"]).endswith("; 2 recordings)")
    gospa = values["evaluation"]["gospa"]
    assert repr(gospa).startswith(f"MetricValue(gospa: {gospa.value:.4g} m; ")
    assert repr(Site()) == "Site(0 occluders, field of view 360 degrees, range 100 m)"


def test_notebooks_show_tables_of_a_few_kilobytes(values):
    for name in ("evaluation", "results"):
        shown = values[name]._repr_html_()
        assert "<table" in shown
        assert len(shown) < 100_000


def test_an_evaluation_is_a_frame_of_data(values):
    evaluation = values["evaluation"]
    frame = evaluation.to_frame()
    assert list(frame.index) == list(evaluation)
    assert frame.loc["gospa", "value"] == evaluation["gospa"].value
    assert frame.loc["gospa", "unit"] == "m"
    assert frame["value"].isna().sum() == sum(value.value is None for value in evaluation.values())
