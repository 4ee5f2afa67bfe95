"""Measure a tracker's values and store them as the baseline, and say what that changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pmbm.errors import InputError
from pmbm.regression.metric import GatedMetric
from pmbm.regression.plan import least_trials
from pmbm.regression.stored import StoredBaseline, Trials, load_baseline
from pmbm.regression.verdicts import Pairs, Rules, Verdict, judge
from pmbm.study import Source, run_trials
from pmbm.tracking import TrackerFactory
from pmbm.wording import counted

_FOR_SPREAD = 1.25
"""Trials stored, over those of a pass where all values are equal: what two trackers of equal merit
take whose values spread by a few percent of the range."""
_PILOT = 10
"""Trials that say how much a share of the baseline is."""

Progress = Callable[[str, int, int], None]
"""Called with a scenario, its trials done and the trials there will be."""


@dataclass(frozen=True)
class Change:
    """The change that storing makes in one scenario.

    verdict : of the new values against the old ones; None where these are not to be compared, for
        the `reason`.
    """

    scenario: str
    old: float | None
    new: float
    trials: int
    verdict: Verdict | None
    reason: str = ""

    @property
    def worse(self) -> bool:
        return self.verdict is Verdict.FAIL

    def in_words(self, metric: str) -> str:
        """One line: old and new mean, and the verdict."""
        trials = counted(self.trials, "trial")
        if self.old is None or self.verdict is None:
            return f"{self.scenario}: {metric} {self.new:.4g}, {trials}; {self.reason}"
        word = {Verdict.FAIL: "worse", Verdict.PASS: "no worse", Verdict.UNDECIDED: "undecided"}
        return (
            f"{self.scenario}: {metric} {self.old:.4g} -> {self.new:.4g}, "
            f"{word[self.verdict]}; {trials}"
        )


def store_baseline(
    file: Path,
    entries: Mapping[str, tuple[Source, TrackerFactory | str]],
    metric: GatedMetric,
    rules: Rules,
    *,
    seed: int,
    tracker: str,
    code: str,
    jobs: int = 1,
    progress: Progress | None = None,
) -> tuple[Change, ...]:
    """Run a tracker alone over each scenario and store its values, as many trials as the margin's
    plan takes; what it changes, scenario by scenario.

    Raises InputError where the tracker raises.
    """
    rules.check_range(metric.value_range)
    tell = progress or (lambda name, done, most: None)

    def measured(name: str, trials: int) -> Trials:
        source, factory = entries[name]
        results = run_trials(
            source, {tracker: factory}, seed, trials, jobs, partial(tell, name), metric
        )
        return tuple((r.recording, float(r.of(tracker)["gated"] or 0.0)) for r in results)

    def planned(name: str) -> int:
        margin = rules.margin
        if margin is None:
            values = [value for _, value in measured(name, min(_PILOT, rules.max_trials))]
            margin = float(rules.margins(np.array(values)).mean())
        if not margin:
            return rules.max_trials
        least = least_trials(margin, metric.value_range, rules, len(entries))
        return min(rules.max_trials, math.ceil(_FOR_SPREAD * least))

    scenarios = {name: measured(name, planned(name)) for name in entries}
    new = StoredBaseline(
        metric=metric.name,
        bounds=metric.bounds,
        seed=seed,
        tracker=tracker,
        code=code,
        scenarios=scenarios,
    )
    changes = tuple(_change(_old(file), new, name, metric, rules) for name in scenarios)
    new.write(file)
    return changes


def _old(file: Path) -> StoredBaseline | None:
    """The baseline in the file now, or None where there is nothing, or nothing readable."""
    try:
        return load_baseline(file)
    except InputError:
        return None


def _change(
    old: StoredBaseline | None, new: StoredBaseline, name: str, metric: GatedMetric, rules: Rules
) -> Change:
    after = new.scenarios[name]
    trials, mean = len(after), new.mean(name)
    before = () if old is None else old.scenarios.get(name, ())
    if old is None or not before:
        return Change(name, None, mean, trials, None, "nothing was stored before")
    common = min(len(before), trials)
    same = (old.metric, old.bounds, old.seed) == (new.metric, new.bounds, new.seed) and all(
        after[trial][0].startswith(before[trial][0]) for trial in range(common)
    )
    if not same:
        return Change(name, None, mean, trials, None, "what was stored is of other recordings")
    pairs = Pairs(
        baseline=np.array([value for _, value in before[:common]]),
        candidate=np.array([value for _, value in after[:common]]),
        value_range=metric.value_range,
    )
    try:
        verdict = judge({name: pairs}, rules)[name].verdict
    except InputError as error:
        return Change(name, old.mean(name), mean, trials, None, str(error))
    return Change(name, old.mean(name), mean, trials, verdict)
