"""A family: metrics that one function counts together."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from pmbm.intervals import SHARE
from pmbm.metrics.core.clear_matching import Matches, clear_matches
from pmbm.metrics.core.formulas import NO_FRAMES, Ratio
from pmbm.metrics.core.parameters import MetricParameters
from pmbm.metrics.core.result import Direction, Formula, Metric
from pmbm.metrics.core.scene import ScoredScene


@dataclass(frozen=True, eq=False)
class Work:
    """A scene with the parameters, and what several families need of it, made once."""

    scene: ScoredScene
    parameters: MetricParameters

    def __post_init__(self) -> None:
        # Found once at the farthest that most of them look, and kept for the nearer.
        self.scene.near(max(self.parameters.ospa_cutoff, self.parameters.gospa_cutoff))

    @cached_property
    def matches(self) -> Matches:
        """The standard CLEAR matching."""
        return clear_matches(self.scene, self.parameters.gate)

    @cached_property
    def observable(self) -> Work:
        """The same of observable objects only; itself where all are."""
        if self.scene.truth.observable.all():
            return self
        return Work(observable_scene(self.scene, self.matches), self.parameters)


@dataclass(frozen=True, eq=False)
class Tally:
    """A family's counts, parameters and series.

    counts : numbers, arrays, `Samples`; they add up over recordings.
    parameters : those it was counted with, by name.
    series : values of each frame (F,), by name.
    """

    counts: Mapping[str, Any]
    parameters: Mapping[str, Any]
    series: Mapping[str, Any]

    @classmethod
    def of(cls, counts: Mapping[str, Any], **parameters: Any) -> Tally:
        """Counts without a series."""
        return cls(counts, parameters, {})

    @classmethod
    def of_frames(cls, series: Mapping[str, Any], **parameters: Any) -> Tally:
        """The sums of per-frame series, all of the same frames, and the number of `frames`."""
        frames = len(next(iter(series.values())))
        sums = {key: float(values.sum()) for key, values in series.items()}
        return cls({"frames": frames, **sums}, parameters, series)


@dataclass(frozen=True, kw_only=True)
class Family:
    """Metrics with the function that counts for all of them.

    rule : what is counted, in a few words.
    follows_objects : it follows objects in and out of sight by its definition, so that its metrics
        are the same for observable objects only.
    """

    name: str
    rule: str
    count: Callable[[Work], Tally]
    metrics: tuple[Metric, ...]
    follows_objects: bool = False


def share(
    name: str, question: str, formula: Formula, direction: Direction = "higher", **more: Any
) -> Metric:
    """A metric that lies between 0 and 1 in every trial."""
    return Metric(
        name=name, unit="1", direction=direction, question=question, formula=formula, bounds=SHARE,
        **more,
    )  # fmt: skip


def per_frame(name: str, question: str, series: str, unit: str, **more: Any) -> Metric:
    """A metric that is the mean over frames of a series of losses."""
    return Metric(
        name=name, unit=unit, direction="lower", question=question, series=series,
        formula=Ratio(series, "frames", NO_FRAMES), **more,
    )  # fmt: skip


def observable_scene(scene: ScoredScene, matches: Matches) -> ScoredScene:
    """The scene without unobservable truth rows and without the track rows matched to them."""
    ignored = np.zeros(len(scene.tracks), np.bool_)
    ignored[matches.track[~scene.truth.observable[matches.truth]]] = True
    return scene.with_rows(scene.truth.observable, ~ignored)
