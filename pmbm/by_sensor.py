"""Trackers of single sensors: one alone, or one for each with their tracks fused afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from pmbm.errors import InputError
from pmbm.labels import Label
from pmbm.study.configured import ConfiguredTracker
from pmbm.tracking import Tracker
from pmbm.types import Detections, FloatArray, Site, Tracks

_Member = tuple[str, Tracks, int]
"""A sensor, its tracks, and the row of one of them."""


class OneSensor:
    """A tracker that is given the deliveries of one sensor alone; at those of others it reports
    what it said last, moved on at constant velocity.

    sensor : its name.
    tracker, parameters : what it is, and what its factory is called with, as in a study file.
    """

    def __init__(
        self,
        sensor: str,
        tracker: str = "pmbm",
        parameters: Mapping[str, Any] | None = None,
        site: Site | None = None,
        seed: int = 0,
    ) -> None:
        site = site or Site()
        site.sensor(sensor)
        self.sensor = sensor
        self._tracker = _made(tracker, parameters, site, seed)
        self._last: Tracks | None = None

    def step(self, detections: Detections, /) -> Tracks:
        """Take in a delivery, or let it pass, and report.

        Raises InputError as the tracker does.
        """
        if detections.sensor == self.sensor:
            self._last = self._tracker.step(detections)
        if self._last is None:
            return Tracks.empty(detections.time)
        return moved_on(self._last, detections.time)


class TracksPerSensor:
    """A tracker for every sensor, each of which knows nothing of the others, and their reports
    fused track to track: the plain way of having several sensors.

    Tracks of two sensors that are the nearest to each other (in total) and within `gate` are one;
    its state is their mean, weighted by the inverse of their covariances as if their errors were
    independent, which those of one object's motion are not (Bar-Shalom, Li & Kirubarajan 2001,
    Sec. 8.3).

    tracker, parameters : of each sensor.
    gate : m.  max_age : s after which a sensor that delivers nothing is left out.
    """

    def __init__(
        self,
        tracker: str = "pmbm",
        parameters: Mapping[str, Any] | None = None,
        gate: float = 3.0,
        max_age: float = 0.5,
        site: Site | None = None,
        seed: int = 0,
    ) -> None:
        for name, value in (("gate", gate), ("max_age", max_age)):
            if not value > 0:
                raise InputError("tracks per sensor", field=name, expected="above 0", got=value)
        self.gate, self.max_age = gate, max_age
        self._how = (tracker, parameters, site or Site(), seed)
        self._trackers: dict[str, Tracker] = {}
        self._reports: dict[str, Tracks] = {}
        self._ids: dict[tuple[str, int], int] = {}
        self._next_id = 0

    def step(self, detections: Detections, /) -> Tracks:
        """Let the sensor's own tracker take in its delivery, and report what all say.

        Raises InputError as that tracker does.
        """
        name, time = detections.sensor, detections.time
        if name not in self._trackers:
            self._trackers[name] = _made(*self._how)
        self._reports[name] = self._trackers[name].step(detections)
        groups: list[list[_Member]] = []
        for sensor in sorted(self._reports):
            if time - self._reports[sensor].time <= self.max_age:
                self._join(groups, sensor, moved_on(self._reports[sensor], time))
        return self._fused(time, groups)

    def _join(self, groups: list[list[_Member]], sensor: str, tracks: Tracks) -> None:
        """Add the tracks of a sensor to groups of tracks of one object each."""
        rows = range(len(tracks))
        if groups and len(tracks):
            place = np.array([one.position[row, :2] for ((_, one, row), *_) in groups])
            apart = np.hypot(*(place[:, None] - tracks.position[:, :2]).transpose(2, 0, 1))
            group, row = linear_sum_assignment(np.minimum(apart, self.gate))
            pairs = zip(group.tolist(), row.tolist(), strict=True)
            near = {r: g for g, r in pairs if apart[g, r] < self.gate}
        else:
            near = {}
        for row in rows:
            if row in near:
                groups[near[row]].append((sensor, tracks, row))
        groups += [[(sensor, tracks, row)] for row in rows if row not in near]

    def _fused(self, time: float, groups: Sequence[Sequence[_Member]]) -> Tracks:
        if not groups:
            return Tracks.empty(time)
        ids = self._named(groups)
        rows = [_mean(group) for group in groups]
        columns: dict[str, Any] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        return Tracks(time=time, id=np.array(ids), **columns)

    def _named(self, groups: Sequence[Sequence[_Member]]) -> list[int]:
        """The id of each group: the oldest that one of its tracks had and no other group has."""
        ids: list[int] = []
        for group in groups:
            names = [(sensor, int(tracks.id[row])) for sensor, tracks, row in group]
            known = sorted({self._ids[one] for one in names if one in self._ids} - set(ids))
            if not known:
                known, self._next_id = [self._next_id], self._next_id + 1
            ids.append(known[0])
            self._ids |= dict.fromkeys(names, known[0])
        return ids


def moved_on(tracks: Tracks, time: float) -> Tracks:
    """The tracks at a later time, at constant velocity; the velocity's covariance adds to the
    position's."""
    ahead = time - tracks.time
    if ahead == 0:
        return tracks
    position = tracks.position.copy()
    position[:, :2] += ahead * tracks.velocity
    covariance = tracks.covariance
    if covariance is not None:
        motion = np.eye(4)
        motion[[0, 1], [2, 3]] = ahead
        covariance = motion @ covariance @ motion.T
    return Tracks(
        time=time,
        id=tracks.id,
        position=position,
        size=tracks.size,
        yaw=tracks.yaw,
        velocity=tracks.velocity,
        score=tracks.score,
        label=tracks.label,
        covariance=covariance,
        undetected=tracks.undetected,
    )


def _made(tracker: str, parameters: Mapping[str, Any] | None, site: Site, seed: int) -> Tracker:
    return ConfiguredTracker(tracker, tuple((parameters or {}).items()))(site, seed)


def _mean(group: Sequence[_Member]) -> dict[str, Any]:
    """One row of `Tracks` from those of several sensors; what it looks like is as the first says
    that knows its class."""
    known = [one for one in group if one[1].label[one[2]] != Label.OTHER]
    _, looks, row = (known or group)[0]
    state = [np.r_[tracks.position[i, :2], tracks.velocity[i]] for _, tracks, i in group]
    given = [tracks.covariance for _, tracks, _ in group]
    cov = [np.eye(4) if P is None else P[i] for P, (_, _, i) in zip(given, group, strict=True)]
    information = np.linalg.inv(np.stack(cov))
    total: FloatArray = np.linalg.inv(information.sum(axis=0))
    mean = total @ np.einsum("nij,nj->i", information, np.stack(state))
    found = {
        "position": np.r_[mean[:2], looks.position[row, 2]],
        "velocity": mean[2:],
        "size": looks.size[row],
        "yaw": looks.yaw[row],
        "label": looks.label[row],
        "score": max(float(tracks.score[i]) for _, tracks, i in group),
        "covariance": 0.5 * (total + total.T),
    }
    if any(P is None for P in given):
        del found["covariance"]
    return found
