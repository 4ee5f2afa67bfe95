#!/usr/bin/env bash
# Package: filterpy 2.0.0 (the same in 1.4.5).
# Expected: a fixed-lag smoother returns E[x_k | z_1 .. z_(k+lag)]: the source it cites (Simon, Optimal State
#   Estimation, 2006, pages 274 to 278) reaches that exactly, and so does a Rauch-Tung-Striebel pass that ends
#   there.
# Seen: FixedLagSmoother starts its recursion from the posterior covariance where the prior belongs, and goes on
#   by F - K H with the gain of the update. At a lag of four steps it gains nothing over the filter for a random
#   walk (exact smoothing takes a fifth of the error away), and half of what there is to gain for constant
#   velocity.
# Why it matters: truth for a study and labels for a detector are made with smoothers. It runs, it looks smooth,
#   and it returns no covariance that could tell. KalmanFilter.rts_smoother of the same package is right.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from filterpy.common import Q_discrete_white_noise
from filterpy.kalman import FixedLagSmoother, KalmanFilter

lag, steps, rng = 4, 24, np.random.default_rng(0)


def errors(F, H, Q, tracks):
    """Root mean square error of the first state by the filter, FixedLagSmoother and exact smoothing, R = 1."""
    n, made = len(F), {"filter": [], "fixed lag": [], "exact": []}

    def prepared(kind, **extra):
        f = kind(n, 1, **extra)
        f.x, f.F, f.H, f.Q, f.R, f.P = np.zeros((n, 1)), F, H, Q, np.eye(1), 4 * np.eye(n)
        return f

    for _ in range(tracks):
        x, truth, z = 2 * rng.normal(size=n), [], []
        for _ in range(steps):
            x = F @ x + rng.multivariate_normal(np.zeros(n), Q)
            truth.append(x[0])
            z.append((H @ x)[0] + rng.normal())
        smoother = prepared(FixedLagSmoother, N=lag)
        for value in z:
            smoother.smooth(value)
        filtered = prepared(KalmanFilter).batch_filter(z)[0]
        for k in range(8, steps - lag):
            kf = prepared(KalmanFilter)
            exact = kf.rts_smoother(*kf.batch_filter(z[: k + lag])[:2])[0]  # what lag steps can know
            made["filter"].append(filtered[k, 0, 0] - truth[k])
            made["fixed lag"].append(smoother.xSmooth[k][0, 0] - truth[k])
            made["exact"].append(exact[k, 0, 0] - truth[k])
    return {name: round(float(np.sqrt(np.mean(np.square(e)))), 3) for name, e in made.items()}


one, dt = np.eye(1), 0.5
velocity = np.array([[1, dt], [0, 1]]), np.array([[1.0, 0]]), Q_discrete_white_noise(2, dt, 1.0)
for name, model in (("random walk", (one, one, 0.5 * one)), ("constant velocity", velocity)):
    e = errors(*model, tracks=60)
    gained = (e["filter"] - e["fixed lag"]) / (e["filter"] - e["exact"])
    print(f"{name}: {e}, {gained:.2f} of what exact smoothing gains")
    assert gained < 0.6
EOF
