"""Identity scores: one track id per object for the whole run.

Ristani, Solera, Zou, Cucchiara, Tomasi, "Performance measures and a data set for multi-target,
multi-camera tracking", ECCV workshops 2016.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Final

import numpy as np

from pmbm.arrays import IntArray
from pmbm.metrics.core.clear_matching import gated_pairs
from pmbm.metrics.core.family import Family, Tally, Work, share
from pmbm.metrics.core.formulas import F1
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.scene import NearPairs, ScoredScene


@dataclass(frozen=True, kw_only=True)
class IdentityCounts:
    """Rows under the best assignment of track ids to object ids: true positives (the assigned
    pair is together inside the gate), misses and false positives (all other rows)."""

    true_positives: int
    misses: int
    false_positives: int


def identity_counts(scene: ScoredScene, together: NearPairs) -> IdentityCounts:
    """Assign object ids to track ids one to one, so that most rows agree.

    together : the pairs of the scene that are inside the gate.
    """
    truth_id, track_id, _, frames = id_pairs(scene, together)
    chosen = best_matching(truth_id, track_id, frames.astype(np.float64))
    true_positives = int(frames[chosen].sum())
    return IdentityCounts(
        true_positives=true_positives,
        misses=len(scene.truth) - true_positives,
        false_positives=len(scene.tracks) - true_positives,
    )


def id_pairs(scene: ScoredScene, pairs: NearPairs) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """The distinct pairs of ids among Q pairs of rows, in ascending order.

    Returns the object's and the track's place among the ids (U,) and (U,), the place of each pair
    of rows among them (Q,), and how many pairs of rows each has (U,).
    """
    n_tracks = max(len(scene.tracks.ids), 1)
    truth_id = scene.truth.index[pairs.truth]
    track_id = scene.tracks.index[pairs.track]
    key, place, count = np.unique(
        truth_id * n_tracks + track_id, return_inverse=True, return_counts=True
    )
    return key // n_tracks, key % n_tracks, place, count


def _count(work: Work) -> Tally:
    gate = work.parameters.gate
    counts = identity_counts(work.scene, gated_pairs(work.scene, gate))
    return Tally.of(asdict(counts), gate=gate, distance="xyz")


FAMILY: Final = Family(
    name="identity",
    rule="one track id for an object in the whole run (Ristani et al. 2016)",
    count=_count,
    metrics=(
        share(
            name="idf1",
            question="For how long does one track id stay with one object?",
            formula=F1("true_positives", "misses", "false_positives"),
        ),
    ),
)
