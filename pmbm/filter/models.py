"""What the filter believes about the world: how objects move, live, appear and are detected."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr

from pmbm import compiled
from pmbm.filter.density import Index, Locals, Mixture
from pmbm.types import FloatArray, Site

if TYPE_CHECKING:
    from pmbm.filter.marks import Levels, Visibility
    from pmbm.filter.occlusion import Shadows

LEAST_VISIBLE_TO_BE_SEEN = 0.05
"""Floor of the visible share where an object was detected: what seems to hide it may be a ghost."""
_GOLDEN_ANGLE_SHARE = (math.sqrt(5) - 1) / 2


@dataclass(frozen=True, eq=False, slots=True)
class Transition:
    """How a state moves over one interval, and how probably its object lives on.

    F (4,4), Q (4,4) over [x, y, vx, vy]; survival : P_S over the interval.
    dt : s.  visibility : how the detector loses and finds objects meanwhile, or None.
    levels : how sure it is of each, which drifts, or None.
    """

    F: FloatArray
    Q: FloatArray
    survival: float
    dt: float = 0.0
    visibility: Visibility | None = None
    levels: Levels | None = None


def constant_velocity(dt: float, spectral_density: float) -> tuple[FloatArray, FloatArray]:
    """F and Q (4,4) over `dt` seconds of a velocity driven by continuous white noise, m^2/s^3.

    The continuous form, so that predicting over a and then over b is predicting over a + b
    (Bar-Shalom, Li & Kirubarajan 2001, Sec. 6.2.2).
    """
    a, b, c = dt**3 / 3, dt**2 / 2, dt
    F = np.array([[1, 0, dt, 0], [0, 1, 0, dt], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64)
    Q = np.array([[a, 0, b, 0], [0, a, 0, b], [b, 0, c, 0], [0, b, 0, c]], np.float64)
    return F, spectral_density * Q


def survival_over(dt: float, survival: float, interval: float) -> float:
    """P_S over `dt` where it is `survival` over `interval`, both in seconds."""
    return survival ** (dt / interval)


def births_over(dt: float, rate: float, survival: float, interval: float) -> float:
    """Expected number of objects that appear during `dt` and are alive at its end.

    rate (1 - exp(-mu dt)) / mu with the death rate mu = -ln(P_S) / interval, so that the expected
    number after many short intervals is that after one long one.
    """
    if dt == 0:
        return 0.0
    if survival == 0:
        return 0.0
    mu = -math.log(survival) / interval
    return rate * (dt if mu == 0 else -math.expm1(-mu * dt) / mu)


@dataclass(frozen=True, eq=False, slots=True)
class View:
    """Where the sensor looks: a sector around its pose (x, y, yaw).

    centre, half_angle : rad, relative to the sensor's yaw; max_range : m.
    """

    pose: FloatArray
    centre: float
    half_angle: float
    max_range: float

    @staticmethod
    def of(site: Site, pose: FloatArray) -> View:
        return View(pose, site.fov_centre, site.fov_half_angle, site.max_range)

    @property
    def area(self) -> float:
        """m^2."""
        return self.half_angle * self.max_range**2

    def share_inside(self, mean: FloatArray, cov: FloatArray) -> FloatArray:
        """(N,) probability that an object lies inside, for Gaussians (N,4), (N,4,4).

        The Gaussian is taken as round, the sector's sides as straight, and the range as normal with
        the root of its mean square across the line of sight: within .03 of the integral for births
        as wide as a third of the range.
        """
        if compiled.native is not None:
            return compiled.native.share_inside(
                mean, cov, self.pose, self.centre, self.half_angle, self.max_range
            )
        dx, dy = mean[:, 0] - self.pose[0], mean[:, 1] - self.pose[1]
        distance = np.hypot(dx, dy)
        sd = np.sqrt(np.maximum(cov[:, 0, 0] + cov[:, 1, 1], 1e-12) / 2)
        share = ndtr((self.max_range - np.hypot(distance, sd)) / sd)
        if self.half_angle < np.pi:
            bearing = np.arctan2(dy, dx) - self.pose[2] - self.centre
            off_centre = np.abs(np.mod(bearing + np.pi, 2 * np.pi) - np.pi)
            share = share * ndtr((self.half_angle - off_centre) * distance / sd)
        return share


@dataclass(frozen=True, slots=True)
class DetectionFromScores:
    """P_D of a track from the running mean of its past scores (Pang & Radha 2021, Sec. 2.6, which
    says that it depends on them and leaves the form open): linear between two bounds.

    low, high : the bounds.  rising : whether clear tracks have the high one; then a track that was
    seen clearly and is missed has probably gone.  Falling, it outlives a doubtful one.
    newest : weight of the newest score in the running mean, in (0, 1].
    """

    low: float
    high: float
    rising: bool
    newest: float

    def of(self, confidence: FloatArray | None) -> FloatArray:
        """(H,) P_D in the open."""
        assert confidence is not None
        share = confidence if self.rising else 1 - confidence
        return np.clip(self.low + (self.high - self.low) * share, self.low, self.high)


@dataclass(frozen=True, eq=False, slots=True)
class Sensor:
    """How detections come about.

    R (2,2) : covariance of a measured position, m^2.
    detection : P_D of an object in view.
    clutter : false detections per m^2 and frame.
    view : None where everything is in view.
    shadows : None where nothing hides anything.
    undetected_in_detail : whether the components of undetected objects are narrow enough to tell
        what is hidden, or out of view, from what is not.
    from_scores : None where P_D does not depend on a track's past scores.
    scaled_misses : the paper's rule for a miss (Sec. 2.6) in place of Bayes'.
    visibility : None where misses do not come in runs.
    newest_box : weight of a new detection's height and size in a track's box.
    """

    R: FloatArray
    detection: float
    clutter: float
    view: View | None = None
    shadows: Shadows | None = None
    undetected_in_detail: bool = False
    from_scores: DetectionFromScores | None = None
    scaled_misses: bool = False
    visibility: Visibility | None = None
    newest_box: float = 1.0

    def of_undetected(
        self, mean: FloatArray, cov: FloatArray
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        """P_D (N,) of undetected objects, averaged over Gaussians (N,4), (N,4,4), as misses and as
        detections count it, and the Gaussians after a miss.

        Where the PPP has the detail for it, times the share in view and the expected visible share,
        floored in the second; then what is left of a Gaussian lies rather where it is hidden.  A
        coarse PPP speaks of the view alone: its intensity is that of each place in view, in the
        open, and what reaches over the edge of the view is none.
        """
        in_the_open = np.full(len(mean), self.usual_detection)
        if not self.undetected_in_detail:
            return in_the_open, in_the_open, (mean, cov)
        in_the_open *= self.share_in_view(mean, cov)
        if self.shadows is None:
            return in_the_open, in_the_open, (mean, cov)
        glimpse = self.shadows.undetected(mean, cov)
        visible = glimpse.share()
        return (
            in_the_open * visible,
            in_the_open * np.maximum(visible, LEAST_VISIBLE_TO_BE_SEEN),
            glimpse.if_missed(mean, cov, in_the_open),
        )

    @property
    def usual_detection(self) -> float:
        """P_D of undetected objects in the open."""
        usual = 1.0 if self.visibility is None else self.visibility.usual_share
        return self.detection * usual

    def share_in_view(self, mean: FloatArray, cov: FloatArray) -> FloatArray:
        """(N,) probability that an object is in view, for Gaussians (N,4), (N,4,4)."""
        return np.ones(len(mean)) if self.view is None else self.view.share_inside(mean, cov)

    def of_tracks(
        self, local: Locals
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        """P_D (H,) of local hypotheses, as misses and as detections count it: in the open, times
        the expected visible share, floored in the latter; and means (H,4) and covariances (H,4,4)
        after a miss, which makes it likelier that an object is where it is hidden."""
        own: FloatArray | float = self.detection
        if self.from_scores is not None:
            own = self.from_scores.of(local.confidence)
        if self.visibility is not None and local.seen is not None:
            own = own * self.visibility.share(local.seen)
        in_the_open = own * self.share_in_view(local.mean, local.cov)
        if self.shadows is None:
            return in_the_open, in_the_open, (local.mean, local.cov)
        return self._hidden(self.shadows, local, in_the_open)

    @staticmethod
    def _hidden(
        shadows: Shadows, local: Locals, in_the_open: FloatArray
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        """`of_tracks` where something may hide them, P_D (H,) in the open."""
        visible, vague, glimpse = shadows.of_tracks(local)
        mean, cov = local.mean, local.cov
        if len(vague):
            mean, cov = mean.copy(), cov.copy()
            mean[vague], cov[vague] = glimpse.of_tracks_if_missed(
                mean[vague], cov[vague], in_the_open[vague]
            )
        return (
            in_the_open * visible,
            in_the_open * np.maximum(visible, LEAST_VISIBLE_TO_BE_SEEN),
            (mean, cov),
        )

    def missed(self, r: FloatArray, P_D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Existence of tracks that were missed, and the weight of missing them, (H,) each.

        Bayes: r (1 - P_D) / (1 - r P_D) and 1 - r P_D.  The paper multiplies both existence and
        weight by 1 - P_D (Sec. 2.6), whatever r.
        """
        if self.scaled_misses:
            return r * (1 - P_D), 1 - P_D
        if compiled.native is not None:
            return compiled.native.missed(r, P_D)
        left = 1 - r * P_D
        # Missing what exists and is always seen is impossible; its r stays a number all the same.
        return np.where(left > 0, r * (1 - P_D) / np.where(left > 0, left, 1.0), 0.0), left

    def seen_usually(self, objects: int) -> FloatArray | None:
        """P(seen) of objects that were never detected, taken to be what it is in the long run."""
        if self.visibility is None:
            return None
        return np.full(objects, self.visibility.usual)

    def seen_if_detected(self, seen: FloatArray | None) -> FloatArray | None:
        if self.visibility is None or seen is None:
            return seen
        return self.visibility.if_detected(seen)

    def seen_if_missed(self, seen: FloatArray | None, P_D: FloatArray) -> FloatArray | None:
        if self.visibility is None or seen is None:
            return seen
        if compiled.native is not None:
            after: FloatArray = compiled.native.seen_if_missed(seen, P_D, self.visibility.unseen)
            return after
        return self.visibility.if_missed(seen, P_D)

    def boxed(self, before: FloatArray, detected: FloatArray) -> FloatArray:
        """Boxes (n,5) after detections: height and size with those before, the newest heading."""
        if self.newest_box == 1:
            return detected
        box = before + self.newest_box * (detected - before)
        box[:, 4] = detected[:, 4]
        return box

    def remembered(
        self, before: FloatArray | None, scores: FloatArray | None, measurement: Index
    ) -> FloatArray | None:
        """The running mean of past scores, one detection on."""
        if self.from_scores is None or before is None or scores is None:
            return None
        share = self.from_scores.newest
        return (1 - share) * before + share * scores[measurement]


def spread_over(view: View, components: int, speed_sd: float) -> Mixture:
    """A mixture of weight one that covers the view and its edge about evenly, at any velocity.

    components : how many Gaussians; their centres lie on a sunflower's spiral, which fills any
        sector evenly.  speed_sd : of each velocity component, m/s.
    """
    i = np.arange(components)
    turn = np.mod(i * _GOLDEN_ANGLE_SHARE, 1.0)
    angle = view.pose[2] + view.centre + view.half_angle * (2 * turn - 1)
    radius = view.max_range * np.sqrt((i + 0.5) / components)
    mean = np.zeros((components, 4))
    mean[:, 0] = view.pose[0] + radius * np.cos(angle)
    mean[:, 1] = view.pose[1] + radius * np.sin(angle)
    variance = 0.25 * view.area / components
    cov = np.diag([variance, variance, speed_sd**2, speed_sd**2])
    return Mixture(
        np.full(components, -math.log(components)), mean, np.tile(cov, (components, 1, 1))
    )
