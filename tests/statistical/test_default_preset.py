"""The default's proof: the study is the one it claims to be, and what its store says."""

import os
import tomllib
from pathlib import Path

import pytest

from pmbm.cli.sources import resolve
from pmbm.filter import PMBMConfig
from pmbm.reports.versus import compare
from pmbm.sim.scenario.scenario import load_scenario, scenario_names
from pmbm.study import load_results
from pmbm.study.file import load_study
from pmbm.tracking import SHIPPED_BOUNDS, SHIPPED_TRACKERS
from pmbm.tune import FIRST_REPORTING_SEED

FILE = Path(__file__).parents[2] / "studies" / "default_preset.toml"
BASELINES = ("argoverse", "waymo", "probabilistic_kf")
DEMANDING = (
    *("misses_iid", "misses_burst", "birth_popup", "birth_ring", "crossing", "crossing_angle"),
    *("crossing_count", "truck_occlusion", "long_occlusion", "range_falloff"),
)
"""Where clutter, misses, births or crossing objects are what matters."""


def test_the_study_leaves_nothing_out():
    study = load_study(FILE, resolve)
    # Those of several sensors are compared in test_sensors_proof.py; recorded traffic is one truth.
    simulated = [
        name
        for name in scenario_names()
        if not load_scenario(name).sensors() and load_scenario(name).form.scene.kind != "recorded"
    ]
    assert sorted(cell.scenario for cell in study.cells) == simulated
    assert all(not cell.point for cell in study.cells)
    assert set(study.trackers) == {*SHIPPED_TRACKERS, *SHIPPED_BOUNDS}
    assert study.trackers[0] == "pmbm"
    assert study.trials == 50
    assert study.seed >= FIRST_REPORTING_SEED
    # All as they ship; the bound has the default's own model.
    document = tomllib.loads(FILE.read_text(encoding="utf-8"))
    (own,) = document["tracker"].values()
    default = PMBMConfig()
    assert own["parameters"] == {"position_sd": default.sensor.position_sd}


STORE = os.environ.get("PMBM_DEFAULT_STORE", "")


@pytest.mark.slow
@pytest.mark.skipif(
    not Path(STORE).is_file(),
    reason="PMBM_DEFAULT_STORE names no store; "
    "pmbm study studies/default_preset.toml --store FILE makes one (about 90 min of CPU time)",
)
def test_the_default_is_nowhere_worse_than_a_baseline(verified):
    results = load_results(STORE)
    assert results.done == results.total
    assert not len(results.failures)
    summaries = [results.summary(cell, "pmbm") for cell in range(len(results.cells))]
    found = compare(summaries, "gospa", leave_out=list(SHIPPED_BOUNDS))
    names = [row["scenario"] for row in results.cells.to_dict("records")]
    verdicts = {(names[one.cell], one.tracker): one.verdict for one in found}
    worse = sorted(
        place for place, verdict in verdicts.items() if verdict == "worse" and place[1] in BASELINES
    )
    lacking = sorted(
        (name, tracker)
        for name in DEMANDING
        for tracker in BASELINES
        if verdicts[name, tracker] != "better"
    )
    for id_, what, places in (
        ("default_worse", "scenarios where a baseline has significantly less GOSPA", worse),
        ("default_not_better", "demanding scenarios where the default is not better", lacking),
    ):
        shown = ", ".join(f"{name} ({tracker})" for name, tracker in places)
        verified(id_, f"{what}: {shown or 'none'}", len(places), 0, not places)
