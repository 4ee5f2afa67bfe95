#!/usr/bin/env bash
# Package: nuscenes-devkit 1.2.0 (its issue 1141 and pull request 1192 are open).
# Expected: "Interpolate the tracks to fill in holes": a box filled in at a third of a gap lies a third of the
#   way.
# Seen: the weight of the later box is computed as its distance in time, so the filled boxes run backwards: a
#   car that moves 5 m a frame and is missing in two frames goes 0, 10, 5, 15 m. With one frame missing half is
#   half and nothing shows. The function fills both sides: the ground truth (whose boxes without lidar points
#   were removed before) and the submitted tracks, which for an online tracker is a look into the future.
# Why it matters: a tracker that coasts correctly through a gap of two frames is scored against a truth that
#   jumps: at 5 m a frame both frames are misses and false positives under the official 2 m. Own evaluations
#   that interpolate in time disagree with the official AMOTA, and neither side sees why.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps nuscenes-devkit==1.2.0 numpy==1.26.4 pyquaternion==0.9.9 \
  tqdm==4.67.1 cachetools==5.5.2 matplotlib==3.9.4 pillow==11.3.0 cycler==0.12.1 kiwisolver==1.4.9 \
  contourpy==1.3.3 pyparsing==3.2.5 packaging==25.0 python-dateutil==2.9.0.post0 six==1.17.0 \
  fonttools==4.60.1 scikit-learn==1.6.1 scipy==1.15.3 joblib==1.5.2 threadpoolctl==3.6.0 \
  opencv-python-headless==4.11.0.86 shapely==2.0.7
"$work/venv/bin/python" - <<'EOF'
from collections import defaultdict

from nuscenes.eval.common.config import config_factory
from nuscenes.eval.tracking.data_classes import TrackingBox
from nuscenes.eval.tracking.loaders import interpolate_tracks

config_factory("tracking_nips_2019")  # registers the class names


def car(x):
    return TrackingBox(
        "sample", (x, 0, 0), (2, 4, 1.5), (1, 0, 0, 0), (10, 0), tracking_id="a", tracking_name="car"
    )


frames = defaultdict(list, {0: [car(0.0)], 500_000: [], 1_000_000: [], 1_500_000: [car(15.0)]})
seen = [float(boxes[0].translation[0]) for _, boxes in sorted(interpolate_tracks(frames).items())]
print("expected 0, 5, 10, 15 m; filled in as", seen)
assert [round(x, 9) for x in seen] == [0, 10, 5, 15]
EOF
