"""Sensor registration: how far the mounts of several sensors are off against each other (Lin,
Bar-Shalom & Kirubarajan, IEEE TAES 41(3), 2005).

Where mounts are believed to be elsewhere than they are, every object is followed twice.  What two
sensors say of one object within a moment tells how far they are off: x, y and yaw of each mount,
the states of one Kalman filter.  Once that is beyond doubt and beyond the noise, deliveries are
moved back.  Of two mounts that do not fit each other nothing says which one is off: each is moved
half-way, or, where one is said to be sure, the other alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import Index
from pmbm.types import Detections, FloatArray, Site, Tracks

_PRIOR_SD = np.array([0.5, 0.5, np.deg2rad(1.0)])
"""m and rad by which a mount may be off."""
_DRIFT_SD = np.array([0.02, 0.02, np.deg2rad(0.02)])
"""By which it may change, per root s."""
_CENTRE_SD = 0.3
"""m by which two kinds of sensors may place the centre of one object apart."""
_MOMENT = 0.25
"""s between two looks whose detections are compared, at most."""
_PAUSE, _SETTLED_PAUSE, _SETTLED = 0.25, 2.0, 10
"""s until a sensor's detections are compared again: at first, and after so many comparisons where
mounts fit.  Sooner they would say much the same again."""
_NEAR = 5.0
"""m from a track that is reported, from which on a detection is not taken for its."""
_GATE = 13.8
"""Squared Mahalanobis distance of a pair that may be one object: 1 of 1000 lies beyond it."""
_ENOUGH = 3
"""Pairs in two looks: fewer may well be of different objects, each seen by one sensor alone."""
_BEYOND_DOUBT = 30.0
"""Squared Mahalanobis distance of two mounts that do not fit each other."""


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """A delivery, as it came, and the pose (3,) of what carried its sensor."""

    detections: Detections
    carrier: FloatArray

    def shift(self, rows: Index) -> FloatArray:
        """(2,n,3) by how much each of these detections is off, x and y, per m, m and rad of the
        mount."""
        cos, sin = np.cos(self.carrier[2]), np.sin(self.carrier[2])
        dx, dy = (self.detections.position[rows, :2] - self.detections.sensor_pose[:2]).T
        shift = np.empty((2, len(rows), 3))
        shift[0, :, 0], shift[0, :, 1], shift[0, :, 2] = cos, -sin, -dy
        shift[1, :, 0], shift[1, :, 1], shift[1, :, 2] = sin, cos, dx
        return shift

    def places(self, error: FloatArray) -> FloatArray:
        """(M,2) the positions where the mount is off by this (3,)."""
        pose, at = self.detections.sensor_pose, self.pose(error)
        turn = pose[2] - at[2]
        cos, sin = np.cos(turn), np.sin(turn)
        offset = self.detections.position[:, :2] - pose[:2]
        found: FloatArray = at[:2] + offset @ np.array([[cos, -sin], [sin, cos]])
        return found

    def pose(self, error: FloatArray) -> FloatArray:
        """(3,) of the sensor where its mount is off by this (3,)."""
        cos, sin = np.cos(self.carrier[2]), np.sin(self.carrier[2])
        x, y, turn = error
        return self.detections.sensor_pose - [x * cos - y * sin, x * sin + y * cos, turn]

    def moved_back(self, error: FloatArray) -> Detections:
        """The delivery as it is where the mount is off by this (3,)."""
        given = self.detections
        return replace(
            given,
            position=np.column_stack([self.places(error), given.position[:, 2]]),
            yaw=given.yaw - error[2],
            sensor_pose=self.pose(error),
        )


@dataclass(frozen=True, eq=False, slots=True)
class Registration:
    """What is known of the mounts of S sensors, in the order of the site.

    compared : s, when the detections of each were compared with those of others.  comparisons : how
        many there were in which enough objects were seen by both.
    error (S,3), cov (3S,3S) : as the site has each mount, less as it is: x forward, y left, m, and
        yaw, rad, in the frame of the carrier; one that is not aligned has none.
    misfit : the two sensors whose mounts prove not to fit each other, or None: then deliveries are
        moved back.
    newest : the last delivery of each sensor.  tracks : the last report.
    """

    error: FloatArray
    cov: FloatArray
    compared: Mapping[str, float] = field(default_factory=dict)
    comparisons: int = 0
    misfit: tuple[str, str] | None = None
    newest: Mapping[str, Look] = field(default_factory=dict)
    tracks: Tracks | None = None

    @staticmethod
    def initial(model: PMBMConfig, site: Site) -> Registration:
        """Nothing known yet."""
        aligned = _aligned(model, site)
        return Registration(
            np.zeros((len(aligned), 3)), np.diag(np.outer(aligned, _PRIOR_SD**2).ravel())
        )

    def after(
        self, model: PMBMConfig, site: Site, detections: Detections, carrier: FloatArray
    ) -> tuple[Registration, Detections]:
        """What is known after a delivery, and the delivery moved back where mounts are off.

        carrier (3,) : pose of what carries the sensors.
        """
        name, time, look = detections.sensor, detections.time, Look(detections, carrier)
        now = replace(self, newest={**self.newest, name: look})
        settled = self.comparisons >= _SETTLED and self.misfit is None
        pause = _SETTLED_PAUSE if settled else _PAUSE
        if time - self.compared.get(name, -np.inf) >= pause and self.cov.any():
            now = now._after_comparison(model, site, look)
        if now.misfit is None:
            return now, detections
        row = site.sensors.index(site.sensor(name))
        return now, look.moved_back(now.error[row])

    def _after_comparison(self, model: PMBMConfig, site: Site, look: Look) -> Registration:
        """With what a look and the newest of the other sensors say."""
        name, time = look.detections.sensor, look.detections.time
        names = [one.name for one in site.sensors]
        since = max(self.compared.values(), default=time)
        drift = (time - since) * np.outer(_aligned(model, site), _DRIFT_SD**2).ravel()
        now = replace(self, cov=self.cov + np.diag(drift), compared={**self.compared, name: time})
        for other in self.newest.values():
            if other is not look and time - other.detections.time <= _MOMENT:
                now = now._compared(model, names, look, other)
        return replace(now, misfit=now._misfit(model, site))

    def _compared(
        self, model: PMBMConfig, names: list[str], look: Look, other: Look
    ) -> Registration:
        """With what the detections of two looks say that are of one object: each other's nearest,
        and one of them at a track that is reported, with whose velocity it moves on."""
        s, o = (names.index(one.detections.sensor) for one in (look, other))
        time, before = look.detections.time, other.detections
        there = other.places(self.error[o])
        at, velocity, spread = _at_tracks(there, before.time, self.tracks)
        ahead = time - before.time
        there, here = there[at] + ahead * velocity, look.places(self.error[s])
        one, two = _mutually_nearest(here, there)
        if not len(one):
            return self
        J = np.zeros((2, len(one), self.error.size))
        J[:, :, 3 * s : 3 * s + 3] = look.shift(one)
        J[:, :, 3 * o : 3 * o + 3] = -other.shift(at[two])
        residual = (here[one] - there[two]).T
        # Of an axis; of a radar the wider one.
        R = ahead**2 * spread[two] + _CENTRE_SD**2
        for each, which in ((look, one), (other, at[two])):
            R = R + _noise(model, each, which) ** 2
        S = R + ((J @ self.cov) * J).sum(axis=(0, 2)) / 2
        kept = np.flatnonzero((residual * residual).sum(axis=0) < _GATE * S)
        if len(kept) < _ENOUGH:
            return self
        rows = J[:, kept].reshape(-1, self.error.size)
        weighted = rows.T / np.tile(R[kept], 2)
        # In this form a mount that is sure may have no variance at all.
        cov = self.cov @ np.linalg.inv(np.eye(len(self.cov)) + weighted @ rows @ self.cov)
        error = cov @ (weighted @ residual[:, kept].ravel())
        return replace(
            self,
            error=self.error + error.reshape(-1, 3),
            cov=(cov + cov.transpose()) / 2,
            comparisons=self.comparisons + 1,
        )

    def _misfit(self, model: PMBMConfig, site: Site) -> tuple[str, str] | None:
        """Two sensors whose mounts are off against each other beyond doubt and by more than their
        noise, half as far as they see; or were, and still are by half of that."""
        for o, other in enumerate(site.sensors):
            for s, sensor in enumerate(site.sensors[:o]):
                pair = (sensor.name, other.name)
                x, y, turn = difference = self.error[o] - self.error[s]
                far = np.array(min(sensor.max_range, other.max_range) / 2)
                shift = np.hypot(x, y) + abs(turn) * far
                noise = max(float(model.sensor_named(name).noise_at(far)) for name in pair)
                if shift < noise / 2 or (shift < noise and self.misfit != pair):
                    continue
                select = np.zeros((3, self.error.size))
                select[:, 3 * s : 3 * s + 3] = -np.eye(3)
                select[:, 3 * o : 3 * o + 3] = np.eye(3)
                cov = select @ self.cov @ select.transpose()
                if difference @ np.linalg.solve(cov, difference) > _BEYOND_DOUBT:
                    return pair
        return None

    def told(self, site: Site) -> str:
        """The misfit in words."""
        assert self.misfit is not None
        names = [one.name for one in site.sensors]
        first, second = self.misfit
        # A mount is that much on the other side of where the site has it.
        x, y, turn = self.error[names.index(first)] - self.error[names.index(second)]
        return (
            f"the mounts of '{first}' and '{second}' do not fit each other: if the first is where "
            f"the site has it, the second is {abs(x):.2f} m farther "
            f"{'front' if x > 0 else 'back'}, {abs(y):.2f} m farther {'left' if y > 0 else 'right'}"
            f" and turned by {abs(np.rad2deg(turn)):.1f} degrees to the "
            f"{'left' if turn > 0 else 'right'}; what they deliver is moved half-way, or wholly to "
            "that of a sensor whose mount is sure (align = false)"
        )


def _aligned(model: PMBMConfig, site: Site) -> FloatArray:
    """(S,) 1 for each sensor whose mount may be off, and 0 for those that are sure."""
    return np.array([float(model.sensor_named(one.name).align) for one in site.sensors])


def _noise(model: PMBMConfig, look: Look, rows: Index) -> FloatArray:
    """(n,) standard deviation of the positions of these detections, in the worse direction, m."""
    given = look.detections
    offset = given.position[rows, :2] - given.sensor_pose[:2]
    return model.sensor_named(given.sensor).noise_at(np.hypot(offset[:, 0], offset[:, 1]))


def _at_tracks(
    place: FloatArray, time: float, tracks: Tracks | None
) -> tuple[Index, FloatArray, FloatArray]:
    """Rows (n,) of the places (M,2) that lie at a track at this time, and the velocities (n,2) of
    those tracks with their variances (n,), of an axis."""
    if tracks is None or not len(tracks) or not len(place):
        return np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros(0)
    assert tracks.covariance is not None
    there = tracks.position[:, :2] + (time - tracks.time) * tracks.velocity
    nearest, apart = _nearest(place, there)
    at = np.flatnonzero(apart < _NEAR**2)
    row = nearest[at]
    spread = (tracks.covariance[row, 2, 2] + tracks.covariance[row, 3, 3]) / 2
    return at, tracks.velocity[row], spread


def _nearest(one: FloatArray, two: FloatArray) -> tuple[Index, FloatArray]:
    """Of each of (M,2) the row of (N,2) that is nearest, and the squared distance."""
    apart = _apart(one, two)
    nearest = apart.argmin(axis=1)
    return nearest, apart[np.arange(len(one)), nearest]


def _mutually_nearest(one: FloatArray, two: FloatArray) -> tuple[Index, Index]:
    """Rows of (M,2) and of (N,2) that are each other's nearest."""
    if not len(one) or not len(two):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    apart = _apart(one, two)
    nearest = apart.argmin(axis=1)
    mutual = np.flatnonzero(apart.argmin(axis=0)[nearest] == np.arange(len(one)))
    return mutual, nearest[mutual]


def _apart(one: FloatArray, two: FloatArray) -> FloatArray:
    """(M,N) squared distances of (M,2) and (N,2)."""
    dx, dy = one[:, :1] - two[:, 0], one[:, 1:] - two[:, 1]
    return dx * dx + dy * dy
