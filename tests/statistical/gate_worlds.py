"""Simulated studies for the gate: worlds of paired differences, and the verdicts over them.

The metric's range is 1, differences lie in [-1, 1].  Verdicts of many studies at once are found
from the evidence by the two rules written out here; a test compares them with `judge`.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pmbm.regression.sequence import evidence

ALPHA = 0.01
RAREST = 0.05
PASS, FAIL, UNDECIDED = 1, -1, 0
_CHUNK = 2**18
"""Trials handled at a time, so that arrays stay small."""


@dataclass(frozen=True)
class World:
    """Differences of paired trials whose distribution is known.

    draw : of a generator and a shape, differences.
    margin : the gate's.
    mean : of the differences, exactly.
    trials : how many a study may have.
    """

    name: str
    draw: Callable[[np.random.Generator, tuple[int, int]], np.ndarray]
    margin: float
    mean: float
    trials: int = 600

    @property
    def wrong(self):
        """The verdict that would be wrong, None in between."""
        if self.mean >= self.margin - 1e-12:
            return PASS
        return FAIL if self.mean <= 1e-12 else None


def points(name, values, shares, margin, trials=600):
    """A world of a few values, each with its share of the trials; None stands for what is left."""
    shares = np.array([1.0 - sum(s for s in shares if s) if s is None else s for s in shares])
    values = np.array(values, dtype=float)

    def draw(rng, shape):
        return rng.choice(values, shape, p=shares)

    return World(name, draw, margin, float(values @ shares), trials)


def balanced(name, value, share, mean, margin, trials=600):
    """A world of `value` in a share of trials, and else a constant that makes the mean this."""
    rest = (mean - share * value) / (1.0 - share)
    return points(name, [value, rest], [share, None], margin, trials)


def normal(mean, sd, margin, trials=1500):
    """Normal differences, as today's benign worlds have them."""
    return World(
        f"normal, sd {sd:g}, mean {mean:g}",
        lambda rng, shape: rng.normal(mean, sd, shape).clip(-1.0, 1.0),
        margin,
        mean,
        trials,
    )


def beta(a, b, low, high, margin, trials=600):
    """Beta differences between two values, skewed and heaped at the ends where a, b < 1."""
    mean = low + (high - low) * a / (a + b)
    return World(
        f"beta({a:g}, {b:g}) in [{low:g}, {high:g}]",
        lambda rng, shape: low + (high - low) * rng.beta(a, b, shape),
        margin,
        mean,
        trials,
    )


def calm_and_wild(mean, margin, trials=1000):
    """Coins of a spread that differs from one run of trials to the next; the mean never does."""

    def draw(rng, shape):
        spread = np.where(np.arange(shape[1]) // 37 % 2, 1.0 - abs(mean), 0.02)
        return mean + spread * rng.choice([-1.0, 1.0], shape)

    return World(f"coins, calm and wild in turn, mean {mean:g}", draw, margin, mean, trials)


def heavy_tail(mean, margin, sign, trials=1000):
    """Differences of +-2^-k with shares that fall as fast: each size weighs the same."""
    sizes = 0.5 ** np.arange(9)
    shares = 0.5 ** np.arange(9, 0, -1)
    shares /= shares.sum()
    values = sign * sizes
    rest = (mean - 0.5 * values @ shares) / 0.5
    return points(
        f"half heavy tail of 2^-k ({'losses' if sign > 0 else 'gains'}), mean {mean:g}",
        [*values, rest],
        [*(0.5 * shares), 0.5],
        margin,
        trials,
    )


TABLE = [
    points("0, and 1 with probability .01", [1, 0], [0.01, None], 0.01, 1000),
    points("0, and 1 with probability .02", [1, 0], [0.02, None], 0.02),
    points("0, and 1 with probability .02", [1, 0], [0.02, None], 0.01),
    points("0, and 1 with probability .03", [1, 0], [0.03, None], 0.01),
    balanced("a constant, and 1 with probability .03", 1, 0.03, 0.02, 0.02),
    balanced("a small loss, and a gain of 1 with probability .05", -1, 0.05, 0.0, 0.02, 1000),
]
"""Worlds in which an asymptotic sequence goes wrong in up to 42 % of studies."""

BENIGN = [
    normal(0.0, 0.03, 1 / 60),
    normal(0.0, 0.2, 0.05),
    normal(1 / 60, 0.03, 1 / 60),
    normal(0.05, 0.2, 0.05),
    points("0, and 1 with probability .05", [1, 0], [0.05, None], 1 / 60, 1500),
    points("0, and .6 with probability .05", [0.6, 0], [0.05, None], 0.01, 1500),
]

ELSEWHERE = [
    points("coins", [1, -1], [0.5, None], 0.05, 1000),
    points("coins", [1, -1], [0.5, None], 0.5, 1000),
    points("coins at the margin", [1, -1], [0.525, None], 0.05, 1000),
    points("coins at the margin", [1, -1], [0.75, None], 0.5, 1000),
    points("coins of a tenth", [0.1, -0.1], [0.5, None], 0.05, 1000),
    points("-1, 0, 1", [1, -1, 0], [0.005, 0.005, None], 0.02, 5000),
    points("-1, 0, 1 at the margin", [1, -1, 0], [0.06, 0.01, None], 0.05, 1000),
    points("always the margin", [0.05], [1.0], 0.05),
    points("always nothing", [0.0], [1.0], 1e-9),
    balanced("a gain, and 1 with probability .1", 1, 0.1, 0.05, 0.05),
    balanced("a gain, and 1 with probability .3", 1, 0.3, 0.02, 0.02, 1000),
    balanced("a gain, and 1 with probability .5", 1, 0.5, 0.2, 0.2, 1000),
    balanced("-1 with probability .1, else a loss", -1, 0.1, 0.05, 0.05),
    balanced("a loss, and -1 with probability .005", -1, 0.005, 0.0, 0.02, 5000),
    balanced("a loss, and -1 with probability .3", -1, 0.3, 0.0, 0.02, 1000),
    balanced("a gain, and 1 with probability .01", 1, 0.01, 0.0, 0.02, 5000),
    balanced("a constant, and 1 with probability .004", 1, 0.004, 0.005, 0.005, 5000),
    beta(0.02, 0.98, 0.0, 1.0, 0.02, 1000),
    beta(0.05, 0.05, -1.0, 1.0, 0.05, 1000),
    beta(9.5, 0.5, -1.0, 1.0 / 19.0, 0.02, 1000),
    beta(0.5, 9.5, 0.0, 1.0, 0.05, 1000),
    heavy_tail(0.02, 0.02, 1),
    heavy_tail(0.0, 0.02, -1),
    heavy_tail(0.0, 0.02, 1),
    calm_and_wild(0.0, 0.05),
    calm_and_wild(0.05, 0.05),
]


def verdicts(world, studies, seed):
    """Verdict and trials used, (studies,) each."""
    rng = np.random.default_rng(seed)
    size = max(1, _CHUNK // world.trials)
    found = []
    while sum(len(v) for v, _ in found) < studies:
        found.append(decided(world.draw(rng, (size, world.trials)), world.margin))
    verdict, trials = (np.concatenate(part)[:studies] for part in zip(*found, strict=True))
    return verdict, trials


def decided(loss, margin):
    """Verdict and trials used of each study (S,), whose differences are (S, N)."""
    proof = evidence(loss, loss - margin, value_range=1.0, ceiling=1.0 - margin)
    return first(proof.margin <= ALPHA, proof.fail <= ALPHA)


def first(no_margin, some_loss, rarest=RAREST):
    """Verdict and trials used of each study, from what (S, N) is excluded after each trial."""
    seen = (1.0 - rarest) ** np.arange(1, no_margin.shape[1] + 1) <= ALPHA
    passes, fails = no_margin & seen, some_loss & ~no_margin
    either = passes | fails
    at = either.argmax(axis=1)
    row = np.arange(len(at))
    verdict = np.where(passes[row, at], PASS, np.where(fails[row, at], FAIL, UNDECIDED))
    return verdict, np.where(verdict == UNDECIDED, no_margin.shape[1], at + 1)
