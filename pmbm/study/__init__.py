"""Monte Carlo studies: trials, their statistics, and runs that survive anything."""

from pmbm.study.parallel import run_trials
from pmbm.study.summary import Estimate, Summary, estimate, summarise
from pmbm.study.trial import Source, StepTime, TrialResult, run_trial

__all__ = [
    "Estimate",
    "Source",
    "StepTime",
    "Summary",
    "TrialResult",
    "estimate",
    "run_trial",
    "run_trials",
    "summarise",
]
