"""One step of the filter in one compiled call.

What scores, births and detection models say stays outside it: they come as columns and numbers.
The plain version is `advance` of `pmbm.filter.tracker`, box by box.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cached_property
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np

from pmbm.filter import estimation
from pmbm.filter.advanced import Advanced
from pmbm.filter.config import PMBMConfig, Report
from pmbm.filter.density import Density, Index, MixtureColumns
from pmbm.filter.estimation import Marginals, ReportedColumns
from pmbm.filter.frame import Frame, detection_in, split_by_view, undetected_in
from pmbm.filter.hypotheses import branching, clusters
from pmbm.filter.hypotheses.weights import log_of
from pmbm.filter.identity.inheritance import IdInheritance
from pmbm.filter.identity.recycling import MOST_OF_ONE
from pmbm.filter.models import occlusion, rays
from pmbm.filter.models.birth import BroadBirth
from pmbm.filter.models.detection import DetectionChain, DetectionFromScores, FixedDetection
from pmbm.filter.models.detection_by_sensor import DetectionBySensor
from pmbm.filter.models.protocols import Detection
from pmbm.filter.models.sensor import LEAST_VISIBLE_TO_BE_SEEN
from pmbm.filter.models.view import View
from pmbm.filter.reduction import ALIKE, AS_HEAVY, FEW, ReductionStats, with_more_undetected
from pmbm.types import FloatArray, IntArray, Site

_OCCLUSION = (
    occlusion.IGNORED_EXISTENCE,
    occlusion.CERTAIN,
    occlusion.TOUCHING,
    occlusion.VAGUE,
    occlusion.MOVES,
    occlusion.CAR_SD,
    LEAST_VISIBLE_TO_BE_SEEN,
    rays.FAR,
)
_PARTS = ("predict", "associate", "update", "reduce")


def has(frame: Frame) -> bool:
    """Whether this step is compiled for a frame: P_D is one of the models known here."""
    return all(map(_has_law, _models(frame.detection)))


def advance(
    native: ModuleType, model: PMBMConfig, site: Site, density: Density, frame: Frame
) -> Advanced:
    """As `advance` of `pmbm.filter.tracker`."""
    scan, detection = frame.scan, frame.detection
    aside = None
    undetected: MixtureColumns | tuple[()]
    births: _Births = ()
    if frame.partial and not model.birth.place_by_place:
        predicted, dropped = undetected_in(model, density.undetected, frame)
        seen, aside, denser = split_by_view(predicted, frame)
        undetected, scan = seen.columns(), scan.with_denser_births(denser)
    else:
        undetected, births, dropped = _undetected(model, density, frame)
    given, radar, held = scan.detections, scan.radar, density.held
    held, judged, removed, gated, seconds = native.step(
        _made(native.Rules, _rules, model, site, given.sensor),
        _made(native.Interval, _interval, model, site, given.sensor, frame.dt),
        undetected,
        births,
        _columns(density) if held is None else held,
        _remembered(model, density, frame.dt),
        density.detections_seen,
        (
            given.position,
            given.size,
            given.yaw,
            given.label,
            scan.evidence,
            scan.birth,
            scan.first,
            scan.said,
            scan.confidence,
        ),
        () if radar is None else radar.columns(),
        frame.view.pose,
        frame.region.pose,
        detection.looking if isinstance(detection, DetectionBySensor) else 0,
        frame.blind,
        detection.of_undetected(),
    )
    after = Density.of_held(held, density.detections_seen + len(scan))
    if aside is not None:
        after = with_more_undetected(after, aside, model.reduction, model.birth)
    counts = (*removed, dropped, gated)
    seconds_of = dict(zip(_PARTS, seconds, strict=True))
    return AdvancedByKernel(after, judged, ReductionStats(*counts), seconds_of)


class AdvancedByKernel(Advanced):
    """The filter after a compiled step: of what it says of tracks, arrays are made where somebody
    looks."""

    def __init__(
        self,
        density: Density,
        judged: Any,
        removed: ReductionStats,
        seconds: Mapping[str, float],
    ) -> None:
        self.__dict__.update(density=density, judged=judged, removed=removed, seconds=seconds)

    judged: Any

    @cached_property
    def marginal(self) -> Marginals:
        return Marginals(*self.judged.marginals())

    @cached_property
    def inside(self) -> FloatArray:
        found: FloatArray = self.judged.inside()
        return found

    def number_in_view(self, object_share: FloatArray) -> float:
        number: float = self.judged.number_in_view(object_share)
        return number

    def reported_as_known(
        self, object_share: FloatArray, rule: Report, ids: IdInheritance
    ) -> tuple[IntArray, ReportedColumns, FloatArray] | None:
        """Ids and columns of the tracks that are reported, and P(class) (R,K) of each, where all
        have been reported before and none may inherit another's id; None otherwise."""
        found = self.judged.reported_as_known(
            object_share,
            ids.reported_ids,
            ids.candidate,
            rule.above,
            rule.exclusive,
            estimation.WHOLE,
        )
        return None if found is None else (found[0], ReportedColumns(*found[1]), found[2])


def _remembered(
    model: PMBMConfig, density: Density, dt: float
) -> tuple[FloatArray, FloatArray] | tuple[()]:
    """P(class) and the running sums of local hypotheses, predicted, or none where they stay as they
    are and the kernel holds them."""
    scores, held = model.scores, density.held
    if held is None:
        source, record = density.local.marks.source, density.local.record
    elif scores.steady:
        return ()
    else:
        source, record = held.source(), held.record()
    return scores.predicted(source, dt), scores.aged(record, dt)


_Births: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, bool] | tuple[()]


def _undetected(
    model: PMBMConfig, density: Density, frame: Frame
) -> tuple[MixtureColumns | tuple[()], _Births, float]:
    """The undetected objects, none where the kernel holds them; the births that it adds to them
    when it has predicted them, none where they come predicted; and what was dropped.

    How the broad births join the survivors, the kernel knows; any other model says it here.
    """
    if type(model.birth) is BroadBirth:
        before = () if density.held is not None else density.undetected.columns()
        born = frame.births
        return before, (born.log_weight, born.mean, born.cov, model.birth.merge_below > 0), 0.0
    predicted, dropped = undetected_in(model, density.undetected, frame)
    return predicted.columns(), (), dropped


def _columns(density: Density) -> tuple[Any, ...]:
    """The hypotheses that no step before this holds, but for what the scores' model remembers."""
    local = density.local
    return (
        (
            local.track,
            local.existence,
            local.mean,
            local.cov,
            local.box,
            local.label,
            local.newest,
            local.shown,
            local.history,
            local.marks.source.shape[1],
            local.marks.confidence,
            local.marks.detectable,
            local.record.shape[1],
        ),
        density.hypotheses.columns(),
        density.track_id,
        density.undetected_settled,
    )


_MADE: dict[tuple[Any, ...], tuple[PMBMConfig, Site, Any]] = {}
"""What was made, by what of; that is kept beside it, so that its id names it alone."""
_MOST_MADE = 256


def _made(
    kind: type, values: Callable[..., tuple[Any, ...]], model: PMBMConfig, site: Site, *more: Any
) -> Any:
    """What is the same in step after step, made of these values once: by identity, since to compare
    two models, or hash one, takes longer than a step."""
    key = kind, id(model), id(site), *more
    found = _MADE.get(key)
    if found is None:
        if len(_MADE) >= _MOST_MADE:
            _MADE.clear()
        found = _MADE[key] = model, site, kind(values(model, site, *more))
    return found[2]


def _rules(model: PMBMConfig, site: Site, name: str) -> tuple[Any, ...]:
    """What the kernel needs of the model and the sensor of that name."""
    sensor, limits = model.sensor_named(name), model.reduction
    view = View.of(site.sensor(name) or site, np.zeros(3))
    observed = sensor.over(view, place_by_place=model.birth.place_by_place)
    prune, merge_below = model.birth.thresholds(limits.prune_undetected)
    return (
        observed.R,
        observed.clutter,
        *(view.centre, view.half_angle, view.max_range),
        *(site.fov_centre, site.fov_half_angle, site.max_range),
        sensor.occlusion,
        observed.undetected_in_detail,
        *_polygons(site),
        observed.scaled_misses,
        observed.box_gain,
        observed.describes,
        limits.gate if sensor.gate is None else sensor.gate,
        limits.recycle,
        log_of(prune),
        merge_below,
        ALIKE,
        AS_HEAVY,
        estimation.ALIKE,
        limits.max_undetected,
        FEW,
        MOST_OF_ONE,
        estimation.STAY,
        limits.max_hypotheses,
        clusters.largest_table(limits.max_hypotheses),
        branching.LARGEST_SEARCH,
        log_of(limits.prune_hypothesis),
        limits.recycle_below,
        limits.max_tracks,
        limits.clustering,
        limits.split_below,
        clusters.WORTH_FACTORING,
        _OCCLUSION,
        occlusion.nodes() if sensor.occlusion else _NO_NODES,
        rays.COS,
        rays.SIN,
    )


_NO_NODES = np.zeros((0, 2))


def _polygons(site: Site) -> tuple[Index, FloatArray]:
    """The site's occluders: where each begins among the corners (V,2) of all."""
    start = np.zeros(len(site.occluders) + 1, np.intp)
    np.cumsum([len(one) for one in site.occluders], out=start[1:])
    corners = np.concatenate([np.zeros((0, 2)), *site.occluders])
    return start, corners


def _interval(model: PMBMConfig, site: Site, name: str, dt: float) -> tuple[Any, ...]:
    """What becomes of objects, and of what sensors remember of them, in that time."""
    survival = model.survival.over(dt)
    return (
        *model.motion.transition(dt),
        survival,
        log_of(survival),
        tuple(_law(one, dt) for one in _models(detection_in(model, site, name))),
    )


def _models(detection: Detection) -> tuple[Detection, ...]:
    """Those of each sensor."""
    return detection.models if isinstance(detection, DetectionBySensor) else (detection,)


def _law(model: Detection, dt: float) -> tuple[float, ...]:
    """A model of P_D in the numbers of the kernel's `DetectionLaw`."""
    match model:
        case DetectionChain():
            stay = model.stay_detectable + model.stay_undetectable - 1
            lasting = model.undetectable, model.stationary, stay ** (dt / model.interval)
            return _law(model.base, dt)[:4] + lasting
        case DetectionFromScores():
            return model.low, model.high, model.rising, model.newest, 0.0, 1.0, 1.0
        case FixedDetection():
            return model.probability, model.probability, False, 0.0, 0.0, 1.0, 1.0
    raise TypeError(f"{type(model).__name__} is not compiled")


def _has_law(model: Detection) -> bool:
    own = model.base if type(model) is DetectionChain else model
    return type(own) in (FixedDetection, DetectionFromScores)
