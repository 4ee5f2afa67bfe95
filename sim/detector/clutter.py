"""Boxes that come from no object: a Poisson number a frame, and some that stay at a place."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from pmbm.errors import InputError
from pmbm.geometry import wrap_angle
from pmbm.labels import Label
from pmbm.sim.detector.boxes import TYPICAL_SIZE, Boxes, concatenate, in_view, polar
from pmbm.sim.detector.knobs import (
    NO_UNKNOWN_KEYS,
    Curve,
    NamedLabel,
    NumberOrCurve,
    Shares,
    Size,
    SizeCorrelation,
    Spread,
    by_label,
    check_correlation,
    drawn_label,
    without_proxies,
)
from pmbm.sim.streams import Purpose, Streams, beta, correlated, cumulative_normal, normal
from pmbm.sim.world.scene import Scene
from pmbm.types import CLUTTER, FloatArray, IntArray, Site
from pmbm.validation import NOT_NEGATIVE, POSITIVE, SHARE, Bounds, check_fields

_SMALLEST_SIZE = 0.2

_BLOCK = 16
_CELL = 40.0
_CELLS_A_SIDE = 2**20
_COMPANY = 20
_COMPANY_SCORES = [9, 19]
_ECHO_SPREAD = 0.1


_ONE = Curve.constant(1.0)
_LOW = Curve.constant(0.3)


def _cars() -> Mapping[Label, float]:
    return {Label.CAR: 1.0}


@dataclass(frozen=True, kw_only=True)
class FalseBoxes:
    """The sizes, headings and scores of false boxes of a label.

    range_profile : curve over range (m): relative density per square metre.
    score_mean : curve over range (m): mean of the confidence, a Beta variable.
    score_concentration : sum of both shapes of the Beta; larger is narrower.
    size_spread : relative standard deviations of length, width and height about the typical ones.
    size_correlation : correlation of these three errors: one number for every two, or three.
    aligned_share : of the boxes, the share that lies along or against the sensor's axis, as what
        stands by a road does.
    across_share : the share that lies across it, to the left or to the right; all others head
        anywhere.
    aligned_spread : standard deviation of both about their directions, rad.
    typical_size : length, width, height, m; where absent, the label's usual one.
    companion_probability : of a further false box of the label near one.
    companion_spread : standard deviation of where that is about the first, x and y, m.
    echo : probability of a further false box of another label at the same place (give or take
        0.1 m), for each such label.  Companions and echoes come and go with the box that they
        belong to.
    """

    range_profile: Annotated[NumberOrCurve, NOT_NEGATIVE] = _ONE
    score_mean: Annotated[NumberOrCurve, SHARE] = _LOW
    score_concentration: Annotated[float, POSITIVE] = 6.0
    size_spread: Spread = (0.1, 0.1, 0.1)
    size_correlation: SizeCorrelation = 0.0
    aligned_share: Annotated[float, SHARE] = 0.0
    across_share: Annotated[float, SHARE] = 0.0
    aligned_spread: Annotated[float, NOT_NEGATIVE] = 0.2
    typical_size: Size | None = None
    companion_probability: Annotated[float, SHARE] = 0.0
    companion_spread: Annotated[float, NOT_NEGATIVE] = 2.0
    echo: Shares = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "echo", by_label("echo", self.echo))
        check_fields(self, "clutter model")
        check_correlation("size_correlation", self.size_correlation)
        if self.aligned_share + self.across_share > 1.0:
            raise InputError(
                "impossible across_share",
                field="across_share",
                expected="with aligned_share at most 1",
                got=self.across_share,
            )
        if not any(density > 0 for density in self.range_profile.value):
            raise InputError(
                "impossible range_profile",
                field="range_profile",
                expected="a value above 0",
                got=list(self.range_profile.value),
            )

    def __reduce__(self) -> tuple[Any, ...]:
        return without_proxies(self)


@dataclass(frozen=True, kw_only=True)
class ClutterModel(FalseBoxes):
    """The number, places and labels of false boxes.

    rate : mean number a frame, over the whole field of view, companions and echoes not counted.
    persistent_share : of the mean number, the share that belongs to fixed places in the world;
        the rest appears anywhere, anew in every frame.
    persistent_detection : probability that a place in view gives a box in a frame.
    persistent_noise : standard deviation of such a box about its place, x and y, m.
    persistent_yaw_noise : the same of its heading about the place's, rad.
    persistent_score_shift : how much better the latent quality behind the scores of a place's boxes
        is than that of false boxes on average, in its standard deviations.
    persistent_score_share : of the variance of that quality, the share that a place keeps for good:
        some places score high, frame after frame.
    speed_spread : standard deviation of how fast a false box seems to move over the ground along
        the line of sight, m/s, where radial velocities are measured; those of a fixed place stand.
    labels : relative frequency of each label.
    label : what false boxes of single labels are like; the others are as this table says.
    """

    rate: Annotated[float, NOT_NEGATIVE] = 0.0
    persistent_share: Annotated[float, SHARE] = 0.0
    persistent_detection: Annotated[float, Bounds(most=1.0, above=0.0)] = 0.8
    persistent_noise: Annotated[float, NOT_NEGATIVE] = 0.3
    persistent_yaw_noise: Annotated[float, NOT_NEGATIVE] = 0.1
    persistent_score_shift: Annotated[float, Bounds(-5.0, 5.0)] = 0.0
    persistent_score_share: Annotated[float, SHARE] = 0.0
    speed_spread: Annotated[float, NOT_NEGATIVE] = 0.0
    labels: Annotated[Mapping[NamedLabel, float], NOT_NEGATIVE] = field(default_factory=_cars)
    label: Mapping[NamedLabel, FalseBoxes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("labels", "label"):
            given = getattr(self, name)
            ordered = {Label(label): given[label] for label in sorted(given)}
            object.__setattr__(self, name, MappingProxyType(ordered))
        if not any(share > 0 for share in self.labels.values()):
            raise InputError(
                "impossible labels",
                field="labels",
                expected="a value above 0",
                got=list(self.labels.values()),
            )

    def of(self, label: Label) -> FalseBoxes:
        """The model of false boxes of that label."""
        return self.label.get(label, self)

    @property
    def has_company(self) -> bool:
        """Whether some false boxes bring others."""
        looks = [self.of(label) for label in self.labels]
        return any(look.companion_probability > 0 or look.echo for look in looks)


FalseBoxes.__pydantic_config__ = NO_UNKNOWN_KEYS  # type: ignore[attr-defined]
ClutterModel.__pydantic_config__ = NO_UNKNOWN_KEYS  # type: ignore[attr-defined]


def clutter(model: ClutterModel, scene: Scene, streams: Streams) -> Boxes:
    """All false boxes of a scene, in the world."""
    fleeting = _fleeting(model, scene, streams)
    if model.rate * model.persistent_share == 0:
        return fleeting
    return concatenate([fleeting, _persistent(model, scene, streams)])


def _fleeting(model: ClutterModel, scene: Scene, streams: Streams) -> Boxes:
    """A Poisson number of boxes a frame, over the field of view.

    The candidates of a frame come at the points of a Poisson process of unit intensity along the
    axis of the rate, and those below the rate are there: a higher rate only adds boxes.
    """
    rate = model.rate * (1.0 - model.persistent_share)
    reached = np.zeros(len(scene))
    frames, marks = [np.zeros(0, np.int64)], [np.zeros((0, 11))]
    block = 0
    company = [np.zeros((0, _COMPANY))]
    speeds = [np.zeros(0)]
    while len(scene) and reached.min() < rate:
        draws = streams.uniforms(Purpose.CLUTTER, len(scene), 11 * _BLOCK, block)
        draws = draws.reshape(len(scene), _BLOCK, 11)
        level = reached[:, None] + np.cumsum(-np.log(draws[..., 0]), axis=1)
        frame, mark = np.nonzero(level < rate)
        frames.append(frame)
        marks.append(draws[frame, mark])
        if model.has_company:
            of_block = streams.uniforms(Purpose.COMPANION, len(scene), _COMPANY * _BLOCK, block)
            company.append(of_block.reshape(len(scene), _BLOCK, _COMPANY)[frame, mark])
        if model.speed_spread > 0:
            of_block = streams.uniforms(Purpose.CLUTTER_SPEED, len(scene), _BLOCK, block)
            speeds.append(model.speed_spread * normal(of_block[frame, mark]))
        reached = level[:, -1]
        block += 1
    frame = np.concatenate(frames)
    _, along, around, label_draw, score, *look = np.concatenate(marks).T
    pose = scene.sensor_pose[frame]
    label = _labels(list(model.labels.items()), label_draw)
    distance = np.zeros(len(frame))
    for kind in model.labels:
        rows = label == kind
        distance[rows] = _range_quantile(model.of(kind).range_profile, scene.site, along[rows])
    bearing = pose[:, 2] + scene.site.fov_centre + scene.site.fov_half_angle * (2 * around - 1)
    centre = pose[:, :2] + distance[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    marks_of_look = np.stack(look, axis=1)
    boxes = _false_boxes(model, frame, centre, distance, pose[:, 2], label, marks_of_look, score)
    if model.speed_spread > 0:
        boxes = replace(boxes, ground_speed=np.concatenate(speeds))
    return _with_company(model, boxes, distance, pose[:, 2], np.concatenate(company))


def _persistent(model: ClutterModel, scene: Scene, streams: Streams) -> Boxes:
    """Boxes about fixed places of the world, wherever the field of view meets them.

    The places of each square cell of the world are the points of one process that a higher density
    only adds to, so that they stay where they are whatever the sensor's path.
    """
    rate = model.rate * model.persistent_share / model.persistent_detection
    total = sum(model.labels.values())
    weights = [
        (kind, share / total / _effective_area(model.of(kind).range_profile, scene.site))
        for kind, share in model.labels.items()
    ]
    per_cell = _CELL**2 * rate * sum(weight for _, weight in weights)
    parts = [Boxes.none()]
    for column, row in _cells(scene):
        cell = (column + _CELLS_A_SIDE // 2) * _CELLS_A_SIDE + row + _CELLS_A_SIDE // 2
        for number, place in enumerate(_places(per_cell, streams, cell)):
            centre = _CELL * (np.array([column, row]) + place[1:3])
            label = _labels(weights, place[3:4])
            key = cell * 2**20 + number
            parts.append(_boxes_of_place(model, scene, streams, key, centre, label, place[4:]))
    return concatenate(parts)


def _boxes_of_place(
    model: ClutterModel,
    scene: Scene,
    streams: Streams,
    key: int,
    centre: FloatArray,
    label: IntArray,
    look: FloatArray,
) -> Boxes:
    """The boxes that one place gives in the frames in which it is in view."""
    distance, bearing = polar(np.broadcast_to(centre, (len(scene), 2)), scene.sensor_pose)
    seen, *noise, score = streams.uniforms(Purpose.PLACE_SEEN, len(scene), 5, key).T
    profile = model.of(Label(label[0])).range_profile
    probability = model.persistent_detection * profile(distance) / max(profile.value)
    frame = np.flatnonzero(
        in_view(scene.site, distance, bearing - scene.sensor_pose[:, 2]) & (seen < probability)
    )
    error = normal(np.stack(noise, axis=1)[frame])
    # What a place looks like, it looks like from wherever it is met first.
    axis = scene.sensor_pose[frame[:1], 2]
    heading = np.broadcast_to(axis, len(frame)) if len(frame) else axis
    boxes = _false_boxes(
        model,
        frame,
        centre + model.persistent_noise * error[:, :2],
        distance[frame],
        heading,
        np.broadcast_to(label, len(frame)),
        np.broadcast_to(look, (len(frame), len(look))),
        _score_draws_of_place(model, score, streams, key)[frame],
    )
    boxes = replace(boxes, yaw=wrap_angle(boxes.yaw + model.persistent_yaw_noise * error[:, 2]))
    if not model.has_company:
        return boxes
    draws = streams.uniforms(Purpose.COMPANION, len(scene), _COMPANY, key)
    lasting = np.tile(draws[0], (len(frame), 1))
    lasting[:, _COMPANY_SCORES] = draws[frame][:, _COMPANY_SCORES]
    return _with_company(model, boxes, distance[frame], heading, lasting)


def _score_draws_of_place(
    model: ClutterModel, draw: FloatArray, streams: Streams, key: int
) -> FloatArray:
    """Uniforms (F,) of the scores of a place's boxes, from independent ones."""
    share, shift = model.persistent_score_share, model.persistent_score_shift
    if share == 0 and shift == 0:
        return draw
    kept = normal(streams.uniforms(Purpose.PLACE_SCORE, 1, 1, key)[0, 0])
    return cumulative_normal(shift + np.sqrt(share) * kept + np.sqrt(1.0 - share) * normal(draw))


def _with_company(
    model: ClutterModel,
    boxes: Boxes,
    distance: FloatArray,
    axis: FloatArray,
    draws: FloatArray,
) -> Boxes:
    """Boxes at distances (R,) with their companions and echoes; `draws` (R,20) are uniforms:
    whether there is a companion, where (two), its look and score (seven); which echo, where, its
    look and score."""
    if not model.has_company:
        return boxes
    parts = [boxes]
    for value in np.unique(boxes.label).tolist():
        look = model.of(Label(value))
        joined = (boxes.label == value) & (draws[:, 0] < look.companion_probability)
        aside = look.companion_spread * normal(draws[joined, 1:3])
        parts.append(
            _false_boxes(
                model,
                boxes.frame[joined],
                boxes.position[joined, :2] + aside,
                distance[joined],
                axis[joined],
                boxes.label[joined],
                draws[joined, 3:9],
                draws[joined, 9],
            )
        )
        other = drawn_label(look.echo, draws[:, 10])
        rows = (boxes.label == value) & (other >= 0)
        brought = boxes.take(rows)
        parts.append(look_alike(model, brought, distance[rows], other[rows], draws[rows, 11:]))
    return concatenate(parts)


def look_alike(
    model: ClutterModel, boxes: Boxes, distance: FloatArray, label: IntArray, draws: FloatArray
) -> Boxes:
    """False boxes of those labels (R,) where `boxes` are, at distances (R,), and heading as they
    do; `draws` (R,9) are uniforms of place (two), look and score."""
    centre = boxes.position[:, :2] + _ECHO_SPREAD * normal(draws[:, :2])
    echo = _false_boxes(
        model, boxes.frame, centre, distance, boxes.yaw, label, draws[:, 2:8], draws[:, 8]
    )
    return replace(echo, yaw=boxes.yaw)


def _cells(scene: Scene) -> Iterator[tuple[int, int]]:
    """The cells of the world that the field of view may meet."""
    at = np.unique(np.floor(scene.sensor_pose[:, :2] / _CELL).astype(np.int64), axis=0)
    reach = int(np.ceil(scene.site.max_range / _CELL))
    step = np.arange(-reach, reach + 1)
    around = np.stack(np.meshgrid(step, step, indexing="ij"), axis=-1).reshape(-1, 2)
    cells = np.unique((at[:, None] + around).reshape(-1, 2), axis=0)
    return ((int(column), int(row)) for column, row in cells)


def _places(per_cell: float, streams: Streams, cell: int) -> FloatArray:
    """Marks (P,10) of the places of one cell, of which there are `per_cell` on average."""
    count = 4
    while True:
        marks = streams.uniforms(Purpose.PLACE, count, 10, cell)
        level = np.cumsum(-np.log(marks[:, 0]))
        if level[-1] >= per_cell:
            return marks[level < per_cell]
        count *= 2


def _range_quantile(profile: Curve, site: Site, share: FloatArray) -> FloatArray:
    """Distances (R,) within which these shares (R,) of the clutter lie."""
    if len(set(profile.value)) == 1:
        return site.max_range * np.sqrt(share)
    edge = np.linspace(0.0, site.max_range, 513)
    middle = (edge[1:] + edge[:-1]) / 2
    mass = np.concatenate([[0.0], np.cumsum(profile(middle) * middle)])
    return np.interp(share * mass[-1], mass, edge)


def _effective_area(profile: Curve, site: Site) -> float:
    """The area of the field of view, each square metre weighed by the profile over its peak,
    m^2."""
    edge = np.linspace(0.0, site.max_range, 513)
    middle = (edge[1:] + edge[:-1]) / 2
    mean = np.average(profile(middle), weights=middle) / max(profile.value)
    return float(site.fov_half_angle * site.max_range**2 * mean)


def _labels(weights: Sequence[tuple[Label, float]], draw: FloatArray) -> IntArray:
    """Labels (R,) by their relative weights."""
    names = np.array([int(label) for label, _ in weights])
    cumulative = np.cumsum([weight for _, weight in weights])
    return names[np.searchsorted(cumulative, draw * cumulative[-1], side="right")]


def _false_boxes(
    model: ClutterModel,
    frame: IntArray,
    centre: FloatArray,
    distance: FloatArray,
    axis: FloatArray,
    label: IntArray,
    draws: FloatArray,
    score_draw: FloatArray,
) -> Boxes:
    """Boxes at centres (R,2), seen at distances (R,); `axis` (R,) is where the sensor heads,
    `draws` (R,6) are uniforms of the heading (two) and the size (four)."""
    size, score, yaw = np.zeros((len(frame), 3)), np.zeros(len(frame)), np.zeros(len(frame))
    for kind in map(Label, np.unique(label).tolist()):
        rows, look = label == kind, model.of(kind)
        typical = np.array(look.typical_size or TYPICAL_SIZE[kind])
        error = correlated(normal(draws[rows, 2:]), look.size_correlation)
        size[rows] = np.maximum(typical * (1 + np.array(look.size_spread) * error), _SMALLEST_SIZE)
        mean = look.score_mean(distance[rows])
        score[rows] = beta(score_draw[rows], mean, look.score_concentration)
        aligned = draws[rows, 0] < look.aligned_share
        across = ~aligned & (draws[rows, 0] < look.aligned_share + look.across_share)
        # One draw gives both which way along the axis and how far off it.
        way, off = np.divmod(2 * draws[rows, 1], 1.0)
        along = axis[rows] + np.pi * way + look.aligned_spread * normal(np.maximum(off, 2.0**-53))
        anywhere = 2 * np.pi * draws[rows, 1] - np.pi
        yaw[rows] = np.select([aligned, across], [along, along + np.pi / 2], anywhere)
    return Boxes(
        frame=frame,
        origin=np.full(len(frame), CLUTTER),
        position=np.concatenate([centre, size[:, 2:] / 2], axis=1),
        size=size,
        yaw=wrap_angle(yaw),
        score=score,
        label=label,
        ground_speed=np.zeros(len(frame)),
    )
