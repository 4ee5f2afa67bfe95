"""The store of a study: one SQLite file that survives kills, full disks and flipped bits.

One row a trial, written in one transaction each (write-ahead log, synchronous FULL).  The file has
its tables before there is a log, and takes in the log every few trials, so that the file alone is a
store.  SQLite does not notice most flipped bits, so every row carries a hash of its content: a row
whose hash does not fit is named and run again, never reported.
"""

from __future__ import annotations

import hashlib
import json
import os
import sqlite3
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pmbm.errors import InputError
from pmbm.provenance import provenance
from pmbm.study.study import Study, canonical

SCHEMA = 1
_TABLES = """
CREATE TABLE study (
  id INTEGER PRIMARY KEY CHECK (id = 0), schema INTEGER NOT NULL, hash TEXT NOT NULL,
  document TEXT NOT NULL, about TEXT NOT NULL
);
CREATE TABLE trial (
  id INTEGER PRIMARY KEY, outcome TEXT NOT NULL, result TEXT NOT NULL, time TEXT NOT NULL,
  note TEXT NOT NULL, hash TEXT NOT NULL
);
CREATE TABLE in_flight (id INTEGER PRIMARY KEY, deaths INTEGER NOT NULL)
"""
_CHECKPOINT_EVERY = 8
"""Trials after which the file takes in the log."""


@dataclass(frozen=True)
class StoreRow:
    """The stored row of one trial.

    outcome : "ok"; "tracker raised", with the results of the other trackers; or how it failed as a
        whole: "raised", "timeout", "memory" or "died".
    result : canonical JSON, a pure function of (study hash, index).
    time : JSON of what was measured with a clock; part of no digest.
    note : for people, for example a traceback; part of no digest.
    """

    index: int
    outcome: str
    result: str
    time: str = "{}"
    note: str = ""

    def hash(self, study: str) -> str:
        parts = (study, str(self.index), self.outcome, self.result, self.time, self.note)
        return hashlib.sha256("\x1f".join(parts).encode()).hexdigest()


@dataclass(frozen=True)
class Contents:
    """The contents of a store.

    about : name, trials and provenance of the study, as it was last run.
    rows : those whose hash fits, by index.
    damaged : indices of those whose hash does not.
    """

    hash: str
    document: Mapping[str, Any]
    about: Mapping[str, Any]
    rows: Mapping[int, StoreRow]
    damaged: tuple[int, ...]

    def digest(self) -> str:
        """One hash of all results: equal where they are equal, in whatever order, by however many
        processes and in however many attempts they were computed.

        Raises InputError where rows are damaged.
        """
        if self.damaged:
            raise InputError(
                "damaged rows have no digest",
                rows=self.damaged,
                hint="run the study again: it computes them anew",
            )
        hasher = hashlib.sha256()
        for index in sorted(self.rows):
            row = self.rows[index]
            hasher.update(f"{index}\x1f{row.outcome}\x1f{row.result}\x1e".encode())
        return hasher.hexdigest()


class Store:
    """A study's store as its one driver holds it; others may read meanwhile."""

    def __init__(self, connection: sqlite3.Connection, file: Path, study: Study) -> None:
        self._connection = connection
        self._file = file
        self._study = study
        self._identity = _identity(file)
        self._finished = 0

    @property
    def contents(self) -> Contents:
        with _named(self._file):
            return _contents(self._connection, self._file)

    def forget(self, indices: Iterable[int]) -> None:
        """Remove rows, so that they are run again."""
        with self._transaction():
            for index in indices:
                self._run("DELETE FROM trial WHERE id = ?", (index,))

    def start(self, indices: Iterable[int]) -> None:
        """Note which trials are in flight, before they are."""
        with self._transaction():
            self._note(indices)

    def finish(self, row: StoreRow, start: Iterable[int] = ()) -> None:
        """Keep a result, and note which trials are in flight in its place."""
        with self._transaction():
            self._run(
                "INSERT INTO trial VALUES (?, ?, ?, ?, ?, ?)",
                (
                    row.index,
                    row.outcome,
                    row.result,
                    row.time,
                    row.note,
                    row.hash(self._study.hash),
                ),
            )
            self._run("DELETE FROM in_flight WHERE id = ?", (row.index,))
            self._note(start)
        self._finished += 1
        if self._finished % _CHECKPOINT_EVERY == 0:
            self._run("PRAGMA wal_checkpoint")
        self._check_unmoved()

    def died(self, index: int) -> int:
        """Note that a trial, alone in its process, took the process with it; how often by now."""
        with self._transaction():
            self._run("UPDATE in_flight SET deaths = deaths + 1 WHERE id = ?", (index,))
        return dict(self.in_flight())[index]

    def land(self) -> None:
        """Note that nothing is in flight: the driver stops in order."""
        with self._transaction():
            self._run("DELETE FROM in_flight")
        self._check_unmoved()

    def in_flight(self) -> list[tuple[int, int]]:
        """Trials that were in flight when the last driver died, and their deaths alone."""
        found = self._run("SELECT id, deaths FROM in_flight ORDER BY id")
        return [(int(index), int(deaths)) for index, deaths in found]

    def _check_unmoved(self) -> None:
        """Raise InputError where the file is no longer where it was: closing would leave the last
        trials in a log that nothing finds again."""
        if _identity(self._file) == self._identity:
            return
        log = _log(self._file)
        busy, *_ = self._run("PRAGMA wal_checkpoint(TRUNCATE)")[0]
        if busy:
            hint = f"move {log} too, to the store's new name with -wal, and resume with --store"
        else:
            hint = f"it holds what is done: resume with --store; {log} is empty and may go"
        raise InputError(
            "the store was moved or deleted while the study runs", file=self._file, hint=hint
        )

    def _note(self, indices: Iterable[int]) -> None:
        for index in indices:
            self._run("INSERT OR IGNORE INTO in_flight VALUES (?, 0)", (index,))

    @contextmanager
    def _transaction(self) -> Iterator[None]:
        self._run("BEGIN IMMEDIATE")
        try:
            yield
            self._run("COMMIT")
        except BaseException:
            if self._connection.in_transaction:
                self._connection.execute("ROLLBACK")
            raise

    def _run(self, sql: str, values: tuple[Any, ...] = ()) -> list[Any]:
        with _named(self._file, "what is stored is safe: make room and run the same command again"):
            return execute(self._connection, sql, values)


@contextmanager
def open_store(file: Path, study: Study) -> Iterator[Store]:
    """The store of a study, made where there is none, for the one driver that runs it.

    Raises InputError where another driver holds it, where it belongs to another study or another
    version of the code, and where it cannot be read or written.
    """
    with _only_driver(file):
        log = _log(file)
        if _identity(file) is None and log.exists() and log.stat().st_size:
            raise InputError(
                "the store is gone, and its last trials are here without it",
                file=log,
                hint=f"move the store back to {file}, or remove this file to begin anew",
            )
        with _named(file):
            connection = sqlite3.connect(file, isolation_level=None)
        try:
            with _named(file, "take another --store, or remove it"):
                execute(connection, "PRAGMA synchronous = FULL")
                _prepare(connection, file, study)
                execute(connection, "PRAGMA journal_mode = WAL")
            yield Store(connection, file, study)
        finally:
            connection.close()


def read_store(file: Path) -> Contents:
    """Read a store, also while a study runs into it.

    Raises InputError where it is none or damaged beyond its rows.
    """
    if not file.is_file():
        raise InputError("no such store", file=file)
    with _named(file):
        connection = _reader(file)
        try:
            return _contents(connection, file)
        finally:
            connection.close()


def execute(connection: sqlite3.Connection, sql: str, values: tuple[Any, ...] = ()) -> list[Any]:
    """The one door to the database."""
    return connection.execute(sql, values).fetchall()


def _reader(file: Path) -> sqlite3.Connection:
    address = f"file:{_quoted(file)}?mode=ro"
    connection = sqlite3.connect(address, uri=True, isolation_level=None)
    try:
        execute(connection, "SELECT 1 FROM sqlite_master")
    except sqlite3.Error as error:
        connection.close()
        # In a folder that cannot be written to, SQLite reads only what it is told nobody writes.
        log = _log(file)
        if not isinstance(error, sqlite3.OperationalError) or (log.exists() and log.stat().st_size):
            raise
        connection = sqlite3.connect(f"{address}&immutable=1", uri=True, isolation_level=None)
    return connection


def _log(file: Path) -> Path:
    """The file in which SQLite keeps what the store has not taken in yet."""
    return Path(f"{file}-wal")


def _identity(file: Path) -> tuple[int, int] | None:
    """The identity of the file that is there, or None where there is none."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return None
    return found.st_dev, found.st_ino


def _quoted(file: Path) -> str:
    from urllib.parse import quote

    return quote(str(file.resolve()))


def _prepare(connection: sqlite3.Connection, file: Path, study: Study) -> None:
    about = canonical({"name": study.name, "trials": study.trials, "provenance": provenance()})
    if not execute(connection, "SELECT 1 FROM sqlite_master"):
        if file.stat().st_size:
            raise _without_tables(file)
        execute(connection, "BEGIN IMMEDIATE")
        for statement in _TABLES.split(";"):
            execute(connection, statement)
        values = (SCHEMA, study.hash, canonical(study.document), about)
        execute(connection, "INSERT INTO study VALUES (0, ?, ?, ?, ?)", values)
        execute(connection, "COMMIT")
        return
    known_hash, document, _ = _head(connection, file)
    if known_hash != study.hash:
        where = _first_difference(document, json.loads(canonical(study.document)))
        raise InputError(
            f"the store belongs to another study: {where} differs",
            file=file,
            hint="take another --store"
            + (", or the code it was begun with" if where.startswith("code") else ""),
        )
    execute(connection, "UPDATE study SET about = ?", (about,))


def _without_tables(file: Path) -> InputError:
    return InputError(
        "there are no tables in it",
        file=file,
        hint=f"a copy lacks what is in the original's -wal: copy that too, to {_log(file)}",
    )


def _head(connection: sqlite3.Connection, file: Path) -> tuple[str, dict[str, Any], dict[str, Any]]:
    if not execute(connection, "SELECT 1 FROM sqlite_master"):
        raise _without_tables(file)
    found = execute(connection, "SELECT schema, hash, document, about FROM study")
    if len(found) != 1 or found[0][0] != SCHEMA:
        raise InputError("not a store of this version", file=file)
    _, known_hash, text, about = found[0]
    try:
        document = json.loads(text)
        whole = hashlib.sha256(canonical(document).encode()).hexdigest() == known_hash
        return_about = json.loads(about)
    except ValueError:
        whole = False
    if not whole:
        raise InputError("the store's head is damaged", file=file, hint="take another --store")
    return known_hash, document, return_about


def _contents(connection: sqlite3.Connection, file: Path) -> Contents:
    known_hash, document, about = _head(connection, file)
    rows, damaged = {}, []
    for *values, row_hash in execute(connection, "SELECT * FROM trial ORDER BY id"):
        try:
            row = StoreRow(int(values[0]), *map(_text, values[1:]))
            whole = row.hash(known_hash) == row_hash
        except (TypeError, ValueError):
            whole = False
        if whole:
            rows[row.index] = row
        else:
            damaged.append(int(values[0]))
    return Contents(known_hash, document, about, rows, tuple(damaged))


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise TypeError
    return value


def _first_difference(old: Any, new: Any, place: str = "") -> str:
    """The dotted key of the first value in which two documents differ."""
    if isinstance(old, dict) and isinstance(new, dict):
        for key in sorted(old.keys() | new.keys()):
            if old.get(key) != new.get(key):
                inner = f"{place}.{key}" if place else str(key)
                return _first_difference(old.get(key), new.get(key), inner)
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for number, (one, other) in enumerate(zip(old, new, strict=True)):
            if one != other:
                return _first_difference(one, other, f"{place}[{number}]")
    return place


if sys.platform == "win32":
    import msvcrt

    def _lock(descriptor: int) -> None:
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(descriptor: int) -> None:
        """Lock a file that no other process has locked; OSError where one has."""
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def _only_driver(file: Path) -> Iterator[None]:
    """Hold the lock beside a store; the kernel lets go of it when the driver dies."""
    try:
        descriptor = os.open(f"{file}.lock", os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise InputError(f"cannot write a store there: {error.strerror}", file=file) from error
    try:
        try:
            _lock(descriptor)
        except OSError as error:
            raise InputError(
                "another driver is running this study",
                file=file,
                hint="wait for it, or take another --store",
            ) from error
        yield
    finally:
        os.close(descriptor)


@contextmanager
def _named(file: Path, hint: str | None = None) -> Iterator[None]:
    """Turn what SQLite refuses into one line."""
    try:
        yield
    except (sqlite3.Error, UnicodeDecodeError) as error:
        raise InputError(f"the store fails: {error}", file=file, hint=hint) from error
