#!/usr/bin/env bash
# Package: kalbee 1.0.0 (September 2026).
# Expected: joint probabilistic data association sums over joint events, in which a measurement comes from at
#   most one track: over all tracks the probabilities of one measurement add up to at most 1 (Bar-Shalom and Li,
#   1995, section 6.2).
# Seen: JPDAAssociation normalises each track's row alone. Two equal tracks and one detection get .996 each,
#   1.99 for the one detection; the joint events give .499 each. A comment in the source says "approximation",
#   the documents say "Joint".
# Why it matters: joint association is there so that two close tracks do not share a detection and merge. This
#   is PDA run twice, so tracks coalesce as with PDA, under the name of JPDA.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps kalbee==1.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from kalbee.tracking.jpda import JPDAAssociation

detection, clutter, variance = 0.9, 0.01, 2.0
state, spread = np.zeros((1, 1)), np.eye(1)
beta = JPDAAssociation(p_d=detection, clutter_density=clutter).compute_association_probabilities(
    [state, state], [spread, spread], np.eye(1), np.eye(1), np.array([[0.0]])
)
ratio = detection / clutter / np.sqrt(2 * np.pi * variance)  # P_d N(z; 0, S) / clutter, S = 2
miss = 1 - detection
joint = ratio * miss / (2 * ratio * miss + miss**2)  # events: first track's, second track's, clutter
print("P(the detection is of track i) by kalbee:", beta[:, 1].round(3), "by joint events:", round(joint, 3))
assert np.allclose(beta[:, 1], ratio / (ratio + miss))
assert beta[:, 1].sum() > 1.9
assert 2 * joint < 1
EOF
