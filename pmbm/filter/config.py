"""The configuration of the PMBM tracker: a model made of parts, each checked where it is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any

from pmbm.errors import InputError, nearest_hint
from pmbm.filter.models.birth import BroadBirth
from pmbm.filter.models.detection import DetectionFromScores, FixedDetection
from pmbm.filter.models.motion import ConstantVelocity, Survival
from pmbm.filter.models.protocols import BIRTHS, MOTIONS, SCORES, Birth, Motion, Scores
from pmbm.filter.models.score_levels import LastingScores
from pmbm.filter.models.scores import FirstScore, IgnoreScores
from pmbm.filter.models.sensor import Sensor
from pmbm.validation import (
    COUNT,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    Bounds,
    check_fields,
    hash_of_fields,
)


@dataclass(frozen=True, kw_only=True)
class Reduction:
    """The limits on what the filter keeps (Pang & Radha 2021, Sec. 2.7).

    gate : squared Mahalanobis distance of a measurement that may be a track's.
    max_hypotheses : global hypotheses kept per cluster; a parent of weight w has at most
        ceil(max_hypotheses w) children.  A cluster of more than 30 tracks keeps fewer: as many as
        hold 30 max_hypotheses entries together, one entry a track, or 6000 if that is more; and so
        does one that a single frame gives more than 300,000 ways to pair tracks and detections.
    prune_hypothesis : global hypotheses of a weight up to this are dropped.
    recycle_below : Bernoullis of an existence below this leave the mixture.  Where clutter is dense
        and objects are often missed, .1 keeps the number of objects right
        (docs/results/presets.md).
    recycle : whether these become PPP components, or are forgotten.
    prune_undetected : PPP components of a weight up to this are dropped.
    max_tracks, max_undetected : tracks and PPP components kept.
    clustering : whether independent groups of tracks are kept apart; off, one table of global
        hypotheses spans the scene (the textbook form, for small scenes).
    split_below : groups of tracks of one cluster part where they depend on each other by less than
        this total variation; 0 parts only tracks whose hypothesis is certain.
    """

    gate: Annotated[float, POSITIVE] = 20.0
    max_hypotheses: Annotated[int, COUNT] = 200
    prune_hypothesis: Annotated[float, Bounds(0.0, below=1.0)] = 1e-3
    recycle_below: Annotated[float, SHARE] = 0.01
    recycle: bool = True
    prune_undetected: Annotated[float, NOT_NEGATIVE] = 1e-5
    max_tracks: Annotated[int, COUNT] = 200_000
    max_undetected: Annotated[int, COUNT] = 200_000
    clustering: bool = True
    split_below: Annotated[float, NOT_NEGATIVE] = 1e-3

    def __post_init__(self) -> None:
        check_fields(self, "reduction")


@dataclass(frozen=True, kw_only=True)
class Report:
    """The rule by which tracks are reported.

    above : a track is reported when the probability that it exists and is an object exceeds this.
    exclusive : whether a track is held back where another is reported at its place, the centre of
        one in the box of the other: two objects are never at one place.  The one known for longer
        is reported, if it is there more probably than not, or the whole instead of its part.
    keep_above : the batch mode keeps a track whose probability, as of its last detection, exceeds
        this.
    history : steps of association history kept per hypothesis; more than the last is to look at.
    """

    above: Annotated[float, SHARE] = 0.5
    exclusive: bool = True
    keep_above: Annotated[float, SHARE] = 0.5
    history: Annotated[int, COUNT] = 1

    def __post_init__(self) -> None:
        check_fields(self, "report")


@dataclass(frozen=True, kw_only=True)
class PMBMConfig:
    """The model of the world that the tracker assumes, and its limits, part by part.

    The defaults are those that measured best on simulated scenes; `textbook()` and `paper()` are
    the two presets beside them.  The parts' protocols, and their other members, are in
    `pmbm.filter.models.protocols`.

    motion : how objects move.  survival : how probably they live on (Pang & Radha 2021, Sec. 2.5).
    birth : where undetected objects appear (Sec. 2.2).
    sensor : how detections come about (Sec. 2.6).
    sensors : the same of single sensors by name, where a site has several; `sensor` of the others.
    scores : what scores and labels say of their sources (Sec. 2.6).
    reduction : what is kept in mind (Sec. 2.7).  report : which tracks are reported.
    """

    motion: Annotated[Motion, MOTIONS] = field(default_factory=ConstantVelocity)
    survival: Survival = field(default_factory=Survival)
    birth: Annotated[Birth, BIRTHS] = field(default_factory=BroadBirth)
    sensor: Sensor = field(default_factory=Sensor)
    sensors: Mapping[str, Sensor] = field(default_factory=dict)
    scores: Annotated[Scores, SCORES] = field(default_factory=LastingScores)
    reduction: Reduction = field(default_factory=Reduction)
    report: Report = field(default_factory=Report)

    def __new__(cls, *_: Any, **given: Any) -> PMBMConfig:
        """Refuse names that are none of the parts, before the dataclass would, with a hint."""
        names = [one.name for one in fields(cls)]
        for name in given:
            if name not in names:
                raise InputError(
                    f"PMBMConfig has no '{name}'",
                    field=name,
                    hint=renamed(name) or nearest_hint(name, names, "part"),
                )
        return super().__new__(cls)

    def __post_init__(self) -> None:
        try:
            check_fields(self, "PMBM configuration")
        except InputError as error:
            raise error.located(hint=renamed(error.field or "") or error.hint) from None
        object.__setattr__(self, "sensors", MappingProxyType(dict(self.sensors)))
        for name, sensor in self.sensors.items():
            if not isinstance(sensor, Sensor):
                raise InputError(
                    "PMBM configuration",
                    field=f"sensors.{name}",
                    expected="a Sensor",
                    got=type(sensor).__name__,
                )
            classes = 1 if sensor.scores is None else sensor.scores.classes
            if classes not in (1, self.scores.classes):
                raise InputError(
                    "PMBM configuration",
                    field=f"sensors.{name}.scores",
                    expected=f"1 class of sources, or the {self.scores.classes} of the model's",
                    got=classes,
                )

    __hash__ = hash_of_fields

    def __reduce__(self) -> tuple[Any, ...]:
        # Mapping proxies do not pickle.
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return _made_again, ({**values, "sensors": dict(self.sensors)},)

    def sensor_named(self, name: str) -> Sensor:
        """The model of the sensor of that name."""
        return self.sensors.get(name, self.sensor)

    @classmethod
    def textbook(cls) -> PMBMConfig:
        """Exact Bayes with one P_D for all in view: scores ignored, nothing hides anything, every
        sensor is as it is said to be (Williams 2015; Garcia-Fernandez et al. 2018)."""
        return cls(
            sensor=Sensor(
                detection=FixedDetection(probability=0.9),
                occlusion=False,
                align=False,
                may_fail=False,
            ),
            scores=IgnoreScores(),
            report=Report(exclusive=False),
        )

    @classmethod
    def paper(cls) -> PMBMConfig:
        """The three deviations of Pang & Radha (2021, Sec. 2.6) from the textbook: scores in the
        first detection, P_D from past scores, and misses that scale existence and weight.

        What each does on its own is measured by `studies/preset_options.toml`
        (docs/results/presets.md).
        """
        return cls(
            sensor=Sensor(
                detection=DetectionFromScores(undetected=0.9),
                occlusion=False,
                miss_rule="scaled",
                align=False,
                may_fail=False,
            ),
            scores=FirstScore(),
            report=Report(exclusive=False),
        )

    def changed(self, values: Mapping[str, Any]) -> PMBMConfig:
        """A copy with other values, by dotted names: {"sensor.clutter_rate": 2.0}.

        Raises InputError, naming the field, for an unknown name or a value that does not fit.
        """
        config = self
        for name, value in values.items():
            config = _with(config, name.split("."), value, name)
        return config


def _made_again(values: dict[str, Any]) -> PMBMConfig:
    return PMBMConfig(**values)


RENAMED: Mapping[str, str] = {
    "survival": "survival.probability",
    "scores": "a part, IgnoreScores(), FirstScore(), EveryScore() or LastingScores(); in a file "
    "scores.kind",
    "survival_interval": "survival.interval",
    "spectral_density": "motion.acceleration_density",
    "measurement_sd": "sensor.position_sd",
    "clutter_rate": "sensor.clutter_rate",
    "occlusion": "sensor.occlusion",
    "miss_rule": "sensor.miss_rule",
    "newest_box": "sensor.box_gain",
    "detection_probability": "sensor.detection.base.probability of a DetectionChain, "
    "sensor.detection.probability of a FixedDetection",
    "visibility": "sensor.detection = DetectionChain(...)",
    "detection_from_scores": "sensor.detection = DetectionFromScores(...)",
    "detection_low": "low of DetectionFromScores",
    "detection_high": "high of DetectionFromScores",
    "newest_score": "newest of DetectionFromScores",
    "score_model": "score_model of FirstScore, EveryScore or DetectionFromScores",
    "kinds": "scores = ObjectClasses(...)",
    "levels": "scores = ScoreLevels(...)",
    "birth_rate": "birth.rate",
    "initial_objects": "birth.initial",
    "birth_components": "birth.components of a BroadBirth",
    "birth_speed_sd": "birth.speed_sd",
    "merge_undetected": "birth.merge_below of a BroadBirth",
    "undetected_detail": "birth = BirthMap(spacing=...)",
    **{
        name: f"reduction.{name}"
        for name in (
            "gate",
            "max_hypotheses",
            "prune_hypothesis",
            "recycle_below",
            "recycle",
            "prune_undetected",
            "max_tracks",
            "max_undetected",
            "clustering",
            "split_below",
        )
    },
    "report_above": "report.above",
    "exclusive": "report.exclusive",
    "keep_above": "report.keep_above",
    "history": "report.history",
}
"""Name before version 0.2 -> where the same is said now."""


def renamed(name: str) -> str | None:
    """The hint for a name that there was before version 0.2, or None."""
    return f"it is now {RENAMED[name]}" if name in RENAMED else None


def _with(part: Any, path: list[str], value: Any, whole: str) -> Any:
    """A dataclass, or a table of them, with the field at the end of a path replaced."""
    if isinstance(part, Mapping):
        if len(path) > 1:
            value = _with(part.get(path[0], Sensor()), path[1:], value, whole)
        return {**part, path[0]: value}
    names = [one.name for one in fields(part)] if is_dataclass(part) else []
    if path[0] not in names:
        raise InputError(
            f"{type(part).__name__} has no '{path[0]}'",
            field=whole,
            hint=renamed(whole) or nearest_hint(path[0], names, "field"),
        )
    inner = getattr(part, path[0])
    if len(path) > 1:
        value = _with(inner, path[1:], value, whole)
    try:
        return replace(part, **{path[0]: value})
    except InputError as error:
        raise (error if "." in (error.field or "") else error.located(field=whole)) from None
