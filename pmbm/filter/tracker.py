"""The PMBM tracker: predict, associate, update, reduce (Pang & Radha 2021, Fig. 2)."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any

from pmbm import kernels
from pmbm.errors import InputError, InputWarning
from pmbm.filter import compiled
from pmbm.filter.advanced import Advanced
from pmbm.filter.association import associate
from pmbm.filter.blindness import Blindness, log_chance_of_none
from pmbm.filter.compiled import AdvancedByKernel
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import Density, Locals, Mixture
from pmbm.filter.estimation import (
    Marginals,
    ReportedColumns,
    in_view,
    marginals,
    reported_in,
)
from pmbm.filter.explain.inspection import Inspection, inspect
from pmbm.filter.frame import Frame, form_frame, split_by_view, undetected_in
from pmbm.filter.identity.inheritance import IdInheritance
from pmbm.filter.models.birth_map import BirthMap
from pmbm.filter.models.occlusion import Shadows
from pmbm.filter.models.protocols import SceneDensity
from pmbm.filter.models.sensor import ObservationModel
from pmbm.filter.models.view import View
from pmbm.filter.prediction import predict
from pmbm.filter.reduction import ReductionStats, reduce, with_more_undetected
from pmbm.filter.registration import Registration
from pmbm.filter.update import update
from pmbm.types import Detections, FloatArray, IntArray, Site, Tracks, unchecked


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """What the tracker knows between two frames.

    time : s, of the last frame; NaN before the first.
    density : the PMBM density.
    births : memory of the birth model (`Birth.births`).
    scene : how many objects the scene has held.
    ids : which tracks may take over whose id.
    before : the scene before `time`, and the s since the time before it: a further delivery of the
        same time counts in place of those before it, not on top of them.
    blindness, registration : of several sensors, which have gone blind, and whose mounts are off.
    """

    time: float
    density: Density
    births: Any
    scene: SceneDensity
    ids: IdInheritance
    before: tuple[SceneDensity, float] = (SceneDensity(), 0.0)
    blindness: Mapping[str, Blindness] = field(default_factory=dict)
    registration: Registration | None = None

    def __repr__(self) -> str:
        return f"State({self.time:g} s: {self.density})"

    @staticmethod
    def initial(model: PMBMConfig) -> State:
        """Nothing looked at yet."""
        density = Density.initial(
            Mixture.empty(),
            clustering=model.reduction.clustering,
            local=Locals.empty(model.report.history, model.scores.classes, model.scores.sums),
        )
        return State(math.nan, density, None, SceneDensity(), IdInheritance())

    @property
    def started(self) -> bool:
        return not math.isnan(self.time)


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """What a step leaves to look at.

    before : the density after the frame before.  frame : as the model saw it.
    removed : by the reductions.  seconds : what each part took (never part of a result).
    """

    before: Density
    frame: Frame
    removed: ReductionStats
    seconds: Mapping[str, float]

    def __repr__(self) -> str:
        return f"Trace(before: {self.before})"


def step(
    model: PMBMConfig, site: Site, state: State, detections: Detections
) -> tuple[State, Tracks, Trace]:
    """The state and the report after one frame, empty or not.

    Raises InputError where time runs backwards, or where the site has no such sensor.
    """
    frame, state = _next_frame(model, site, state, detections)
    return _after(model, site, state, frame)


def _next_frame(
    model: PMBMConfig, site: Site, state: State, detections: Detections
) -> tuple[Frame, State]:
    """The frame of these detections, and the state with what they say of several sensors."""
    if state.started and detections.time < state.time:
        raise InputError(
            "detections out of order",
            field="time",
            expected=f">= {state.time:g}",
            got=detections.time,
        )
    carrier = site.carrier_pose(detections)
    several = len(site.sensors) > 1
    if several:
        registration = state.registration or Registration.initial(model, site)
        registration, detections = registration.after(model, site, detections, carrier)
        state = replace(state, registration=registration)
    frame = form_frame(
        model,
        site,
        detections,
        carrier=carrier,
        last=state.time if state.started else None,
        births_memory=state.births,
        scene=state.before[0] if detections.time == state.time else state.scene,
    )
    if several:
        frame, blindness = _seeing(model, site, state, frame, detections)
        state = replace(state, blindness=blindness)
    return frame, state


def _after(
    model: PMBMConfig, site: Site, state: State, frame: Frame
) -> tuple[State, Tracks, Trace]:
    if kernels.native is None or not compiled.has(frame):
        advanced = advance(model, site, state.density, frame)
    else:
        advanced = compiled.advance(kernels.native, model, site, state.density, frame)
    after, tracks = report(model, state, frame, advanced)
    if state.registration is not None:
        registration = replace(state.registration, tracks=tracks)
        after = replace(after, blindness=state.blindness, registration=registration)
    return after, tracks, Trace(state.density, frame, advanced.removed, advanced.seconds)


def _seeing(
    model: PMBMConfig, site: Site, state: State, frame: Frame, detections: Detections
) -> tuple[Frame, Mapping[str, Blindness]]:
    """The frame as a sensor made it that may have gone blind, and which sensors are."""
    name = detections.sensor
    one = state.blindness.get(name, Blindness(frame.time))
    if len(detections) or not frame.sensor.may_fail:
        one = one.after_detections(frame.time)
    else:
        predicted, _ = predicted_in(model, state.density, frame)
        P_D, _, _ = observe(model, site, frame, predicted).of_tracks(predicted.local)
        one = one.after_none(frame.time, log_chance_of_none(predicted, P_D))
    if one.blind:
        frame = frame.blinded()
    return frame, {**state.blindness, name: one}


def advance(model: PMBMConfig, site: Site, density: Density, frame: Frame) -> Advanced:
    """The density after a frame, by the four boxes of Fig. 2."""
    clock = _Clock()
    predicted, dropped = predicted_in(model, density, frame)
    scan, limits, aside = frame.scan, model.reduction, None
    if frame.partial and not model.birth.place_by_place:
        seen, aside, denser = split_by_view(predicted.undetected, frame)
        predicted, scan = predicted.with_undetected(seen), scan.with_denser_births(denser)
    clock.read("predict")
    sensor = observe(model, site, frame, predicted)
    if frame.sensor.gate is not None:
        limits = replace(limits, gate=frame.sensor.gate)
    association = associate(predicted, scan, sensor, limits)
    clock.read("associate")
    updated = update(predicted, scan, association, sensor)
    clock.read("update")
    reduced, removed = reduce(updated, limits, model.birth)
    if aside is not None:
        reduced = with_more_undetected(reduced, aside, limits, model.birth)
    marginal, inside = in_view(reduced, frame.region)
    shown = replace(reduced.local, shown=marginal.shown_as(reduced.local))
    clock.read("reduce")
    removed = replace(
        removed,
        hypotheses_pruned=removed.hypotheses_pruned + association.dropped,
        undetected_dropped=dropped,
        pairs_gated=len(predicted.local) * len(frame.scan) - len(association.known.row),
    )
    return Advanced(replace(reduced, local=shown), marginal, inside, removed, clock.seconds)


def predicted_in(model: PMBMConfig, density: Density, frame: Frame) -> tuple[Density, float]:
    """The density as the frame finds it, and the expected number of objects that fell from the map
    of undetected ones."""
    predicted = predict(density, frame.transition, frame.births)
    undetected, dropped = undetected_in(model, density.undetected, frame)
    return predicted.with_undetected(undetected), dropped


def observe(model: PMBMConfig, site: Site, frame: Frame, predicted: Density) -> ObservationModel:
    """The sensor that looks at the predicted objects, some of which hide others."""
    place_by_place = model.birth.place_by_place
    sensor = frame.sensor.over(frame.view, place_by_place=place_by_place, detection=frame.detection)
    if not frame.sensor.occlusion or not (place_by_place or len(predicted.local)):
        return sensor
    return replace(sensor, shadows=Shadows.of(predicted, frame.view.pose, site.occluders))


def report(
    model: PMBMConfig, state: State, frame: Frame, advanced: Advanced
) -> tuple[State, Tracks]:
    """The state after the frame, and the tracks that probably exist and are probably in view.  One
    that has left the view is kept in mind, and reported again where it comes back."""
    before = state.before if frame.time == state.time else (state.scene, frame.dt)
    scene = model.scores.observed(before[0], advanced.number_in_view, before[1])
    density, ids, named = advanced.density, state.ids, None
    if isinstance(advanced, AdvancedByKernel) and kernels.native and not model.scores.sums:
        share = model.scores.object_share(scene)
        named = advanced.reported_as_known(share, model.report, ids)
    if named is None:
        density, ids, named = _named(model, scene, ids, advanced, frame.region)
    track_id, columns, source = named
    tracks = unchecked(
        Tracks,
        time=frame.time,
        id=track_id,
        position=columns.position,
        size=columns.size,
        yaw=columns.yaw,
        velocity=columns.velocity,
        score=columns.score,
        label=model.scores.labels(columns.label, source),
        covariance=columns.covariance,
        undetected=density.public_undetected(),
    )
    return State(frame.time, density, frame.births_memory, scene, ids, before), tracks


def _named(
    model: PMBMConfig, scene: SceneDensity, ids: IdInheritance, advanced: Advanced, region: View
) -> tuple[Density, IdInheritance, tuple[IntArray, ReportedColumns, FloatArray]]:
    """The density, with the ids that its tracks go by; which may inherit which; and ids and columns
    of those that are reported, with P(class) (R,K) of each."""
    density, marginal = advanced.density, advanced.marginal
    exists = objects(model, scene, marginal, density, region)
    reported, columns, source = reported_in(
        density,
        marginal.best,
        exists,
        advanced.inside,
        above=model.report.above,
        exclusive=model.report.exclusive,
    )
    ids, density = ids.after(density, marginal, exists, reported)
    return density, ids, (density.track_id[reported], columns, source)


def objects(
    model: PMBMConfig, scene: SceneDensity, marginal: Marginals, density: Density, region: View
) -> FloatArray:
    """(T,) the probability of each track to exist and be an object."""
    exists = marginal.objects(model.scores.object_share(scene))
    if not model.scores.sums:
        return exists
    local, best = density.local, marginal.best
    return exists * model.scores.recorded_share(
        local.record[best], region.distance(local.mean[best])
    )


class PMBMTracker:
    """Follows an unknown number of objects through noisy, cluttered, incomplete detections.

    config : what it assumes; site : what the sensor can see (default: 100 m all round).

    Raises InputError for models of sensors that the site does not name.

    Example
    -------
    >>> tracker = PMBMTracker(PMBMConfig(reduction=Reduction(gate=16.0)))
    >>> tracks = tracker.step(Detections.empty(time=0.0))
    >>> len(tracks)
    0
    """

    def __init__(self, config: PMBMConfig | None = None, site: Site | None = None) -> None:
        self.config = config if config is not None else PMBMConfig()
        self.site = site if site is not None else Site()
        for name in self.config.sensors:
            if self.site.sensor(name) is None:
                raise InputError(
                    f"a model of the sensor '{name}' where the site names no sensors",
                    field="sensors",
                    expected="none",
                    got=", ".join(self.config.sensors),
                    hint="set what is assumed of a single sensor as sensor.KEY, or name the "
                    "sensors in the scenario or site",
                )
        self.state = State.initial(self.config)
        self.trace: Trace | None = None
        self._warned: set[str] = set()

    @classmethod
    def with_map(cls, site: Site | None = None) -> PMBMTracker:
        """The default tracker, with undetected objects kept place by place: a map of where the
        sensor cannot see, whose `Tracks.undetected.expected_count(polygon)` counts them anywhere.
        """
        return cls(PMBMConfig(birth=BirthMap()), site)

    @classmethod
    def textbook(cls, site: Site | None = None) -> PMBMTracker:
        """With `PMBMConfig.textbook()`: exact Bayes, and nothing beyond it."""
        return cls(PMBMConfig.textbook(), site)

    @classmethod
    def paper(cls, site: Site | None = None) -> PMBMTracker:
        """With `PMBMConfig.paper()`: what Pang & Radha (2021) do differently."""
        return cls(PMBMConfig.paper(), site)

    @property
    def takes_all_labels(self) -> bool:
        """Whether `step` wants the detections of all labels though it follows those of one."""
        return self.config.scores.needs_all_labels

    @property
    def density(self) -> Density | None:
        """The PMBM density after the last step, or None before the first."""
        return self.state.density if self.state.started else None

    def step(self, detections: Detections, /) -> Tracks:
        """Take in one frame, empty or not, and report the objects that probably exist.

        Frames come in order of time; two of one time are two looks at the same moment.

        Raises InputError, the tracker unchanged, where time runs backwards.  Warns (InputWarning),
        once, of a sensor that is taken for blind and of two whose mounts do not fit.
        """
        frame, state = _next_frame(self.config, self.site, self.state, detections)
        # The density that the last trace keeps is done with: of many objects a third one is much.
        self.trace = None
        self.state, tracks, self.trace = _after(self.config, self.site, state, frame)
        if self.state.registration is not None:
            self._warn_of_sensors(self.state.registration)
        return tracks

    def _warn_of_sensors(self, registration: Registration) -> None:
        blindness = self.state.blindness
        found = {name: one.told(name) for name, one in blindness.items() if one.lasts}
        if registration.misfit is not None:
            found["mounts"] = registration.told(self.site)
        for what in found.keys() - self._warned:
            self._warned.add(what)
            warnings.warn(InputWarning(f"at {self.state.time:g} s {found[what]}"), stacklevel=3)

    def inspect(self) -> Inspection:
        """Every track's hypotheses with weights and, where `config.report.history` says to keep
        them, association histories; how well the sensor could see it; what the last step's
        reductions removed; how long its parts took.

        Raises InputError before the first step, and where the last one was cut short.
        """
        if self.trace is None:
            raise InputError(
                "nothing to inspect before the first step, or after one that was cut short"
            )
        trace, state, config = self.trace, self.state, self.config
        predicted, _ = predicted_in(config, trace.before, trace.frame)
        marginal, region = marginals(state.density), trace.frame.region
        return inspect(
            state.density,
            marginal,
            objects(config, state.scene, marginal, state.density, region),
            predicted,
            observe(config, self.site, trace.frame, predicted),
            self.site.occluders,
            distance=region.distance(state.density.local.mean[marginal.best]),
            time=state.time,
            report_above=config.report.above,
            reduced=trace.removed,
            seconds=trace.seconds,
        )


class _Clock:
    """Time between readings, by what was done in between.  The system's CPU clock can take longer
    to read than a step takes."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self._last = perf_counter()

    def read(self, what: str) -> None:
        now = perf_counter()
        self.seconds[what], self._last = now - self._last, now
