#!/usr/bin/env bash
# Package: serums 1.0.6, the metrics of the RFS filters in carbs 1.0.4.
# Expected: calculate_mahalanobis documents the root of (x - y)' inv(S) (x - y).
# Seen: the covariance is not inverted: the root of (x - y)' S (x - y). With a standard deviation of 2 m an error
#   of 2 m has distance 4 where 1 is right, and one of .1 m has .01 where 1 is right: the less certain an estimate
#   is, the farther away it counts. At unit covariance the two agree.
# Why it matters: it is the base distance of OSPA and OSPA(2) by MAHALANOBIS here: a track that admits its
#   uncertainty is punished for it, and an overconfident one looks near to the truth.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps serums==1.0.6 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from scipy.spatial.distance import mahalanobis
from serums.distances import calculate_mahalanobis

for deviation in (0.1, 1.0, 2.0):
    covariance = np.diag([deviation**2, 1.0])
    error = np.array([[deviation], [0.0]])  # one standard deviation, so the distance is 1
    seen = calculate_mahalanobis(error, np.zeros((2, 1)), covariance).item()
    right = mahalanobis(error.ravel(), [0.0, 0.0], np.linalg.inv(covariance))
    print(f"standard deviation {deviation} m, error {deviation} m: {seen:.2f}, by scipy {right:.2f}")
    assert np.isclose(right, 1.0)
    assert np.isclose(seen, deviation**2)
EOF
