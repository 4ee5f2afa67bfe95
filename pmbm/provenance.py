"""Provenance of a result: enough to make it again."""

from __future__ import annotations

import functools
import platform
from importlib import metadata
from typing import Any

SCHEMA_VERSION = 1
_PACKAGES = ("pmbm", "numpy", "scipy", "shapely", "highway-env", "gymnasium", "filterpy")
"""All whose version can change a trial's number."""


def provenance(**parameters: Any) -> dict[str, Any]:
    """The schema version, the parameters given, and the versions of what computes.

    Holds no time, host or path, so that equal runs give equal provenance.
    """
    return {
        "schema": SCHEMA_VERSION,
        "parameters": parameters,
        "versions": {"python": platform.python_version(), **_versions(*_PACKAGES)},
        "platform": platform_key(),
    }


def platform_key() -> str:
    """The machine's kind; last bits of floating-point results may differ between kinds."""
    return f"{platform.system().lower()}-{platform.machine().lower()}"


def made_with(*more: str) -> str:
    """The versions of what computes a trial, and of `more` packages, as one sentence for a file's
    head."""
    found = {"python": platform.python_version(), **_versions(*_PACKAGES, *more)}
    return f"Made with {', '.join(f'{name} {version}' for name, version in found.items())}."


@functools.cache
def _versions(*packages: str) -> dict[str, str]:
    """The versions of those that are installed."""
    found = {}
    for package in packages:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found
