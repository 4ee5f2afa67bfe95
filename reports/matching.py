"""The object that each track stands for in a frame, and the frame since when each object is
known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from pmbm.geometry import centre_distance
from pmbm.metrics.core.clear_matching import clear_matches
from pmbm.metrics.core.scene import scene_of
from pmbm.types import CLUTTER, GroundTruth, Recording, Tracks, TrackSequence

MISS_DISTANCE = 4.0
"""m; GOSPA's cut-off, so that the marks agree with its missed and false parts."""


@dataclass(frozen=True)
class Switch:
    """A frame in which the object is followed under another track id than before."""

    frame: int
    object: int
    old: int
    new: int


BoolPair = tuple[NDArray[np.bool_], NDArray[np.bool_]]


def matched(truth: GroundTruth, tracks: Tracks) -> BoolPair:
    """Tracks (K,) that stand for an object, and objects (N,) that a track stands for.

    The assignment is GOSPA's (Rahmathullah, Garcia-Fernandez, Svensson, FUSION 2017) with cut-off
    4 m and p = 2, over all objects, observable or not: a track on a hidden object is not false.
    """
    distance = centre_distance(tracks.position[:, :2], truth.position[:, :2])
    rows, columns = linear_sum_assignment(np.minimum(distance, MISS_DISTANCE) ** 2)
    near = distance[rows, columns] < MISS_DISTANCE
    is_track, is_object = np.zeros(len(tracks), np.bool_), np.zeros(len(truth), np.bool_)
    is_track[rows[near]] = True
    is_object[columns[near]] = True
    return is_track, is_object


def first_detection(recording: Recording) -> dict[int, int]:
    """Frame of each object's first detection; of its first observable frame where origins are
    unknown."""
    first: dict[int, int] = {}
    if recording.origin is None:
        for index, truth in enumerate(recording.truth):
            for i in truth.id[truth.observable].tolist():
                first.setdefault(i, index)
        return first
    for frame, origin in zip(recording.frame.tolist(), recording.origin, strict=True):
        for i in recording.truth[frame].id[origin[origin != CLUTTER]].tolist():
            first[i] = min(frame, first.get(i, frame))
    return first


def identity_switches(recording: Recording, tracks: TrackSequence) -> list[Switch]:
    """The switches that CLEAR MOT counts, by frame (its standard matching at 2 m)."""
    scene = scene_of(recording, tracks)
    matches = clear_matches(scene)
    last: dict[int, int] = {}
    found = []
    for step, row, track, switch in zip(
        matches.frame.tolist(),
        matches.truth.tolist(),
        matches.track.tolist(),
        matches.switch.tolist(),
        strict=True,
    ):
        identity, new = int(scene.truth.id[row]), int(scene.tracks.id[track])
        if switch:
            found.append(Switch(int(tracks.frame[step]), identity, last[identity], new))
        last[identity] = new
    return found
