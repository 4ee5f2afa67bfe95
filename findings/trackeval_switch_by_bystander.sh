#!/usr/bin/env bash
# Package: trackeval 1.3.0 beside motmetrics 1.4.0.
# Expected: whether object A's track changes does not depend on a detection elsewhere; a frame in which a
#   tracker says nothing is not better than one in which it says something about another object.
# Seen: CLEAR carries pairs over from "the single previous timestep", and a frame without any tracker box is
#   skipped before that memory is cleared. So after one missed frame TrackEval sticks to the old track if the
#   frame was empty, and takes the best overlap if there was any other box in it: no switch becomes one switch.
#   motmetrics keeps the pair in both.
# Why it matters: a tracker with fewer false alarms (more empty frames) gets fewer id switches for the same
#   tracks of A, and a count by another library differs by scenes with gaps: the two reference implementations
#   of MOTA disagree.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps trackeval==1.3.0 numpy==2.4.6 scipy==1.17.1 motmetrics==1.4.0 \
  pandas==3.1.1 tzdata==2026.6 python-dateutil==4.0.0 xmltodict==1.0.4
"$work/venv/bin/python" -W ignore - <<'EOF'
import motmetrics
import numpy as np
import trackeval


def switches(gap):
    """Switches of truth 0 by TrackEval and by motmetrics; ``gap`` lists the tracks of the second frame."""
    frames = [([0], [[0.9]]), (gap, np.zeros((1, len(gap)))), ([0, 1], [[0.6, 0.9]]), ([0, 1], [[0.6, 0.9]])]
    data = {
        "num_gt_dets": 4,
        "num_tracker_dets": sum(len(tracks) for tracks, _ in frames),
        "num_gt_ids": 1,
        "num_tracker_ids": 3,
        "num_timesteps": 4,
        "gt_ids": [np.array([0])] * 4,
        "tracker_ids": [np.array(tracks, dtype=int) for tracks, _ in frames],
        "similarity_scores": [np.array(overlap) for _, overlap in frames],
    }
    clear = trackeval.metrics.CLEAR({"PRINT_CONFIG": False}).eval_sequence(data)
    accumulator = motmetrics.MOTAccumulator(auto_id=True)
    for tracks, overlap in frames:
        distance = 1 - np.array(overlap)
        accumulator.update([0], tracks, np.where(distance > 0.5, np.nan, distance))
    other = motmetrics.metrics.create().compute(accumulator, metrics=["num_switches"])
    return int(clear["IDSW"]), int(other.iloc[0, 0])


for name, gap in (("nothing", []), ("a false alarm far away", [2])):
    print(
        f"second frame holds {name}: switches by trackeval {switches(gap)[0]}, by motmetrics {switches(gap)[1]}"
    )
assert switches([]) == (0, 0)
assert switches([2]) == (1, 0)
EOF
