"""A user's own logs: CSV or Parquet tables of boxes, a file a sequence (docs/guide/tables.md)."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from pmbm.arrays import IntArray
from pmbm.datasets.files import Place, prepare_folder, read_text, safe_name
from pmbm.datasets.logs import LogFolder
from pmbm.datasets.table_files import (
    located,
    read_table,
    table_file,
    table_names,
    texts_in,
    write_table,
)
from pmbm.errors import InputError, nearest_hint
from pmbm.metrics.benchmarks.rules import ComparedSequence
from pmbm.metrics.benchmarks.table import RULES
from pmbm.tables.axes import Axes
from pmbm.tables.cells import Cells
from pmbm.tables.reading import Frame, Parts, parts, track_rows
from pmbm.tables.writing import track_columns
from pmbm.types import (
    GroundTruth,
    Label,
    MountedSensor,
    Recording,
    Site,
    Tracks,
    TrackSequence,
    frames_of,
)

SETTINGS: Final = "table.toml"
_IGNORED: Final = "ignored"
"""In place of a label: a class whose rows are left out."""
_LABELS: Final = {label.name.lower(): label for label in Label}


@dataclass(frozen=True, kw_only=True)
class Settings:
    """The settings that `table.toml` gives for the tables beside it.

    frame : that boxes are given in.  rate : frames a second, where no table has times.
    ignored_columns : of any table.
    classes : the tables' own names -> labels, None for those left out.
    site : where the sensor stands.
    """

    frame: Frame = "world"
    rate: float = 10.0
    ignored_columns: tuple[str, ...] = ()
    classes: Mapping[str, Label | None] = field(default_factory=dict)
    site: Site = field(default_factory=Site)


@dataclass(frozen=True, kw_only=True)
class Table(LogFolder):
    """Sequences as tables of boxes.

    root : a folder with truth/, and perhaps poses/ and table.toml.
    detections : a folder with a table a sequence; None for none.
    poses : of the same, where the poses are elsewhere.
    classes : names of labels; those that occur where none is asked for.

    Frames are those of the poses; without poses, of truth and detections, and where results are
    read, of these.  A frame without a row of detections was looked at and is empty, unless its row
    of the poses says that nothing was delivered.
    """

    name: ClassVar = "table"
    title: ClassVar = "table"
    class_labels: ClassVar = _LABELS
    rules: ClassVar = RULES

    classes: tuple[str, ...] = ()
    poses: Path | None = None

    def __post_init__(self) -> None:
        LogFolder.__post_init__(self)
        poses = self.root / "poses" if self.poses is None else Path(self.poses)
        if self.poses is not None and not poses.is_dir():
            raise InputError("no such folder", file=poses, field="poses")
        object.__setattr__(self, "poses", poses)
        if not self.classes:
            object.__setattr__(self, "classes", self._occurring())

    @cached_property
    def settings(self) -> Settings:
        """The settings of `table.toml`; the defaults where there is none."""
        path = self.root / SETTINGS
        return read_settings(path) if path.exists() else Settings()

    def sequences(self) -> list[str]:
        """The names of all sequences: those with truth; without any, those with detections."""
        names = table_names(self.root / "truth")
        if not names and self.detections is not None:
            names = table_names(Path(self.detections))
        if not names:
            raise Place(self.root).error("no tables", expected="truth/NAME.csv or NAME.parquet")
        return names

    def recording(self, sequence: str, *, truth: bool = True) -> Recording:
        """One sequence in the world; without `truth` no more is read of it than which frames there
        are.

        Raises InputError with file, line (Parquet: row) and column.
        """
        found = self._parts(sequence, truth=truth)
        return Recording.from_parts(
            found,
            name=sequence,
            site=self.settings.site,
            provenance={"dataset": "table", "sequence": sequence},
        )

    def write(self, sequence: str, tracks: TrackSequence, out: Path) -> Path:
        """Write `out`/SEQUENCE.csv, or .parquet where the tables are such, and give its path."""
        found = self._parts(sequence, truth=False)
        frames = found.clock.key if found.clock.by == "frame" else np.arange(len(found.clock.key))
        if len(tracks) and tracks.frame[-1] >= len(frames):
            raise InputError(
                "tracks of a frame that the sequence does not have",
                frame=int(tracks.frame[-1]),
                expected=f"0 to {len(frames) - 1}",
            )
        self._refuse_others(tracks)
        columns = track_columns(tracks, frames, found.clock.time)
        if found.axes is not None:
            rows = np.repeat(tracks.frame, [len(step) for step in tracks])
            columns = _in_ego(columns, found.axes.take(rows))
        any_table = self._file("truth", sequence) or self._file("detections", sequence)
        assert any_table is not None
        path = prepare_folder(Path(out)) / f"{sequence}{any_table.suffix}"
        write_table(path, columns)
        return path

    def read(self, sequence: str, folder: Path) -> TrackSequence:
        """The tracks of `folder`/SEQUENCE.csv or .parquet in the world, a report a frame."""
        return self._results(sequence, folder, self._parts(sequence, truth=False))

    def submit(self, sequences: Sequence[str], folder: Path) -> Path:
        """Refused: a table is handed in nowhere."""
        raise InputError(
            "tables are of no benchmark, so there is nothing to hand in",
            file=folder,
            hint="the results are the tables that pmbm track wrote",
        )

    def compared(self, sequence: str, kind: str, folder: Path) -> ComparedSequence:
        """Truth and results of one class in the world; frames that only the results have count."""
        found = self._parts(sequence, truth=True, results=folder)
        tracks = self._results(sequence, folder, found)
        time = found.clock.time.tolist()
        truth = frames_of(GroundTruth, time, found.truth_count, found.truth)
        label = _LABELS[kind]
        compared = tuple(step.take(_rows_of(step, label)) for step in tracks)
        height = np.zeros((len(truth), 1))
        return ComparedSequence(
            truth=tuple(frame.take(_rows_of(frame, label)) for frame in truth),
            tracks=compared,
            excused=np.zeros(sum(map(len, compared)), bool),
            sensor=np.concatenate([found.pose[:, :2], height], axis=1),
        )

    def _occurring(self) -> tuple[str, ...]:
        """The labels of the classes that truth and detections have; all where they have none."""
        known = {**_LABELS, **self.settings.classes}
        found = set()
        for folder in (self.root / "truth", self.detections):
            names = [] if folder is None else table_names(Path(folder))
            for file in [table_file(Path(str(folder)), name) for name in names]:
                assert file is not None
                found |= {known.get(text) for text in texts_in(file, "class")}
        return tuple(name for name, label in _LABELS.items() if label in found) or tuple(_LABELS)

    def _classes(self) -> dict[str, Label | None]:
        """The tables' own names -> labels, None where not asked for."""
        own = {**_LABELS, **self.settings.classes}
        return {name: label if label in self.labels else None for name, label in own.items()}

    def _file(self, what: str, sequence: str) -> Path | None:
        name = safe_name(sequence, Place(self.root), "sequences")
        if what == "detections":
            return None if self.detections is None else table_file(Path(self.detections), name)
        folder = self.poses if what == "poses" else self.root / what
        assert folder is not None
        return table_file(folder, name)

    def _cells(self, path: Path, what: str) -> Cells:
        return read_table(path, what, self.settings.ignored_columns)

    def _parts(self, sequence: str, *, truth: bool, results: Path | None = None) -> Parts:
        """The columns of the sequence's tables."""
        files = {what: self._file(what, sequence) for what in ("truth", "detections", "poses")}
        if files["truth"] is None and (truth or files["detections"] is None):
            raise InputError(
                "no such table",
                file=self.root / "truth" / sequence,
                expected=f"{sequence}.csv or {sequence}.parquet",
                hint=nearest_hint(sequence, self.sequences(), "sequence"),
            )
        if self.detections is not None and files["detections"] is None:
            raise InputError(
                "no such table",
                file=Path(self.detections) / sequence,
                expected=f"{sequence}.csv or {sequence}.parquet",
            )
        if results is not None:
            files["tracks"] = self._result_file(sequence, results)
        given = {what: file for what, file in files.items() if file is not None}
        with _located(given):
            return parts(
                {what: self._cells(file, what) for what, file in given.items()},
                frame=self.settings.frame,
                classes=self._classes(),
                rate=self.settings.rate,
                frames_only=("tracks",) if truth else ("tracks", "truth"),
            )

    def _result_file(self, sequence: str, folder: Path) -> Path:
        name = safe_name(sequence, Place(Path(folder)), "sequences")
        found = table_file(Path(folder), name)
        if found is None:
            raise InputError(
                "no such table",
                file=Path(folder) / name,
                expected=f"{name}.csv or {name}.parquet",
            )
        return found

    def _results(self, sequence: str, folder: Path, found: Parts) -> TrackSequence:
        path = self._result_file(sequence, folder)
        with located(path):
            rows = track_rows(self._cells(path, "tracks"), found.clock, found.axes, self._classes())
        steps = frames_of(Tracks, found.clock.time.tolist(), rows.count, rows.columns)
        return TrackSequence(steps=steps, frame=np.arange(len(steps)))

    def _refuse_others(self, tracks: TrackSequence) -> None:
        there = {Label(label) for step in tracks for label in np.unique(step.label).tolist()}
        others = sorted(label.name.lower() for label in there if label not in self.labels)
        if others:
            raise InputError(
                "a track of a class that was not asked for",
                field="label",
                expected=list(self.classes),
                got=others,
            )


def read_settings(path: Path) -> Settings:
    """Read a `table.toml`.

    Raises InputError with file and key, and for an unknown key the nearest valid one.
    """
    try:
        document = tomllib.loads(read_text(path))
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise InputError(f"not valid TOML: {error}", file=path) from None
    _refuse_unknown(document, _KEYS, path)
    frame = document.get("frame", "world")
    if frame not in ("world", "ego"):
        raise InputError(
            "bad value", file=path, field="frame", expected='"world" or "ego"', got=frame
        )
    rate = document.get("rate", 10.0)
    if isinstance(rate, bool) or not isinstance(rate, int | float) or not 0 < rate < 1e6:
        raise InputError("bad value", file=path, field="rate", expected="frames a second", got=rate)
    ignored = document.get("ignored_columns", [])
    if not isinstance(ignored, list) or not all(isinstance(name, str) for name in ignored):
        raise InputError(
            "bad value", file=path, field="ignored_columns", expected="a list of names", got=ignored
        )
    site = _table(document, "site", path)
    _refuse_unknown(site, _SITE_KEYS, path, "site.")
    sensors = site.pop("sensors", [])
    if not isinstance(sensors, list) or not all(isinstance(one, dict) for one in sensors):
        raise InputError("bad value", file=path, field="site.sensors", expected="a list of tables")
    for one in sensors:
        _refuse_unknown(one, _SENSOR_KEYS, path, "site.sensors.")
    try:
        stands = Site(
            **site, sensors=tuple(MountedSensor(**{"name": "", **one}) for one in sensors)
        )
    except InputError as error:
        raise error.located(file=path, field=f"site.{error.field}") from None
    return Settings(
        frame=frame,
        rate=float(rate),
        ignored_columns=tuple(ignored),
        classes=_class_map(_table(document, "classes", path), path),
        site=stands,
    )


def site_document(site: Site) -> dict[str, Any]:
    """A site as `[site]` of a `table.toml` has it."""

    def plain(value: Any) -> Any:
        if isinstance(value, tuple):
            return [plain(part) for part in value]
        if isinstance(value, MountedSensor):
            return {field.name: plain(getattr(value, field.name)) for field in fields(value)}
        return value.tolist() if isinstance(value, np.ndarray) else value

    document = {field.name: plain(getattr(site, field.name)) for field in fields(Site)}
    return {name: value for name, value in document.items() if value not in (None, [])}


_KEYS: Final = ("frame", "rate", "ignored_columns", "classes", "site")
_SITE_KEYS: Final = tuple(field.name for field in fields(Site))
_SENSOR_KEYS: Final = tuple(field.name for field in fields(MountedSensor))


def _refuse_unknown(
    table: Mapping[str, Any], known: Sequence[str], path: Path, under: str = ""
) -> None:
    for key in table:
        if key not in known:
            raise InputError(
                "unknown key",
                file=path,
                field=f"{under}{key}",
                hint=nearest_hint(key, known, "key"),
            )


def _table(document: Mapping[str, Any], key: str, path: Path) -> dict[str, Any]:
    table = document.get(key, {})
    if not isinstance(table, dict):
        raise InputError("not a table", file=path, field=key, expected=f"[{key}]", got=table)
    return table


def _class_map(table: Mapping[str, Any], path: Path) -> dict[str, Label | None]:
    known: dict[str, Label | None] = {**_LABELS, _IGNORED: None}
    for name, label in table.items():
        if label not in known:
            raise InputError(
                "no such label",
                file=path,
                field=f"classes.{name}",
                got=label,
                hint=nearest_hint(label, known, "label"),
            )
    return {name: known[label] for name, label in table.items()}


@contextmanager
def _located(files: Mapping[str, Path]) -> Iterator[None]:
    """Give errors about cells the file of their table."""
    try:
        yield
    except InputError as error:
        what = error.problem.partition(":")[0]
        if error.file is not None or what not in files:
            raise
        with located(files[what]):
            raise


def _in_ego(columns: Mapping[str, NDArray[Any]], axes: Axes) -> dict[str, NDArray[Any]]:
    """Columns of tracks with places, headings and velocities in the ego's frame."""
    moved = axes.to_sensor(
        {
            "position": np.column_stack([columns[name] for name in ("x", "y", "z")]),
            "velocity": np.column_stack([columns[name] for name in ("vx", "vy")]),
            "yaw": columns["yaw"],
        }
    )
    x, y, z = moved["position"].T
    vx, vy = moved["velocity"].T
    return {**columns, "x": x, "y": y, "z": z, "yaw": moved["yaw"], "vx": vx, "vy": vy}


def _rows_of(frame: GroundTruth | Tracks, label: Label) -> IntArray:
    """The rows of one label in order of id."""
    rows = np.flatnonzero(frame.label == label)
    return rows[np.argsort(frame.id[rows])]
