"""Monte Carlo studies: trials, their statistics, and runs that survive anything."""

from pmbm.study.configured import ConfiguredTracker
from pmbm.study.parallel import run_trials
from pmbm.study.study import Cell, Study
from pmbm.study.summary import Estimate, Summary, estimate, summarise
from pmbm.study.trial import Source, StepTime, TrialResult, run_trial

__all__ = [
    "Cell",
    "ConfiguredTracker",
    "Estimate",
    "Source",
    "StepTime",
    "Study",
    "Summary",
    "TrialResult",
    "estimate",
    "run_trial",
    "run_trials",
    "summarise",
]
