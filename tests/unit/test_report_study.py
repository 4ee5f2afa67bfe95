"""A study's verdicts, curves and texts, against scipy and by hand."""

import itertools

import numpy as np
import pytest
from scipy import stats
from test_report_page import Outline
from traffic import recording, tracks

from pmbm.reports.study_report import (
    findings,
    holm,
    p_value,
    robustness,
    study_markdown,
    study_page,
)
from pmbm.reports.values import CellResults, Failure, ReplayPage, StudyReport, WorstTrial
from pmbm.study import StepTime, TrialResult, estimate

HOSTILE = "</script><img src=x onerror=alert(1)>|\n# `&\u2028"


def cell(shift=0.0, trials=8, scenario="crossing", point=None, seed=0, trackers=("a", "b")):
    """Tracker b is worse than a by `shift` m of GOSPA, give or take."""
    rng = np.random.default_rng(seed)
    results = []
    for trial in range(trials):
        common = rng.normal()
        scores = {
            name: {
                "gospa": 5 + common + shift * index + 0.1 * rng.normal(),
                "gospa_localisation": 1.0,
                "gospa_missed": 2.0 + index,
                "gospa_false": 0.5,
                "mota": 0.9 - 0.01 * index,
            }
            for index, name in enumerate(trackers)
        }
        time = {name: StepTime(0.001, 0.0009, 0.004) for name in trackers}
        results.append(TrialResult(scenario, 0, trial, f"d{trial}", scores, time))
    return CellResults(scenario=scenario, point=point or {}, results=results, stresses="Crossing.")


def study(*cells, **changes):
    values = {"name": "night", "cells": cells, "planned": sum(len(c.results) for c in cells)}
    return StudyReport(**{**values, **changes})


def test_the_p_value_is_scipys():
    rng = np.random.default_rng(1)
    for n in (2, 5, 40):
        a, b = rng.normal(size=n), rng.normal(0.3, 1, n)
        assert p_value(estimate((b - a).tolist())) == pytest.approx(
            stats.ttest_rel(b, a).pvalue, rel=1e-12
        )
    assert p_value(estimate([1.0])) == 1
    assert p_value(estimate([0.0, 0.0])) == 1
    # Equal differences: the sign test's.
    assert p_value(estimate([0.5, 0.5])) == 0.5
    assert p_value(estimate([0.5] * 20)) == pytest.approx(stats.binomtest(20, 20).pvalue)


def test_holm_is_the_closure_of_bonferroni():
    """Holm rejects a hypothesis exactly where Bonferroni rejects every set that contains it."""
    rng = np.random.default_rng(2)
    for _ in range(60):
        p = rng.choice([0.001, 0.01, 0.0125, 0.02, 0.04, 0.3], size=4)
        subsets = [s for k in range(1, 5) for s in itertools.combinations(range(4), k)]
        closed = [
            all(min(p[list(s)]) <= 0.05 / len(s) for s in subsets if i in s) for i in range(4)
        ]
        assert holm(p.tolist()) == closed


def test_verdicts_name_the_scenario_and_the_settings():
    night = study(
        cell(1.0),
        cell(0.0, scenario="merge", point={"rate": 1}, seed=1),
        cell(2.0, scenario="merge", point={"rate": 5}, seed=2),
    )
    crossing, merge = findings(night)
    assert crossing.verdict == "worse"
    assert crossing.headline == "crossing: b is worse than a"
    assert "8 paired trials" in crossing.detail
    assert merge.headline == "merge: b is worse than a in 1 of 2 settings"
    assert "at rate = 5" in merge.detail


def test_no_difference_is_no_verdict():
    (finding,) = findings(study(cell(0.0)))
    assert finding.verdict == "tie"
    assert finding.headline == "crossing: no clear difference between b and a"


def test_many_comparisons_do_not_make_findings():
    """200 studies of 10 settings without any difference: by Holm at most 5 % claim one."""
    claims = 0
    for seed in range(200):
        rng = np.random.default_rng([3, seed])
        cells = []
        for k in range(10):
            results = [
                TrialResult(
                    "s", 0, t, "d", {n: {"gospa": float(rng.normal())} for n in ("a", "b")}, {}
                )
                for t in range(6)
            ]
            cells.append(CellResults(scenario="s", point={"k": k}, results=results))
        claims += findings(study(*cells))[0].verdict != "tie"
    # Binomial(200, .05) exceeds 22 with probability below 1e-4.
    assert stats.binom.sf(22, 200, 0.05) < 1e-3
    assert claims <= 22


def test_curves_average_a_trial_over_the_other_parameters():
    cells = [
        cell(point={"rate": rate, "noise": noise}, seed=rate)
        for rate in (1, 5)
        for noise in (0.1, 0.2)
    ]
    (gospa, _mota) = robustness(cells, "rate")
    assert gospa.levels == (1, 5)
    # Both noises of a rate hold the same numbers here, so the interval is that of 8 trials.
    want = estimate([r.scores["a"]["gospa"] for r in cells[0].results])
    assert gospa.lines["a"][0].n == 8
    assert gospa.lines["a"][0].high == pytest.approx(want.high)
    assert robustness([cell(point={"rate": 1})], "rate") == []


def test_trials_without_every_setting_are_left_out_of_curves():
    short = cell(point={"rate": 1, "noise": 0.2}, trials=3)
    cells = [cell(point={"rate": 1, "noise": 0.1}), short, cell(point={"rate": 2, "noise": 0.1})]
    gospa = robustness(cells, "rate")[0]
    assert [e.n for e in gospa.lines["a"]] == [3, 8]


def test_the_page_holds_everything_and_loads_nothing():
    scene = recording(frames=5)
    worst = WorstTrial(
        why=HOSTILE,
        command=HOSTILE,
        replay=ReplayPage(recording=scene, tracks={HOSTILE: tracks(scene)}),
    )
    night = study(
        *(cell(k, point={HOSTILE: k}, scenario=HOSTILE, trackers=(HOSTILE, "b")) for k in (1, 2)),
        name=HOSTILE,
        planned=20,
        commands={HOSTILE: HOSTILE},
        failures=[Failure(trial=HOSTILE, what=HOSTILE, command=HOSTILE)],
        worst=[worst],
        provenance={HOSTILE: HOSTILE},
    )
    page = study_page(night)
    outline = Outline()
    outline.feed(page)
    assert outline.handlers == []
    assert all(link.startswith("data:") for link in outline.links)
    assert outline.tags.count("img") == outline.tags.count("source") == 2  # GOSPA and MOTA
    assert "16 of 20 trials" in page
    assert page == study_page(night)


def test_an_empty_study_is_a_page_too():
    page = study_page(study(CellResults(scenario="s", point={}, results=[]), planned=10))
    assert "0 of 10 trials" in page
    assert "nothing to compare" in page


def test_markdown_is_for_a_pull_request():
    night = study(
        cell(1.0),
        commands={"Repeat it": "pmbm study night.toml"},
        failures=[Failure(trial="7", what="died | twice", command="pmbm run")],
    )
    text = study_markdown(night)
    assert text.startswith("### night\n")
    assert "- **crossing: b is worse than a**" in text
    assert "| crossing | GOSPA ↓ |" in text
    assert "died \\| twice" in text
    assert "\n    pmbm study night.toml\n" in text
    assert "| crossing | MOTA ↑ |" in text
    many = study_markdown(study(*(cell(1.0, point={"rate": k}) for k in range(5))))
    assert many.count("GOSPA ↓") == 5
    assert "MOTA" not in many
    hostile = study_markdown(study(cell(1.0, scenario=HOSTILE), name=HOSTILE))
    assert "<img" not in hostile
    assert hostile.startswith("### ")
    assert "\n# " not in hostile


def test_no_name_gets_out_of_its_block_of_code():
    """A line end in a file's name would end the block, and what follows would be a page's HTML."""
    command = "pmbm study 'a\n<img src=x>\r# b\r\n\nc.toml'"
    text = study_markdown(study(cell(1.0), commands={"Repeat it": command}))
    block = text.split("Repeat it:\n\n")[1].splitlines()
    assert block == ["    pmbm study 'a", "    <img src=x>", "    # b", "    ", "    c.toml'"]
