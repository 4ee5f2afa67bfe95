#!/usr/bin/env bash
# Package: ortools 9.15.6755.
# Expected: costs that the solver cannot represent are refused: add_arc_with_cost(0, 0, .5) raises a TypeError,
#   since costs are integers.
# Seen: the vectorised add_arcs_with_cost, the one to use from numpy, cuts an array of floats to integers
#   without a word. Costs [[1.9, 1.0], [1.0, 1.2]] become four ones; solve() says OPTIMAL and returns the
#   assignment of cost 3.1 where 2.0 is the best. Over random IoU costs (all below 1, so all cut to 0) every
#   assignment is "optimal".
# Why it matters: association costs are distances, log-likelihoods or 1 - IoU, all of them floats. The tracker
#   runs and associates at random. Multiply and round before, with the scale in mind.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps ortools==9.15.6755 numpy==2.4.6 scipy==1.17.1
"$work/venv/bin/python" - <<'EOF'
import numpy as np
from ortools.graph.python.linear_sum_assignment import SimpleLinearSumAssignment
from scipy.optimize import linear_sum_assignment


def by_ortools(costs):
    rows, columns = np.indices(costs.shape)
    solver = SimpleLinearSumAssignment()
    solver.add_arcs_with_cost(rows.ravel(), columns.ravel(), costs.ravel())
    assert solver.solve() == SimpleLinearSumAssignment.OPTIMAL
    chosen = [solver.right_mate(i) for i in range(len(costs))]
    return solver.optimal_cost(), float(costs[np.arange(len(costs)), chosen].sum())


try:
    SimpleLinearSumAssignment().add_arc_with_cost(0, 0, 0.5)
    raise SystemExit("a single float is taken: the behaviour has changed")
except TypeError:
    print("one float cost: TypeError")
costs = np.array([[1.9, 1.0], [1.0, 1.2]])
said, paid = by_ortools(costs)
best = costs[linear_sum_assignment(costs)].sum()
print(f"an array of floats: OPTIMAL, cost said {said}, paid {paid:.1f}, best {best:.1f}")
assert (said, round(paid, 9), round(float(best), 9)) == (2, 3.1, 2.0)

rng = np.random.default_rng(0)
overlaps = [1 - rng.random((6, 6)) for _ in range(50)]
worse = np.mean([by_ortools(c)[1] - c[linear_sum_assignment(c)].sum() for c in overlaps])
print(f"1 - IoU, six by six: {worse:.2f} above the best on average")
assert worse > 1
EOF
