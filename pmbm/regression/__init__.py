"""Did the tracker get worse? Paired trials, an honest verdict, and what to do about it."""

from pmbm.regression.gate import GateEntry, GateReport, SceneReport, run_gate
from pmbm.regression.metric import GatedMetric, gated_metric
from pmbm.regression.plan import Pilot, least_trials, run_pilot, trials_with_spread
from pmbm.regression.stored import StoredBaseline, load_baseline
from pmbm.regression.storing import Change, store_baseline
from pmbm.regression.verdicts import Decision, Pairs, Rules, Verdict, judge

__all__ = [
    "Change",
    "Decision",
    "GateEntry",
    "GateReport",
    "GatedMetric",
    "Pairs",
    "Pilot",
    "Rules",
    "SceneReport",
    "StoredBaseline",
    "Verdict",
    "gated_metric",
    "judge",
    "least_trials",
    "load_baseline",
    "run_gate",
    "run_pilot",
    "store_baseline",
    "trials_with_spread",
]
