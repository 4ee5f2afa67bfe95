#!/usr/bin/env bash
# Package: trackeval 1.3.0.
# Expected: FP_per_frame of several sequences is their false positives over their frames.
# Seen: a sequence without ground truth (an empty road) returns early with CLR_Frames 0, while its false
#   positives count. Ten empty frames with one false alarm each say FP_per_frame 0 by themselves; together with
#   ten perfect frames they say 1.0, where 10 false alarms in 20 frames make .5. The frames of a sequence in
#   which the tracker reports nothing are lost likewise.
# Why it matters: false alarms on empty roads are what a tracker's existence model is judged by, and there the
#   figure is zero, or the combined figure twice too large, depending on the split.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps trackeval==1.3.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" -W ignore - <<'EOF'
import numpy as np
import trackeval

metric, none = trackeval.metrics.CLEAR({"PRINT_CONFIG": False}), np.array([], dtype=int)


def sequence(truths, tracks, similarity):
    return metric.eval_sequence(
        {
            "num_gt_dets": 10 * len(truths),
            "num_tracker_dets": 10 * len(tracks),
            "num_gt_ids": len(truths),
            "num_tracker_ids": len(tracks),
            "num_timesteps": 10,
            "gt_ids": [truths] * 10,
            "tracker_ids": [tracks] * 10,
            "similarity_scores": [similarity] * 10,
        }
    )


one = np.array([0])
empty_road = sequence(none, one, np.zeros((0, 1)))
followed = sequence(one, one, np.ones((1, 1)))
silent = sequence(one, none, np.zeros((1, 0)))
together = metric.combine_sequences({"empty": empty_road, "followed": followed})
for name, result in (("empty road", empty_road), ("one object followed", followed), ("together", together)):
    print(
        f"{name}: {result['CLR_FP']} false positives, frames {result['CLR_Frames']}, a frame {result['FP_per_frame']}"
    )
assert (empty_road["CLR_FP"], empty_road["CLR_Frames"], empty_road["FP_per_frame"]) == (10, 0, 0)
assert silent["CLR_Frames"] == 0
assert together["FP_per_frame"] == 1.0
EOF
