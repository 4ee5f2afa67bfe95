"""A tracker's parameters on the command line: `--set reduction.gate=9`."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from pmbm.errors import InputError

if TYPE_CHECKING:
    from pmbm.study import ConfiguredTracker

option = click.option(
    "--set",
    "settings",
    multiple=True,
    metavar="KEY=VALUE",
    help="A parameter of the tracker, of several the first, such as gate=4 or "
    "sensor.clutter_rate=2.",
)


def configured(name: str, settings: Sequence[str]) -> ConfiguredTracker:
    """The tracker of that name with these parameters.

    Raises InputError for an unknown tracker or parameter, and for what is not KEY=VALUE.
    """
    from pmbm.study import ConfiguredTracker

    tracker = ConfiguredTracker(name, tuple(parsed(settings).items()))
    tracker.bound()
    return tracker


def named(trackers: Sequence[str], settings: Sequence[str]) -> dict[str, ConfiguredTracker | str]:
    """The trackers by what tables call them, the first with these parameters.

    Raises InputError as `configured` does.
    """
    first, *others = trackers
    start = {shown_name(first, settings): configured(first, settings) if settings else first}
    return {**start, **{name: name for name in others}}


def parsed(settings: Sequence[str]) -> dict[str, Any]:
    """Parameters by their names.

    Raises InputError for what is not KEY=VALUE.
    """
    return dict(_parsed(one) for one in settings)


def shown_name(name: str, settings: Sequence[str]) -> str:
    """The name of a tracker with parameters, for tables."""
    return f"{name} ({', '.join(settings)})" if settings else name


def _parsed(setting: str) -> tuple[str, Any]:
    key, equals, text = (part.strip() for part in setting.partition("="))
    if not key or not equals:
        raise InputError("not a parameter", field="--set", expected="KEY=VALUE", got=setting)
    try:
        return key, tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        # A name without quotes, as the shell leaves it.
        return key, text
