#!/usr/bin/env bash
# Package: filterpy 2.0.0 (the same in 1.4.5).
# Expected: without a measurement the mode probabilities of an interacting multiple model filter only pass
#   through the Markov chain, mu' = mu M: there is no likelihood to weigh them by (Bar-Shalom, Li and
#   Kirubarajan, 2001, section 11.6). filterpy accepts update(None) for a missed detection.
# Seen: IMMEstimator.update(None) weighs by a likelihood all the same: that of an innovation of zero under the
#   covariance of the last update. Every miss counts as a perfect hit, and the model with the smaller innovation
#   covariance gains: after ten misses .82 where the chain has come back to .50.
# Why it matters: during an occlusion the manoeuvring model is talked out of existence, so the gate is too small
#   just when the object comes back. log_likelihood holds the same zero innovation, so a track score that sums
#   it earns a bonus for each miss.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import IMMEstimator, KalmanFilter

dt, chain = 0.5, np.array([[0.9, 0.1], [0.1, 0.9]])


def model(variance):
    kf = KalmanFilter(dim_x=2, dim_z=1)
    kf.F = np.array([[1, dt], [0, 1]])
    kf.H = np.array([[1.0, 0]])
    kf.R *= 0.5
    kf.Q = Q_discrete_white_noise(2, dt, variance)
    return kf


imm = IMMEstimator([model(0.3), model(30.0)], [0.5, 0.5], chain)
for z in (0.1, 1.2):
    imm.predict()
    imm.update(np.array([[z]]))
print("quiet and manoeuvring model after two detections:", imm.mu.round(3))
expected = imm.mu
for _ in range(10):
    imm.predict()
    imm.update(None)
    expected = expected @ chain
print("after ten misses:", imm.mu.round(3), "by the Markov chain alone:", expected.round(3))
assert abs(expected[0] - 0.5) < 0.03
assert imm.mu[0] > 0.75

kf = model(0.3)
kf.predict()
kf.update(5.0)
hit = kf.log_likelihood
kf.predict()
kf.update(None)
print(
    "log likelihood of a detection 5 m off:", round(hit, 2), "of no detection:", round(kf.log_likelihood, 2)
)
assert np.isclose(kf.log_likelihood, -0.5 * np.log(2 * np.pi * kf.S[0, 0]))
EOF
