"""What else one could judge paired trials by, beside the gate's sequence: cost and validity.

    python tests/statistical/gate_methods.py     prints the table of docs/guide/studies.md

Each method gives, for differences (S, N) in [-1, 1], an upper bound of their mean after every trial
that is meant to be wrong with probability alpha at most; a lower bound is its mirror image.
"""

import math

import numpy as np
from gate_worlds import ALPHA, FAIL, PASS, TABLE, UNDECIDED, decided, first, normal
from scipy.special import log_ndtr
from scipy.stats import t as student

COST_TRIALS = 5000
FIRST_LOOK = 5
"""Trials before the first t-test."""


def asymptotic(x):
    """The gate's sequence until it was found not to hold: a half-normal mixture of Gaussian
    likelihood ratios (Waudby-Smith, Arbour, Sinha, Kennedy, Ramdas, "Time-uniform central limit
    theory and asymptotic confidence sequences"), the variance at least 1 / n, but for values that
    are all equal so far."""
    n = np.arange(1.0, x.shape[1] + 1)
    tuned = -2.0 * math.log(2.0 * ALPHA)
    spread = (tuned + math.log(tuned) + 1.0) / 90
    mean = np.cumsum(x, axis=1) / n
    variance = (np.cumsum(x**2, axis=1) / n - mean**2) * n / np.maximum(n - 1, 1)
    target = -math.log(2.0 * ALPHA) + 0.5 * np.log(n * spread + 1.0)
    score = np.sqrt(2.0 * (target + math.log(2.0)))
    for _ in range(25):
        slope = score + np.exp(-0.5 * score**2 - 0.5 * math.log(2 * math.pi) - log_ndtr(score))
        score = score - (0.5 * score**2 + log_ndtr(score) - target) / slope
    reach = score / (n * np.sqrt(spread / (n * spread + 1.0)))
    equal = np.logical_and.accumulate(x == 0.0, axis=1)
    return np.where(equal, 0.0, mean + reach * np.sqrt(np.maximum(variance, 1.0 / n)))


def hoeffding(x):
    """Waudby-Smith and Ramdas, theorem 1: the predictable-plugin Hoeffding sequence."""
    n, unit = np.arange(1.0, x.shape[1] + 1), (1 + x) / 2
    bet = np.minimum(np.sqrt(8 * math.log(1 / ALPHA) / (n * np.log(n + 1))), 1.0)
    total = np.cumsum(bet)
    slack = (math.log(1 / ALPHA) + np.cumsum(bet**2) / 8) / total
    return 2 * (np.cumsum(bet * unit, axis=1) / total + slack) - 1


def empirical_bernstein(x):
    """Waudby-Smith and Ramdas, theorem 2: the predictable-plugin empirical-Bernstein sequence."""
    n, unit = np.arange(1.0, x.shape[1] + 1), (1 + x) / 2
    mean = (0.5 + np.cumsum(unit, axis=1)) / (n + 1)
    variance = (0.25 + np.cumsum((unit - mean) ** 2, axis=1)) / (n + 1)
    before = np.full((len(x), 1), 0.5), np.full((len(x), 1), 0.25)
    mean = np.hstack([before[0], mean[:, :-1]])
    variance = np.hstack([before[1], variance[:, :-1]])
    bet = np.minimum(np.sqrt(2 * math.log(1 / ALPHA) / (variance * n * np.log(n + 1))), 0.5)
    total = np.cumsum(bet, axis=1)
    spent = np.cumsum((unit - mean) ** 2 * (-np.log1p(-bet) - bet), axis=1)
    slack = (math.log(1 / ALPHA) + spent) / total
    return 2 * (np.cumsum(bet * unit, axis=1) / total + slack) - 1


def peeking_t_test(x):
    """Student's t at level alpha, looked at after every trial."""
    n = np.arange(1.0, x.shape[1] + 1)
    mean = np.cumsum(x, axis=1) / n
    variance = np.maximum(np.cumsum(x**2, axis=1) / n - mean**2, 0.0) * n / np.maximum(n - 1, 1)
    high = mean + student.ppf(1 - ALPHA, np.maximum(n - 1, 1)) * np.sqrt(variance / n)
    high[:, : FIRST_LOOK - 1] = np.inf
    return high


BOUNDS = {
    "asymptotic": asymptotic,
    "Hoeffding": hoeffding,
    "empirical Bernstein": empirical_bernstein,
    "t-test that peeks": peeking_t_test,
}
INVALID = ("asymptotic", "t-test that peeks")
"""Those that promise alpha only in the limit, or only for one look at normal values."""


def verdicts(method, loss, margin):
    """Verdict and trials used of each study (S,); only the two sequences of the gate's own wait
    until a disaster in 5 % of trials would have been seen."""
    if method == "betting":
        return decided(loss, margin)
    bound = BOUNDS[method]
    rarest = 0.05 if method == "asymptotic" else 1.0 - 1e-9
    return first(bound(loss) < margin, -bound(-loss) > 0.0, rarest)


def in_parts(method, world, trials, studies, seed):
    """Verdicts and trials of so many studies, drawn a few at a time."""
    rng, size = np.random.default_rng(seed), max(1, 2**18 // trials)
    parts = []
    for start in range(0, studies, size):
        loss = world.draw(rng, (min(size, studies - start), trials))
        parts.append(verdicts(method, loss, world.margin))
    return (np.concatenate(part) for part in zip(*parts, strict=True))


def cost(method, mean, sd, margin, wanted):
    """Mean trials of a verdict, as text."""
    studies = 1 if sd == 0.0 else 200
    found, trials = in_parts(method, normal(mean, sd, margin), COST_TRIALS, studies, seed=1)
    if (found == UNDECIDED).any():
        return f"> {COST_TRIALS}"
    assert (found == wanted).mean() > 0.9
    return f"{trials.mean():.0f}"


def main():
    columns = "equal values, margin 5 / 2 / 1 %", "no change, 5 / 2 %", "worse, 5 / 2 %"
    print(f"| | {' | '.join(columns)} | wrong verdicts |")
    print("|---|---:|---:|---:|---:|")
    for method in ("betting", *BOUNDS):
        equal = [cost(method, 0.0, 0.0, margin, PASS) for margin in (0.05, 0.02, 0.01)]
        same = [cost(method, 0.0, 0.03, margin, PASS) for margin in (0.05, 0.02)]
        worse = [cost(method, 2 * margin, 0.03, margin, FAIL) for margin in (0.05, 0.02)]
        rates = []
        for world in TABLE:
            found, _ = in_parts(method, world, world.trials, 2000, seed=2)
            rates.append((found == world.wrong).mean())
        cells = [" / ".join(part) for part in (equal, same, worse)]
        name = f"{method} (invalid)" if method in INVALID else method
        print(f"| {name} | {' | '.join(cells)} | up to {max(rates):.3f} |", flush=True)


if __name__ == "__main__":
    main()
