#!/usr/bin/env bash
# Package: lap 0.5.13 (the same in lapx 0.11.1 and in munkres 3.0.0, October 2026, with max_cost).
# Expected: "an upper limit for a cost of a single assignment" (lap, cost_limit); "refuses bad pairs and leaves
#   rows unmatched instead, which is what object tracking needs" (munkres). A gate forbids the pairs above it;
#   of the others a tracker wants as many as there can be, at the least cost.
# Seen: both put a price on leaving a row alone, so a pair within the gate is dropped wherever that is cheaper.
#   Costs [[4, 0], [100, 4]] and a gate of 5: the two pairs of cost 4 are valid and cover everything, but one
#   pair of cost 0 is returned; a track and a detection stay alone. A fifth of random 4 x 4 problems lose a pair
#   this way.
# Why it matters: ByteTrack and its kin associate by lap's cost_limit, SORT by scipy and a threshold afterwards.
#   With the same costs and the same threshold they match different pairs, and a comparison of the trackers
#   measures this, too.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps lap==0.5.13 munkres==3.0.0 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import lap
import munkres
import numpy as np
from scipy.optimize import linear_sum_assignment


def by_lap(costs, gate):
    columns = lap.lapjv(costs, extend_cost=True, cost_limit=gate)[1]
    return sorted((i, int(j)) for i, j in enumerate(columns) if j >= 0)


def by_munkres(costs, gate):
    return sorted(munkres.solve(costs.tolist(), max_cost=gate).pairs)


def most_pairs(costs, gate):
    """As many pairs within the gate as there can be, at the least cost."""
    barred = np.where(costs <= gate, costs, 1e6)
    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(barred)) if costs[i, j] <= gate]


costs = np.array([[4.0, 0.0], [100.0, 4.0]])
print(
    "gate 5: lap", by_lap(costs, 5.0), "munkres", by_munkres(costs, 5.0), "most pairs", most_pairs(costs, 5.0)
)
assert by_lap(costs, 5.0) == by_munkres(costs, 5.0) == [(0, 1)]
assert most_pairs(costs, 5.0) == [(0, 0), (1, 1)]
print("gate 9: lap", by_lap(costs, 9.0))  # the price has risen above the difference
assert by_lap(costs, 9.0) == [(0, 0), (1, 1)]

rng, fewer = np.random.default_rng(0), [0, 0]
for _ in range(400):
    costs = rng.uniform(0, 10, (4, 4))
    for k, method in enumerate((by_lap, by_munkres)):
        pairs = method(costs, 5.0)
        assert all(costs[pair] <= 5.0 for pair in pairs)
        fewer[k] += len(pairs) < len(most_pairs(costs, 5.0))
print("of 400 random problems with fewer pairs than possible: lap", fewer[0], "munkres", fewer[1])
assert fewer[0] == fewer[1] > 40
EOF
