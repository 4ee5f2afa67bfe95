"""Verdicts from evidence: the gate's rules, and Holm's correction over scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from pmbm.errors import InputError
from pmbm.regression.sequence import (
    Evidence,
    evidence,
    fewest_trials,
    hidden_rate,
    trials_without_change,
    upper_bound,
)
from pmbm.types import BoolArray, FloatArray


class Verdict(StrEnum):
    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"


@dataclass(frozen=True, kw_only=True)
class Rules:
    """The tolerated loss, and the probability of a wrong verdict.

    margin : loss tolerated, in the metric's unit, > 0; or
    relative_margin : as a share of the baseline's value, > 0.  Exactly one of the two.
    alpha : probability of a wrong verdict, of either kind, over all scenarios together, whatever
        the distribution of the values within the metric's range.
    rarest : the rarest disaster promised to be seen, as a share of trials.
    max_trials : undecided after so many.
    """

    margin: float | None = None
    relative_margin: float | None = None
    alpha: float = 0.01
    rarest: float = 0.05
    max_trials: int = 600

    def __post_init__(self) -> None:
        if (self.margin is None) == (self.relative_margin is None):
            raise InputError(
                "bad gate",
                field="margin",
                expected="one of margin and relative_margin",
                got="both" if self.margin is not None else "neither",
            )
        name = "margin" if self.margin is not None else "relative_margin"
        self._check(name, above=0.0, below=np.inf)
        self._check("alpha", above=0.0, below=0.2)
        self._check("rarest", above=0.0, below=0.5)
        if not isinstance(self.max_trials, int) or self.max_trials < 1:
            raise InputError(
                "bad gate",
                field="max_trials",
                expected="a whole number of at least 1",
                got=self.max_trials,
            )

    def _check(self, name: str, *, above: float, below: float) -> None:
        value: Any = getattr(self, name)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if not (number and above < value < below):
            bounds = f"above {above:g}" + (f" and below {below:g}" if below < np.inf else "")
            raise InputError("bad gate", field=name, expected=f"a number {bounds}", got=value)

    def check_range(self, value_range: float) -> None:
        """Raise InputError where the margin tolerates every loss within a metric's range."""
        if self.margin is not None and self.margin >= value_range:
            raise InputError(
                "bad gate",
                field="margin",
                expected=f"less than the metric's range, {value_range:g}",
                got=self.margin,
            )

    def margins(self, baseline: FloatArray) -> FloatArray:
        """The tolerated loss of each trial, given the baseline's values (N,)."""
        if self.margin is not None:
            return np.full(baseline.shape, float(self.margin))
        assert self.relative_margin is not None
        return self.relative_margin * np.abs(baseline)

    def ceiling(self, value_range: float) -> float:
        """The most by which a loss can exceed its margin."""
        if self.margin is not None:
            return value_range - self.margin
        assert self.relative_margin is not None
        return value_range * (1.0 + self.relative_margin)


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """A metric over the trials of one scenario, baseline beside candidate.

    baseline, candidate (N,) : values, lower is better.
    value_range : B, the greatest difference that two values can have; a greater one counts as B,
        as a value beyond a gated metric's bounds does.

    Raises InputError for values that are not finite or not paired, and for no range.
    """

    baseline: FloatArray
    candidate: FloatArray
    value_range: float

    def __post_init__(self) -> None:
        for name in ("baseline", "candidate"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, values)
            bad = np.flatnonzero(~np.isfinite(values))
            if values.ndim != 1 or not len(values) or len(bad):
                raise InputError(
                    "bad pairs",
                    field=name,
                    expected="a finite number of each trial, of one trial at least",
                    got=f"{values.flat[bad[0]]} in trial {bad[0]}" if len(bad) else values.shape,
                )
        if self.baseline.shape != self.candidate.shape:
            raise InputError(
                "bad pairs",
                field="candidate",
                expected=f"{len(self.baseline)} values, as the baseline has",
                got=len(self.candidate),
            )
        if not 0.0 < self.value_range < np.inf:
            raise InputError(
                "bad pairs", field="value_range", expected="a number above 0", got=self.value_range
            )

    @property
    def loss(self) -> FloatArray:
        return np.clip(self.candidate - self.baseline, -self.value_range, self.value_range)


@dataclass(frozen=True, kw_only=True)
class Decision:
    """The verdict over one scenario and what it rests on.

    trials : how many the verdict needed (all, where undecided).
    loss, low, high : mean loss of the candidate over these trials, and its confidence sequence at
        `level`, each end wrong with at most that probability at any time.  With a relative margin
        `high` is `margin` plus the bound on what a loss exceeds its own trial's margin by.
    margin : mean tolerated loss over these trials.
    baseline, candidate : mean values.
    level : alpha after Holm's correction.
    hidden : rate of disasters that so many trials cannot exclude.
    needs : trials that a pass takes where all values are equal.
    """

    verdict: Verdict
    trials: int
    loss: float
    low: float
    high: float
    margin: float
    baseline: float
    candidate: float
    level: float
    hidden: float
    needs: int
    equal: bool

    @property
    def worse_within_margin(self) -> bool:
        """A loss proven, and proven to be smaller than the margin."""
        return self.verdict is Verdict.PASS and self.low > 0


def judge(scenarios: Mapping[str, Pairs], rules: Rules) -> dict[str, Decision]:
    """The verdict over each scenario at the first trial that allows one.

    Pass: the sequence excludes a loss of the margin or more, after enough trials for rare
    disasters.  Fail: it excludes no loss, but not the margin.  A loss proven to lie between is
    no failure, and passes as "worse, within the margin" once there are enough trials.

    At every look the hypotheses of both kinds are one family to Holm's method, counted as Shaffer
    does ("Modified sequentially rejective multiple test procedures", JASA 81, 1986): at most one
    of a scenario's two is true, so that m scenarios need alpha / m, and with k of them known to
    lie between, where both are false, alpha / (m - k).  A pass or a failure alone frees nothing,
    since the scenario's other hypothesis may be true and has had its chance to be rejected.  The
    sequences hold at any time, so looking after every trial, and stopping a scenario that is
    decided, costs nothing.

    Raises InputError for a margin as wide as the range, and for a share of a baseline of zero.
    """
    check_margin(scenarios, rules)
    return {
        name: _decision(scenarios[name], rules, first)
        for name, first in first_verdicts(scenarios, rules).items()
    }


def check_margin(scenarios: Mapping[str, Pairs], rules: Rules) -> None:
    """Raise InputError for a margin as wide as the range, or a share of a baseline of zero."""
    for name, pairs in scenarios.items():
        rules.check_range(pairs.value_range)
        if rules.relative_margin is not None and not pairs.baseline.any():
            raise InputError(
                f"the baseline's mean is zero in '{name}', and so is every share of it",
                field="relative_margin",
                hint="say margin, in the metric's unit",
            )


def overall(verdicts: Sequence[Verdict]) -> Verdict:
    """Fail if any fails, pass if all pass, else undecided."""
    if Verdict.FAIL in verdicts:
        return Verdict.FAIL
    return Verdict.PASS if set(verdicts) == {Verdict.PASS} else Verdict.UNDECIDED


@dataclass(frozen=True)
class First:
    """The first trial that allows a verdict, at this level; the last one where none does."""

    verdict: Verdict
    trials: int
    level: float


def first_verdicts(scenarios: Mapping[str, Pairs], rules: Rules) -> dict[str, First]:
    """The verdicts of `judge`, without what they rest on."""
    longest = max((len(pairs.baseline) for pairs in scenarios.values()), default=0)
    levels = np.full(longest, rules.alpha / max(len(scenarios), 1))
    found = {name: _evidence(pairs, rules) for name, pairs in scenarios.items()}
    while True:
        firsts = {name: _first(proof, levels, rules.rarest) for name, proof in found.items()}
        between = np.zeros(longest, dtype=np.int64)
        for name, proof in found.items():
            both = _between(proof, levels)[: firsts[name].trials]
            if both.any():
                between[both.argmax() :] += 1
        # A level depends on what was found up to its own trial, so that each round settles one
        # more of the scenarios that leave the family.
        relaxed = rules.alpha / np.maximum(len(scenarios) - between, 1)
        if np.array_equal(relaxed, levels):
            return firsts
        levels = relaxed


def _evidence(pairs: Pairs, rules: Rules) -> Evidence:
    return evidence(
        pairs.loss,
        pairs.loss - rules.margins(pairs.baseline),
        value_range=pairs.value_range,
        ceiling=rules.ceiling(pairs.value_range),
    )


def _between(proof: Evidence, levels: FloatArray) -> BoolArray:
    """After which trials (N,) a loss is proven, and proven to be smaller than the margin."""
    level = levels[: len(proof.fail)]
    return (proof.fail <= level) & (proof.margin <= level)


def _first(proof: Evidence, levels: FloatArray, rarest: float) -> First:
    trials = len(proof.fail)
    level = levels[:trials]
    seen = (1.0 - rarest) ** np.arange(1, trials + 1) <= level
    passes = (proof.margin <= level) & seen
    either = np.flatnonzero(passes | ((proof.fail <= level) & (proof.margin > level)))
    if not len(either):
        return First(Verdict.UNDECIDED, trials, float(level[-1]))
    at = int(either[0])
    return First(Verdict.PASS if passes[at] else Verdict.FAIL, at + 1, float(level[at]))


def _decision(pairs: Pairs, rules: Rules, first: First) -> Decision:
    n = first.trials
    baseline, candidate, loss = pairs.baseline[:n], pairs.candidate[:n], pairs.loss[:n]
    margins = rules.margins(baseline)
    margin = float(margins.mean())
    ceiling = rules.ceiling(pairs.value_range)
    without_change = trials_without_change(margin, ceiling=ceiling, level=first.level)
    return Decision(
        verdict=first.verdict,
        trials=n,
        loss=float(loss.mean()),
        low=-upper_bound(-loss, pairs.value_range, first.level),
        high=margin + upper_bound(loss - margins, ceiling, first.level),
        margin=margin,
        baseline=float(baseline.mean()),
        candidate=float(candidate.mean()),
        level=first.level,
        hidden=hidden_rate(first.level, n),
        needs=max(without_change, fewest_trials(first.level, rules.rarest)),
        equal=bool(np.array_equal(baseline, candidate)),
    )
