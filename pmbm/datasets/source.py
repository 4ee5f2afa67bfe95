"""A dataset's sequences as a source of recordings, for studies and gates: trial t is sequence t."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from pmbm.datasets import chosen_sequences, open_dataset, with_origins
from pmbm.datasets.files import read_text
from pmbm.errors import InputError, nearest_hint
from pmbm.types import Recording

_PATHS: Final = ("root", "detections", "poses")
_LISTS: Final = ("classes", "sequences")
_KEYS: Final = ("dataset", *_PATHS, *_LISTS)


@dataclass(frozen=True)
class DatasetSource:
    """Sequences of a dataset with their own detections.

    name : of the file.  dataset : that of `pmbm.datasets.DATASETS`.
    options : what the dataset is opened with.  sequences : in the order of the trials, all where
        none is named.
    """

    name: str
    dataset: str
    options: Mapping[str, Any] = field(default_factory=dict)
    sequences: tuple[str, ...] = ()

    @cached_property
    def trials(self) -> tuple[str, ...]:
        """The sequence of each trial."""
        return self.sequences or tuple(open_dataset(self.dataset, **self.options).sequences())

    def record(self, seed: int, trial: int = 0) -> Recording:
        """The sequence of a trial, whatever the seed; a detection's origin is by overlap where the
        dataset does not tell it.

        Raises InputError where there is no such trial.
        """
        if not 0 <= trial < len(self.trials):
            raise InputError(
                f"'{self.name}' has a sequence a trial, and none for this one",
                field="trial",
                expected=f"0 to {len(self.trials) - 1}",
                got=trial,
                hint=f"trials = {len(self.trials)}",
            )
        made = open_dataset(self.dataset, **self.options).recording(self.trials[trial])
        return made if made.origin is not None else with_origins(made)


def dataset_source(path: Path, document: Mapping[str, Any]) -> DatasetSource:
    """The source that a TOML file names: `dataset`, its options, and which sequences; folders are
    beside the file.

    Raises InputError with file and key.
    """
    for key, value in document.items():
        if key not in _KEYS:
            hint = nearest_hint(key, _KEYS, "key")
            raise InputError("unknown key", file=path, field=key, hint=hint)
        texts = value if key in _LISTS else [value]
        if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
            expected = "a list of names" if key in _LISTS else "a text"
            raise InputError("bad value", file=path, field=key, expected=expected, got=value)
    options: dict[str, Any] = {
        key: str(path.parent / document[key]) for key in _PATHS if key in document
    }
    if "classes" in document:
        options["classes"] = tuple(document["classes"])
    try:
        opened = open_dataset(document["dataset"], **options)
        chosen = tuple(document.get("sequences", ()))
        known = opened.sequences() if chosen else chosen_sequences(opened)
    except InputError as error:
        raise error.located(file=error.file or path) from None
    for name in chosen:
        if name not in known:
            raise InputError(
                f"no sequence '{name}'",
                file=path,
                field="sequences",
                hint=nearest_hint(name, known, "sequence"),
            )
    return DatasetSource(path.stem, document["dataset"], options, chosen)


def named_dataset(name: str) -> DatasetSource | None:
    """The source that a TOML file of this name describes; None where it is no such file, or is one
    without a dataset."""
    path = Path(name)
    if path.suffix != ".toml" or not path.is_file():
        return None
    try:
        document = tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError, InputError):
        # What is wrong is said where the file is read as a scenario.
        return None
    return dataset_source(path, document) if "dataset" in document else None
