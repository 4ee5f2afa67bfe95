"""Where a result comes from: enough to make it again."""

from __future__ import annotations

import platform
from importlib import metadata
from typing import Any

SCHEMA_VERSION = 1
_PACKAGES = ("pmbm", "numpy", "scipy", "highway-env", "gymnasium", "filterpy")


def provenance(**parameters: Any) -> dict[str, Any]:
    """The schema version, the parameters given, and the versions of what computes.

    Holds no time, host or path, so that equal runs give equal provenance.
    """
    return {
        "schema": SCHEMA_VERSION,
        "parameters": parameters,
        "versions": {"python": platform.python_version(), **_versions()},
        "platform": platform_key(),
    }


def platform_key() -> str:
    """The machine's kind; last bits of floating-point results may differ between kinds."""
    return f"{platform.system().lower()}-{platform.machine().lower()}"


def _versions() -> dict[str, str]:
    found = {}
    for package in _PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return found
