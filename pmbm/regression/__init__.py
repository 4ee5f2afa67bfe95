"""Did the tracker get worse? Paired trials, an honest verdict, and what to do about it."""

from pmbm.regression.gate import Entry, GateReport, SceneReport, run_gate
from pmbm.regression.metric import GatedMetric, gated_metric
from pmbm.regression.stored import StoredBaseline, load_baseline
from pmbm.regression.verdicts import Decision, Pairs, Rules, Verdict, judge

__all__ = [
    "Decision",
    "Entry",
    "GateReport",
    "GatedMetric",
    "Pairs",
    "Rules",
    "SceneReport",
    "StoredBaseline",
    "Verdict",
    "gated_metric",
    "judge",
    "load_baseline",
    "run_gate",
]
