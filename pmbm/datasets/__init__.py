"""Real datasets by the same door as simulated scenes: folder -> Recording, tracks -> submission."""

from __future__ import annotations

import dataclasses
import importlib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Protocol

from pmbm.datasets.origins import with_origins
from pmbm.errors import InputError, InputWarning, nearest_hint
from pmbm.metrics.benchmarks.rules import ComparedSequence, ScoringRule
from pmbm.types import Label, Recording, TrackSequence
from pmbm.wording import counted

__all__ = [
    "DATASETS",
    "Dataset",
    "adapter",
    "chosen_sequences",
    "class_of_label",
    "load",
    "open_dataset",
    "with_origins",
]

DATASETS: Final = {
    "argoverse1": "pmbm.datasets.argoverse1:Argoverse1",
    "argoverse2": "pmbm.datasets.argoverse2:Argoverse2",
    "kitti": "pmbm.datasets.kitti:Kitti",
    "nuscenes": "pmbm.datasets.nuscenes:NuScenes",
    "table": "pmbm.datasets.table:Table",
    "waymo": "pmbm.datasets.waymo:Waymo",
}
"""Name -> module:class, imported when it is opened."""


class Dataset(Protocol):
    """The protocol of a dataset's adapter, which reads a sequence when it is asked for."""

    @property
    def name(self) -> str:
        """The dataset's name in `DATASETS`."""

    @property
    def rules(self) -> Mapping[str, ScoringRule]:
        """The rules by which results are scored, by name; the first is the default."""

    @property
    def classes(self) -> tuple[str, ...]:
        """The classes asked for, by the dataset's names."""

    @property
    def known_classes(self) -> tuple[str, ...]:
        """All classes that may be asked for."""

    @property
    def labels(self) -> tuple[int, ...]:
        """The labels of the classes asked for, in their order."""

    def sequences(self) -> list[str]:
        """The names of all sequences there are."""

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One sequence in the world; without `truth` no label is read."""

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """One sequence's tracks in the dataset's own format; the path of what was written."""

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of a sequence from the files that `write` wrote, in the world."""

    def submit(self, sequences: Sequence[str], folder: Path) -> Path:
        """Pack what `write` wrote of these sequences into the one file to hand in, in the same
        folder."""

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Truth and a result of one class, as the dataset's own rules compare them."""


def adapter(name: str) -> Any:
    """The class that reads a dataset.

    Raises InputError for an unknown dataset, with the nearest valid name.
    """
    if name not in DATASETS:
        raise InputError(f"no dataset '{name}'", hint=nearest_hint(name, DATASETS, "dataset"))
    module, _, attribute = DATASETS[name].partition(":")
    return getattr(importlib.import_module(module), attribute)


LAYOUTS = {
    "kitti": "a folder with calib/NNNN.txt and, for truth, label_02/NNNN.txt",
    "argoverse1": "a folder of logs, in each poses/city_SE3_egovehicle_<ns>.json and, for truth, "
    "per_sweep_annotations_amodal/tracked_object_labels_<ns>.json",
    "argoverse2": "a folder of logs, in each city_SE3_egovehicle.feather and, for truth, "
    "annotations.feather",
    "nuscenes": "the folder of the tables, such as v1.0-mini: scene.json, sample.json, ...",
    "waymo": "a folder with vehicle_pose/ and, for truth, lidar_box/, a parquet file a segment in "
    "each; or a metrics.Objects file",
    "table": "a folder with truth, detections or poses, a table a sequence",
}
"""Name -> what its root holds; docs/guide/datasets.md has the rest."""


def open_dataset(name: str, **options: Any) -> Dataset:
    """The adapter of a dataset with its options; those that are None are left at their defaults.

    Raises InputError for an unknown dataset or option, or for a missing one, with the nearest valid
    name.
    """
    made = adapter(name)
    known = {field.name: field for field in dataclasses.fields(made)}
    given = {key: value for key, value in options.items() if value is not None}
    for key in given:
        if key not in known:
            raise InputError(
                f"{name} takes no such option", field=key, hint=nearest_hint(key, known, "option")
            )
    for key, field in known.items():
        if key not in given and field.default is dataclasses.MISSING:
            raise InputError(f"{name} needs an option", field=key)
    root = Path(given["root"]) if "root" in given else None
    if root is not None and not root.exists():
        raise InputError(
            f"{name}: there is no such folder", file=root, field="root", expected=LAYOUTS[name]
        )
    dataset: Dataset = made(**given)
    return dataset


def class_of_label(dataset: Dataset) -> dict[Label, str]:
    """Label -> the dataset's name of it, of the classes asked for in their order."""
    return dict(zip(map(Label, dataset.labels), dataset.classes, strict=True))


def chosen_sequences(dataset: Dataset, names: Sequence[str] = ()) -> list[str]:
    """These sequences, each once; all of the dataset where none is named.

    Warns (InputWarning) of detections of sequences that the dataset does not have: without poses,
    calibration or truth, whichever its sequences are known by.
    """
    if names:
        return list(dict.fromkeys(names))
    known = dataset.sequences()
    others = _detected_elsewhere(dataset, known)
    if others:
        shown = ", ".join(others[:5]) + (", ..." if len(others) > 5 else "")
        warnings.warn(
            f"detections of {counted(len(others), 'sequence')} that {dataset.name} does not have "
            f"are passed over: {shown}; expected {LAYOUTS[dataset.name]}",
            InputWarning,
            stacklevel=2,
        )
    return known


def _detected_elsewhere(dataset: Dataset, known: Sequence[str]) -> list[str]:
    """Sequences with a file or folder among the detections as the known ones have it, that are not
    known."""
    pattern = str(getattr(dataset, "detections", None) or "")
    folders = {Path(pattern.replace("{class}", kind)) for kind in dataset.classes}
    there = [path for folder in folders if folder.is_dir() for path in folder.iterdir()]
    named = [(path.name, "") if path.is_dir() else (path.stem, path.suffix) for path in there]
    endings = {ending for name, ending in named if name in known}
    return sorted({name for name, ending in named if ending in endings} - set(known))


def load(dataset: Dataset, sequences: Sequence[str] | None = None) -> Iterator[Recording]:
    """The recordings of these sequences (default: all), each read when it is reached."""
    for sequence in dataset.sequences() if sequences is None else sequences:
        yield dataset.recording(sequence)
