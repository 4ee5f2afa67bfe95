#!/usr/bin/env bash
# Package: stonesoup 1.9.1.
# Expected: function of a measurement model takes a State or, for particles and sigma points, a StateVectors with one
#   state a column, and measures each column by itself, as CartesianToElevationBearingRangeRate does.
# Seen: CartesianToElevationRateBearingRateRangeRate adds the position times velocity of all columns up before it
#   divides by each range. The same state in 13 columns (the sigma points of six dimensions) has 13 times its range
#   rate, 18.57 m/s for 1.43 m/s, and an elevation rate of -.057 rad/s for .006 rad/s. Its jacobian, a difference
#   quotient over seven columns, is wrong in these two rows by up to .82.
# Why it matters: one state at a time is right, so simulated measurements are; the extended, unscented and particle
#   updates expect other rates than their own sensor measures. No warning is raised.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps stonesoup==1.9.1 numpy==2.4.6 scipy==1.17.1 ordered-set==4.1.0
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from stonesoup.models.measurement.nonlinear import (
    CartesianToElevationBearingRangeRate,
    CartesianToElevationRateBearingRateRangeRate,
)
from stonesoup.types.array import StateVector, StateVectors
from stonesoup.types.state import State

x = np.array([[30.0], [3.0], [20.0], [-2.0], [5.0], [0.4]])  # x, vx, y, vy, z, vz
position, velocity = x[::2, 0], x[1::2, 0]
distance, ground = np.linalg.norm(position), np.linalg.norm(position[:2])
range_rate = position @ velocity / distance
elevation_rate = (velocity[2] * ground - position[2] * (position[:2] @ velocity[:2]) / ground) / distance**2

common = {"ndim_state": 6, "mapping": (0, 2, 4), "velocity_mapping": (1, 3, 5)}
rates = CartesianToElevationRateBearingRateRangeRate(noise_covar=np.eye(6), **common)
sibling = CartesianToElevationBearingRangeRate(noise_covar=np.eye(4), **common)


def measure(model, columns):
    """First measurement of the same state in so many columns."""
    states = StateVector(x) if columns == 1 else StateVectors(np.repeat(x, columns, axis=1))
    return np.asarray(model.function(State(states), noise=False), float)[:, 0]


for columns in (1, 2, 13):
    seen = measure(rates, columns)
    print(
        f"{columns} equal columns: range rate {seen[5]:.3f} m/s, right {range_rate:.3f};"
        f" elevation rate {seen[3]:.4f} rad/s, right {elevation_rate:.4f}"
    )
    assert np.isclose(seen[5], columns * range_rate)
    assert np.isclose(measure(sibling, columns)[3], range_rate)
assert np.isclose(measure(rates, 1)[3], elevation_rate)
assert measure(rates, 13)[3] < -0.05 < 0.005 < elevation_rate

right = np.empty((6, 6))
for i, step in enumerate(1e-5 * np.eye(6)):  # central differences, one state at a time
    ends = [
        np.asarray(rates.function(State(StateVector(x[:, 0] + sign * step)), noise=False), float)[:, 0]
        for sign in (1, -1)
    ]
    right[:, i] = (ends[0] - ends[1]) / 2e-5
error = np.abs(np.asarray(rates.jacobian(State(StateVector(x))), float) - right).max(axis=1)
print("largest error of the jacobian by row:", error.round(4))
assert error[5] > 0.8 and error[3] > 1e-3 and error[[0, 1, 2, 4]].max() < 1e-6
EOF
