"""Write tests/oracle/gate/confseq.json: wealths and bounds that the package confseq gives.

    apt-get install libboost-dev
    pip install 'numpy<2' 'pandas<3' scikit-build cmake ninja pybind11 setuptools
    pip install confseq==0.0.11 --no-build-isolation
    python tests/oracle/gate_answers.py

confseq is source only and wants a numpy of before 2, so that this runs outside the suite.  Its
values lie in [0, 1]; differences in [-1, 1] are mapped onto them.  The bets and weights are written
out here, not imported: the largest bet with half of the weight, seven that halve it.
"""

import json
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
from confseq.betting import cs_from_martingale, diversified_betting_mart

FILE = Path(__file__).with_name("gate") / "confseq.json"
LEVEL = 0.01
BREAKS = 2000
SHARES = [1, 1 / 2, 1 / 4, 1 / 8, 1 / 16, 1 / 32, 1 / 64, 1 / 128]
WEIGHTS = [1 / 2] + [1 / 14] * 7


def worlds():
    """Differences (120,) of several kinds, in [-1, 1]."""
    rng = np.random.default_rng(20240216)
    n = 120
    rare = np.where(rng.random(n) < 0.05, 1.0, -0.01)
    coins = np.where(rng.random(n) < 0.5, 1.0, -1.0)
    return {
        "equal": np.zeros(n),
        "calm": np.clip(rng.normal(0.0, 0.03, n), -1, 1),
        "worse": np.clip(rng.normal(0.1, 0.03, n), -1, 1),
        "noisy": np.clip(rng.normal(0.05, 0.4, n), -1, 1),
        "rare": rare,
        "coins": coins,
        "skewed": 2 * rng.beta(0.2, 0.8, n) - 1,
        "ceiling": np.ones(n),
    }


def wealth(unit, mean, theta):
    """Wealth against "the mean is at least `mean`" (theta 0) or at most (theta 1), by confseq."""
    return diversified_betting_mart(
        unit,
        mean,
        lambdas_fns_positive=[lambda x, m, c=c: np.repeat(c / m, len(x)) for c in SHARES],
        lambdas_fns_negative=[lambda x, m, c=c: np.repeat(c / (1 - m), len(x)) for c in SHARES],
        lambdas_weights=WEIGHTS,
        theta=theta,
        trunc_scale=1,
    )


def bounds(unit):
    """Lower and upper ends after every trial, on a grid of `BREAKS` means, each at `LEVEL`."""
    inner = lambda theta: lambda x, m: wealth(x, min(max(m, 1e-9), 1 - 1e-9), theta)  # noqa: E731
    low, _ = cs_from_martingale(unit, inner(1), breaks=BREAKS, alpha=LEVEL)
    _, high = cs_from_martingale(unit, inner(0), breaks=BREAKS, alpha=LEVEL)
    return low, high


def main():
    cases = {}
    for name, loss in worlds().items():
        unit = (1 + loss) / 2
        low, high = bounds(unit)
        cases[name] = {
            "loss": loss.tolist(),
            "above": {m: wealth(unit, (1 + m) / 2, 0).tolist() for m in (0.01, 0.05, 0.3)},
            "below": {m: wealth(unit, (1 + m) / 2, 1).tolist() for m in (0.0, -0.2)},
            "low": (2 * low - 1).tolist(),
            "high": (2 * high - 1).tolist(),
        }
    FILE.parent.mkdir(exist_ok=True)
    document = {
        "command": "python tests/oracle/gate_answers.py",
        "versions": {name: version(name) for name in ("confseq", "numpy")}
        | {"python": sys.version.split()[0]},
        "level": LEVEL,
        "grid": 2 / BREAKS,
        "cases": cases,
    }
    FILE.write_text(json.dumps(document) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
