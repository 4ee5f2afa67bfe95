"""One frame of detections as the model sees it, before it meets the density."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pmbm.errors import InputError
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import Mixture
from pmbm.filter.models.protocols import SceneDensity
from pmbm.filter.models.view import View
from pmbm.filter.prediction import Transition, predict_undetected
from pmbm.filter.scan import Scan
from pmbm.types import Detections, Site


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """One frame of detections, as the model sees it.

    time : s.  dt : s since the frame before; 0 for the first.
    view : where the sensor looks.  scan : what it measured.
    transition : how objects moved and lived on since.
    births : objects that appeared since.  births_memory : of the birth model, after them.
    """

    time: float
    dt: float
    view: View
    scan: Scan
    transition: Transition
    births: Mixture
    births_memory: Any


def form_frame(
    model: PMBMConfig,
    site: Site,
    detections: Detections,
    *,
    last: float | None,
    births_memory: Any,
    scene: SceneDensity,
) -> Frame:
    """The frame of these detections.

    last : s, time of the frame before; None for the first.
    births_memory, scene : as the frame before left them.

    Raises InputError where time runs backwards.
    """
    if last is not None and detections.time < last:
        raise InputError(
            "detections out of order",
            field="time",
            expected=f">= {last:g}",
            got=detections.time,
        )
    dt = 0.0 if last is None else detections.time - last
    view = View.of(site, detections.sensor_pose)
    scored = model.scores.read(detections, scene)
    births, memory = model.birth.births(
        site, view, None if last is None else dt, model.survival, births_memory
    )
    F, Q = model.motion.transition(dt)
    survival = model.survival.over(dt)
    return Frame(
        time=detections.time,
        dt=dt,
        view=view,
        scan=Scan.of(scored, model.sensor.detection.confidence(scored.detections)),
        transition=Transition(F, Q, survival, dt, model.sensor.detection, model.scores),
        births=births,
        births_memory=memory,
    )


def undetected_in(model: PMBMConfig, ppp: Mixture, frame: Frame) -> tuple[Mixture, float]:
    """The undetected objects as the frame finds them, in the detail that they are kept in, and the
    expected number of objects that this dropped."""
    predicted = predict_undetected(ppp, frame.transition, frame.births, model.birth)
    return model.birth.reduced(
        predicted,
        frame.view,
        model.survival,
        frame.births_memory,
        model.reduction.prune_undetected,
    )
