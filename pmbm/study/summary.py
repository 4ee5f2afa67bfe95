"""Means with intervals, and paired differences, over trials."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmbm.errors import InputError, nearest_hint
from pmbm.intervals import COUNT, MEASURED, Scale, Student, Uncertainty, of_mean
from pmbm.metrics.catalogue import definition, names
from pmbm.study.trial import TrialResult
from pmbm.wording import counted

_NAMES = frozenset(names())


@dataclass(frozen=True)
class Estimate:
    """A mean over trials with its uncertainty.

    mean : None where no trial defines the value.
    sem : standard error of the mean, None below two trials and where all trials have one value,
        which says nothing of its spread.
    low, high : the interval at 95 %, see `pmbm.intervals`; None below two trials, and where all
        trials have one value and the metric's range does not bound what others could have.
    n : trials that define the value.
    undefined : trials that do not; they are left out of everything above.
    uncertainty : the p-value, and what `at` needs; None below two trials.
    """

    mean: float | None
    sem: float | None
    low: float | None
    high: float | None
    n: int
    undefined: int = 0
    uncertainty: Uncertainty | None = None

    @property
    def half(self) -> float | None:
        """Half of the interval where it is as wide to either side by its kind."""
        if not isinstance(self.uncertainty, Student) or self.mean is None or self.high is None:
            return None
        return self.high - self.mean

    def at(self, level: float) -> Estimate:
        """The same with its interval at another level."""
        ends = None if self.uncertainty is None else self.uncertainty.ends(level)
        low, high = ends or (None, None)
        return replace(self, low=low, high=high)


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

    def __repr__(self) -> str:
        return f"Summary({', '.join(self.trackers)}; {counted(self.trials, 'trial')})"

    @property
    def trackers(self) -> tuple[str, ...]:
        return tuple(self.estimates)

    @property
    def metrics(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys(name for row in self.estimates.values() for name in row))


def estimate(values: Iterable[float | None], scale: Scale = MEASURED) -> Estimate:
    """Mean, standard error and 95 % interval of the values that are not None.

    scale : the values that there can be, see `metric_scale`.
    """
    given = list(values)
    defined = np.array([value for value in given if value is not None], dtype=np.float64)
    n = len(defined)
    undefined = len(given) - n
    if n == 0:
        return Estimate(None, None, None, None, 0, undefined)
    mean = math.fsum(defined) / n
    uncertainty = of_mean(defined, scale)
    if uncertainty is None:
        return Estimate(mean, None, None, None, 1, undefined)
    sem = math.sqrt(math.fsum((defined - mean) ** 2) / (n - 1) / n) or None
    low, high = uncertainty.ends() or (None, None)
    return Estimate(mean, sem, low, high, n, undefined, uncertainty)


def metric_scale(metric: str, values: Iterable[float | None] = ()) -> Scale:
    """The values that a metric can have in a trial; of one that the catalogue does not know, whole
    numbers from 0 up where all of these `values` are such."""
    if metric in _NAMES:
        return definition(metric).scale
    known = [value for value in values if value is not None]
    whole = all(value >= 0 and float(value).is_integer() for value in known)
    return COUNT if known and whole else MEASURED


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
    scales = {
        metric: metric_scale(
            metric, (value for (_, key), each in columns.items() if key == metric for value in each)
        )
        for metric in dict.fromkeys(m for each in metrics.values() for m in each)
    }
    estimates = {t: {m: estimate(columns[t, m], scales[m]) for m in metrics[t]} for t in trackers}
    differences = {
        t: {
            m: estimate(paired(columns[t, m], columns[reference, m]), scales[m].of_differences)
            for m in metrics[t]
            if m in metrics[reference]
        }
        for t in trackers
        if t != reference
    }
    return Summary(estimates, differences, reference, len(results))


def paired(values: Sequence[float | None], reference: Sequence[float | None]) -> list[float | None]:
    """Trial by trial, value - reference, or None where either is undefined."""
    return [
        None if a is None or b is None else a - b for a, b in zip(values, reference, strict=True)
    ]
