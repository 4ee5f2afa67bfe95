"""Monte Carlo studies: trials, their statistics, and runs that survive anything."""

from pmbm.study.configured import ConfiguredTracker, follow
from pmbm.study.jackknife import Difference, jackknife_difference
from pmbm.study.parallel import TrialsInterrupted, run_trials
from pmbm.study.results import StudyResults, export, load_results
from pmbm.study.runner import Progress, run_study
from pmbm.study.sources import NamedSource, Source, is_named_source, recorded
from pmbm.study.store import read_store
from pmbm.study.study import Cell, Study
from pmbm.study.summary import Estimate, Summary, estimate, metric_scale, summarise
from pmbm.study.trial import StepTime, TrackerError, TrialResult, run_trial

__all__ = [
    "Cell",
    "ConfiguredTracker",
    "Difference",
    "Estimate",
    "NamedSource",
    "Progress",
    "Source",
    "StepTime",
    "Study",
    "StudyResults",
    "Summary",
    "TrackerError",
    "TrialResult",
    "TrialsInterrupted",
    "estimate",
    "export",
    "follow",
    "is_named_source",
    "jackknife_difference",
    "load_results",
    "metric_scale",
    "read_store",
    "recorded",
    "run_study",
    "run_trial",
    "run_trials",
    "summarise",
]
