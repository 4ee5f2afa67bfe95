"""Searching a scenario's parameters for what breaks a tracker, and shrinking what was found.

The search draws points of a box of parameters (scrambled Sobol), then improves the worst by steps
that shrink.  What fails is made smaller as long as it still fails: parameters back to where they
were, actors out of the scene, seconds off the end.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from scipy.stats import qmc

from pmbm.errors import InputError
from pmbm.sim.scenario.scenario import Scenario
from pmbm.types import FloatArray
from pmbm.wording import four_digits

_REFINED_SHARE: Final = 0.5
_BISECTIONS: Final = 4


@dataclass(frozen=True)
class Knob:
    """A number of a scenario's document that the search may change.

    key : dotted, such as "detector.clutter.rate".
    least, most : between which it may lie; whole numbers stay whole where `whole` is set.
    rest : where it is when nothing is wrong.
    """

    key: str
    least: float
    most: float
    rest: float
    whole: bool = False

    def at(self, share: float) -> float | int:
        """The value at a share of the way from least to most."""
        value = self.least + share * (self.most - self.least)
        return round(value) if self.whole else four_digits(value)


FAULTS: Final = (
    Knob("detector.objects.detection_probability", 0.6, 0.99, 0.95),
    Knob("detector.objects.miss_burst_length", 1.0, 8.0, 1.0),
    Knob("detector.objects.position_noise_scale", 0.5, 3.0, 1.0),
    Knob("detector.objects.duplicate_probability", 0.0, 0.3, 0.0),
    Knob("detector.clutter.rate", 0.0, 20.0, 2.0),
    Knob("detector.clutter.persistent_share", 0.0, 0.5, 0.0),
    Knob("detector.sensor.drop_probability", 0.0, 0.3, 0.0),
)
"""Faults of the detector that a search varies where it is not told what to vary."""


@dataclass(frozen=True)
class Finding:
    """A scenario that fails.

    document : as the scenario's file says it.
    value : the metric there; rest : the metric of the scenario as it was.
    changed : the parameters that are still away from rest.
    evaluations : how many documents were tried in all.
    """

    document: Mapping[str, Any]
    value: float
    rest: float
    changed: Mapping[str, float]
    evaluations: int


Badness = Callable[[Mapping[str, Any]], float]
"""How bad a document is for the tracker; larger is worse, minus infinity where it is impossible."""


def search(
    document: Mapping[str, Any],
    badness: Badness,
    knobs: Sequence[Knob],
    *,
    budget: int,
    limit: float | None = None,
    seed: int = 0,
) -> Finding | None:
    """The smallest document found whose badness exceeds `limit`, or None if none was found.

    document : a scenario without a sweep.
    limit : default: half-way from the document's own badness to the worst found.
    budget : documents to try in the search; shrinking tries about as many again.
    """
    tries = _Tries(badness)
    base = copy.deepcopy(dict(document))
    rest = tries(base)
    worst, worst_value = _worst(base, tries, knobs, budget, seed)
    if limit is None:
        limit = (rest + worst_value) / 2
    if worst_value <= limit or worst_value <= rest:
        return None
    return _shrunk(base, worst, tries, knobs, limit, rest)


def swept_knobs(scenario: Scenario) -> list[Knob]:
    """The scenario's own swept parameters, between their least and greatest level."""
    sweep = scenario.form.sweep
    if sweep is None:
        return []
    columns = sweep.set or {sweep.parameter: sweep.levels}
    knobs = []
    for key, values in columns.items():
        numbers = [value for value in values if isinstance(value, int | float)]
        if len(numbers) == len(values) and min(numbers) < max(numbers):
            whole = all(isinstance(value, int) for value in numbers)
            knobs.append(Knob(key, min(numbers), max(numbers), numbers[0], whole))
    return knobs


class _Tries:
    """Counts the documents tried; an impossible one is as good as can be."""

    def __init__(self, badness: Badness) -> None:
        self.badness = badness
        self.count = 0

    def __call__(self, document: Mapping[str, Any]) -> float:
        self.count += 1
        try:
            return self.badness(document)
        except InputError:
            return -np.inf


def _worst(
    base: Mapping[str, Any], tries: _Tries, knobs: Sequence[Knob], budget: int, seed: int
) -> tuple[FloatArray, float]:
    """The worst point (K,) of the unit cube that the budget finds, and its badness."""
    rng = np.random.default_rng(seed)
    first = max(1, round(budget * (1 - _REFINED_SHARE)))
    cube = qmc.Sobol(len(knobs), seed=rng)
    points = cube.random_base2(int(np.ceil(np.log2(first + 1))))[:first]
    values = [tries(_document(base, knobs, point)) for point in points]
    best = int(np.argmax(values))
    point, value = points[best], values[best]
    step = 0.25
    for _ in range(budget - first):
        which = rng.random(len(knobs)) < 0.5
        trial = np.clip(point + step * which * rng.standard_normal(len(knobs)), 0.0, 1.0)
        found = tries(_document(base, knobs, trial))
        if found > value:
            point, value = trial, found
        else:
            step = max(0.9 * step, 0.03)
    return point, value


def _shrunk(
    base: Mapping[str, Any],
    point: FloatArray,
    tries: _Tries,
    knobs: Sequence[Knob],
    limit: float,
    rest: float,
) -> Finding:
    values: dict[str, float] = {
        knob.key: knob.at(share) for knob, share in zip(knobs, point, strict=True)
    }

    def fails(document: Mapping[str, Any], values: Mapping[str, float]) -> bool:
        return tries(with_values(document, values)) > limit

    for knob in knobs:
        without = {key: value for key, value in values.items() if key != knob.key}
        if fails(base, without):
            values = without
            continue
        # What has to stay is brought as near to rest as it still fails.
        near, far = knob.rest, values[knob.key]
        for _ in range(_BISECTIONS):
            middle = (near + far) / 2
            middle = round(middle) if knob.whole else float(f"{middle:.3g}")
            if fails(base, {**values, knob.key: middle}):
                far = middle
            else:
                near = middle
        values = {**values, knob.key: far}
    document = dict(base)
    shrinking = True
    while shrinking:
        shrinking = False
        for smaller in _smaller(document):
            if fails(smaller, values):
                document, shrinking = dict(smaller), True
                break
    final = with_values(document, values)
    return Finding(final, tries(final), rest, values, tries.count)


def _smaller(document: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Documents with a shorter run, or with one actor or occluder less."""
    duration = document.get("duration", 20.0)
    if duration / 2 >= 2.0:
        yield {**document, "duration": round(duration / 2)}
    scene = document.get("scene", {})
    for part in ("actors", "tracks", "walkers", "occluders", "spawn"):
        group = scene.get(part)
        if not isinstance(group, Mapping | list):
            continue
        for key in list(group) if isinstance(group, Mapping) else range(len(group)):
            if isinstance(group, Mapping):
                left: Any = {name: actor for name, actor in group.items() if name != key}
            else:
                left = [actor for index, actor in enumerate(group) if index != key]
            yield {**document, "scene": {**scene, part: left}}
            count = group[key].get("count", 1) if isinstance(group[key], Mapping) else 1
            if isinstance(count, int) and count > 1:
                fewer = copy.deepcopy(group)
                fewer[key]["count"] = count // 2
                yield {**document, "scene": {**scene, part: fewer}}


def _document(base: Mapping[str, Any], knobs: Sequence[Knob], point: FloatArray) -> dict[str, Any]:
    return with_values(
        base, {knob.key: knob.at(share) for knob, share in zip(knobs, point, strict=True)}
    )


def with_values(base: Mapping[str, Any], values: Mapping[str, float]) -> dict[str, Any]:
    """The document with the values at their dotted keys."""
    document = copy.deepcopy(dict(base))
    for key, value in values.items():
        table = document
        *path, last = key.split(".")
        for part in path:
            table = table.setdefault(part, {})
        table[last] = value
    return document
