"""The sensor: what the tracker assumes of it, and how it observes one frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np

from pmbm.errors import InputError
from pmbm.filter.density import Locals
from pmbm.filter.models.detection import DetectionChain
from pmbm.filter.models.protocols import DETECTIONS, SCORES, Detection, Scores
from pmbm.filter.models.view import View
from pmbm.types import FloatArray
from pmbm.validation import NOT_NEGATIVE, POSITIVE, Bounds, check_fields

if TYPE_CHECKING:
    from pmbm.filter.models.occlusion import Shadows

LEAST_VISIBLE_TO_BE_SEEN = 0.05
"""Floor of the visible share where an object was detected: what seems to hide it may be clutter."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """What the tracker assumes of the sensor.

    position_sd : standard deviation of a measured position, per axis, m.
    range_sd, azimuth_sd : the same along the line of sight, m, and of the bearing, rad, of a sensor
        that measures these; given both, they stand for `position_sd`.
    radial_velocity_sd : standard deviation of a measured radial velocity, m/s; None reads none.
    clutter_speed_sd : standard deviation of how fast clutter seems to move over the ground along
        the line of sight, m/s.
    clutter_rate : expected false detections per frame over the field of view.
    detection : P_D of an object in view that nothing hides.
    occlusion : whether the other tracks, as likely as they exist, and the site's occluders hide an
        object, so that its P_D is that in the open times its expected visible share (Sec. 2.2).
    miss_rule : "bayes"; "scaled": a miss multiplies existence and weight by 1 - P_D, as the paper
        has it (Sec. 2.6).
    box_gain : weight of the newest detection in a track's height above ground and size, against all
        before it; 1 copies the last detection, as the paper does.  Headings are always the last
        detection's.
    describes : whether its boxes and labels say what an object is like; if not, a track keeps those
        that another sensor gave it.
    gate, scores : of this sensor among several, where they are not those of `Reduction` and of the
        whole model.
    align : whether its mount, of one of several, may be off, so that its deliveries are moved back
        where it proves not to fit the others; if not, it is where the site has it.
    may_fail : whether one of several sensors that detects none of many tracks in a delivery without
        any detection is taken for blind, until it detects something again.
    """

    position_sd: Annotated[float, POSITIVE] = 0.5
    range_sd: Annotated[float | None, POSITIVE] = None
    azimuth_sd: Annotated[float | None, POSITIVE] = None
    radial_velocity_sd: Annotated[float | None, POSITIVE] = None
    clutter_speed_sd: Annotated[float, POSITIVE] = 5.0
    clutter_rate: Annotated[float, NOT_NEGATIVE] = 5.0
    detection: Annotated[Detection, DETECTIONS] = field(default_factory=DetectionChain)
    occlusion: bool = True
    miss_rule: Literal["bayes", "scaled"] = "bayes"
    box_gain: Annotated[float, Bounds(above=0.0, most=1.0)] = 1.0
    describes: bool = True
    gate: Annotated[float | None, POSITIVE] = None
    scores: Annotated[Scores | None, SCORES] = None
    align: bool = True
    may_fail: bool = True

    def __post_init__(self) -> None:
        check_fields(self, "sensor")
        if (self.range_sd is None) != (self.azimuth_sd is None):
            raise InputError(
                "sensor",
                field="azimuth_sd" if self.azimuth_sd is None else "range_sd",
                expected="range_sd and azimuth_sd, or neither",
                got=None,
            )

    @cached_property
    def R(self) -> FloatArray:
        """(2,2) covariance of a measured position, m^2."""
        return self.position_sd**2 * np.eye(2)

    def noise_at(self, distance: FloatArray) -> FloatArray:
        """Standard deviation of positions measured at these distances, m, in the worse
        direction."""
        if self.range_sd is None or self.azimuth_sd is None:
            return np.full(np.shape(distance), self.position_sd)
        return np.maximum(self.range_sd, self.azimuth_sd * distance)

    def over(
        self,
        view: View | None,
        *,
        place_by_place: bool = False,
        detection: Detection | None = None,
    ) -> ObservationModel:
        """The sensor in a frame in which it looks there; `view` None, everywhere, with
        `clutter_rate` in 1/m^2.

        detection : P_D in this frame; None is that of the sensor.
        place_by_place : whether undetected objects are kept in components so narrow that it can be
            told which are in view and which are hidden.
        """
        return ObservationModel(
            R=self.R,
            clutter=self.clutter_rate / (1.0 if view is None else view.area),
            detection=self.detection if detection is None else detection,
            view=view,
            undetected_in_detail=place_by_place,
            scaled_misses=self.miss_rule == "scaled",
            box_gain=self.box_gain,
            describes=self.describes,
        )


@dataclass(frozen=True, eq=False, slots=True)
class ObservationModel:
    """How the detections of one frame come about.

    R (2,2) : covariance of a measured position, m^2.
    clutter : false detections per m^2 and frame.
    detection : P_D of an object in view that nothing hides.
    view : None where everything is in view.
    shadows : None where nothing hides anything.
    undetected_in_detail : whether the components of undetected objects are narrow enough to tell
        what is hidden, or out of view, from what is not.
    scaled_misses : the paper's rule for a miss (Sec. 2.6) in place of Bayes'.
    box_gain : weight of a new detection's height and size in a track's box.
    describes : whether a track takes over a new detection's box and label.
    """

    R: FloatArray
    clutter: float
    detection: Detection
    view: View | None = None
    shadows: Shadows | None = None
    undetected_in_detail: bool = False
    scaled_misses: bool = False
    box_gain: float = 1.0
    describes: bool = True

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
        in_the_open = np.full(len(mean), self.detection.of_undetected())
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

    def share_in_view(self, mean: FloatArray, cov: FloatArray) -> FloatArray:
        """(N,) probability that an object is in view, for Gaussians (N,4), (N,4,4)."""
        return np.ones(len(mean)) if self.view is None else self.view.share_inside(mean, cov)

    def of_tracks(
        self, local: Locals
    ) -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
        """P_D (H,) of local hypotheses, as misses and as detections count it: in the open, times
        the expected visible share, floored in the latter; and means (H,4) and covariances (H,4,4)
        after a miss, which makes it likelier that an object is where it is hidden."""
        own = self.detection.of_tracks(local.marks)
        in_the_open = own * self.share_in_view(local.mean, local.cov)
        if self.shadows is None:
            return in_the_open, in_the_open, (local.mean, local.cov)
        return self.of_hidden_tracks(self.shadows, local, in_the_open)

    @staticmethod
    def of_hidden_tracks(
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
        left = 1 - r * P_D
        # Missing what exists and is always detected is impossible; its r stays a number all the
        # same.
        return np.where(left > 0, r * (1 - P_D) / np.where(left > 0, left, 1.0), 0.0), left

    def boxed(self, before: FloatArray, detected: FloatArray) -> FloatArray:
        """Boxes (n,5) after detections: height and size with those before, the newest heading."""
        if not self.describes:
            return before
        if self.box_gain == 1:
            return detected
        box = before + self.box_gain * (detected - before)
        box[:, 4] = detected[:, 4]
        return box
