#!/usr/bin/env bash
# Package: opencv-python-headless 5.0.0.93.
# Expected: the overlap of two boxes does not depend on where the map's origin lies; Python passes its floats as
#   doubles.
# Seen: rotatedRectangleIntersection works in float32. At the origin it is right to 2e-6 m2; in UTM coordinates
#   (northing 4,000,000 m, where a float32 step is .25 m) the overlap of two cars is off by up to .86 of 8.1 m2.
#   No error, no warning.
# Why it matters: rotated IoU by OpenCV is the usual way without CUDA. On logs in UTM a match at IoU .5 is
#   decided by rounding. Subtract a local origin first.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps opencv-python-headless==5.0.0.93 shapely==2.2.0 numpy==2.4.6
"$work/venv/bin/python" - <<'EOF'
from math import cos, radians, sin

import cv2
import numpy as np
from shapely.geometry import Polygon


def by_opencv(a, b):
    _, corners = cv2.rotatedRectangleIntersection(a, b)
    return 0.0 if corners is None else cv2.contourArea(cv2.convexHull(corners))


def outline(box):
    (x, y), (length, width), degrees = box
    c, s = cos(radians(degrees)), sin(radians(degrees))
    corners = [
        (length / 2, width / 2),
        (-length / 2, width / 2),
        (-length / 2, -width / 2),
        (length / 2, -width / 2),
    ]
    return Polygon([(x + c * u - s * v, y + s * u + c * v) for u, v in corners])


worst = {}
for east, north in ((0.0, 0.0), (500_000.0, 4_000_000.0)):
    rng, errors = np.random.default_rng(0), []
    for _ in range(200):
        a, b = (
            ((east + rng.uniform(-1, 1), north + rng.uniform(-1, 1)), (4.5, 1.8), rng.uniform(0, 360))
            for _ in range(2)
        )
        errors.append(abs(by_opencv(a, b) - outline(a).intersection(outline(b)).area))
    worst[north] = max(errors)
    print(
        f"centre at ({east:.0f}, {north:.0f}): largest error {max(errors):.2g} m2, mean {np.mean(errors):.2g} m2"
    )
assert worst[0.0] < 1e-5
assert worst[4_000_000.0] > 0.5
EOF
