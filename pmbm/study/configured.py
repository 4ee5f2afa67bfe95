"""A tracker with parameters, as a study file or a tuner names it."""

from __future__ import annotations

import collections.abc
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
        of that dataclass, as nested tables or by dotted names ("sensor.clutter_rate").

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
            keywords = {"config": from_table(config, nested(parameters))}
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
    return track(factory_of(tracker), recording, seed)


def factory_of(tracker: TrackerFactory | str) -> TrackerFactory:
    """The factory itself, that of a configured tracker, or the one of that name.

    Raises InputError where there is none.
    """
    factory: Any = tracker_factory(tracker) if isinstance(tracker, str) else tracker
    return factory.bound() if isinstance(factory, ConfiguredTracker) else factory


def nested(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Parameters as nested tables: a dotted name stands for a value in a table, and of two of one
    place the later counts."""
    table: dict[str, Any] = {}
    for name, value in parameters.items():
        *path, last = name.split(".")
        place = table
        for part in path:
            inner = place.get(part)
            place[part] = place = dict(inner) if isinstance(inner, Mapping) else {}
        place[last] = value
    return table


def merged(under: Mapping[str, Any], over: Mapping[str, Any], config: Any = None) -> dict[str, Any]:
    """Nested tables of which the values of `over` count, but where a table of another `kind` stands
    in its place.

    config : the dataclass that the tables are of: its fields' defaults have a kind too.
    """
    result = dict(under)
    for name, value in over.items():
        below = result.get(name)
        if isinstance(below, Mapping) and isinstance(value, Mapping):
            default, members, inner = _default(config, name)
            kind = below.get("kind", default)
            if value.get("kind", kind) == kind:
                if members is not None and kind is not None:
                    inner = members.of_kind(kind)
                result[name] = merged(below, value, inner)
                continue
        result[name] = value
    return result


def config_of(factory: str) -> Any:
    """The dataclass of a tracker's parameters, or None where it has none.

    Raises InputError for an unknown tracker.
    """
    named = tracker_factory(factory)
    return _config_type(named.tracks if isinstance(named, Bound) else named)


def _default(config: Any, name: str) -> tuple[str | None, Any, Any]:
    """Of a dataclass's field: the kind that it has by default and the members that kinds name, or
    the dataclass that it is."""
    if config is None:
        return None, None, None
    found = [one for one in dataclasses.fields(config) if one.name == name]
    if not found:
        return None, None, None
    hint = typing.get_type_hints(config, include_extras=True)[name]
    members = _members(hint)
    if members is None:
        return None, None, _dataclass_in(hint)
    factory = found[0].default_factory
    default = found[0].default if factory is dataclasses.MISSING else factory()
    return members.kind_of(default), members, None


def from_table(config: Any, values: Mapping[str, Any], path: str = "") -> Any:
    """A dataclass from its fields; fields that are dataclasses themselves may be given as tables of
    theirs, as a file has them, those of several members with their `kind`: such a field's
    annotation holds what gives the class `of_kind`.

    Raises InputError, with the dotted name of the field.
    """
    hints = typing.get_type_hints(config, include_extras=True)
    names = [field.name for field in dataclasses.fields(config)]
    given = {}
    for name, value in values.items():
        if name not in names:
            raise InputError(
                f"{config.__name__} has no '{name}'",
                field=path + name,
                hint=_renamed(config, name) or nearest_hint(name, names, "parameter"),
            )
        if isinstance(value, Mapping):
            value = _member(config, name, hints[name], value, f"{path}{name}.")
        given[name] = value
    missing = [
        field.name
        for field in dataclasses.fields(config)
        if field.name not in given
        and field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise InputError("missing parameter", field=path + missing[0])
    try:
        return config(**given)
    except InputError as error:
        where = error.field or ""
        raise (error if where.startswith(path) else error.located(field=path + where)) from None


def _renamed(config: Any, name: str) -> str | None:
    """The hint for a name that the PMBM tracker's configuration had, in any part of it."""
    if not config.__module__.startswith("pmbm.filter."):
        return None
    from pmbm.filter.config import renamed

    return renamed(name)


def _member(config: Any, name: str, hint: Any, value: Mapping[str, Any], path: str) -> Any:
    """The value of a field that a file gives as a table."""
    values = dict(value)
    members = _members(hint)
    if typing.get_origin(hint) is collections.abc.Mapping:
        kind = typing.get_args(hint)[1]
        if not dataclasses.is_dataclass(kind):
            return value
        return {
            key: from_table(kind, one, f"{path}{key}.") if isinstance(one, Mapping) else one
            for key, one in values.items()
        }
    if members is None:
        inner = _dataclass_in(hint)
        return value if inner is None else from_table(inner, values, path)
    if "kind" in values:
        try:
            return from_table(members.of_kind(values.pop("kind")), values, path)
        except InputError as error:
            raise (error if error.field != "kind" else error.located(field=f"{path}kind")) from None
    (default,) = (one for one in dataclasses.fields(config) if one.name == name)
    if default.default_factory is dataclasses.MISSING:
        raise InputError("missing parameter", field=f"{path}kind")
    return from_table(default.default_factory, values, path)


def _members(hint: Any) -> Any:
    """The registry that gives the classes of kinds for an annotated field, or None where it has one
    class."""
    return next((one for one in getattr(hint, "__metadata__", ()) if hasattr(one, "of_kind")), None)


def _config_type(factory: Any) -> Any:
    """The dataclass that the parameter `config` is annotated with, if it is one."""
    target: Any = factory.__init__ if inspect.isclass(factory) else factory
    return _dataclass_in(typing.get_type_hints(target).get("config"))


def _dataclass_in(annotation: Any) -> Any:
    """The dataclass that an annotation is, or has among its alternatives."""
    for kind in (annotation, *typing.get_args(annotation)):
        if dataclasses.is_dataclass(kind):
            return kind
    return None
