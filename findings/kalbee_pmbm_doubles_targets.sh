#!/usr/bin/env bash
# Package: kalbee 1.0.0 (September 2026).
# Expected: "Poisson Multi-Bernoulli Mixture (PMBM) filter for multi-target tracking": hypotheses of one object
#   exclude each other, and update() returns a "list of confirmed target hypotheses (r > 0.5)". With one object,
#   detected once a frame, the expected number of targets is about one.
# Seen: each Bernoulli splits into its miss and each of its detections, all of these become targets side by
#   side, and every detection is a birth besides. Nothing holds alternatives together (there are no global
#   hypotheses and no Poisson part), so one detection confirms several targets: 1, 4, 8, 17, 35, 71 of them in
#   frames 1 to 6, existence summing to 74 objects. Their ids are those of new Python objects each frame.
# Why it matters: in a table beside JPDA and SORT it stands for PMBM. Its count, OSPA and id metrics say nothing
#   of the method, and the number of components doubles each frame, so long runs are out of reach.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps kalbee==1.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from kalbee.models.motion import constant_velocity
from kalbee.tracking.pmbm import PMBMTracker

F, Q = constant_velocity(dt=0.1, process_var=1.0, n_dims=1)
tracker = PMBMTracker(F, Q, np.array([[1.0, 0.0]]), np.array([[0.01]]), p_d=0.9, clutter_density=1e-4)
confirmed = []
for frame in range(7):  # one object at 1 m/s, one perfect detection a frame
    tracker.predict()
    confirmed.append(len(tracker.update(np.array([[0.1 * frame]]))))
expected = sum(target.existence_prob for target in tracker.targets)
print(
    "confirmed targets by frame:",
    confirmed,
    f"expected number at the end: {expected:.1f}; there is one object",
)
assert confirmed[1] == 1
assert all(later >= 2 * before for before, later in zip(confirmed[2:], confirmed[3:]))
assert expected > 50
EOF
