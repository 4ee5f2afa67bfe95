#!/usr/bin/env bash
# Package: filterpy 2.0.0.
# Expected: the information filter is the Kalman filter in other variables, so its log_likelihood, the
#   "log-likelihood of the last measurement", is log N(y; 0, H P H' + R) in both, y being the innovation.
# Seen: InformationFilter takes for the covariance of y its own S, which is the information matrix of the updated
#   state. State and covariance agree with KalmanFilter to 1e-12, while an innovation of 6 m has log likelihood -69.1
#   for -4.1 (two states, one measurement). With four states and two measurements update() raises a ValueError, unless
#   compute_log_likelihood, on by default, is switched off.
# Why it matters: likelihoods choose between models, hypotheses and parameters, and information is the reverse of a
#   covariance: of two noise levels, R 1 and R 25, that innovation speaks for 25, and InformationFilter for 1.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from filterpy.kalman import InformationFilter, KalmanFilter


def last_likelihoods(variance, axes=1):
    """Log likelihood of an innovation of 6 m after five of 0: by hand and in the two filters."""
    n = 2 * axes
    transition, measurement = np.kron(np.eye(axes), [[1.0, 1.0], [0.0, 1.0]]), np.eye(n)[::2]
    kalman, information = KalmanFilter(n, axes), InformationFilter(n, axes)
    for kf in (kalman, information):
        kf.F, kf.H, kf.Q = transition, measurement, 0.1 * np.eye(n)
    kalman.P, information.P_inv = 10 * np.eye(n), np.eye(n) / 10
    kalman.R, information.R_inv = variance * np.eye(axes), np.eye(axes) / variance
    for z in (0.0, 0.0, 0.0, 0.0, 0.0, 6.0):
        for kf in (kalman, information):
            kf.predict()
        s = (measurement @ kalman.P @ measurement.T)[0, 0] + variance
        for kf in (kalman, information):
            kf.update(np.full((axes, 1), z))
    assert np.allclose(kalman.x, information.x, atol=1e-12) and np.allclose(kalman.P, information.P, atol=1e-12)
    by_hand = -0.5 * (np.log(2 * np.pi * s) + 6.0**2 / s)
    return by_hand, kalman.log_likelihood, information.log_likelihood


for variance in (1.0, 4.0, 25.0):
    right, seen, wrong = last_likelihoods(variance)
    print(f"R {variance}: by hand {right:.2f}, KalmanFilter {seen:.2f}, InformationFilter {wrong:.2f}")
    assert np.isclose(right, seen)
assert last_likelihoods(4.0)[2] < -60 < -5 < last_likelihoods(4.0)[0]
assert last_likelihoods(25.0)[0] > last_likelihoods(1.0)[0]
assert last_likelihoods(25.0)[2] < last_likelihoods(1.0)[2]
try:
    last_likelihoods(4.0, axes=2)
except ValueError as error:
    print("four states, two measurements:", error)
else:
    raise AssertionError("four states and two measurements have a likelihood now")
EOF
