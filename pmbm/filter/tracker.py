"""The PMBM tracker: predict, associate, update, reduce (Pang & Radha 2021, Fig. 2)."""

from __future__ import annotations

import math
from dataclasses import replace
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from pmbm.errors import InputError
from pmbm.filter.association import associate
from pmbm.filter.config import PMBMConfig
from pmbm.filter.density import Density, Locals, Mixture
from pmbm.filter.estimation import apart, marginals
from pmbm.filter.inspection import Inspection, inspect
from pmbm.filter.marks import GHOST, Levels, Seen
from pmbm.filter.models import (
    DetectionFromScores,
    Sensor,
    Transition,
    View,
    births_over,
    constant_velocity,
    spread_over,
    survival_over,
)
from pmbm.filter.occlusion import Shadows
from pmbm.filter.prediction import predict
from pmbm.filter.reduction import Limits, Reduced, reduce
from pmbm.filter.scan import Scan
from pmbm.filter.succession import Succession
from pmbm.filter.unseen import FINE, MOST, NEGLIGIBLE, Ground, settle
from pmbm.filter.update import update
from pmbm.score import ScoreModel
from pmbm.types import Detections, FloatArray, Site, Tracks, vouched


class PMBMTracker:
    """Follows an unknown number of objects through noisy, cluttered, incomplete detections.

    config : what it assumes; site : what the sensor can see (default: 100 m all round).

    Example
    -------
    >>> tracker = PMBMTracker(PMBMConfig(detection_probability=0.95))
    >>> tracks = tracker.step(Detections.empty(time=0.0))
    >>> len(tracks)
    0
    """

    def __init__(self, config: PMBMConfig | None = None, site: Site | None = None) -> None:
        self.config = config if config is not None else PMBMConfig()
        self.site = site if site is not None else Site()
        self.density: Density | None = None
        self.reduced = Reduced()
        self._before: tuple[Density, View] | None = None
        self._time = math.nan
        self._seconds: dict[str, float] = {}
        self._shape: Mixture | None = None
        self._shape_pose = np.zeros(3)
        self._ground: Ground | None = None
        self._score_model = self.config.score_model or ScoreModel.trusting()
        self._from_scores = _from_scores(self.config)
        self._levels = _levels(self.config, self._score_model)
        self._marks = self._levels or self.config.kinds
        self._seen = Seen()
        self._succession = Succession()
        self._limits = _limits(self.config)
        self._noise = self.config.measurement_sd**2 * np.eye(2)
        self.takes_all_labels = (
            self.config.levels is not None and self.config.levels.label is not None
        )
        """Whether `step` wants the detections of all labels though it follows those of one."""

    @classmethod
    def with_map(cls, site: Site | None = None) -> PMBMTracker:
        """The default tracker, with undetected objects kept place by place: a map of where the
        sensor cannot see, whose `Tracks.undetected.expected_count(polygon)` counts them anywhere.
        """
        return cls(PMBMConfig(undetected_detail=3.5), site)

    @classmethod
    def textbook(cls, site: Site | None = None) -> PMBMTracker:
        """With `PMBMConfig.textbook()`: exact Bayes, and nothing beyond it."""
        return cls(PMBMConfig.textbook(), site)

    @classmethod
    def paper(cls, site: Site | None = None) -> PMBMTracker:
        """With `PMBMConfig.paper()`: what Pang & Radha (2021) do differently."""
        return cls(PMBMConfig.paper(), site)

    def step(self, detections: Detections, /) -> Tracks:
        """Take in one frame, empty or not, and report the objects that probably exist.

        Frames come in order of time; two of one time are two looks at the same moment.

        Raises InputError, the tracker unchanged, where time runs backwards.
        """
        config = self.config
        clock = _Clock()
        view = View.of(self.site, detections.sensor_pose)
        scan = self._scan(detections)
        dt = 0.0
        if self.density is None:
            predicted = Density.initial(
                self._first(view),
                clustering=config.clustering,
                local=Locals.empty(
                    config.history,
                    confidence=self._from_scores is not None,
                    kinds=0 if self._marks is None else self._marks.birth.shape[-1],
                    seen=config.visibility is not None,
                ),
            )
        else:
            dt = self._elapsed(detections.time)
            predicted = predict(
                self.density,
                self._transition(dt),
                self._births(view, dt),
                merge_births=config.merge_undetected > 0 and config.undetected_detail is None,
            )
        predicted, dropped = self._settled(predicted, view)
        clock.read("predict")
        sensor = self._sensor(view, predicted)
        # The tracker stands at this frame's time from here on, and lets go of what came before.
        self.density, self._time, self._before = predicted, detections.time, (predicted, view)
        association = associate(
            predicted,
            scan,
            sensor,
            gate_threshold=config.gate,
            max_hypotheses=config.max_hypotheses,
            negligible=config.prune_hypothesis,
            clustering=config.clustering,
        )
        clock.read("associate")
        # Of a large scene, what hides what takes memory that the rest of the step can use.
        sensor = replace(sensor, shadows=None)
        updated = update(predicted, scan, association, sensor)
        clock.read("update")
        unlikely, gated = association.dropped, len(association.known.row)
        # And so does what the scan said.
        del association
        self.density, reduced = reduce(updated, self._limits)
        del updated
        self.reduced = replace(
            reduced,
            hypotheses_pruned=reduced.hypotheses_pruned + unlikely,
            undetected_dropped=dropped,
            pairs_gated=len(predicted.local) * len(scan) - gated,
        )
        clock.read("reduce")
        self._seconds = clock.seconds
        return self._report(self.density, view, dt)

    def inspect(self) -> Inspection:
        """Every track's hypotheses with weights and, where `config.history` says to keep them,
        association histories; how well the sensor could see it; what the last step's reductions
        removed; how long its parts took.

        Raises InputError before the first step.
        """
        if self.density is None or self._before is None:
            raise InputError("nothing to inspect before the first step")
        predicted, view = self._before
        return inspect(
            self.density,
            predicted,
            self._sensor(view, predicted),
            self.site.occluders,
            time=self._time,
            report_above=self.config.report_above,
            object_share=self._object_share(),
            reduced=self.reduced,
            seconds=self._seconds,
        )

    def _elapsed(self, time: float) -> float:
        if time < self._time:
            raise InputError(
                "detections out of order", field="time", expected=f">= {self._time:g}", got=time
            )
        return time - self._time

    def _scan(self, detections: Detections) -> Scan:
        """The measurements, with what their scores say under this configuration."""
        config = self.config
        speaking, evidence, births = config.scores, None, None
        if self._levels is not None:
            detections, log_odds = self._levels.own(detections)
            evidence = self._levels.evidence(log_odds)
            births = self._levels.birth_after(self._seen, detections.distance)
        elif config.kinds is not None:
            evidence, births = config.kinds.evidence(detections), config.kinds.birth
        scan = Scan.of(detections, evidence, births)
        if self._marks is not None:
            speaking = "ignore"
        if speaking == "ignore" and self._from_scores is None:
            return scan
        given = self._score_model.read(detections)
        s = np.clip(self._score_model.evidence(given), 1e-3, 1 - 1e-3)
        if speaking == "everywhere":
            scan = replace(scan, evidence=(s / (1 - s))[:, None])
        return replace(
            scan,
            first=np.column_stack([2 * s, 2 * (1 - s)]) if speaking == "first" else None,
            confidence=s if self._from_scores is not None else None,
        )

    def _transition(self, dt: float) -> Transition:
        config = self.config
        F, Q = constant_velocity(dt, config.spectral_density)
        survival = survival_over(dt, config.survival, config.survival_interval)
        return Transition(F, Q, survival, dt, config.visibility, self._levels)

    def _first(self, view: View) -> Mixture:
        if self.config.undetected_detail is not None:
            return self._on_ground(view, 0.0, self.config.undetected_detail)
        return self._spread(view, self.config.initial_objects)

    def _births(self, view: View, dt: float) -> Mixture:
        config = self.config
        expected = births_over(dt, config.birth_rate, config.survival, config.survival_interval)
        if config.undetected_detail is not None:
            return self._on_ground(view, expected, config.undetected_detail)
        return self._spread(view, expected)

    def _on_ground(self, view: View, expected: float, spacing: float) -> Mixture:
        """Births, and what ground that the map comes to cover may hold from before."""
        before = self._ground
        self._ground = ground = Ground.of(self.site, view, spacing, before)
        weight = expected * ground.births()
        weight += self.config.initial_objects * ground.newly_covered(before)
        return ground.mixture(weight, spacing, self.config.birth_speed_sd)

    def _settled(self, predicted: Density, view: View) -> tuple[Density, float]:
        """The PPP with the detail that it is to have, and the mass that this dropped."""
        config = self.config
        if config.undetected_detail is None or self._ground is None:
            return predicted, 0.0
        each = births_over(
            config.survival_interval, config.birth_rate, config.survival, config.survival_interval
        ) / max(1, self._ground.cells)
        undetected, dropped = settle(
            predicted.undetected,
            view,
            config.undetected_detail,
            most=min(config.max_undetected, MOST),
            negligible=min(config.prune_undetected, NEGLIGIBLE * each),
            fine_above=FINE * each,
        )
        return predicted.with_undetected(undetected), dropped

    def _spread(self, view: View, expected: float) -> Mixture:
        if expected == 0:
            return Mixture.empty()
        shape = self._shape
        if shape is None or not np.array_equal(view.pose, self._shape_pose):
            shape = spread_over(view, self.config.birth_components, self.config.birth_speed_sd)
            self._shape, self._shape_pose = shape, view.pose
        return Mixture(shape.log_weight + math.log(expected), shape.mean, shape.cov)

    def _sensor(self, view: View, predicted: Density) -> Sensor:
        config = self.config
        detailed = config.undetected_detail is not None
        hides = config.occlusion and (detailed or len(predicted.local) > 0)
        return Sensor(
            R=self._noise,
            detection=config.detection_probability,
            clutter=config.clutter_rate / view.area,
            view=view,
            from_scores=self._from_scores,
            visibility=config.visibility,
            scaled_misses=config.miss_rule == "scaled",
            newest_box=config.newest_box,
            shadows=Shadows.of(predicted, view.pose, self.site.occluders) if hides else None,
            undetected_in_detail=detailed,
        )

    def _object_share(self) -> FloatArray | None:
        """P(object) of a source of each kind, in this scene; None without marks."""
        if self._levels is not None:
            return self._levels.object_after(self._seen)
        return None if self._marks is None else self._marks.object

    def _report(self, density: Density, view: View, dt: float) -> Tracks:
        """The tracks that probably exist and are probably in view, `dt` after those before.  One
        that has left the view is kept in mind, and reported again where it comes back."""
        marginal, local = marginals(density), density.local
        inside = view.share_inside(local.mean, local.cov)[marginal.best]
        if self._levels is not None and self._levels.usual is not None:
            usually = marginal.objects(self._levels.object)
            number = float(usually @ inside)
            self._seen = self._seen.after(dt, number, self._levels.memory)
        exists = marginal.objects(self._object_share())
        reported = np.flatnonzero((exists > self.config.report_above) & (inside > 0.5))
        local = local.take(marginal.best[reported])
        if self.config.exclusive:
            # What is known for longer has the better claim, if it is there more probably than not.
            doubtful = exists[reported] <= 0.5
            claims = np.lexsort((density.track_id[reported], doubtful))
            sure = len(claims) - int(np.count_nonzero(doubtful))
            stands = apart(np.ascontiguousarray(local.mean[:, :2]), local.box, claims, sure)
            if len(stands) < len(local):
                reported, local = reported[stands], local.take(stands)
        self._succession, self.density = self._succession.after(density, marginal, exists, reported)
        return vouched(
            Tracks,
            time=self._time,
            id=self.density.track_id[reported],
            position=np.concatenate([local.mean[:, :2], local.box[:, :1]], axis=1),
            size=local.box[:, 1:4].copy(),
            yaw=local.box[:, 4].copy(),
            velocity=local.mean[:, 2:].copy(),
            score=exists[reported],
            label=local.label if self.config.kinds is None else _labels(local),
            covariance=local.cov,
            undetected=density.undetected.public(),
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


def _labels(local: Locals) -> NDArray[np.int8]:
    """The likeliest label of each row, by all of its detections."""
    assert local.kind is not None
    return local.kind[:, :GHOST].argmax(axis=1).astype(np.int8)


def _levels(config: PMBMConfig, scores: ScoreModel) -> Levels | None:
    """What the configuration says of the levels of scores, unless `kinds` say it all."""
    if config.scores == "lasting" and config.levels is None and config.kinds is None:
        return Levels.at_their_word(scores)
    return config.levels


def _limits(config: PMBMConfig) -> Limits:
    limits = Limits(**{name: getattr(config, name) for name in Limits.__slots__})
    if config.undetected_detail is None:
        return limits
    # Undetected objects are merged and dropped where they are settled.
    return replace(limits, prune_undetected=0.0, merge_undetected=0.0)


def _from_scores(config: PMBMConfig) -> DetectionFromScores | None:
    if config.detection_from_scores == "off":
        return None
    return DetectionFromScores(
        config.detection_low,
        config.detection_high,
        config.detection_from_scores == "rising",
        config.newest_score,
    )
