"""A tracker with parameters, as a study file or a tuner names it."""

from __future__ import annotations

import dataclasses
import functools
import inspect
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pmbm.errors import InputError, nearest_hint
from pmbm.tracking import Bound, Tracker, TrackerFactory, make_tracker, track, tracker_factory
from pmbm.types import Recording, Site, TrackSequence


@dataclass(frozen=True)
class ConfiguredTracker:
    """A factory and the parameters it is called with; itself a factory.

    factory : a shipped name or MODULE:FACTORY.
    parameters : keyword arguments of the factory; or, where the factory takes one `config`, fields
        of that dataclass.

    Raises InputError for an unknown tracker or parameter, with the nearest valid name.
    """

    factory: str
    parameters: tuple[tuple[str, Any], ...] = ()

    def __call__(self, site: Site, seed: int = 0) -> Tracker:
        return make_tracker(self.bound(), site, seed)

    def bound(self) -> TrackerFactory:
        """The factory with its parameters filled in; checks them."""
        named = tracker_factory(self.factory)
        if not self.parameters:
            return named
        factory: Any = named.tracks if isinstance(named, Bound) else named
        parameters = dict(self.parameters)
        signature = inspect.signature(factory)
        accepted = [name for name in signature.parameters if name != "site"]
        config = _config_type(factory) if "config" in accepted else None
        if config is not None:
            valid = [field.name for field in dataclasses.fields(config)]
            self._check(parameters, valid)
            keywords = {"config": _built(config, parameters, "")}
        else:
            anything = any(p.kind is p.VAR_KEYWORD for p in signature.parameters.values())
            self._check(parameters, list(parameters) if anything else accepted)
            keywords = parameters
        filled = functools.partial(factory, **keywords)
        return Bound(filled) if isinstance(named, Bound) else filled

    def _check(self, given: Mapping[str, Any], valid: list[str]) -> None:
        for name in given:
            if name not in valid:
                raise InputError(
                    f"tracker '{self.factory}' has no parameter '{name}'",
                    field=name,
                    hint=nearest_hint(name, valid, "parameter"),
                )


def follow(tracker: TrackerFactory | str, recording: Recording, seed: int) -> TrackSequence:
    """`track` of a factory, of a configured tracker, or of the one of that name."""
    factory: Any = tracker_factory(tracker) if isinstance(tracker, str) else tracker
    if isinstance(factory, ConfiguredTracker):
        factory = factory.bound()
    return track(factory, recording, seed)


def _built(kind: Any, values: Mapping[str, Any], path: str) -> Any:
    """A dataclass from its fields; fields that are dataclasses themselves may be given as tables of
    theirs, as a file has them."""
    hints = typing.get_type_hints(kind)
    given = {}
    for name, value in values.items():
        if name not in hints:
            raise InputError(
                "unknown parameter",
                field=path + name,
                hint=nearest_hint(name, [field.name for field in dataclasses.fields(kind)]),
            )
        inner = _dataclass_in(hints[name])
        nested = inner is not None and isinstance(value, Mapping)
        given[name] = _built(inner, value, f"{path}{name}.") if nested else value
    missing = [
        field.name
        for field in dataclasses.fields(kind)
        if field.name not in given
        and field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise InputError("missing parameter", field=path + missing[0])
    return kind(**given)


def _config_type(factory: TrackerFactory) -> Any:
    """The dataclass that the parameter `config` is annotated with, if it is one."""
    target: Any = factory.__init__ if inspect.isclass(factory) else factory
    return _dataclass_in(typing.get_type_hints(target).get("config"))


def _dataclass_in(annotation: Any) -> Any:
    """The dataclass that an annotation is, or has among its alternatives."""
    for kind in (annotation, *typing.get_args(annotation)):
        if dataclasses.is_dataclass(kind):
            return kind
    return None
