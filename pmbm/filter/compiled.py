"""One step of the filter in one compiled call.

What scores, births and detection models say stays outside it: they come as columns.  The plain
version is `step` of `pmbm.filter.tracker`, box by box.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from types import ModuleType

import numpy as np

from pmbm.filter import estimation
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import Density, Globals, Index, Locals, Marks, Mixture
from pmbm.filter.frame import Frame, split_by_view, undetected_in
from pmbm.filter.hypotheses import branching, clusters
from pmbm.filter.hypotheses.weights import log_of
from pmbm.filter.identity.recycling import MOST_OF_ONE
from pmbm.filter.models import occlusion, rays
from pmbm.filter.models.birth import BroadBirth
from pmbm.filter.models.sensor import LEAST_VISIBLE_TO_BE_SEEN
from pmbm.filter.prediction import predict_marks
from pmbm.filter.reduction import ALIKE, AS_HEAVY, FEW, ReductionStats, with_more_undetected
from pmbm.types import FloatArray, Site

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
    """Whether this step is compiled for a frame: its measurements are positions of one covariance,
    with boxes and labels that count."""
    return frame.scan.radar is None and frame.sensor.describes


def advance(
    native: ModuleType, model: PMBMConfig, site: Site, density: Density, frame: Frame
) -> tuple[Density, ReductionStats, Mapping[str, float]]:
    """The density after a frame, what the reductions removed, and what each part took, s."""
    local, scan, transition = density.local, frame.scan, frame.transition
    partial = frame.partial and not model.birth.place_by_place
    undetected, births, dropped = _undetected(model, density.undetected, frame, partial)
    aside = None
    if partial:
        undetected, aside, denser = split_by_view(undetected, frame)
        scan = scan.with_denser_births(denser)
    marks = predict_marks(local.marks, transition)
    sensor = frame.sensor.over(frame.view, place_by_place=model.birth.place_by_place)
    hides = frame.sensor.occlusion and (model.birth.place_by_place or len(local) > 0)
    prune, merge_below = model.birth.thresholds(model.reduction.prune_undetected)
    limits = model.reduction
    ppp, columns, table, track_id, settled, origin, removed, pairs, seconds = native.step(
        undetected.columns(),
        births,
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
            marks.source,
            frame.detection.of_tracks(marks),
        ),
        density.hypotheses.columns(),
        density.track_id,
        density.detections_seen,
        density.undetected_settled,
        (
            np.ascontiguousarray(scan.position),
            scan.box,
            scan.label,
            scan.evidence,
            scan.birth,
            scan.first,
        ),
        (
            sensor.R,
            sensor.clutter,
            frame.detection.of_undetected(),
            (frame.view.pose, frame.view.centre, frame.view.half_angle, frame.view.max_range),
            hides,
            sensor.undetected_in_detail,
            *_polygons(site),
            sensor.scaled_misses,
            sensor.box_gain,
        ),
        (
            transition.F,
            transition.Q,
            transition.survival,
            limits.gate if frame.sensor.gate is None else frame.sensor.gate,
            limits.recycle,
            log_of(prune),
            merge_below,
            ALIKE,
            AS_HEAVY,
            estimation.ALIKE,
            limits.max_undetected,
            FEW,
            MOST_OF_ONE,
            log_of(transition.survival),
            estimation.STAY,
        ),
        (
            limits.max_hypotheses,
            clusters.largest_table(limits.max_hypotheses),
            branching.LARGEST_SEARCH,
            log_of(limits.prune_hypothesis),
            limits.recycle_below,
            limits.max_tracks,
            limits.clustering,
            limits.split_below,
            clusters.WORTH_FACTORING,
        ),
        _OCCLUSION,
        occlusion.NODES,
        rays.COS,
        rays.SIN,
    )
    track, existence, mean_of, cov_of, box, label, newest, shown, history, source = columns
    after = Density(
        Mixture.of_columns(ppp),
        Locals(
            track,
            existence,
            mean_of,
            cov_of,
            box,
            label,
            newest,
            shown,
            history,
            _marks_after(marks, frame, source, *origin),
            _record_after(local.record, frame, *origin[:4]),
        ),
        Globals(*table),
        track_id,
        density.detections_seen + len(scan),
        settled,
    )
    if aside is not None:
        after = with_more_undetected(after, aside, limits, model.birth)
    counts = replace(
        ReductionStats(*removed),
        undetected_dropped=dropped,
        pairs_gated=len(local) * len(scan) - pairs,
    )
    return after, counts, dict(zip(_PARTS, seconds, strict=True))


def _undetected(
    model: PMBMConfig, ppp: Mixture, frame: Frame, partial: bool
) -> tuple[Mixture, tuple[FloatArray, FloatArray, FloatArray, bool] | tuple[()], float]:
    """The undetected objects, the births that the kernel adds to them when it has predicted them,
    and what was dropped; no births where they come predicted, as for a partial view.

    How the broad births join the survivors, the kernel knows; any other model says it here.
    """
    if type(model.birth) is BroadBirth and not partial:
        born = frame.births
        return ppp, (born.log_weight, born.mean, born.cov, model.birth.merge_below > 0), 0.0
    predicted, dropped = undetected_in(model, ppp, frame)
    return predicted, (), dropped


def _marks_after(
    before: Marks,
    frame: Frame,
    source: FloatArray,
    missed: int,
    detected: int,
    row: Index,
    measurement: Index,
    P_D: FloatArray,
) -> Marks:
    """Marks of local hypotheses: first those missed, then those detected, then new ones.

    source (n,K) : P(class) of each, after the scan.  row (missed + detected,) : of `before`.
    measurement (detected + new,).  P_D (missed,) : of those missed.
    """
    detection, known = frame.detection, missed + detected
    taken = frame.scan.confidence.take(measurement)
    confidence, detectable = before.confidence.take(row, 0), before.detectable.take(row, 0)
    parts = (
        detection.if_missed(Marks(source[:missed], confidence[:missed], detectable[:missed]), P_D),
        detection.if_detected(
            Marks(source[missed:known], confidence[missed:], detectable[missed:]),
            taken[:detected],
        ),
        detection.first(source[known:], taken[detected:]),
    )
    return Marks(
        source,
        np.concatenate([part.confidence for part in parts]),
        np.concatenate([part.detectable for part in parts]),
    )


def _record_after(
    before: FloatArray, frame: Frame, missed: int, detected: int, row: Index, measurement: Index
) -> FloatArray:
    """Running sums (n,R) of what detections said, in the order of `_marks_after`."""
    if not before.shape[1]:
        # No record is kept: the usual case, in every step.
        return np.zeros((len(row) + len(measurement) - detected, 0))
    transition, said = frame.transition, frame.scan.said.take(measurement, axis=0)
    known = (before * transition.scores.fade(transition.dt)).take(row, axis=0)
    return np.concatenate([known[:missed], known[missed:] + said[:detected], said[detected:]])


@lru_cache(maxsize=8)
def _polygons(site: Site) -> tuple[Index, FloatArray]:
    """The site's occluders: where each begins among the corners (V,2) of all."""
    start = np.zeros(len(site.occluders) + 1, np.intp)
    np.cumsum([len(one) for one in site.occluders], out=start[1:])
    corners = np.concatenate([np.zeros((0, 2)), *site.occluders])
    return start, corners
