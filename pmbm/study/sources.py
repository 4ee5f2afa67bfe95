"""Sources of recordings, also those named as MODULE:SOURCE."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, runtime_checkable

from pmbm.errors import InputError
from pmbm.named_modules import import_named, missing_hint
from pmbm.seeding import recording_seed
from pmbm.types import Recording


@runtime_checkable
class Source(Protocol):
    """A source of recordings: a simulated scene or a dataset's log, alike.

    `record` is a pure function: equal arguments give recordings with equal digests.  One that takes
    a seed alone gets one of its own for every trial.  Sources travel to other processes, so they
    pickle.
    """

    @property
    def name(self) -> str: ...

    def record(self, seed: int, trial: int = 0) -> Recording: ...


def recorded(source: Source, seed: int, trial: int = 0) -> Recording:
    """The recording of a trial.

    Raises InputError where the source gives something else.
    """
    record: Any = source.record
    found = record(seed, trial) if _takes_trial(record) else record(recording_seed(seed, trial))
    if not isinstance(found, Recording):
        raise InputError(
            f"source '{source.name}' recorded something else than a Recording",
            expected="pmbm.Recording",
            got=type(found).__name__,
        )
    return found


def _takes_trial(record: Any) -> bool:
    parameters = inspect.signature(record).parameters.values()
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    return len(positional) > 1 or any(p.kind is p.VAR_POSITIONAL for p in parameters)


def is_named_source(name: str) -> bool:
    """Whether a scenario's name is a MODULE:SOURCE."""
    return ":" in name and not any(mark in name for mark in ("/", "\\", ".toml"))


@dataclass(frozen=True)
class NamedSource:
    """The source behind MODULE:SOURCE, looked up where it is asked for a recording: other processes
    get its name alone.

    place : MODULE:SOURCE; a source, or a class or function without arguments that makes one.

    Raises InputError where there is none.
    """

    place: str

    def __post_init__(self) -> None:
        _ = self.source

    @property
    def name(self) -> str:
        return str(getattr(self.source, "name", self.place.partition(":")[2]))

    @property
    def stresses(self) -> str:
        return str(getattr(self.source, "stresses", ""))

    def record(self, seed: int, trial: int = 0) -> Recording:
        return recorded(self.source, seed, trial)

    @cached_property
    def source(self) -> Any:
        module, _, attribute = self.place.partition(":")
        try:
            found: Any = import_named(module)
            for part in attribute.split("."):
                found = getattr(found, part)
        except (ImportError, AttributeError) as error:
            raise InputError(
                f"source '{self.place}' cannot be imported: {error}",
                hint=missing_hint(error, module),
            ) from error
        if inspect.isclass(found) or (callable(found) and not hasattr(found, "record")):
            found = found()
        if not callable(getattr(found, "record", None)):
            raise InputError(
                f"'{self.place}' is no source of recordings",
                expected="an object with record(seed, trial) -> Recording, or what makes one",
                got=type(found).__name__,
            )
        return found

    def __reduce__(self) -> tuple[Any, ...]:
        return NamedSource, (self.place,)
