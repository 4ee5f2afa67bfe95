#!/usr/bin/env bash
# Package: filterpy 2.0.0 (in 1.4.5 the unscented filter did the same; 2.0.0 mended that one alone).
# Expected: on a linear model with Gaussian noise every sigma point filter equals the Kalman filter. The paper
#   that CubatureKalmanFilter cites (Arasaratnam and Haykin, IEEE TAC 54, 2009, measurement update, step 1)
#   factorises the predicted covariance and draws new points before it predicts the measurement.
# Seen: CubatureKalmanFilter keeps the points from before the process noise was added, so neither the innovation
#   covariance nor the gain contains Q. With P .01, Q 1, R 1 and z 3 it answers S 1.01 and mean .03 where S 2.01
#   and mean 1.51 are right; UnscentedKalmanFilter agrees with the hand values to 1e-12.
# Why it matters: a tracker that swaps its UKF for the CKF stops listening to its measurements where the motion
#   model is loose, and gates on an innovation covariance of half the size. No warning is raised.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from filterpy.kalman import CubatureKalmanFilter, JulierSigmaPoints, UnscentedKalmanFilter

P, Q, R, z = 0.01, 1.0, 1.0, 3.0


def run(f):
    f.x, f.P, f.Q, f.R = np.zeros(f.x.shape), np.array([[P]]), np.array([[Q]]), np.array([[R]])
    f.predict()
    f.update(np.array([z]).reshape(f.x.shape))
    return f.S[0, 0], f.x.ravel()[0], f.P[0, 0]


by_hand = P + Q + R, (P + Q) / (P + Q + R) * z, (P + Q) * R / (P + Q + R)
unscented = run(
    UnscentedKalmanFilter(1, 1, 1.0, hx=lambda x: x, fx=lambda x, dt: x, points=JulierSigmaPoints(1, 2.0))
)
cubature = run(CubatureKalmanFilter(1, 1, 1.0, hx=lambda x: x, fx=lambda x, dt: x))
for name, values in (("by hand", by_hand), ("unscented", unscented), ("cubature", cubature)):
    print(f"{name:10} innovation variance {values[0]:.3f}, mean {values[1]:.3f}, variance {values[2]:.3f}")
assert np.allclose(unscented, by_hand, atol=1e-12)
assert np.allclose(
    cubature, (P + R, P / (P + R) * z, P + Q - P**2 / (P + R)), atol=1e-12
)  # no Q in S nor in K
EOF
