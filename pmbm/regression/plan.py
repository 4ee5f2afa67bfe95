"""The cost of a gate before it runs: the least number of trials, and the number with the spread
that a few show."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from pmbm.regression.gate import GateEntry, paired_values
from pmbm.regression.metric import GatedMetric
from pmbm.regression.sequence import evidence, fewest_trials, trials_without_change
from pmbm.regression.verdicts import Pairs, Rules

_STUDIES = 100
_AT_MOST = 5000
"""Trials of a resampled study."""


@dataclass(frozen=True)
class Pilot:
    """A few trials of one scenario, run to see how far apart they lie and how long they take.

    seconds : of one trial, with both trackers.
    """

    pairs: Pairs
    seconds: float

    @property
    def spread(self) -> float:
        """Standard deviation of the losses."""
        return float(self.pairs.loss.std(ddof=1)) if len(self.pairs.loss) > 1 else 0.0


def run_pilot(name: str, entry: GateEntry, metric: GatedMetric, *, seed: int, trials: int) -> Pilot:
    """The first trials of a scenario, timed; as many as are stored where those are fewer.

    Raises InputError where the candidate or the baseline raises.
    """
    start = perf_counter()
    pairs = paired_values(name, entry, metric, seed=seed, trials=trials)
    return Pilot(pairs, (perf_counter() - start) / len(pairs.loss))


def least_trials(margin: float, value_range: float, rules: Rules, scenarios: int) -> int:
    """Trials of a pass where all values are equal; a better candidate may take fewer.

    margin : in the metric's unit; the mean of what is tolerated.
    """
    level = rules.alpha / scenarios
    alone = trials_without_change(margin, ceiling=rules.ceiling(value_range), level=level)
    return max(alone, fewest_trials(level, rules.rarest))


def trials_with_spread(pairs: Pairs, rules: Rules, scenarios: int) -> int | None:
    """The median number of trials of a pass where the losses spread as these do, about nothing:
    over studies resampled from them.  None where that is more than 5000."""
    level = rules.alpha / scenarios
    floor = fewest_trials(level, rules.rarest)
    drawn = np.random.default_rng(0).integers(len(pairs.loss), size=(_STUDIES, _AT_MOST))
    loss, margins = pairs.loss - pairs.loss.mean(), rules.margins(pairs.baseline)
    trials = np.full(_STUDIES, np.inf)
    for study, rows in enumerate(drawn):
        proof = evidence(
            loss[rows],
            loss[rows] - margins[rows],
            value_range=pairs.value_range,
            ceiling=rules.ceiling(pairs.value_range),
        )
        passes = np.flatnonzero(proof.margin[floor - 1 :] <= level)
        if len(passes):
            trials[study] = floor + passes[0]
    found = float(np.median(trials))
    return int(found) if np.isfinite(found) else None
