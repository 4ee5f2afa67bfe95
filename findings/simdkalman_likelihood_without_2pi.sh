#!/usr/bin/env bash
# Package: simdkalman 1.0.4.
# Expected: compute(log_likelihood=True) returns "the log-likelihood(s) for the entire series", log p(y_1 .. y_n), and
#   likelihoods=True the "likelihoods of each step".
# Seen: the term log(2 pi) / 2 is missing for each measured value, and no document says so. A series of six positions
#   in x and y is 11.03 too high, with one of them missing (NaN) 9.19; states and covariances are right.
#   likelihoods=True alone returns none; with log_likelihood=True they are there as log_likelihoods, in logarithms.
# Why it matters: the constant cancels only between models of the same measurements. Beside a clutter density, a birth
#   or another package's likelihood each detection in x and y counts 6.28 times as much as it should, so tracks with
#   more detections win and clutter is taken for objects.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps simdkalman==1.0.4 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from scipy.stats import multivariate_normal
from simdkalman import KalmanFilter

steps = 6
transition = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])  # x, vx, y, vy
measurement = np.eye(4)[::2]
motion, noise, prior = 0.1 * np.eye(4), 4 * np.eye(2), 10 * np.eye(4)
series = np.random.default_rng(0).normal(scale=3, size=(steps, 2))
gap = series.copy()
gap[3] = np.nan


def by_joint_gaussian(values):
    """Log density of all measured values at once: no filter is run."""
    covariance = np.zeros((4 * steps, 4 * steps))
    marginal = prior
    for i in range(steps):
        block = marginal
        for j in range(i, steps):
            covariance[4 * i : 4 * i + 4, 4 * j : 4 * j + 4] = block
            covariance[4 * j : 4 * j + 4, 4 * i : 4 * i + 4] = block.T
            block = block @ transition.T
        marginal = transition @ marginal @ transition.T + motion
    wide = np.kron(np.eye(steps), measurement)
    total = wide @ covariance @ wide.T + np.kron(np.eye(steps), noise)
    seen = ~np.isnan(values.ravel())
    return multivariate_normal.logpdf(values.ravel()[seen], cov=total[np.ix_(seen, seen)])


kf = KalmanFilter(transition, motion, measurement, noise)
common = {"initial_value": np.zeros(4), "initial_covariance": prior}
for name, values, count in (("six positions", series, 12), ("one missing", gap, 10)):
    result = kf.compute(values[None], 0, log_likelihood=True, likelihoods=True, **common)
    (seen,) = result.log_likelihood
    right = by_joint_gaussian(values)
    print(f"{name}: log likelihood {seen:.3f}, right {right:.3f}, difference {seen - right:.3f}")
    assert np.isclose(seen - right, 0.5 * count * np.log(2 * np.pi))
    assert np.isclose(result.log_likelihoods.sum(), seen)

alone = kf.compute(series[None], 0, likelihoods=True, **common)
print("likelihoods=True alone returns:", sorted(vars(alone)))
assert not any("likelihood" in field for field in vars(alone))
EOF
