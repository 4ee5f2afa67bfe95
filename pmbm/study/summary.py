"""Means with intervals, and paired differences, over trials."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from pmbm.errors import InputError, nearest_hint
from pmbm.study.trial import TrialResult

LEVEL = 0.95


@dataclass(frozen=True)
class Estimate:
    """A mean over trials with its uncertainty.

    mean : None where no trial defines the value.
    sem : standard error of the mean, None below two trials.
    low, high : the Student-t interval at 95 %, None below two trials.
    n : trials that define the value.
    undefined : trials that do not; they are left out of everything above.
    """

    mean: float | None
    sem: float | None
    low: float | None
    high: float | None
    n: int
    undefined: int = 0


@dataclass(frozen=True)
class Summary:
    """Every tracker's metrics over the same trials.

    estimates : tracker -> metric -> mean over trials.
    differences : tracker -> metric -> mean of (tracker - reference), trial by trial; the
        reference itself is absent.  A trial counts where both values are defined.
    reference : the tracker that the others are compared with.
    trials : how many.
    """

    estimates: Mapping[str, Mapping[str, Estimate]]
    differences: Mapping[str, Mapping[str, Estimate]]
    reference: str
    trials: int

    @property
    def trackers(self) -> tuple[str, ...]:
        return tuple(self.estimates)

    @property
    def metrics(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for row in self.estimates.values() for name in row))


def estimate(values: Iterable[float | None]) -> Estimate:
    """Mean, standard error and 95 % Student-t interval of the values that are not None."""
    given = list(values)
    defined = np.array([value for value in given if value is not None], dtype=np.float64)
    n = len(defined)
    undefined = len(given) - n
    if n == 0:
        return Estimate(None, None, None, None, 0, undefined)
    mean = math.fsum(defined) / n
    if n == 1:
        return Estimate(mean, None, None, None, 1, undefined)
    sem = math.sqrt(math.fsum((defined - mean) ** 2) / (n - 1) / n)
    reach = float(stdtrit(n - 1, (1 + LEVEL) / 2)) * sem
    return Estimate(mean, sem, mean - reach, mean + reach, n, undefined)


def summarise(results: Sequence[TrialResult], reference: str | None = None) -> Summary:
    """The table of a run of trials; `reference` is the first tracker unless named.

    Raises InputError for no trials at all and for an unknown reference.
    """
    if not results:
        raise InputError("nothing to summarise", expected="at least one trial", got="none")
    trackers = list(results[0].scores)
    reference = trackers[0] if reference is None else reference
    if reference not in trackers:
        raise InputError(
            f"no tracker '{reference}' in these trials",
            field="reference",
            hint=nearest_hint(reference, trackers, "tracker"),
        )
    metrics = {
        tracker: list(dict.fromkeys(key for r in results for key in r.scores[tracker]))
        for tracker in trackers
    }
    columns = {
        (tracker, metric): [r.scores[tracker].get(metric) for r in results]
        for tracker in trackers
        for metric in metrics[tracker]
    }
    estimates = {t: {m: estimate(columns[t, m]) for m in metrics[t]} for t in trackers}
    differences = {
        t: {
            m: estimate(paired(columns[t, m], columns[reference, m]))
            for m in metrics[t]
            if m in metrics[reference]
        }
        for t in trackers
        if t != reference
    }
    return Summary(estimates, differences, reference, len(results))


def paired(values: Sequence[float | None], reference: Sequence[float | None]) -> list[float | None]:
    """Trial by trial, value - reference; None where either is undefined."""
    return [
        None if a is None or b is None else a - b for a, b in zip(values, reference, strict=True)
    ]
