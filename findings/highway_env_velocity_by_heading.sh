#!/usr/bin/env bash
# Package: highway-env 1.12.1 (August 2026).
# Expected: a velocity is the derivative of the position; the observation's vx and vy are documented as the
#   vehicle's velocity on the axes x and y.
# Seen: the bicycle model moves the centre along heading plus slip angle, but Vehicle.velocity (and vx, vy of
#   to_dict, which the Kinematics observation is made of) points along the heading. At a steering angle of .3
#   rad the two are 8.8 degrees apart: 1.5 m/s to the side at 10 m/s, as long as the wheel is held. A TODO in
#   the source admits it.
# Why it matters: as truth for a tracker the vector is biased in every turn and lane change. A filter that
#   estimates the derivative of the position is charged with an error that is the truth's own, and its NEES
#   looks inconsistent.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps highway-env==1.12.1 gymnasium==1.4.0 farama-notifications==0.0.6 \
  cloudpickle==3.1.3 typing-extensions==4.16.0 numpy==2.4.6 pandas==3.1.1 tzdata==2026.6 python-dateutil==4.0.0 \
  pygame-ce==2.5.8 matplotlib==3.11.2 pillow==13.0.0 cycler==0.12.1 kiwisolver==1.5.1 contourpy==1.3.3 \
  pyparsing==3.3.3 packaging==26.4 fonttools==4.68.0
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle

dt, steering = 1e-3, 0.3
vehicle = Vehicle(Road(RoadNetwork.straight_road_network(lanes=1)), [0.0, 0.0], heading=0.0, speed=10.0)
vehicle.act({"steering": steering, "acceleration": 0.0})
for _ in range(3):
    before, told = vehicle.position.copy(), vehicle.velocity.copy()
    assert np.allclose(told, [vehicle.to_dict()["vx"], vehicle.to_dict()["vy"]])
    vehicle.step(dt)
    moved = (vehicle.position - before) / dt
    apart = np.arctan2(moved[1], moved[0]) - np.arctan2(told[1], told[0])
    print("velocity told", told.round(3), "moved", moved.round(3), f"apart {np.degrees(apart):.2f} degrees")
    assert np.isclose(apart, np.arctan(np.tan(steering) / 2), atol=1e-6)  # the slip angle at the centre
    assert np.isclose(np.linalg.norm(moved), np.linalg.norm(told))
EOF
