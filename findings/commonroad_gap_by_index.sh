#!/usr/bin/env bash
# Package: commonroad-io 2026.1 (April 2026).
# Expected: Trajectory.state_at_time_step(k) gives "the state of a trajectory at a specific time instance". States may
#   leave steps out: append_state asks only that a new state's step be larger than the last one's.
# Seen: the k-th entry of the list is returned, whatever its step. A car recorded at steps 0, 1, 5 and 6, hidden
#   in between, is at steps 2 and 3 where it was at 5 and 6, and is gone at steps 5 and 6, while final_state
#   says 6.
# Why it matters: recorded traffic has gaps. As truth the car jumps by four steps at once and vanishes too
#   early; errors of tens of metres are charged to the tracker that follows it rightly.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps commonroad-io==2026.1 numpy==2.4.6 shapely==2.2.0 omegaconf==2.4.0 \
  pyyaml==6.0.4
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from commonroad.scenario.state import KSState
from commonroad.scenario.trajectory import Trajectory


def state(step):
    return KSState(
        time_step=step, position=np.array([10.0 * step, 0.0]), orientation=0.0, velocity=100.0, steering_angle=0.0
    )


car = Trajectory(0, [state(0), state(1)])
car.append_state(state(5))
car.append_state(state(6))
seen = {}
for step in range(7):
    found = car.state_at_time_step(step)
    seen[step] = None if found is None else found.time_step
print("asked for step -> got the state of step:", seen, "final state:", car.final_state.time_step)
assert seen == {0: 0, 1: 1, 2: 5, 3: 6, 4: None, 5: None, 6: None}
assert car.final_state.time_step == 6
EOF
