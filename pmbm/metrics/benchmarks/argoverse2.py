"""The Argoverse 2 tracking rule: CLEAR MOT, identity and HOTA by TrackEval's matching.

Similarity falls from 1 to 0 over 2 m between centres seen from above; 1 m still matches.

What differs from the official evaluation (av2 0.3.6, `av2/evaluation/tracking/eval.py`):

- Truth and tracks are not filtered by the map's region of interest.  The official filter hands
  offsets in the city's axes to a function that takes them for the vehicle's and turns them by its
  heading once more, so that it asks the map about other places.
- Figures are of all tracks.  The official script looks for the score threshold of each class that
  gives the best figure, over 10 recall levels, with scores of all assigned pairs, those too far
  apart to match included.
"""

from __future__ import annotations

from typing import Final

from pmbm.arrays import FloatArray
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.metrics.benchmarks.trackeval import similarity_rule
from pmbm.metrics.core.scene import ScoredScene
from pmbm.metrics.families.hota import distance_similarity


def _near(scene: ScoredScene, _: ComparedSequence) -> FloatArray:
    return distance_similarity(scene.pairs.distance, 2.0)


RULES: Final = {
    "argoverse2": similarity_rule(
        _near,
        0.5,
        "centres within 1 m seen from above, boxes within 50 m, no region of interest",
        50.0,
    ),
}
