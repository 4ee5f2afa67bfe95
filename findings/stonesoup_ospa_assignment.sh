#!/usr/bin/env bash
# Package: stonesoup 1.9.1.
# Expected: OSPA of order p minimises the sum of d^p over assignments (Schuhmacher, Vo and Vo, IEEE TSP 56,
#   2008, equation 3, which the class cites).
# Seen: OSPAMetric assigns by the plain distances whatever p is, and raises to p afterwards. p = 1 is right; for
#   p = 2 it says 2.8 m where two errors of 2 m make 2.0 m, and is too large for a third of random sets of four
#   points. GOSPAMetric of the same package is right for p = 2.
# Why it matters: OSPA with p = 2 is what many papers on RFS filters report. The error sits in close and
#   crossing targets, the scenes in question, and grows with the cutoff; a study by this class and one by
#   another do not compare.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps stonesoup==1.9.1 numpy==2.4.6 scipy==1.17.1 ordered-set==4.1.0
"$work/venv/bin/python" - <<'EOF'
from datetime import datetime
from itertools import permutations

import numpy as np
from stonesoup.measures import Euclidean
from stonesoup.metricgenerator.ospametric import OSPAMetric
from stonesoup.types.state import State

now, cutoff = datetime(2026, 1, 1), 10.0


def library(truth, tracks, p):
    states = [[State(point.reshape(-1, 1), timestamp=now) for point in points] for points in (tracks, truth)]
    return float(OSPAMetric(c=cutoff, p=p, measure=Euclidean()).compute_OSPA_distance(*states).value)


def brute_force(truth, tracks, p):
    return min(
        np.mean([min(cutoff, np.linalg.norm(a - tracks[j])) ** p for a, j in zip(truth, order)]) ** (1 / p)
        for order in permutations(range(len(tracks)))
    )


truth = np.array([[0.0, 0.0], [-1.92, 0.56]])
tracks = np.array([[0.0, 0.0], [2.0, 0.0]])  # 0 and 3.96 m straight, 2 and 2 m across
print("by hand 2.0, the library", library(truth, tracks, 2))
assert np.isclose(library(truth, tracks, 2), 2.8)
assert np.isclose(brute_force(truth, tracks, 2), 2.0)

rng = np.random.default_rng(0)
wrong = {1: 0, 2: 0}
for _ in range(600):
    truth, tracks = rng.uniform(0, 6, (2, 4, 2))
    for p in (1, 2):
        seen, right = library(truth, tracks, p), brute_force(truth, tracks, p)
        assert seen > right - 1e-9
        wrong[p] += int(seen > right + 1e-9)
print("sets of 600 with a wrong OSPA, by p:", wrong)
assert wrong[1] == 0
assert wrong[2] > 100
EOF
