"""Distances between whole tracks: OSPA(2).

Beard, Vo, Vo, "OSPA(2): using the OSPA metric to evaluate multi-target tracking performance",
2017; "A solution for large-scale multi-object tracking", IEEE TSP 68, 2020.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.metrics.gospa import check_cutoff_and_order
from pmbm.metrics.matching import best_matching
from pmbm.metrics.ospa import OspaSeries
from pmbm.metrics.scene import Boxes, Scene

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def ospa2_series(scene: Scene, window: int, cutoff: float = 10.0, order: float = 2.0) -> OspaSeries:
    """OSPA(2) at every frame: OSPA between the tracks alive in the last `window` frames.

    The distance of an object and a track, to the p-th power, is the mean over the window's frames
    in which at least one of them exists: of min(d, c)^p where both do, of c^p where one does.
    Windows are cut at the first frame.

    window : frames, >= 1.  cutoff : c > 0, m.  order : p >= 1, inside and outside.
    """
    check_cutoff_and_order(cutoff, order)
    if window < 1:
        raise InputError("bad window", field="window", expected="at least 1 frame", got=window)
    frames, pairs = len(scene), scene.pairs
    window = min(window, max(frames, 1))
    objects, track_ids = max(len(scene.truth.ids), 1), max(len(scene.tracks.ids), 1)
    truth_frames, m = _presence(scene.truth, window, frames)
    track_frames, n = _presence(scene.tracks, window, frames)

    near = pairs.distance < cutoff
    key = scene.truth.index[pairs.truth] * track_ids + scene.tracks.index[pairs.track]
    # Pairs of ids that never come near keep the distance c whatever the assignment.
    relevant = np.flatnonzero(np.isin(key, key[near]))
    power = np.minimum(pairs.distance, cutoff) ** order
    place, end = _in_windows(pairs.frame[relevant], window, frames)
    cell, inverse, together = np.unique(
        end * (objects * track_ids) + key[relevant][place], return_inverse=True, return_counts=True
    )
    cell_end, ids = cell // (objects * track_ids), cell % (objects * track_ids)
    truth_cell = cell_end * objects + ids // track_ids
    track_cell = cell_end * track_ids + ids % track_ids
    either = truth_frames[truth_cell] + track_frames[track_cell] - together
    both = np.bincount(inverse, power[relevant][place], minlength=len(cell))
    # D^p; where the two are never near it is c^p but for rounding, which must not look like gain.
    ever_near = np.bincount(inverse, near[relevant][place], minlength=len(cell)) > 0
    cost = (both + cutoff**order * (either - together)) / either
    useful = np.flatnonzero(ever_near & (cost < cutoff**order))
    chosen = useful[
        best_matching(truth_cell[useful], track_cell[useful], cutoff**order - cost[useful])
    ]
    matched = np.bincount(cell_end[chosen], minlength=frames)
    near_cost = np.bincount(cell_end[chosen], cost[chosen], minlength=frames)

    size = np.maximum(np.maximum(m, n), 1)
    localisation = (near_cost + cutoff**order * (np.minimum(m, n) - matched)) / size
    cardinality = cutoff**order * np.abs(m - n) / size
    return OspaSeries(
        distance=(localisation + cardinality) ** (1 / order),
        localisation=localisation ** (1 / order),
        cardinality=cardinality ** (1 / order),
    )


def _in_windows(frame: IntArray, window: int, frames: int) -> tuple[IntArray, IntArray]:
    """Each row once for every window that holds it: the row (E,), the window's last frame (E,)."""
    row = np.repeat(np.arange(len(frame)), window)
    end = frame[row] + np.tile(np.arange(window), len(frame))
    inside = end < frames
    return row[inside], end[inside]


def _presence(boxes: Boxes, window: int, frames: int) -> tuple[IntArray, IntArray]:
    """Frames in which each id exists in the window that ends at each frame, flat (F*I,), and how
    many ids exist in each window (F,)."""
    ids = max(len(boxes.ids), 1)
    row, end = _in_windows(boxes.frame, window, frames)
    present = np.bincount(end * ids + boxes.index[row], minlength=frames * ids)
    return present, (present.reshape(frames, ids) > 0).sum(axis=1)
