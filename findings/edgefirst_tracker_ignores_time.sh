#!/usr/bin/env bash
# Package: edgefirst-tracker 0.38.0 (October 2026).
# Expected: update(boxes, scores, labels, timestamp_ns) takes the time of each frame in nanoseconds, so a Kalman
#   filter predicts over the time that has passed: a box at 100 px/s that was at 290 px is expected at 300 px
#   after .1 s and at 390 px after 1 s.
# Seen: the time serves lifespan_ns alone. Every call predicts by one step of the frames seen so far: 299.4 px
#   after .1 s, .5 s and 1 s alike. No argument sets the step.
# Why it matters: dropped frames and uneven rates are what timestamps are handed over for. After a gap of five
#   frames the search box is 40 px behind a box of 60 px, and the match by overlap is down to chance.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps edgefirst-tracker==0.38.0 numpy==2.4.6
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from edgefirst.tracker import ByteTrack


def expected_left_edge(gap):
    """Left edge of a box at 100 px/s, as told after ``gap`` seconds without a detection."""
    tracker = ByteTrack(high_conf=0.5, iou=0.1, lifespan_ns=10_000_000_000)
    for frame in range(30):
        x = 10.0 * frame
        box = np.array([[x, 100.0, x + 60.0, 140.0]], np.float32)
        tracker.update(box, np.array([0.9], np.float32), np.array([0], np.uint64), frame * 100_000_000)
    none = np.zeros((0, 4), np.float32), np.zeros(0, np.float32), np.zeros(0, np.uint64)
    tracker.update(*none, 2_900_000_000 + int(gap * 1e9))
    (track,) = tracker.get_active_tracks()
    return track.info.tracked_location[0]


seen = {gap: round(expected_left_edge(gap), 1) for gap in (0.1, 0.5, 1.0)}
for gap, x in seen.items():
    print(f"after {gap} s: {x} px, where the box is at {290 + 100 * gap:.0f} px")
assert seen[0.1] == seen[0.5] == seen[1.0]
assert abs(seen[0.1] - 300) < 2
EOF
