"""A Monte Carlo study: which trials there are, and what identifies them."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from pmbm.errors import InputError
from pmbm.external import EXEC
from pmbm.metrics.catalogue import definition
from pmbm.study.code import code_version
from pmbm.study.configured import ConfiguredTracker
from pmbm.study.sources import NamedSource, Source
from pmbm.study.trial import TrialResult, run_trial
from pmbm.types import Site, digest_of
from pmbm.wording import counted

Resolve = Callable[[str, Mapping[str, Any]], Source]
"""Turns a name and overrides of its parameters into a Source, or raises InputError."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One configuration of the world and of the trackers.

    scenario : the name given in the study.
    point : the swept parameters and their values here.
    source : what is recorded.
    trackers : name -> tracker, with its parameters here.
    """

    scenario: str
    point: Mapping[str, Any]
    source: Source
    trackers: Mapping[str, ConfiguredTracker]

    @property
    def label(self) -> str:
        """The scenario and the point, for people."""
        return cell_label(self.scenario, self.point)

    def __repr__(self) -> str:
        return f"Cell('{self.label}': {', '.join(self.trackers)})"


@dataclass(frozen=True, eq=False, kw_only=True)
class Study:
    """Trials over cells.  Trial `index` is trial `index // C` of cell `index % C` of C cells, so
    that all cells grow together, and raising `trials` adds indices and moves none.

    A trial is a pure function of (`hash`, index).

    name : of the study.
    cells : its configurations.
    trials : trials of each cell.
    seed : of all.
    metrics : names to keep, or None for all.
    gate : the study file's table about regression, as written.
    time_limit, memory_limit : of one trial, s and MB, or None.
    """

    name: str
    cells: tuple[Cell, ...]
    trials: int
    seed: int = 0
    metrics: tuple[str, ...] | None = None
    gate: Mapping[str, Any] = field(default_factory=dict)
    time_limit: float | None = None
    memory_limit: float | None = None

    def __post_init__(self) -> None:
        if not self.cells:
            raise InputError("a study of nothing", field="scenarios", expected="at least one")
        if os.name != "posix" and (self.time_limit or self.memory_limit):
            raise InputError("limits of a trial are kept on Linux and macOS alone", field="limits")
        for name in self.metrics or ():
            definition(name)
        for cell in self.cells:
            for name, tracker in cell.trackers.items():
                try:
                    tracker.bound()
                    check_sensors(tracker, cell.source)
                except InputError as error:
                    of_it = None if error.field is None else f"tracker.{name}.{error.field}"
                    raise error.located(field=of_it) from None

    def __len__(self) -> int:
        return self.trials * len(self.cells)

    def __repr__(self) -> str:
        return (
            f"Study('{self.name}': {counted(len(self.cells), 'cell')} of "
            f"{counted(self.trials, 'trial')}, {counted(len(self.trackers), 'tracker')})"
        )

    def cell(self, index: int) -> Cell:
        return self.cells[index % len(self.cells)]

    def trial(self, index: int) -> int:
        return index // len(self.cells)

    def run(self, index: int) -> TrialResult:
        """Compute one trial."""
        cell = self.cell(index)
        return run_trial(cell.source, cell.trackers, self.seed, self.trial(index), self.metrics)

    @property
    def trackers(self) -> tuple[str, ...]:
        return tuple(self.cells[0].trackers)

    @cached_property
    def document(self) -> dict[str, Any]:
        """All that a trial's result depends on, as plain JSON values; `trials` is no part of it."""
        modules = {
            tracker.factory
            if tracker.factory.startswith(EXEC)
            else tracker.factory.partition(":")[0]
            for cell in self.cells
            for tracker in cell.trackers.values()
            if ":" in tracker.factory
        }
        modules |= {
            cell.source.place.partition(":")[0]
            for cell in self.cells
            if isinstance(cell.source, NamedSource)
        }
        return {
            "cells": [
                {
                    "scenario": cell.scenario,
                    "point": dict(cell.point),
                    "source": _identity(cell.source),
                    "trackers": [
                        {
                            "name": name,
                            "factory": tracker.factory,
                            "parameters": dict(tracker.parameters),
                        }
                        for name, tracker in cell.trackers.items()
                    ],
                }
                for cell in self.cells
            ],
            "seed": self.seed,
            "metrics": None if self.metrics is None else list(self.metrics),
            "code": code_version(modules),
        }

    @cached_property
    def hash(self) -> str:
        """SHA-256 of `document`."""
        return hashlib.sha256(canonical(self.document).encode()).hexdigest()


def check_sensors(tracker: ConfiguredTracker, source: Source) -> None:
    """Raise InputError where a tracker has parameters of a sensor that the source does not have, as
    far as the source says which it has (`mounted`)."""
    mounted = getattr(source, "mounted", None)
    if mounted is not None and any(key.split(".")[0] == "sensors" for key, _ in tracker.parameters):
        try:
            tracker(Site(sensors=tuple(mounted)))
        except InputError as error:
            raise error.located(run=source.name, field="sensors") from None


def cell_label(scenario: str, point: Mapping[str, Any]) -> str:
    """A scenario and a point of a sweep, for people."""
    settings = ", ".join(f"{key} = {value}" for key, value in point.items())
    return f"{scenario} [{settings}]" if settings else scenario


def canonical(value: Any) -> str:
    """JSON that is equal where the values are: sorted, without spaces, floats in full.

    Raises ValueError for NaN and infinities.
    """
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _identity(source: Any) -> Any:
    """The identity that tells a source from another of its name."""
    document = getattr(source, "document", None)
    if isinstance(document, Mapping):
        return hashlib.sha256(canonical(document).encode()).hexdigest()
    if dataclasses.is_dataclass(source):
        return digest_of(source)
    return source.name
