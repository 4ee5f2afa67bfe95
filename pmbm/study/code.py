"""A hash of the sources that can change a result."""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from pmbm.external import EXEC, program_named
from pmbm.named_modules import find_named
from pmbm.provenance import provenance

WITHOUT_EFFECT = (
    "cli",
    "regression",
    "testing.py",
    "pytest_plugin.py",
    "tune.py",
    "tune",
    "reports",
    "example",
    "sim",
)
"""Parts of pmbm that only run, judge or show trials; and pmbm.sim, which is hashed by itself."""


def code_version(modules: Iterable[str] = ()) -> dict[str, Any]:
    """The identity of the code of a trial: digests of pmbm, pmbm.sim and the modules named,
    versions, platform.

    modules : of the trackers in use ("package.module"), of which the whole package is hashed; a
        program's "exec:COMMAND" stands for the files that the command names.
    """
    known = provenance()
    tops = {name if name.startswith(EXEC) else name.split(".")[0] for name in modules}
    named = sorted(tops | {"pmbm", "pmbm.sim"})
    return {
        "sources": {name: digest for name in named if (digest := _digest(name)) is not None},
        "versions": known["versions"],
        "platform": known["platform"],
    }


def _digest(package: str) -> str | None:
    """SHA-256 of the sources of a top-level package or module, None where it has none; of a program
    that of its files."""
    if package.startswith(EXEC):
        return program_named(package).digest()
    sources = sorted(_sources(package))
    hasher = hashlib.sha256()
    for name, file in sources:
        content = file.read_bytes()
        hasher.update(f"{name} {len(content)};".encode())
        hasher.update(content)
    return hasher.hexdigest() if sources else None


def _sources(package: str) -> Iterator[tuple[str, Path]]:
    loaded = sys.modules.get(package)
    spec = loaded.__spec__ if loaded is not None else find_named(package)
    if spec is None:
        return
    if spec.origin is None or not Path(spec.origin).is_file():
        return
    origin = Path(spec.origin)
    if spec.submodule_search_locations is None:
        yield package, origin
        return
    # An editable install may search further folders, which hold more than the package.
    for pattern in ("*.py", "*.toml"):
        for file in origin.parent.rglob(pattern):
            name = file.relative_to(origin.parent)
            if package != "pmbm" or name.parts[0] not in WITHOUT_EFFECT:
                yield name.as_posix(), file
