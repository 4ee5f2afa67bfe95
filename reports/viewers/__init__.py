"""A trial as a log for a viewer: MCAP for Foxglove, .rrd for Rerun."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

from pmbm.durable import check_writable
from pmbm.errors import InputError
from pmbm.reports.values import ReplayPage

_PACKAGES = {".mcap": ("mcap", "mcap"), ".rrd": ("rerun", "rerun")}
"""Suffix -> the package that writes such files, and the extra that brings it."""


def check_log(file: Path) -> None:
    """Raise InputError where a log of that name cannot be written, before there is one."""
    if file.suffix not in _PACKAGES:
        raise InputError(
            "no log of that kind",
            file=file,
            expected=" or ".join(f"a name that ends in {suffix}" for suffix in _PACKAGES),
        )
    package, extra = _PACKAGES[file.suffix]
    if find_spec(package) is None:
        raise InputError(
            f"the package '{package}' is not installed",
            file=file,
            hint=f"pip install 'pmbm[{extra}]'",
        )
    check_writable(file)


def write_log(replay: ReplayPage, file: Path) -> None:
    """Write a trial, whole or not at all.

    Raises InputError as `check_log` does.
    """
    check_log(file)
    if file.suffix == ".mcap":
        from pmbm.reports.viewers.foxglove import write_mcap

        write_mcap(replay, file)
    else:
        from pmbm.reports.viewers.rerun_log import write_rrd

        write_rrd(replay, file)
