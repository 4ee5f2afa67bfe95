"""A tracker's parameters, searched for by Optuna; what is kept for reporting is refused."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final

from pmbm.errors import InputError, nearest_hint

FIRST_HELD_BACK_SEED: Final = 10_000_000
"""Seeds from here on show whether a gain is one beyond the recordings that were tuned on: the
parameters tuned on seed s are compared with the defaults on seed s + FIRST_HELD_BACK_SEED."""
FIRST_REPORTING_SEED: Final = 20_000_000
"""Seeds from here on are for figures that are reported: a figure for recordings that parameters
were chosen on flatters them."""


@dataclass(frozen=True)
class Range:
    """Numbers from `low` to `high`, both included.

    log : spread evenly in the logarithm; low > 0.
    whole : whole numbers only.
    Raises InputError where the bounds do not fit.
    """

    low: float
    high: float
    log: bool = False
    whole: bool = False

    def __post_init__(self) -> None:
        for name in ("log", "whole"):
            given = getattr(self, name)
            if not isinstance(given, bool):
                raise InputError("bad range", field=name, expected="true or false", got=given)
        for name in ("low", "high"):
            given = getattr(self, name)
            kinds = int if self.whole else int | float
            good = isinstance(given, kinds) and not isinstance(given, bool)
            if not good or not math.isfinite(given):
                expected = "a whole number" if self.whole else "a finite number"
                raise InputError("bad range", field=name, expected=expected, got=given)
        if not self.low < self.high:
            raise InputError(
                "bad range", field="high", expected=f"above {self.low:g}", got=self.high
            )
        if self.log and self.low <= 0:
            raise InputError("bad range", field="low", expected="above 0, for log", got=self.low)

    def rounded(self, value: float) -> float:
        """To a thousandth of the range, or of the value where log: what a file can show whole."""
        if self.whole:
            return int(value)
        finest = value if self.log else self.high - self.low
        short = round(value, 3 - math.floor(math.log10(finest)))
        return float(min(max(short, self.low), self.high))

    def __contains__(self, value: object) -> bool:
        return (
            isinstance(value, int | float)
            and not isinstance(value, bool)
            and self.low <= value <= self.high
            and (not self.whole or value == int(value))
        )


@dataclass(frozen=True)
class Choice:
    """A set of values, at least two, without an order."""

    values: tuple[Any, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", tuple(self.values))
        if len(self.values) < 2:
            raise InputError("bad choice", expected="two values or more", got=list(self.values))

    def __contains__(self, value: object) -> bool:
        return value in self.values


Space = Mapping[str, Range | Choice]
"""Parameter -> where to look for it; the others stay as they are."""

_SKELETON: Final[Space] = {
    "min_score": Range(0.0, 0.95),
    "report_above": Range(0.0, 0.95),
    "iou_gate": Range(0.01, 0.5, log=True),
    "min_hits": Range(1, 8, whole=True),
    "max_age": Range(1.0, 20.0),
    "process_variance": Range(0.001, 10.0, log=True),
    "process_velocity_variance": Range(0.0001, 1.0, log=True),
    "measurement_variance": Range(0.001, 10.0, log=True),
}
SPACES: Final[Mapping[str, Space]] = {
    "pmbm": {
        "survival.probability": Range(0.95, 0.9999),
        "motion.acceleration_density": Range(0.05, 50.0, log=True),
        "sensor.position_sd": Range(0.05, 1.5, log=True),
        "sensor.detection.base.probability": Range(0.5, 0.995),
        "sensor.clutter_rate": Range(0.05, 100.0, log=True),
        "birth.rate": Range(0.01, 10.0, log=True),
        "birth.initial": Range(0.1, 100.0, log=True),
        "birth.speed_sd": Range(1.0, 30.0, log=True),
        "reduction.gate": Range(6.0, 60.0, log=True),
        "report.above": Range(0.1, 0.9),
    },
    "argoverse": _SKELETON,
    "waymo": _SKELETON,
    "probabilistic_kf": {
        "mahalanobis_gate": Range(2.0, 60.0, log=True),
        "min_score": Range(0.0, 0.95),
        "report_above": Range(0.0, 0.95),
        "min_hits": Range(1, 8, whole=True),
        "max_age": Range(1.0, 20.0),
    },
}
"""Shipped tracker -> where its parameters are looked for unless one says otherwise: what the world
sets (rates, noises, probabilities) and when a track is reported, over what road scenes and
detectors span; not what trades time for accuracy.  Units are those of the tracker's config."""


@dataclass(frozen=True)
class Attempt:
    """parameters : what was set, or empty for the defaults.  value : None where it has none."""

    parameters: Mapping[str, Any]
    value: float | None


@dataclass(frozen=True)
class Tuned:
    """The result of a search.

    parameters : those of the best attempt; empty where nothing beat the defaults.
    value, default_value : the objective there, and with the defaults.
    attempts : all of them in order, the defaults first.
    """

    parameters: Mapping[str, Any]
    value: float
    default_value: float
    attempts: tuple[Attempt, ...]
    interrupted: bool = False


Objective = Callable[[Mapping[str, Any]], float | None]
"""Value of parameters, of none for the defaults; None where it is undefined or they do not fit
together."""
Progress = Callable[[int, int, float], None]
"""Called with attempts done, attempts in all and the best value."""


def tune(
    objective: Objective,
    space: Space,
    *,
    trials: int,
    seed: int,
    maximise: bool = False,
    defaults: Mapping[str, Any] | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """The best parameters of a space, by Optuna's tree-structured Parzen estimator.

    Equal arguments give equal results with one version of Optuna: other versions draw otherwise,
    which no setting of the sampler undoes.

    trials : evaluations of the objective, that of the defaults included, which comes first.
    seed : of the sampler.
    defaults : the defaults' values, as far as known: where they lie in the space, the search
        learns from them, too.

    An interrupt (Ctrl-C) after the defaults' evaluation ends the search with what it has.

    Raises InputError where Optuna is not installed, and where the objective has no value with the
    defaults.
    """
    optuna = _optuna()
    default_value = _value(objective({}))
    if default_value is None:
        raise InputError("the objective is undefined with the default parameters")
    tell = progress or (lambda done, total, best: None)
    attempts = [Attempt(MappingProxyType({}), default_value)]
    best = Tuned(attempts[0].parameters, default_value, default_value, ())
    tell(1, trials, best.value)
    study = optuna.create_study(
        direction="maximize" if maximise else "minimize",
        sampler=optuna.samplers.TPESampler(seed=seed),
    )
    distributions = {name: _distribution(optuna, place) for name, place in space.items()}
    known = defaults or {}
    if all(name in known and known[name] in place for name, place in space.items()):
        study.add_trial(
            optuna.trial.create_trial(
                params={name: _drawn(place, known[name]) for name, place in space.items()},
                distributions=distributions,
                value=default_value,
            )
        )
    for done in range(2, trials + 1):
        trial = study.ask(distributions)
        parameters = MappingProxyType(
            {name: _meant(space[name], trial.params[name]) for name in space}
        )
        try:
            value = _value(objective(parameters))
        except KeyboardInterrupt:
            return Tuned(best.parameters, best.value, default_value, tuple(attempts), True)
        attempts.append(Attempt(parameters, value))
        if value is None:
            # Pruned ones count as worse than all; failed ones would not count at all.
            study.tell(trial, state=optuna.trial.TrialState.PRUNED)
        else:
            study.tell(trial, value)
            if (value > best.value) if maximise else (value < best.value):
                best = Tuned(parameters, value, default_value, ())
        tell(done, trials, best.value)
    return Tuned(best.parameters, best.value, default_value, tuple(attempts))


def parse_space(document: Mapping[str, Any]) -> dict[str, Range | Choice]:
    """The space that a file's tables say: a list is a choice, a table a range.

    Raises InputError with the dotted key, and where there is nothing in it.
    """
    if not document:
        raise InputError("nothing to tune", expected="a line a parameter")
    space: dict[str, Range | Choice] = {}
    for name, given in _leaves(document):
        if isinstance(given, list):
            kind: Callable[..., Range | Choice] = Choice
            values = {"values": tuple(given)}
        elif isinstance(given, Mapping):
            kind, values = Range, dict(given)
            valid = [field.name for field in fields(Range)]
            for key in given:
                if key not in valid:
                    hint = nearest_hint(key, valid, "key")
                    raise InputError("unknown key of a range", field=f"{name}.{key}", hint=hint)
            for key in ("low", "high"):
                if key not in given:
                    raise InputError("missing key of a range", field=f"{name}.{key}")
        else:
            raise InputError(
                "not a place to look for a parameter",
                field=name,
                expected="{ low = ..., high = ... } or a list of values",
                got=given,
            )
        try:
            space[name] = kind(**values)
        except InputError as error:
            key = f"{name}.{error.field}" if error.field else name
            raise error.located(field=key) from None
    return space


def _leaves(document: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted names and values.  A table of tables and lists alone is no range but holds them, and
    so does one none of whose keys is a range's."""
    keys = {field.name for field in fields(Range)}
    for name, given in document.items():
        inner = given if isinstance(given, Mapping) else {}
        holds = all(isinstance(one, Mapping | list) for one in inner.values())
        if inner and (holds or not keys & inner.keys()):
            yield from _leaves(inner, f"{path}{name}.")
        else:
            yield path + name, given


def refuse_reserved_seed(seed: int) -> None:
    """Raises InputError for a seed whose recordings are not for tuning."""
    if seed >= FIRST_REPORTING_SEED:
        why = f"seeds from {FIRST_REPORTING_SEED} on are kept for reporting"
    elif seed >= FIRST_HELD_BACK_SEED:
        why = f"seeds from {FIRST_HELD_BACK_SEED} on are held back to compare with the defaults"
    else:
        return
    raise InputError(why, field="seed", expected=f"below {FIRST_HELD_BACK_SEED}", got=seed)


def _optuna() -> Any:
    try:
        import optuna
    except ImportError:
        raise InputError(
            "tuning needs Optuna, which is not installed", hint="pip install 'pmbm[tune]'"
        ) from None
    # It announces every study and trial otherwise.
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna


def _distribution(optuna: Any, place: Range | Choice) -> Any:
    if isinstance(place, Choice):
        return optuna.distributions.CategoricalDistribution(range(len(place.values)))
    kinds = optuna.distributions
    kind = kinds.IntDistribution if place.whole else kinds.FloatDistribution
    return kind(place.low, place.high, log=place.log)


def _meant(place: Range | Choice, drawn: Any) -> Any:
    return place.values[drawn] if isinstance(place, Choice) else place.rounded(drawn)


def _drawn(place: Range | Choice, meant: Any) -> Any:
    return place.values.index(meant) if isinstance(place, Choice) else meant


def _value(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else float(value)
