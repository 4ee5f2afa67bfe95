#!/usr/bin/env bash
# Package: pyquaternion 0.9.9 (the quaternion of nuScenes and of many 3D detection code bases).
# Expected: yaw_pitch_roll is documented as "intrinsic Tait-Bryan angles following the z-y'-x'' convention", so
#   that yaw is the heading: the direction of the rotated x axis in the ground plane.
# Seen: it returns the angles of R_x(roll) R_y(pitch) R_z(yaw), the opposite order (the docstring's next line
#   says so too). With pitch or roll alone, 3 or 6 degrees, yaw is off by .12 degrees; at pitch .3 and roll .2
#   rad by 2.1 degrees. For flat rotations the two agree, so tests on a plane pass. scipy gives the same numbers
#   for "zyx", not "ZYX".
# Why it matters: ego poses of nuScenes and Waymo are tilted. At 50 m a heading off by .12 degrees moves a box
#   by 10 cm, and more on slopes; the devkit's own quaternion_yaw rotates a vector for this reason.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps pyquaternion==0.9.9 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from pyquaternion import Quaternion
from scipy.spatial.transform import Rotation

for yaw, pitch, roll in ((0.5, 0.0, 0.0), (0.5, 0.1, 0.0), (0.5, 0.05, 0.03), (0.5, 0.3, 0.2)):
    pose = (
        Quaternion(axis=[0, 0, 1], angle=yaw)
        * Quaternion(axis=[0, 1, 0], angle=pitch)
        * Quaternion(axis=[1, 0, 0], angle=roll)
    )
    x, y, _ = pose.rotate([1.0, 0.0, 0.0])
    heading, told = np.arctan2(y, x), pose.yaw_pitch_roll[0]
    scipy = Rotation.from_quat(pose.elements[[1, 2, 3, 0]])
    print(
        f"pitch {pitch:.2f} roll {roll:.2f}: heading {heading:.4f}, yaw {told:.4f},",
        f"apart {np.degrees(told - heading):+.2f} degrees",
    )
    assert np.isclose(heading, yaw)
    assert np.isclose(scipy.as_euler("ZYX")[0], heading)
    assert np.isclose(scipy.as_euler("zyx")[0], told)
assert abs(np.degrees(told - heading)) > 2
EOF
