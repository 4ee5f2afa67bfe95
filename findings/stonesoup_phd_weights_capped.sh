#!/usr/bin/env bash
# Package: stonesoup 1.9.1.
# Expected: merging keeps the intensity's mass: the merged weight is the sum of the weights (Vo and Ma, IEEE TSP
#   54, 2006, table II, which GaussianMixtureReducer cites). In a PHD filter a weight is an expected number of
#   targets, not a probability, and the sum of all weights is the estimate of how many there are.
# Seen: merge_components sets every merged weight above 1 to 1. Two targets side by side, weight .95 each,
#   become one component of weight 1.0: the PHD now counts 1.0 targets where it knew of 1.9.
# Why it matters: two pedestrians walking side by side, or a car that overtakes another, cost one target of the
#   count for good, and with it cardinality, OSPA and GOSPA of a GM-PHD built from these parts.
set -euo pipefail
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"${PYTHON:-python3}" -m venv "$work/venv"
"$work/venv/bin/pip" install -qq --no-deps stonesoup==1.9.1 numpy==2.4.6 scipy==1.17.1 ordered-set==4.1.0
"$work/venv/bin/python" - <<'EOF'
from datetime import datetime

import numpy as np
from stonesoup.mixturereducer.gaussianmixture import GaussianMixtureReducer
from stonesoup.types.state import TaggedWeightedGaussianState

now = datetime(2026, 1, 1)


def component(x, weight, tag):
    return TaggedWeightedGaussianState(
        state_vector=[[x], [0.0]], covar=np.eye(2), weight=weight, tag=tag, timestamp=now
    )


reducer = GaussianMixtureReducer(prune_threshold=1e-3, merge_threshold=4)
for weights in ((0.3, 0.4), (0.95, 0.95)):
    mixture = reducer.reduce([component(0.0, weights[0], "a"), component(0.5, weights[1], "b")])
    total = float(sum(c.weight for c in mixture))
    print(
        f"expected number of targets before {sum(weights):.2f}, after {total:.2f}, components {len(mixture)}"
    )
    assert len(mixture) == 1
    assert np.isclose(total, min(1.0, sum(weights)))
EOF
