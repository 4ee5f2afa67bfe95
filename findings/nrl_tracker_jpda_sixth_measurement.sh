#!/usr/bin/env bash
# Package: nrl-tracker 2.11.1 (October 2026, import name pytcl).
# Expected: a measurement outside every track's gate changes no association probability: it enters every joint
#   event as clutter alike and cancels. jpda_probabilities says that it "uses an efficient algorithm that avoids
#   explicit enumeration of all joint hypotheses when possible".
# Seen: up to five tracks and five measurements it enumerates and is exact to 1e-12; from the sixth on it
#   changes to a formula of its own, for the same two tracks. One more detection at the other end of the scene
#   takes the probability of a miss from .017 to .049, and over random scenes a probability is off by up to .37.
# Why it matters: tests of small scenes see the exact filter, deployments the other one, and a scene that goes
#   from five to six detections changes the posterior of tracks far away from the new one.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps nrl-tracker==2.11.1 numpy==2.4.6 scipy==1.17.1 numba==0.68.1 \
  llvmlite==0.50.0 h5py==3.16.0 loguru==0.7.3 msgspec==0.23.0 rich==15.0.0 markdown-it-py==4.3.0 mdurl==0.1.2 \
  pygments==2.21.0
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from pytcl.assignment_algorithms import jpda_probabilities

rng = np.random.default_rng(0)


def enumerate_events(likelihood, gated, detection, clutter):
    """Marginals by all joint events; the last column is the miss."""
    tracks, measurements = likelihood.shape
    beta = np.zeros((tracks, measurements + 1))

    def extend(chosen, weight):
        if len(chosen) == tracks:
            beta[np.arange(tracks), chosen] += weight
            return
        i = len(chosen)
        extend([*chosen, measurements], weight * (1 - detection))
        for j in range(measurements):
            if gated[i, j] and j not in chosen:
                extend([*chosen, j], weight * detection * likelihood[i, j] / clutter)

    extend([], 1.0)
    return beta / beta.sum(axis=1, keepdims=True)


def outside(likelihood, count):
    """The same problem with count more measurements that no track gates."""
    more = np.pad(likelihood, ((0, 0), (0, count)))
    return more, more > 0


two = np.array([[0.08, 0.05], [0.06, 0.04]])
miss = {}
for count in (0, 3, 4):
    likelihood, gated = outside(two, count)
    miss[count] = jpda_probabilities(likelihood, gated, 0.9, 0.01)[0, -1]
    assert np.isclose(enumerate_events(likelihood, gated, 0.9, 0.01)[0, -1], 0.01735, atol=1e-4)
print(
    "P(miss) of track 0 with 2, 5 and 6 measurements:", {2 + k: round(float(v), 4) for k, v in miss.items()}
)
assert np.isclose(miss[0], miss[3], atol=1e-12)
assert miss[4] > 2.5 * miss[3]

worst = {2: 0.0, 3: 0.0}
for _ in range(200):
    small = rng.uniform(0, 0.1, (3, 3)) * (rng.random((3, 3)) < 0.8)
    for count in worst:
        likelihood, gated = outside(small, count)
        difference = jpda_probabilities(likelihood, gated, 0.8, 0.02) - enumerate_events(
            likelihood, gated, 0.8, 0.02
        )
        worst[count] = max(worst[count], float(np.abs(difference).max()))
print("largest error with 5 and 6 measurements:", {3 + k: f"{v:.1e}" for k, v in worst.items()})
assert worst[2] < 1e-12
assert worst[3] > 0.2
EOF
