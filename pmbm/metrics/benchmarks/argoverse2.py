"""The Argoverse 2 tracking rule: CLEAR MOT, identity and HOTA by TrackEval's matching.

Similarity falls from 1 to 0 over 2 m between centres seen from above; 1 m still matches.
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
        _near, 0.5, "centres within 1 m seen from above, boxes within 50 m", 50.0
    ),
}
