#!/usr/bin/env bash
# Package: serums 1.0.6, the metrics of the RFS filters in carbs 1.0.4.
# Expected: OSPA of order p is (localisation^p + cardinality^p)^(1/p), so it never exceeds its cutoff c
#   (Schuhmacher, Vo and Vo, IEEE TSP 56, 2008).
# Seen: calculate_ospa adds the two parts as they are. p = 1 is right; with p = 2, c = 2 m, one track 1.9 m from
#   one of two truths it says 2.76 m where 1.95 m is right, more than the largest value there is. Every frame
#   with both an error and a wrong count is too large, three quarters of random scenes; frames with a right
#   count agree.
# Why it matters: a filter that misses one object is charged up to 1.4 times too much, so cardinality errors
#   outweigh localisation in curves by carbs, and do not compare with OSPA elsewhere.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps serums==1.0.6 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
from itertools import permutations

import numpy as np
from serums.distances import calculate_ospa


def library(truth, tracks, c, p):
    states = [np.asarray(points, dtype=float).T[:, None, :] for points in (tracks, truth)]
    return float(calculate_ospa(*states, c, p)[0][0])


def brute_force(truth, tracks, c, p):
    few, many = sorted((np.asarray(truth), np.asarray(tracks)), key=len)
    least = min(
        sum(min(c, np.linalg.norm(few[i] - many[j])) ** p for i, j in enumerate(order))
        for order in permutations(range(len(many)), len(few))
    )
    return float(((least + c**p * (len(many) - len(few))) / len(many)) ** (1 / p))


truth, track = [[0.0, 0.0], [50.0, 0.0]], [[1.9, 0.0]]
seen, right = library(truth, track, 2.0, 2), brute_force(truth, track, 2.0, 2)
print(f"p 2, c 2 m: {seen:.2f} m, by brute force {right:.2f} m")
assert np.isclose(right, ((1.9**2 + 2**2) / 2) ** 0.5)
assert np.isclose(seen, (1.9**2 / 2) ** 0.5 + (2**2 / 2) ** 0.5)
assert seen > 2.0 > right

rng, wrong = np.random.default_rng(0), {1: 0, 2: 0}
for _ in range(200):
    truth, tracks = (rng.uniform(0, 6, (rng.integers(1, 5), 2)) for _ in range(2))
    for p in wrong:
        seen, right = library(truth, tracks, 2.0, p), brute_force(truth, tracks, 2.0, p)
        assert seen > right - 1e-9
        assert len(truth) != len(tracks) or np.isclose(seen, right)
        wrong[p] += int(seen > right + 1e-9)
print("scenes of 200 with another value, by p:", wrong)
assert wrong[1] == 0
assert wrong[2] > 80
EOF
