#!/usr/bin/env bash
# Package: nrl-tracker 2.11.1 (October 2026, import name pytcl).
# Expected: an id switch is a truth whose track id changes (Bernardin and Stiefelhagen, 2008). A metric of sets
#   may not depend on the order in which a frame's tracks happen to be listed.
# Seen: mot_metrics takes positions alone: the place in the list stands for the id. Listing the same two perfect
#   tracks in another order in one frame of ten makes four id switches and MOTA .80 of 1.00; and where the first
#   object leaves while its track coasts, the second one is charged with a switch.
# Why it matters: most trackers return their tracks by score or in the order of a dictionary. The number looks
#   like MOTA, and the docstring says "CLEAR MOT metrics" without a word about order.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps nrl-tracker==2.11.1 numpy==2.4.6 scipy==1.17.1 numba==0.68.1 \
  llvmlite==0.50.0 h5py==3.16.0 loguru==0.7.3 msgspec==0.23.0 rich==15.0.0 markdown-it-py==4.3.0 mdurl==0.1.2 \
  pygments==2.21.0
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from pytcl.performance_evaluation import mot_metrics

truth = [[np.array([float(k), 0.0]), np.array([float(k), 50.0])] for k in range(10)]
tracks = [list(frame) for frame in truth]
reordered = [frame[::-1] if k == 4 else frame for k, frame in enumerate(tracks)]
for name, listed in (("as the truth is listed", tracks), ("one frame listed in reverse", reordered)):
    result = mot_metrics(truth, listed, threshold=2.0)
    print(f"{name}: MOTA {result.mota:.2f}, switches {result.num_switches}")
assert mot_metrics(truth, tracks, threshold=2.0).num_switches == 0
result = mot_metrics(truth, reordered, threshold=2.0)
assert (result.num_switches, round(result.mota, 9)) == (4, 0.8)

left = [frame if k < 6 else frame[1:] for k, frame in enumerate(truth)]
result = mot_metrics(left, tracks, threshold=2.0)
print(
    "the first object leaves, its track coasts:",
    result.num_switches,
    "switch, of an object that was never lost",
)
assert (result.num_false_positives, result.num_switches) == (4, 1)
EOF
