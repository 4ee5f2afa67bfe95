"""The batch mode: a whole run looked at again with what came later."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig
from pmbm.filter.estimation import suppress_overlaps
from pmbm.filter.explain.inspection import Inspection
from pmbm.filter.hypotheses.gaussian import symmetric
from pmbm.geometry import wrap_angle
from pmbm.types import BoolArray, FloatArray, IntArray, Label, Tracks

_LONGEST_GAP = 2.0
"""s without a detection, beyond which what was not seen is not filled in."""
_TURNING = 0.5
"""s over which the course of a heading is averaged."""
_CLIMBING = 0.5
"""s over which a height is averaged."""
_POINTS_AHEAD = (Label.CAR, Label.TRUCK, Label.BUS, Label.MOTORCYCLIST, Label.CYCLIST)
"""What moves where its box points."""
_MOVING = 1.0
"""m/s from which a velocity tells front from back."""
_OWN = 0.5
"""Existence from which a track's detection is its own."""
_AS_UPDATED = 1.05
"""Factor on the area of a position's covariance up to which it is that of a Kalman update."""


def smooth(
    steps: Sequence[Tracks],
    config: PMBMConfig | None = None,
    inspections: Sequence[Inspection] | None = None,
) -> tuple[Tracks, ...]:
    """The tracks of a whole run, each smoothed over its life: one `Tracks` per step, as given.

    A track counts as a whole: it is kept where its score, as of its last detection, with the
    evidence of its whole life, exceeds the configuration's `keep_above`.  It then lives from its
    first report to its last detection, gaps of up to two seconds filled; a detection that is more
    probably another's counts as none.  A tracker that reports from a lower existence on (its own
    `report_above`) thus lets tracks begin before the step in which they became probable.

    Where the scores say of each step how probably an object was there (`Scores.share_by_life`, with
    inspections), it lives from the first to the last step of which that exceeds `keep_above`, and
    is kept where the mean over these, its score, does.

    Positions and velocities are those of the Rauch-Tung-Striebel smoother (AIAA Journal 3(8),
    1965); size is the mean of the detections' and label the most frequent one; height and heading
    are averaged over half a second about each step, boxes turned by half a turn turned back, and
    vehicles turned to where they drive.

    Parameters
    ----------
    steps : what the tracker reported, in order of time, with covariances; boxes as detected.
    config : of that tracker; its noise and `keep_above` count (default: `PMBMConfig()`).
    inspections : what the tracker's `inspect()` gave at each step, which tells existence from being
        no persistent clutter; None, a track is taken to exist wherever it is reported.

    Raises
    ------
    InputError : tracks without covariances, times that run backwards, or inspections of other
        steps.
    """
    config = config if config is not None else PMBMConfig()
    times = np.array([one.time for one in steps])
    if (np.diff(times) < 0).any():
        raise InputError("steps out of order", field="time", got=times[1:][np.diff(times) < 0][0])
    if any(one.covariance is None for one in steps):
        raise InputError("smoothing needs the tracks' covariances", field="covariance")
    inspected = _inspected(steps, inspections)
    lives = []
    for number, rows in sorted(_rows_of_tracks(steps).items()):
        found = _forward(_life(steps, inspected, number, rows, times), config)
        if found is None:
            continue
        life, forward = found
        kept = _kept(life, config, inspected is not None)
        if kept is not None:
            first, end, score = kept
            smoothed = _with_boxes(_backward(life, forward)).between(first, end)
            lives.append(replace(smoothed, score=np.full(end - first, score)))
    reports: list[Tracks] = []
    for number, one in enumerate(steps):
        there = _present(lives, number)
        reports.append(_step(one, _standing(there) if config.report.exclusive else there))
    return tuple(reports)


@dataclass(frozen=True, eq=False, slots=True)
class _Life:
    """The n steps of one track from its first report to its last detection.

    first : its first step.  time (n,).  reported, detected (n,) : whether it was in a step; where
    it was not reported, a row repeats the last report.  mean (n,4), cov (n,4,4), box (n,5) : z,
    length, width, height, yaw.  score (n,), existence (n,), record (n,R), distance (n,), label.
    """

    id: int
    first: int
    time: FloatArray
    reported: BoolArray
    detected: BoolArray
    mean: FloatArray
    cov: FloatArray
    box: FloatArray
    score: FloatArray
    existence: FloatArray
    record: FloatArray
    distance: FloatArray
    label: int

    def between(self, start: int, end: int) -> _Life:
        cut = (
            *("time", "reported", "detected", "mean", "cov", "box"),
            *("score", "existence", "record", "distance"),
        )
        values = {name: getattr(self, name)[start:end] for name in cut}
        return replace(self, first=self.first + start, **values)

    def present(self) -> BoolArray:
        """(n,) where the track is shown: between two detections that are not too far apart."""
        seen = np.flatnonzero(self.detected)
        before = np.searchsorted(seen, np.arange(len(self.time)), side="right") - 1
        after = np.minimum(before + 1, len(seen) - 1)
        gap = self.time[seen[after]] - self.time[seen[np.maximum(before, 0)]]
        return self.detected | (gap <= _LONGEST_GAP)


_Moment = tuple[_Life, int]
"""A life, and the row of a step in it."""


def _rows_of_tracks(steps: Sequence[Tracks]) -> dict[int, list[tuple[int, int]]]:
    """Step and row of every report, by track."""
    rows: dict[int, list[tuple[int, int]]] = {}
    for number, one in enumerate(steps):
        for row, track in enumerate(one.id.tolist()):
            rows.setdefault(track, []).append((number, row))
    return rows


_Inspected = tuple[FloatArray, FloatArray, FloatArray]
"""Of the inspection of a step's K tracks existence (K,), record (K,R) and distance (K,)."""


def _inspected(
    steps: Sequence[Tracks], inspections: Sequence[Inspection] | None
) -> Sequence[_Inspected] | None:
    if inspections is None:
        return None
    if [one.time for one in inspections] != [one.time for one in steps]:
        raise InputError(
            "inspections of other steps",
            field="inspections",
            expected=f"{len(steps)} of the same times",
            got=len(inspections),
        )
    found = []
    for tracks, inspection in zip(steps, inspections, strict=True):
        order = np.argsort(inspection.track_id)
        row = order[np.searchsorted(inspection.track_id, tracks.id, sorter=order)]
        found.append((inspection.existence[row], inspection.record[row], inspection.distance[row]))
    return found


def _life(
    steps: Sequence[Tracks],
    inspected: Sequence[_Inspected] | None,
    track: int,
    where: list[tuple[int, int]],
    times: FloatArray,
) -> _Life:
    numbers = np.array([number for number, _ in where])
    span = np.arange(numbers[0], numbers[-1] + 1)
    # For each step of the life, the last report so far.
    last = np.searchsorted(numbers, span, side="right") - 1
    picked = [(steps[number], row) for number, row in where]
    mean = np.array([[*s.position[r, :2], *s.velocity[r]] for s, r in picked])
    cov = np.array([s.covariance[r] for s, r in picked if s.covariance is not None])
    box = np.array([[s.position[r, 2], *s.size[r], s.yaw[r]] for s, r in picked])
    labels: IntArray = np.array([s.label[r] for s, r in picked], np.int64)
    reported = np.isin(span, numbers)
    own = [(1.0, np.zeros(0), 0.0)] * len(where)
    if inspected is not None:
        own = [tuple(part[row] for part in inspected[number]) for number, row in where]
    existence, record, distance = (np.array(part)[last] for part in zip(*own, strict=True))
    return _Life(
        track,
        int(numbers[0]),
        times[span],
        reported,
        reported,
        mean[last],
        cov[last],
        box[last],
        np.array([s.score[r] for s, r in picked])[last],
        existence,
        record,
        distance,
        int(np.bincount(labels).argmax()),
    )


@dataclass(frozen=True, eq=False, slots=True)
class _Forward:
    """F (n,4,4) into each step and what it predicts there: mean (n,4), cov (n,4,4)."""

    F: FloatArray
    mean: FloatArray
    cov: FloatArray


def _forward(life: _Life, config: PMBMConfig) -> tuple[_Life, _Forward] | None:
    """The life with its gaps predicted through, up to its last detection, or None if it has none.

    A report that is less sure of the place than a measurement makes it is of a track that was
    missed, or whose detection is rather another's, as it is where the track hardly exists.
    """
    information = np.eye(2) / config.sensor.position_sd**2
    n = len(life.mean)
    mean, cov, detected = life.mean.copy(), life.cov.copy(), life.reported & (life.existence > _OWN)
    predicted_mean, predicted_cov = mean.copy(), cov.copy()
    F = np.empty((n, 4, 4))
    for k in range(1, n):
        F[k], Q = config.motion.transition(float(life.time[k] - life.time[k - 1]))
        predicted_mean[k] = F[k] @ mean[k - 1]
        predicted_cov[k] = F[k] @ cov[k - 1] @ F[k].T + Q
        if not life.reported[k]:
            mean[k], cov[k] = predicted_mean[k], predicted_cov[k]
        updated = np.linalg.inv(np.linalg.inv(predicted_cov[k, :2, :2]) + information)
        detected[k] &= np.linalg.det(cov[k, :2, :2]) <= _AS_UPDATED * np.linalg.det(updated)
    if not detected.any():
        return None
    whole = replace(life, mean=mean, cov=cov, detected=detected)
    return (
        whole.between(0, int(np.flatnonzero(detected)[-1]) + 1),
        _Forward(F, predicted_mean, predicted_cov),
    )


def _backward(life: _Life, forward: _Forward) -> _Life:
    mean, cov = life.mean.copy(), life.cov.copy()
    for k in range(len(mean) - 2, -1, -1):
        G = np.linalg.solve(forward.cov[k + 1], forward.F[k + 1] @ cov[k]).T
        mean[k] += G @ (mean[k + 1] - forward.mean[k + 1])
        cov[k] += G @ (cov[k + 1] - forward.cov[k + 1]) @ G.T
    return replace(life, mean=mean, cov=symmetric(cov))


def _kept(life: _Life, config: PMBMConfig, inspected: bool) -> tuple[int, int, float] | None:
    """First and end of the steps of a life that count, and its score; None where it is not kept."""
    least, first, end, score = config.report.keep_above, 0, len(life.time), float(life.score[-1])
    by_life = (
        config.scores.share_by_life(life.record, life.distance, life.time) if inspected else None
    )
    if by_life is not None:
        there = np.flatnonzero(by_life > least)
        if not len(there):
            return None
        first, end = int(there[0]), int(there[-1]) + 1
        score = float(by_life[first:end].mean())
    return (first, end, score) if score > least and life.detected[first:end].any() else None


def _with_boxes(life: _Life) -> _Life:
    """Give a life one size, and smooth its height and heading."""
    seen = np.flatnonzero(life.detected)
    box = life.box.copy()
    box[:, 1:4] = box[seen, 1:4].mean(axis=0)
    lag = life.time[:, None] - life.time[seen]
    box[:, 0] = _averaged(life.box[seen, :1], lag, _CLIMBING)[:, 0]
    box[:, 4] = _headings(life, life.box[seen, 4], lag)
    return replace(life, box=box)


def _averaged(value: FloatArray, lag: FloatArray, within: float) -> FloatArray:
    """Means (n,K) of values (m,K), weighted by a Gaussian of their distance in time (n,m), s."""
    weight = -0.5 * (lag / within) ** 2
    weight = np.exp(weight - weight.max(axis=1, keepdims=True))
    averaged: FloatArray = weight @ value / weight.sum(axis=1, keepdims=True)
    return averaged


def _headings(life: _Life, yaw: FloatArray, lag: FloatArray) -> FloatArray:
    """Headings (n,) from those of the detections (m,), any of which may be turned by half a turn.

    The axis is averaged first, which does not tell front from back, and followed without jumps;
    then all detections, and the motion where it tells, say together which end is the front.
    """
    doubled = _averaged(np.column_stack([np.cos(2 * yaw), np.sin(2 * yaw)]), lag, _TURNING)
    axis = np.unwrap(np.arctan2(doubled[:, 1], doubled[:, 0])) / 2
    ahead = np.cos(yaw - axis[life.detected]).sum()
    speed = np.hypot(life.mean[:, 2], life.mean[:, 3])
    driving = speed > _MOVING
    if life.label in _POINTS_AHEAD and driving.mean() > 0.5:
        course = np.arctan2(life.mean[driving, 3], life.mean[driving, 2])
        ahead = np.cos(course - axis[driving]).sum()
    return wrap_angle(axis if ahead >= 0 else axis + np.pi)


def _present(lives: Sequence[_Life], number: int) -> list[_Moment]:
    return [
        (life, number - life.first)
        for life in lives
        if life.first <= number < life.first + len(life.mean)
        and life.present()[number - life.first]
    ]


def _standing(rows: list[_Moment]) -> list[_Moment]:
    """Keep, of two lives at one place, that of more detections."""
    detections = [np.count_nonzero(life.detected) for life, _ in rows]
    claims = np.argsort(np.negative(detections), kind="stable")
    return [rows[row] for row in suppress_overlaps(*_places(rows), claims, len(rows))]


def _step(given: Tracks, rows: Sequence[_Moment]) -> Tracks:
    place, box = _places(rows)
    n = len(rows)
    mean = np.array([life.mean[k] for life, k in rows]).reshape(n, 4)
    return Tracks(
        time=given.time,
        id=np.array([life.id for life, _ in rows], np.int64),
        position=np.column_stack([place, box[:, 0]]),
        size=box[:, 1:4],
        yaw=box[:, 4],
        velocity=mean[:, 2:],
        score=np.array([life.score[-1] for life, _ in rows]),
        label=np.array([life.label for life, _ in rows], np.int8),
        covariance=np.array([life.cov[k] for life, k in rows]).reshape(n, 4, 4),
        undetected=given.undetected,
    )


def _places(rows: Sequence[_Moment]) -> tuple[FloatArray, FloatArray]:
    """Positions (n,2) and boxes (n,5) of lives at a moment of each."""
    n = len(rows)
    return (
        np.array([life.mean[k, :2] for life, k in rows]).reshape(n, 2),
        np.array([life.box[k] for life, k in rows]).reshape(n, 5),
    )
