"""What is compiled, where the install could build it: chosen here, once, for all who use it.

Every function of the module `pmbm._native` has a plain twin in Python that runs where it is
missing.  PMBM_NO_NATIVE=1 in the environment chooses the plain ones.
"""

from __future__ import annotations

import importlib
import os
from types import ModuleType


def _choose() -> ModuleType | None:
    if os.environ.get("PMBM_NO_NATIVE", "").lower() in ("", "0", "false", "no", "off"):
        try:
            return importlib.import_module("pmbm._native")
        except ModuleNotFoundError:
            # Installed where no compiler was: what the plain twins are for.
            pass
    return None


native: ModuleType | None = _choose()
