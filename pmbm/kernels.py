"""The compiled kernels, and which of each pair of twins runs: chosen here, once, for all.

A kernel is a plain function that `twin` marks, and a function of the module `pmbm._native` of the
same name, arguments and results.  The plain ones run where the install had no compiler, and where
PMBM_NO_NATIVE=1 in the environment asks for them.
"""

from __future__ import annotations

import functools
import importlib
import os
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import ModuleType
from typing import ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def _choose() -> ModuleType | None:
    if os.environ.get("PMBM_NO_NATIVE", "").lower() in ("", "0", "false", "no", "off"):
        try:
            return checked(importlib.import_module("pmbm._native"))
        except ModuleNotFoundError:
            # Installed where no compiler was: what the plain twins are for.
            pass
    return None


def checked(module: ModuleType) -> ModuleType:
    """The compiled module, if it is of the sources beside it.

    Raises ImportError if not: what the two take and give need not be the same.
    """
    expected = fingerprint()
    if expected is None or getattr(module, "fingerprint", None) == expected:
        return module
    raise ImportError(
        f"{module.__file__} was not compiled from the sources in {_SOURCES}: compile it again with "
        "`pip install -e .` in the repository, or do without it by PMBM_NO_NATIVE=1"
    )


_SOURCES = Path(__file__).with_name("native")


def fingerprint() -> str | None:
    """Of the sources of what is compiled, as CMakeLists.txt has it, or None where they are not
    installed."""
    files = sorted(_SOURCES.glob("*.[hc]pp"))
    hashes = "".join(sha256(one.read_bytes()).hexdigest() for one in files)
    return sha256(hashes.encode()).hexdigest() if files else None


native: ModuleType | None = _choose()

TWINS: dict[str, Callable[..., object]] = {}
"""Name of a kernel -> its plain twin."""


def twin(
    name: str,
) -> Callable[[Callable[_Arguments, _Result]], Callable[_Arguments, _Result]]:
    """Mark the plain twin of the kernel `name`, which takes arguments by position alone: a call
    runs the compiled one where there is one."""

    def mark(plain: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
        TWINS[name] = plain

        @functools.wraps(plain)
        def call(*arguments: _Arguments.args, **keywords: _Arguments.kwargs) -> _Result:
            if native is None:
                return plain(*arguments, **keywords)
            result: _Result = getattr(native, name)(*arguments, **keywords)
            return result

        return call

    return mark
