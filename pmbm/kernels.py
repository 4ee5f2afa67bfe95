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
from types import ModuleType
from typing import ParamSpec, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")


def _choose() -> ModuleType | None:
    if os.environ.get("PMBM_NO_NATIVE", "").lower() in ("", "0", "false", "no", "off"):
        try:
            return importlib.import_module("pmbm._native")
        except ModuleNotFoundError:
            # Installed where no compiler was: what the plain twins are for.
            pass
    return None


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
