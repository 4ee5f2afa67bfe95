"""Distances between whole tracks: OSPA(2).

Beard, Vo, Vo, "OSPA(2): using the OSPA metric to evaluate multi-target tracking performance",
2017; "A solution for large-scale multi-object tracking", IEEE TSP 68, 2020.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from pmbm.arrays import BoolArray, IntArray
from pmbm.errors import InputError
from pmbm.metrics.core.family import Family, Tally, Work, per_frame
from pmbm.metrics.core.formulas import Means
from pmbm.metrics.core.matching import best_matching
from pmbm.metrics.core.points import check_cutoff_and_order
from pmbm.metrics.core.scene import BoxRows, ScoredScene
from pmbm.metrics.families.ospa import OSPA_BOUNDS, OspaSeries


def ospa2_series(
    scene: ScoredScene, window: int, cutoff: float = 10.0, order: float = 2.0
) -> OspaSeries:
    """OSPA(2) at every frame: OSPA between the tracks alive in the last `window` frames.

    The distance of an object and a track, to the p-th power, is the mean over the window's frames
    in which at least one of them exists: of min(d, c)^p where both do, of c^p where one does.
    Windows are cut at the first frame.

    window : frames, >= 1.  cutoff : c > 0, m.  order : p >= 1, inside and outside.
    """
    check_cutoff_and_order(cutoff, order)
    if window < 1:
        raise InputError("bad window", field="window", expected="at least 1 frame", got=window)
    frames, pairs = len(scene), scene.near(cutoff)
    window = min(window, max(frames, 1))
    objects, track_ids = max(len(scene.truth.ids), 1), max(len(scene.tracks.ids), 1)
    truth_there = _presence(scene.truth, frames)
    track_there = _presence(scene.tracks, frames)
    truth_frames, track_frames = (
        _last_frames(truth_there, window),
        _last_frames(track_there, window),
    )
    m, n = (truth_frames > 0).sum(axis=0), (track_frames > 0).sum(axis=0)

    # Pairs of ids that are never near in a window keep the distance c whatever the assignment.
    key = scene.truth.index[pairs.truth] * track_ids + scene.tracks.index[pairs.track]
    place, end = _in_windows(pairs.frame, window, frames)
    cell, inverse, near = np.unique(
        end * (objects * track_ids) + key[place], return_inverse=True, return_counts=True
    )
    cell_end, ids = cell // (objects * track_ids), cell % (objects * track_ids)
    i, j = ids // track_ids, ids % track_ids
    together = np.zeros(len(cell), np.int64)
    for back in range(window):
        at = np.maximum(cell_end - back, 0)
        together += truth_there[i, at] & track_there[j, at] & (cell_end >= back)
    either = truth_frames[i, cell_end] + track_frames[j, cell_end] - together
    near_power = np.bincount(inverse, (pairs.distance**order)[place], minlength=len(cell))
    cost = (near_power + cutoff**order * (either - near)) / either
    useful = np.flatnonzero(cost < cutoff**order)
    truth_cell, track_cell = cell_end * objects + i, cell_end * track_ids + j
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


def _presence(boxes: BoxRows, frames: int) -> BoolArray:
    """Whether each id exists in each frame, (I,F)."""
    there = np.zeros((len(boxes.ids), frames), np.bool_)
    there[boxes.index, boxes.frame] = True
    return there


def _last_frames(there: BoolArray, window: int) -> IntArray:
    """The number of the last `window` frames in which each id exists, (I,F)."""
    total: IntArray = np.cumsum(there, axis=1, dtype=np.int64)
    return total - np.pad(total, ((0, 0), (window, 0)))[:, : there.shape[1]]


def _count(work: Work) -> Tally:
    p, period = work.parameters, work.scene.period
    window = 1 if period is None else max(1, round(p.ospa2_window / period))
    result = ospa2_series(work.scene, window, p.ospa_cutoff, p.ospa_order)
    return Tally.of_frames(
        vars(result),
        cutoff=p.ospa_cutoff,
        order=p.ospa_order,
        window=p.ospa2_window,
        distance="xy",
    )


FAMILY: Final = Family(
    name="ospa2",
    rule="OSPA(2) over the tracks of a window that ends at each frame, mean over frames",
    count=_count,
    metrics=(
        per_frame(
            name="ospa2",
            unit="m",
            series="distance",
            bounds=OSPA_BOUNDS,
            question="How far off are the tracks of the last second, identities included?",
            parts=Means(("localisation", "cardinality"), "frames"),
        ),
    ),
)
