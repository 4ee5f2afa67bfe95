"""Recordings' sources from the names and overrides that commands are given."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pmbm.study import Source


def resolve(name: str, overrides: Mapping[str, Any]) -> Source:
    """The scenario of that name or file, with keys of its document overridden; the sequences of the
    dataset that a file names, or the source behind MODULE:SOURCE, which have none.

    overrides : dotted keys of the scenario's file ("detector.clutter_rate") and their values; and
        "level", a level of what the scenario itself sweeps.
    Raises InputError for an unknown scenario, key, level or value.
    """
    from pmbm.datasets.source import named_dataset
    from pmbm.errors import InputError
    from pmbm.sim import Scenario, load_scenario
    from pmbm.study import NamedSource, is_named_source

    if is_named_source(name):
        if overrides:
            raise InputError(
                f"source '{name}' has no file whose keys could be swept",
                field=f"sweep: {next(iter(overrides))}",
            )
        return NamedSource(name)
    logs = named_dataset(name)
    if logs is not None:
        if overrides:
            raise InputError(
                "recorded detections can neither be swept nor held at a level",
                file=name,
                field=f"sweep: {next(iter(overrides))}",
                hint='a scenario of [scene] kind = "recorded" can: it has a detector model',
            )
        return logs
    scenario = load_scenario(name)
    keys = {key: value for key, value in overrides.items() if key != "level"}
    if keys:
        document = copy.deepcopy(dict(scenario.document))
        for key, value in keys.items():
            _put(document, key, value)
        try:
            scenario = Scenario(document, scenario.file)
        except InputError as error:
            # It is not the scenario's own file that is wrong.
            raise error.located(file=None, field=f"sweep: {error.field}") from None
    try:
        return scenario.at(overrides["level"]) if "level" in overrides else scenario
    except InputError as error:
        raise error.located(field="sweep: level") from None


def _put(document: dict[str, Any], key: str, value: Any) -> None:
    from pmbm.errors import InputError
    from pmbm.sim.scenario.checks import check_sensor_in

    table: Any = document
    *path, last = key.split(".")
    check_sensor_in(document, key, field=f"sweep: {key}")
    for part in path:
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            raise InputError(f"'{key}' names no table of the scenario", field=f"sweep: {key}")
    table[last] = value
