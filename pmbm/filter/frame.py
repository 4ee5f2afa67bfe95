"""The model's view of one frame of detections, before the density is updated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import Mixture
from pmbm.filter.models.detection_by_sensor import DetectionBySensor
from pmbm.filter.models.protocols import Detection, SceneDensity
from pmbm.filter.models.radar import RadarScan, log_clutter_velocity
from pmbm.filter.models.scores import ScoredDetections
from pmbm.filter.models.sensor import Sensor
from pmbm.filter.models.view import View
from pmbm.filter.prediction import Transition, predict_undetected
from pmbm.filter.scan import Scan
from pmbm.geometry import normal_density
from pmbm.types import Detections, FloatArray, Site

_IN_VIEW = 0.02
"""Share of a Gaussian of undetected objects, in view or out of it, below which there is none."""


@dataclass(frozen=True, eq=False, slots=True)
class Frame:
    """The model's view of one frame of detections.

    time : s.  dt : s since the frame before; 0 for the first.
    sensor : the model of the sensor that it is of; detection : its P_D.
    view : where that looks.  region : where objects are followed: the same, of a single sensor.
    scan : what it measured.
    model : of the world.
    births : objects that appeared since.  births_memory : of the birth model, after them.
    """

    time: float
    dt: float
    sensor: Sensor
    detection: Detection
    view: View
    region: View
    scan: Scan
    model: PMBMConfig
    births: Mixture
    births_memory: Any

    @property
    def transition(self) -> Transition:
        """The transition of objects, which moved and lived on, since the frame before."""
        model, dt = self.model, self.dt
        F, Q = model.motion.transition(dt)
        return Transition(F, Q, model.survival.over(dt), dt, self.detection, model.scores)

    @property
    def partial(self) -> bool:
        """Whether the sensor looks at a part alone of where objects are followed."""
        view, region = self.view, self.region
        if view is region:
            return False
        offset = math.hypot(*(view.pose[:2] - region.pose[:2]))
        return view.half_angle < math.pi or view.max_range + offset < region.max_range - 1e-6

    @property
    def blind(self) -> bool:
        """Whether its sensor, one of several, sees nothing in it."""
        return isinstance(self.detection, DetectionBySensor) and self.detection.blind

    def blinded(self) -> Frame:
        """The frame of a sensor, one of several, that sees nothing in it."""
        assert isinstance(self.detection, DetectionBySensor)
        return replace(self, detection=replace(self.detection, blind=True))


def form_frame(
    model: PMBMConfig,
    site: Site,
    detections: Detections,
    *,
    carrier: FloatArray,
    last: float | None,
    births_memory: Any,
    scene: SceneDensity,
) -> Frame:
    """The frame of these detections.

    carrier (3,) : pose of what carries the sensor.
    last : s, time of the frame before; None for the first.
    births_memory, scene : as the frame before left them.

    Raises InputError where the site has no such sensor.
    """
    dt = 0.0 if last is None else detections.time - last
    pose, mounted = detections.sensor_pose, site.sensor(detections.sensor)
    region = View.of(site, carrier)
    sensor = model.sensor_named(detections.sensor)
    detection = detection_in(model, site, detections.sensor)
    scored = _read(model, sensor, detections, scene)
    births, memory = model.birth.births(
        site, region, None if last is None else dt, model.survival, births_memory
    )
    return Frame(
        time=detections.time,
        dt=dt,
        sensor=sensor,
        detection=detection,
        view=region if mounted is None else View.of(mounted, pose),
        region=region,
        scan=Scan.of(
            scored,
            detection.confidence(scored.detections),
            RadarScan.of(sensor, scored.detections),
        ),
        model=model,
        births=births,
        births_memory=memory,
    )


def detection_in(model: PMBMConfig, site: Site, name: str) -> Detection:
    """P_D of the sensor of that name, beside what the site's others remember."""
    if len(site.sensors) < 2:
        return model.sensor_named(name).detection
    models = tuple(model.sensor_named(one.name).detection for one in site.sensors)
    return DetectionBySensor(models, [one.name for one in site.sensors].index(name))


def _read(
    model: PMBMConfig, sensor: Sensor, detections: Detections, scene: SceneDensity
) -> ScoredDetections:
    """The evidence of scores and of radial velocities in a sensor's detections."""
    scored = model.scores.read(detections, scene)
    if sensor.scores is not None:
        own = sensor.scores.read(scored.detections, scene)
        if sensor.scores.classes == model.scores.classes:
            scored = own
        else:
            # They tell no classes apart: what they say, they say of every class.
            evidence = np.repeat(own.evidence, model.scores.classes, axis=1)
            scored = replace(scored, evidence=evidence, first=own.first)
    given = scored.detections
    if sensor.radial_velocity_sd is not None and given.radial_velocity is not None:
        first = np.ones((len(given), 2)) if scored.first is None else scored.first.copy()
        first[:, 1] *= np.exp(log_clutter_velocity(sensor, given))
        scored = replace(scored, first=first)
    return scored


def split_by_view(ppp: Mixture, frame: Frame) -> tuple[Mixture, Mixture, FloatArray]:
    """The undetected objects that a partial view shows, those that it does not, and how much denser
    both together are than the first alone where each measurement (M,) is: it is in view.

    A Gaussian over the view's edge is in both, each with its share of the weight.
    """
    share = frame.view.share_inside(ppp.mean, ppp.cov)
    rows, rest = np.flatnonzero(share > _IN_VIEW), np.flatnonzero(share < 1 - _IN_VIEW)
    seen, aside = ppp.take(rows), ppp.take(rest)
    seen = replace(seen, log_weight=seen.log_weight + np.log(share[rows]))
    aside = replace(aside, log_weight=aside.log_weight + np.log1p(-share[rest]))
    z = frame.scan.position

    def density(part: Mixture) -> FloatArray:
        return normal_density(z, part.mean[:, :2], part.cov[:, :2, :2]) @ np.exp(part.log_weight)

    in_view = density(seen)
    denser = np.divide(density(ppp), in_view, out=np.ones(len(z)), where=in_view > 0)
    return seen, aside, denser


def undetected_in(model: PMBMConfig, ppp: Mixture, frame: Frame) -> tuple[Mixture, float]:
    """The undetected objects as the frame finds them, in the detail that they are kept in, and the
    expected number of objects that this dropped."""
    predicted = predict_undetected(ppp, frame.transition, frame.births, model.birth)
    return model.birth.reduced(
        predicted,
        frame.region,
        model.survival,
        frame.births_memory,
        model.reduction.prune_undetected,
    )
