"""From evidence to verdicts: the gate's rules, and Holm's correction over scenarios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
)
from pmbm.types import FloatArray


class Verdict(StrEnum):
    PASS = "pass"
    FAIL = "fail"
    UNDECIDED = "undecided"


@dataclass(frozen=True, kw_only=True)
class Rules:
    """What is tolerated, and how sure one wants to be.

    margin : loss tolerated, in the metric's unit, > 0; or
    relative_margin : as a share of the baseline's value, > 0.  Exactly one of the two.
    alpha : probability of a wrong verdict, of either kind, over all scenarios together.
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

    def margins(self, baseline: FloatArray) -> FloatArray:
        """The tolerated loss of each trial, given the baseline's values (N,)."""
        if self.margin is not None:
            return np.full(baseline.shape, float(self.margin))
        assert self.relative_margin is not None
        return self.relative_margin * np.abs(baseline)


@dataclass(frozen=True, kw_only=True)
class Pairs:
    """A metric over the trials of one scenario, baseline beside candidate.

    baseline, candidate (N,) : values, lower is better.
    value_range : B, the greatest difference that two values can have.
    """

    baseline: FloatArray
    candidate: FloatArray
    value_range: float

    @property
    def loss(self) -> FloatArray:
        return self.candidate - self.baseline

    @property
    def equal(self) -> bool:
        return bool(np.array_equal(self.baseline, self.candidate))


@dataclass(frozen=True, kw_only=True)
class Decision:
    """The verdict over one scenario and what it rests on.

    trials : how many the verdict needed (all, where undecided).
    loss, low, high : mean loss of the candidate over these trials, and its confidence sequence at
        `level`: at any time each end is wrong with at most that probability.
    margin : mean tolerated loss over these trials.
    baseline, candidate : mean values.
    level : alpha after Holm's correction.
    hidden : rate of disasters that so many trials cannot exclude.
    needs : trials below which this margin is never decided unless all values are equal.
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

    Passes and failures are each corrected over the scenarios by Holm's method: with k of m
    decided, the next needs alpha / (m - k).  The p-values hold at any time, so looking after
    every trial, and stopping a scenario that is decided, costs nothing.
    """
    found = {name: _evidence(pairs, rules) for name, pairs in scenarios.items()}
    decided: dict[str, _First] = {}
    while True:
        levels = _levels(decided, len(scenarios), rules.alpha)
        news = {
            name: first
            for name, proof in found.items()
            if name not in decided and (first := _first(proof, levels)) is not None
        }
        if not news:
            break
        decided |= news
    open_level = min(levels.values())
    return {
        name: _decision(
            pairs,
            rules,
            decided.get(name) or _First(Verdict.UNDECIDED, len(pairs.baseline), open_level),
        )
        for name, pairs in scenarios.items()
    }


def overall(verdicts: Sequence[Verdict]) -> Verdict:
    """Fail if any fails, pass if all pass, else undecided."""
    if Verdict.FAIL in verdicts:
        return Verdict.FAIL
    return Verdict.PASS if set(verdicts) == {Verdict.PASS} else Verdict.UNDECIDED


def _evidence(pairs: Pairs, rules: Rules, level: float | None = None) -> Evidence:
    # A share of the baseline's value widens what a trial can contribute by that share.
    wider = 1.0 + (rules.relative_margin or 0.0)
    return evidence(
        pairs.loss,
        rules.margins(pairs.baseline),
        value_range=pairs.value_range * wider,
        alpha=rules.alpha,
        rarest=rules.rarest,
        level=level,
    )


@dataclass(frozen=True)
class _First:
    """The first trial that allows a verdict, at this level."""

    verdict: Verdict
    trials: int
    level: float


def _levels(decided: Mapping[str, _First], scenarios: int, alpha: float) -> dict[Verdict, float]:
    """Holm's level for the next pass and for the next failure."""
    verdicts = [first.verdict for first in decided.values()]
    return {
        kind: alpha / max(scenarios - verdicts.count(kind), 1)
        for kind in (Verdict.PASS, Verdict.FAIL)
    }


def _first(proof: Evidence, levels: Mapping[Verdict, float]) -> _First | None:
    passes = proof.p_pass <= levels[Verdict.PASS]
    between = proof.p_margin <= levels[Verdict.PASS]
    fails = (proof.p_fail <= levels[Verdict.FAIL]) & ~between
    either = np.flatnonzero(passes | fails)
    if not len(either):
        return None
    verdict = Verdict.PASS if passes[either[0]] else Verdict.FAIL
    return _First(verdict, int(either[0]) + 1, levels[verdict])


def _decision(pairs: Pairs, rules: Rules, first: _First) -> Decision:
    n = first.trials
    used = replace(pairs, baseline=pairs.baseline[:n], candidate=pairs.candidate[:n])
    proof = _evidence(used, rules, first.level)
    margin = float(rules.margins(used.baseline).mean())
    return Decision(
        verdict=first.verdict,
        trials=n,
        loss=float(proof.loss[-1]),
        low=float(proof.low[-1]),
        high=float(proof.high[-1]),
        margin=margin,
        baseline=float(used.baseline.mean()),
        candidate=float(used.candidate.mean()),
        level=first.level,
        hidden=hidden_rate(first.level, n),
        needs=_needs(margin, pairs, rules),
        equal=used.equal,
    )


def _needs(margin: float, pairs: Pairs, rules: Rules) -> int:
    if margin <= 0:
        return fewest_trials(rules.alpha, rules.rarest)
    return trials_without_change(
        margin, value_range=pairs.value_range, alpha=rules.alpha, rarest=rules.rarest
    )
