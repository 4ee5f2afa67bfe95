"""Occlusion by other objects and walls: the expected visible share of a track, seen from the
sensor.

The sensor's surroundings are cut into narrow bearings.  Every track believed to exist, and every
static occluder, covers the bearings between its outermost corners, at the distance where the ray
meets it.  A bearing of an object is open with the probability that none of the nearer boxes exists,
the product of their 1 - r, and the object's visible share is the mean over its bearings.

This is what lets a track behind a truck keep its existence: nothing was seen there because nothing
could be seen there (Pang & Radha 2021, Sec. 2.2, the motivating example).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pmbm.filter.density import Density, Index, Locals, starts
from pmbm.filter.estimation import marginals
from pmbm.filter.models.rays import BEARINGS, Rays, bearing_of, box_rays, outline_rays, ray_key
from pmbm.types import FloatArray

IGNORED_EXISTENCE = 0.05
"""Tracks that exist less probably hide nothing: most are clutter, seen once."""
CERTAIN = 1 - 1e-9
TOUCHING = 1e-6
"""m; what is not nearer by more hides nothing, so that of two boxes of one front rounding hides
neither."""
VAGUE = 1.0
"""m; of tracks whose position has a wider standard deviation, where they are hidden counts, too."""
MOVES = 2.0
"""Of a missed track's visible share: the share of Bayes' shift that its place moves by.  Measured
on development seeds of truck_occlusion and long_occlusion: ids are kept about as often as with the
whole shift, and places are as good as with none."""
CAR_SD = 0.8
"""m; standard deviation, along any axis, of a point drawn evenly from a car's outline."""


@cache
def nodes(count: int = 24) -> FloatArray:
    """Points (count,2) of equal weight that stand for a standard normal: its quantiles along both
    axes, paired as evenly as a golden lattice does, with its mean and covariance."""
    from scipy.special import ndtri

    i = np.arange(count)
    turn = np.mod((i + 0.5) * (np.sqrt(5) - 1) / 2, 1.0)
    point = ndtri(np.column_stack([(i + 0.5) / count, turn]))
    point -= point.mean(axis=0)
    root = np.linalg.cholesky(point.T @ point / count)
    return np.linalg.solve(root, point.T).T


@dataclass(frozen=True, eq=False, slots=True)
class Glimpse:
    """The visible share of N Gaussians over places of undetected objects, each taken at k points.

    Of a car-sized object as many bearings are open as of its points, so the Gaussians
    are those of a point drawn from the object: a little wider than those of its centre.

    visible (N,k) : probability that nothing hides the point.
    node (N,k,2) : the point, from the mean, m.  S (N,2,2) : covariance of the points.
    """

    visible: FloatArray
    node: FloatArray
    S: FloatArray

    def share(self) -> FloatArray:
        """(N,) expected visible share."""
        return self.visible.mean(axis=1)

    def if_missed(
        self, mean: FloatArray, cov: FloatArray, in_the_open: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Means (N,4) and covariances (N,4,4) of objects that were missed, P_D (N,) in the open:
        those of what is left when each point has lost the share that would have been seen."""
        shift, spread = self._left(in_the_open)
        gain = self._gain(cov)
        return mean + np.einsum("nij,nj->ni", gain, shift), self._with(cov, gain, spread)

    def of_tracks_if_missed(
        self, mean: FloatArray, cov: FloatArray, in_the_open: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """The same of tracks, which hold their course better than white noise lets one believe.

        Their velocity stays as it is, and their place moves by a share of what Bayes' rule says:
        the whole where half of the points are visible or more, less in proportion where most are
        hidden.  The covariance is that around the place.
        """
        shift, spread = self._left(in_the_open)
        held = 1 - np.minimum(MOVES * self.share(), 1.0)[:, None]
        spread = spread + (held * shift)[:, :, None] * (held * shift)[:, None, :]
        gain = self._gain(cov)
        mean = mean.copy()
        mean[:, :2] += np.einsum("nij,nj->ni", gain[:, :2], (1 - held) * shift)
        return mean, self._with(cov, gain, spread)

    def _left(self, in_the_open: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (N,2), from that before, and covariance (N,2,2) of the points that were missed."""
        left = 1 - in_the_open[:, None] * self.visible
        left /= np.maximum(left.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        shift = np.einsum("nk,nki->ni", left, self.node)
        apart = self.node - shift[:, None]
        return shift, np.einsum("nk,nki,nkj->nij", left, apart, apart)

    def _gain(self, cov: FloatArray) -> FloatArray:
        """(N,4,2) how far the states move with the points."""
        gain = np.linalg.solve(self.S, cov[:, :2, :]).astype(np.float64, copy=False)
        return gain.transpose(0, 2, 1)

    def _with(self, cov: FloatArray, gain: FloatArray, spread: FloatArray) -> FloatArray:
        """Covariances (N,4,4) of states whose points have the covariance `spread`."""
        cov = cov + gain @ (spread - self.S) @ gain.transpose(0, 2, 1)
        return 0.5 * (cov + cov.transpose(0, 2, 1))


_NO_GLIMPSE = Glimpse(np.zeros((0, 1)), np.zeros((0, 1, 2)), np.zeros((0, 2, 2)))


@dataclass(frozen=True, eq=False, slots=True)
class Shadows:
    """Everything around the sensor that may hide something.

    pose (3,) : of the sensor.
    rays : of the outlines, the tracks' first.  track_row : track -> its outline, or -1.
    log_open (B,) : log of the probability that the outline is not there.
    key (n,), log_open_before (n+1,) : rays sorted by bearing, then distance, and the running sum of
        their `log_open`.  start (BEARINGS,) : where each bearing begins among them.
    local, targets : the density's local hypotheses and their rays, the bearings widened by one
        standard deviation of the position across the line of sight.
    shadowless (H,) : those whose box is none of the outlines.
    """

    pose: FloatArray
    rays: Rays
    track_row: Index
    log_open: FloatArray
    key: FloatArray
    log_open_before: FloatArray
    start: Index
    local: Locals
    targets: Rays
    shadowless: NDArray[np.bool_]

    @staticmethod
    def of(density: Density, pose: FloatArray, occluders: Sequence[FloatArray] = ()) -> Shadows:
        """The shadows of a density's tracks, as likely as these exist, and of static occluders,
        seen from pose (3,)."""
        marginal = marginals(density)
        solid = np.flatnonzero(marginal.existence > IGNORED_EXISTENCE)
        row = marginal.best[solid]
        local = density.local
        targets = _targets(pose, local)
        rays = targets.bare(row)
        log_open = np.log1p(-np.minimum(marginal.existence[solid], CERTAIN))
        if occluders:
            rays = Rays.joined(rays, outline_rays(pose, occluders))
            wall = np.full(len(occluders), np.log1p(-CERTAIN))
            log_open = np.concatenate([log_open, wall])
        key = ray_key(rays.bearing, rays.distance)
        order = np.argsort(key, kind="stable")
        log_open_before = np.zeros(len(key) + 1)
        np.cumsum(np.repeat(log_open, np.diff(rays.first))[order], out=log_open_before[1:])
        track_row = np.full(len(density.track_id), -1, np.intp)
        track_row[solid] = np.arange(len(solid))
        shadowless = np.ones(len(local), bool)
        shadowless[row] = False
        return Shadows(
            pose,
            rays,
            track_row,
            log_open,
            key[order],
            log_open_before,
            starts(np.bincount(rays.bearing, minlength=BEARINGS))[:-1],
            local,
            targets,
            shadowless,
        )

    @property
    def origin(self) -> FloatArray:
        """(2,) of the sensor."""
        return self.pose[:2]

    def of_tracks(self, local: Locals) -> tuple[FloatArray, Index, Glimpse]:
        """Expected visible share (H,) of each local hypothesis; and of those whose place is little
        known, their rows and what is seen of them point by point.  A track never hides itself."""
        visible = self._share_of_bearings(local)
        rows = np.flatnonzero(_vague(local))
        if not len(rows):
            return visible, rows, _NO_GLIMPSE
        mean, cov, box = local.mean[rows], local.cov[rows], local.box[rows]
        cos, sin = np.cos(box[:, 4]), np.sin(box[:, 4])
        turn = np.stack([np.stack([cos, -sin], axis=1), np.stack([sin, cos], axis=1)], axis=1)
        own = turn * (box[:, None, 1:3] ** 2 / 12) @ turn.transpose(0, 2, 1)
        glimpse = self._glimpse(mean, cov[:, :2, :2] + own, self.track_row[local.track[rows]])
        visible[rows] = glimpse.share()
        return visible, rows, glimpse

    def visible_share(self, local: Locals) -> FloatArray:
        """(H,) expected visible share of each local hypothesis."""
        return self.of_tracks(local)[0]

    def _share_of_bearings(self, local: Locals) -> FloatArray:
        """(H,) expected share of each local hypothesis's bearings that nothing nearer covers.

        The bearings are widened, so that an object that may or may not stand in a shadow is hidden
        in part.
        """
        known = local is self.local
        target = self.targets if known else _targets(self.pose, local)
        if not len(self.key) or not len(target.bearing):
            return np.ones(len(local))
        row = target.outline
        log_open = self._log_open(target.bearing, target.distance)
        # A box that is an outline itself meets each ray where the outline does, and not behind it.
        foreign = np.flatnonzero(self.shadowless[row]) if known else np.arange(len(row))
        if len(foreign):
            own = self.track_row[local.track[row[foreign]]]
            log_open[foreign] -= self._by_itself(
                target.bearing[foreign], target.distance[foreign], own
            )
        count = np.diff(target.first)
        visible = np.bincount(row, np.exp(np.minimum(log_open, 0.0)), minlength=len(local))
        return np.where(count > 0, visible / np.maximum(count, 1), 1.0)

    def undetected(self, mean: FloatArray, cov: FloatArray) -> Glimpse:
        """The visible share of objects that have no track, for Gaussians (N,4), (N,4,4)."""
        return self._glimpse(mean, cov[:, :2, :2] + CAR_SD**2 * np.eye(2))

    def _glimpse(self, mean: FloatArray, spread: FloatArray, own: Index | None = None) -> Glimpse:
        """The visible share of Gaussians (N,4) whose points have the covariance `spread` (N,2,2).

        own (N,) : their own outlines, which do not hide them, or -1.
        """
        offset = mean[:, :2] - self.origin
        range_ = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
        line = offset / range_[:, None]
        # Columns: across the line of sight, along it.
        turn = np.stack([np.stack([-line[:, 1], line[:, 0]], axis=1), line], axis=2)
        S = turn.transpose(0, 2, 1) @ spread @ turn
        sd = np.sqrt(S[:, 0, 0])
        slope = S[:, 0, 1] / sd
        rest = np.sqrt(np.maximum(S[:, 1, 1] - slope**2, 0.0))
        first, second = nodes().T
        side = sd[:, None] * first
        depth = slope[:, None] * first + rest[:, None] * second
        ahead = range_[:, None] + depth
        angle = np.arctan2(line[:, 1], line[:, 0])[:, None] + np.arctan2(side, ahead)
        bearing = bearing_of(angle - self.pose[2]).ravel()
        distance = np.hypot(side, ahead).ravel()
        log_open = self._log_open(bearing, distance)
        if own is not None and len(self.key):
            log_open -= self._by_itself(bearing, distance, np.repeat(own, side.shape[1]))
        visible = np.exp(np.minimum(log_open, 0.0)).reshape(side.shape)
        node = np.stack([side, depth], axis=2) @ turn.transpose(0, 2, 1)
        return Glimpse(visible, node, turn @ S @ turn.transpose(0, 2, 1))

    def _log_open(self, bearing: Index, distance: FloatArray) -> FloatArray:
        """(n,) log of the probability that nothing stands nearer than `distance` at these bearings
        (n,)."""
        nearer = np.searchsorted(self.key, ray_key(bearing, distance - TOUCHING), side="left")
        log_open: FloatArray = self.log_open_before[nearer]
        log_open -= self.log_open_before[self.start[bearing]]
        return log_open

    def _by_itself(self, bearing: Index, distance: FloatArray, own: Index) -> FloatArray:
        """(n,) what a track's own outline would take from its rays: to be given back."""
        first = np.minimum(self.rays.first[own], len(self.key) - 1)
        offset = np.mod(bearing - self.rays.bearing[first], BEARINGS)
        covers = (own >= 0) & (offset < self.rays.first[own + 1] - self.rays.first[own])
        at = np.where(covers, first + offset, 0)
        hides = ray_key(bearing, self.rays.distance[at]) < ray_key(bearing, distance - TOUCHING)
        return np.where(covers & hides, self.log_open[own], 0.0)


def _targets(pose: FloatArray, local: Locals) -> Rays:
    # Of those whose place is little known no bearings are counted.
    widen = np.where(_vague(local), 0.0, _across(pose[:2], local))
    return box_rays(pose, local.mean[:, :2], local.box, widen)


def _vague(local: Locals) -> NDArray[np.bool_]:
    return local.cov[:, 0, 0] + local.cov[:, 1, 1] > 2 * VAGUE**2


def _across(origin: FloatArray, local: Locals) -> FloatArray:
    """(H,) standard deviation of the position across the line of sight, m."""
    offset = local.mean[:, :2] - origin
    range_ = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), 1e-9)
    normal = np.stack([-offset[:, 1], offset[:, 0]], axis=1) / range_[:, None]
    cov = local.cov[:, :2, :2]
    return np.sqrt(np.maximum(np.einsum("hi,hij,hj->h", normal, cov, normal), 0.0))
