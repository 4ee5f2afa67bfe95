"""Small problems for the four boxes of the filter: bare positions, one P_D, nothing reduced."""

from __future__ import annotations

import numpy as np

from pmbm import Detections
from pmbm.filter import FixedDetection, Reduction
from pmbm.filter.density import Locals, Marks
from pmbm.filter.models.sensor import ObservationModel
from pmbm.filter.scan import Scan

KEEP_ALL = Reduction(
    gate=1e12,
    max_hypotheses=10**15,
    prune_hypothesis=0.0,
    recycle_below=0.0,
    prune_undetected=0.0,
    max_tracks=10**6,
    max_undetected=10**6,
    clustering=False,
    split_below=0.0,
)


def plain_sensor(R, P_D, clutter, **changes):
    """A sensor that looks everywhere; clutter : false detections per m^2 and frame."""
    return ObservationModel(
        R=R, clutter=clutter, detection=FixedDetection(probability=P_D), **changes
    )


def scan_of(position):
    """Points (M,2) alone, whose scores and labels say nothing."""
    position = np.asarray(position, dtype=np.float64).reshape(-1, 2)
    n = len(position)
    return Scan(
        Detections(
            time=0.0,
            position=np.column_stack([position, np.ones(n)]),
            size=np.ones((n, 3)),
            yaw=np.ones(n),
            score=np.ones(n),
            label=np.zeros(n, np.int8),
        ),
        evidence=np.ones((n, 1)),
        birth=np.ones(1),
        first=None,
        said=np.zeros((n, 0)),
        confidence=np.zeros(n),
    )


def bernoullis(track, existence, mean, cov, *, box=None, history=None):
    """Local hypotheses of neutral marks; a history of no steps, where none is given."""
    n = len(existence)
    return Locals(
        track=np.asarray(track, np.intp),
        existence=np.asarray(existence, np.float64),
        mean=np.asarray(mean, np.float64).reshape(n, 4),
        cov=np.asarray(cov, np.float64).reshape(n, 4, 4),
        box=np.ones((n, 5)) if box is None else box,
        label=np.zeros(n, np.int8),
        newest=np.zeros(n, np.int64),
        shown=np.zeros(n, bool),
        history=np.zeros((n, 0), np.int32) if history is None else history,
        marks=Marks.neutral(n),
        record=np.zeros((n, 0)),
    )
