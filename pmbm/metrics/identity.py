"""Identity scores: one track id per object for the whole run.

Ristani, Solera, Zou, Cucchiara, Tomasi, "Performance measures and a data set for multi-target,
multi-camera tracking", ECCV workshops 2016.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmbm.metrics.matching import best_matching
from pmbm.metrics.scene import Pairs, Scene

IntArray = NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class IdentityCounts:
    """Rows under the best assignment of track ids to object ids: true positives (the assigned
    pair is together inside the gate), misses and false positives (all other rows)."""

    true_positives: int
    misses: int
    false_positives: int


def identity_counts(scene: Scene, together: Pairs) -> IdentityCounts:
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


def id_pairs(scene: Scene, pairs: Pairs) -> tuple[IntArray, IntArray, IntArray, IntArray]:
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
