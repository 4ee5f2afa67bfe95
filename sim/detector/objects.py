"""Detection of the objects that are there: misses, displacements, misjudgements, duplicates."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.sim.detector.boxes import TYPICAL_SIZE, Boxes, Targets, concatenate
from pmbm.sim.detector.clutter import ClutterModel, look_alike
from pmbm.sim.detector.knobs import (
    NO_UNKNOWN_KEYS,
    Curve,
    NumberOrCurve,
    Shares,
    Size,
    SizeCorrelation,
    SizeResponse,
    by_label,
    check_correlation,
    drawn_label,
    without_proxies,
)
from pmbm.sim.streams import Purpose, Streams, beta, correlated, cumulative_normal, normal
from pmbm.types import FloatArray, IntArray
from pmbm.validation import NOT_NEGATIVE, POSITIVE, SHARE, Bounds, check_fields

_SMALLEST_SHARE_OF_SIZE = 0.2
"""Noise never makes a box smaller than this share of the object."""


_ZERO = Curve.constant(0.0)
_ONE = Curve.constant(1.0)
_SURE = Curve.constant(0.99)


@dataclass(frozen=True, kw_only=True)
class ObjectModel:
    """How objects of one label are detected.  Every curve is over range (m) unless it says so.

    detection_probability : of an object in full view.
    visibility_factor : curve over the visible share; multiplies the detection probability.
    visibility_odds : curve over the visible share; multiplies the odds of detection, so that
        hiding costs little where detection is next to sure.
    miss_burst_length : frames; mean length of a run of misses, at an unchanged share of misses.
        1 gives independent misses, and so does all that is shorter than their mean run.
    radial_noise, lateral_noise, vertical_noise : standard deviation of the centre along the line
        of sight, across it, and upward, m.
    position_noise_scale : multiplies the three.
    azimuth_noise : standard deviation of the bearing at which the centre is reported, rad, as of a
        radar: it keeps the distance and adds to `lateral_noise`.
    radial_velocity_noise : standard deviation of a reported radial velocity, m/s.
    hidden_noise : how much more the centre errs when hidden: the three are multiplied by
        1 + hidden_noise * (1 - visible share).
    size_pull : how far sizes are pulled from the object's toward the typical: 0 not, 1 all the way.
    typical_size : length, width, height, m; where absent, the label's usual one.
    size_bias : mean relative error of length and width; -0.1 is a tenth too small.
    hidden_size_bias : the same, more of it the less is visible: times (1 - visible share).
    near_side_anchor : how far the centre moves toward the visible side when pull and bias shrink
        the box: 0 keeps the centre, 1 keeps the corner nearest to the sensor.
    length_noise, width_noise, height_noise : standard deviation, m.
    size_response : how deviations of the object's length, width and height from the typical
        (columns) show in the box's (rows), before the pull: a detector that has learned which sizes
        go together reports no others.  Where absent, each shows in itself alone.
    size_correlation : correlation of the three errors of size: one number for every two, or three.
    lasting_size_error : share of the variance of the errors of size that an object keeps for life.
    facing_anchor : how far the centre moves with all that makes the box smaller or larger than the
        object, errors too, so that the side that faces the sensor stays: 0 not, 1 all the way, and
        for sides seen at an angle by its cosine.
    yaw_noise : standard deviation, rad.
    flip_probability : of a heading turned by pi.
    error_persistence : correlation of the errors of centre, size and heading (but for flips) from
        one frame to the next.
    score_persistence : the same of the latent quality that sets the confidence.
    score_mean : mean of the confidence, a Beta variable.
    hidden_score_loss : share of the mean confidence lost when hidden: times (1 - visible share).
    score_concentration : sum of both shapes of the Beta; larger is narrower.
    quality_coupling : how strongly the latent quality that sets the confidence also sets the
        errors of centre, size and heading: they are multiplied by exp(-c z - c^2), z the standard
        normal quality, which leaves their standard deviations over all boxes as they were.
    confusion : probability that the box bears another label, for each such label.
    echo : probability of a false box of another label at the same place as the box, for each such
        label, as of a detector that looks for each label apart.  It looks as false boxes do, heads
        as the box does, and comes and goes as slowly as the quality that sets the confidence.
    duplicate_probability : of a second box of the same object close by, in a frame.
    duplicate_spread : standard deviation of the second box about the first, x and y, m.  Its
        confidence is a uniform share of the first's.
    split_probability : of an object reported as two boxes, its front and its rear half.
    """

    detection_probability: Annotated[NumberOrCurve, SHARE] = _ONE
    visibility_factor: Annotated[NumberOrCurve, SHARE] = _ONE
    visibility_odds: Annotated[NumberOrCurve, POSITIVE] = _ONE
    miss_burst_length: Annotated[float, Bounds(1.0)] = 1.0
    radial_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    lateral_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    vertical_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    position_noise_scale: Annotated[float, NOT_NEGATIVE] = 1.0
    azimuth_noise: Annotated[float, Bounds(0.0, 0.5)] = 0.0
    radial_velocity_noise: Annotated[float, NOT_NEGATIVE] = 0.1
    hidden_noise: Annotated[float, NOT_NEGATIVE] = 0.0
    size_pull: Annotated[NumberOrCurve, SHARE] = _ZERO
    typical_size: Size | None = None
    size_bias: Annotated[float, Bounds(-0.8, 4.0)] = 0.0
    hidden_size_bias: Annotated[float, Bounds(-0.8, 4.0)] = 0.0
    size_response: SizeResponse | None = None
    near_side_anchor: Annotated[float, SHARE] = 0.0
    facing_anchor: Annotated[NumberOrCurve, SHARE] = _ZERO
    length_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    width_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    height_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    size_correlation: SizeCorrelation = 0.0
    lasting_size_error: Annotated[float, SHARE] = 0.0
    yaw_noise: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ZERO
    flip_probability: Annotated[float, SHARE] = 0.0
    error_persistence: Annotated[float, Bounds(0.0, 0.999)] = 0.0
    score_persistence: Annotated[float, Bounds(0.0, 0.999)] = 0.0
    score_mean: Annotated[NumberOrCurve, SHARE] = _SURE
    hidden_score_loss: Annotated[float, SHARE] = 0.0
    score_concentration: Annotated[float, POSITIVE] = 100.0
    quality_coupling: Annotated[float, Bounds(0.0, 2.0)] = 0.0
    confusion: Shares = field(default_factory=dict)
    echo: Shares = field(default_factory=dict)
    duplicate_probability: Annotated[float, SHARE] = 0.0
    duplicate_spread: Annotated[float, NOT_NEGATIVE] = 0.8
    split_probability: Annotated[float, SHARE] = 0.0

    def __post_init__(self) -> None:
        for name in ("confusion", "echo"):
            object.__setattr__(self, name, by_label(name, getattr(self, name)))
        check_fields(self, "detector model")
        check_correlation("size_correlation", self.size_correlation)

    def __reduce__(self) -> tuple[Any, ...]:
        return without_proxies(self)

    def probability(self, distance: FloatArray, visibility: FloatArray) -> FloatArray:
        """Detection probability (R,) at distances (R,) and visible shares (R,)."""
        in_view = self.detection_probability(distance)
        odds = self.visibility_odds(visibility)
        hidden = in_view * odds / (1.0 - in_view + in_view * odds)
        return np.where(odds == 1.0, in_view, hidden) * self.visibility_factor(visibility)

    def position_noise(self, distance: FloatArray, visibility: FloatArray) -> FloatArray:
        """Standard deviations (R,3), radial, lateral, vertical, m."""
        curves = (self.radial_noise, self.lateral_noise, self.vertical_noise)
        at_range = np.stack([curve(distance) for curve in curves], axis=1)
        hidden = 1.0 + self.hidden_noise * (1.0 - visibility)
        return self.position_noise_scale * hidden[:, None] * at_range


ObjectModel.__pydantic_config__ = NO_UNKNOWN_KEYS  # type: ignore[attr-defined]


def sense(model: ObjectModel, seen: Targets, streams: Streams, false_boxes: ClutterModel) -> Boxes:
    """The boxes of those targets, all of one label, that are detected, and their echoes among the
    false boxes."""
    members = seen.members
    steady = model.error_persistence
    sizes = members.normals(streams, Purpose.SIZE, 4, steady)
    if model.lasting_size_error > 0:
        lasting = members.lasting_normals(streams, Purpose.LASTING, 4)
        share = model.lasting_size_error
        sizes = np.sqrt(1.0 - share) * sizes + np.sqrt(share) * lasting
    errors = np.concatenate(
        [
            members.normals(streams, Purpose.POSITION, 3, steady),
            correlated(sizes, model.size_correlation),
            members.normals(streams, Purpose.HEADING, 1, steady),
        ],
        axis=1,
    )
    quality = members.normals(streams, Purpose.SCORE, 1, model.score_persistence)[:, 0]
    # Chains of errors run through frames without a detection, so misses move nothing else.
    detected = _detected(model, seen, streams)
    echo = None
    if model.echo:
        echo = members.normals(streams, Purpose.ECHO, 10, model.score_persistence)[detected]
    seen, errors, quality = seen.take(detected), errors[detected], quality[detected]
    errors *= np.exp(-model.quality_coupling * (quality + model.quality_coupling))[:, None]
    size = _biased_size(model, seen)
    reported = np.maximum(
        size + _size_error(model, seen, errors[:, 3:6]), _SMALLEST_SHARE_OF_SIZE * seen.size
    )
    facing = _facing(seen)
    shift = _in_world(
        seen, model.near_side_anchor * np.sign(facing) * (seen.size - size)[:, :2] / 2
    )
    if any(model.facing_anchor.value):
        held = (
            model.facing_anchor(seen.distance)[:, None] * facing * (seen.size - reported)[:, :2] / 2
        )
        shift = shift + _in_world(seen, held)
    boxes = Boxes(
        frame=seen.frame,
        origin=seen.row,
        position=seen.position + shift + _position_error(model, seen, errors[:, :3]),
        size=reported,
        yaw=_yaw(model, seen, errors[:, 6], streams),
        score=_score(model, seen, quality),
        label=_label(model, seen, streams),
        ground_speed=np.zeros(len(seen)),
    )
    found = _doubled(model, boxes, seen, streams)
    return (
        found
        if echo is None
        else concatenate([found, _echoes(model, boxes, seen.distance, echo, false_boxes)])
    )


def _detected(model: ObjectModel, seen: Targets, streams: Streams) -> NDArray[np.bool_]:
    """Whether each row is detected (R,): a latent uniform of the object lies below its probability.

    For bursts the object keeps its latent value from frame to frame and renews it with the
    probability that gives misses their mean length; being uniform whenever it is looked at, it
    leaves the share of misses as it was.
    """
    probability = model.probability(seen.distance, seen.visibility)
    members = seen.members
    latent = members.uniforms(streams, Purpose.MISS, 1)[:, 0]
    if model.miss_burst_length > 1.0:
        keep = 1.0 - 1.0 / np.maximum(model.miss_burst_length * probability, 1.0)
        renewed = members.uniforms(streams, Purpose.BURST, 1)[:, 0] >= keep
        for _, rows in members:
            latest = np.where(renewed[rows], np.arange(len(rows)), 0)
            latent[rows] = latent[rows][np.maximum.accumulate(latest)]
    detected: NDArray[np.bool_] = latent < probability
    return detected


def _position_error(model: ObjectModel, seen: Targets, errors: FloatArray) -> FloatArray:
    """Errors of the centre (R,3) in the world, from those along and across the line of sight."""
    along, across, up = (errors * model.position_noise(seen.distance, seen.visibility)).T
    cos, sin = np.cos(seen.bearing), np.sin(seen.bearing)
    if model.azimuth_noise > 0:
        # Turned about the sensor: the distance is that with its own error, however far the turn.
        turn, reach = model.azimuth_noise * errors[:, 1], seen.distance + along
        along = reach * np.cos(turn) - seen.distance
        across = across + reach * np.sin(turn)
    return np.stack([along * cos - across * sin, along * sin + across * cos, up], axis=1)


def _biased_size(model: ObjectModel, seen: Targets) -> FloatArray:
    """Sizes (R,3) after response, pull and bias."""
    factor = 1.0 + model.size_bias + model.hidden_size_bias * (1.0 - seen.visibility)
    factor = np.maximum(factor, _SMALLEST_SHARE_OF_SIZE)
    typical = np.array([model.typical_size or TYPICAL_SIZE[Label(v)] for v in Label])[seen.label]
    size = seen.size
    if model.size_response is not None:
        size = typical + (size - typical) @ np.array(model.size_response).T
    size = size + model.size_pull(seen.distance)[:, None] * (typical - size)
    biased: FloatArray = size * np.stack([factor, factor, np.ones_like(factor)], axis=1)
    return biased


def _facing(seen: Targets) -> FloatArray:
    """Cosines (R,2) of the angles between the object's axes, forward and left, and the line to the
    sensor."""
    toward_sensor = seen.bearing + np.pi - seen.yaw
    return np.stack([np.cos(toward_sensor), np.sin(toward_sensor)], axis=1)


def _in_world(seen: Targets, local: FloatArray) -> FloatArray:
    """Moves (R,3) in the world of those along the object's axes (R,2)."""
    cos, sin = np.cos(seen.yaw), np.sin(seen.yaw)
    x = local[:, 0] * cos - local[:, 1] * sin
    y = local[:, 0] * sin + local[:, 1] * cos
    return np.stack([x, y, np.zeros_like(x)], axis=1)


def _size_error(model: ObjectModel, seen: Targets, errors: FloatArray) -> FloatArray:
    curves = (model.length_noise, model.width_noise, model.height_noise)
    return errors * np.stack([curve(seen.distance) for curve in curves], axis=1)


def _yaw(model: ObjectModel, seen: Targets, error: FloatArray, streams: Streams) -> FloatArray:
    yaw = seen.yaw + model.yaw_noise(seen.distance) * error
    if model.flip_probability == 0:
        return wrap_angle(yaw)
    flip = seen.members.uniforms(streams, Purpose.FLIP, 1)[:, 0]
    return wrap_angle(np.where(flip < model.flip_probability, yaw + np.pi, yaw))


def _score(model: ObjectModel, seen: Targets, quality: FloatArray) -> FloatArray:
    mean = model.score_mean(seen.distance) * (
        1.0 - model.hidden_score_loss * (1.0 - seen.visibility)
    )
    return beta(cumulative_normal(quality), mean, model.score_concentration)


def _label(model: ObjectModel, seen: Targets, streams: Streams) -> IntArray:
    if not model.confusion:
        return seen.label
    draw = seen.members.uniforms(streams, Purpose.LABEL, 1)[:, 0]
    other = drawn_label(model.confusion, draw)
    return np.where(other >= 0, other, seen.label)


def _echoes(
    model: ObjectModel,
    boxes: Boxes,
    distance: FloatArray,
    draws: FloatArray,
    false_boxes: ClutterModel,
) -> Boxes:
    """False boxes of another label where `boxes` are, at distances (R,); `draws` (R,10) are
    standard normals."""
    uniform = cumulative_normal(draws)
    label = drawn_label(model.echo, uniform[:, 0])
    rows = label >= 0
    return look_alike(false_boxes, boxes.take(rows), distance[rows], label[rows], uniform[rows, 1:])


def _doubled(model: ObjectModel, boxes: Boxes, seen: Targets, streams: Streams) -> Boxes:
    """The boxes with split objects in halves, and with duplicates."""
    if model.duplicate_probability == 0 and model.split_probability == 0:
        return boxes
    twice, x, y, share, split = seen.members.uniforms(streams, Purpose.DUPLICATE, 5).T
    again = twice < model.duplicate_probability
    aside = model.duplicate_spread * normal(np.stack([x, y], axis=1)[again])
    first = boxes.take(again)
    copy = replace(
        first,
        position=first.position + np.pad(aside, ((0, 0), (0, 1))),
        score=first.score * share[again],
    )
    in_two = split < model.split_probability
    whole = boxes.take(in_two)
    forward = np.stack([np.cos(whole.yaw), np.sin(whole.yaw), np.zeros(len(whole))], axis=1)
    halves = [
        replace(
            whole,
            position=whole.position + side * whole.size[:, :1] / 4 * forward,
            size=whole.size * np.array([0.5, 1.0, 1.0]),
        )
        for side in (1.0, -1.0)
    ]
    return concatenate([boxes.take(~in_two), *halves, copy])
