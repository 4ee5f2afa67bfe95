#!/usr/bin/env bash
# Package: filterpy 2.0.0 (October 2026) beside 1.4.5.
# Expected: "kinematic_kf(dim=2, order=1)" measures the position of each dimension; 1.4.5 gives H = [[1, 0, 0,
#   0], [0, 0, 1, 0]].
# Seen: 2.0.0 takes dim_z = 1 by default, where 1.4.5 ignored it, and writes a one under every position of each
#   row: H = [[1, 0, 1, 0]], the sum x + y. With dim_z=2 both rows are that sum, and the filter puts an object
#   at (10, 2) m at (3, 3) m.
# Why it matters: a tracker that builds its filters by this helper changes with an unpinned upgrade: with
#   dim_z=2 nothing is raised, and every box is drawn to the diagonal. Set H by hand, or pin filterpy below 2.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps filterpy==2.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from filterpy.common import kinematic_kf

print("H by default:", kinematic_kf(dim=2, order=1).H.tolist())
assert kinematic_kf(dim=2, order=1).H.tolist() == [[1, 0, 1, 0]]
kf = kinematic_kf(dim=2, order=1, dim_z=2)
kf.Q *= 1e-3
for _ in range(30):
    kf.predict()
    kf.update([10.0, 2.0])
x, y = kf.x[0].item(), kf.x[2].item()
print("H for dim_z=2:", kf.H.tolist(), f"an object measured at (10, 2) is put at ({x:.2f}, {y:.2f})")
assert np.isclose(x, y)
assert np.isclose(x + y, 6.0, atol=0.1)
EOF
