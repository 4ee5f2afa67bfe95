"""Reading other people's files: every token is checked where it is read, and what is wrong is named
with its file, line or frame, object and field."""

from __future__ import annotations

import io
import json
import re
import warnings
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

from pmbm.durable import replace_bytes
from pmbm.errors import NOT_YET_CONFIRMED, InputError, InputWarning, Verbatim, nearest_hint

LARGEST_LENGTH: Final = 1e8
"""Metres beyond which no coordinate is believed (more than twice the Earth's girth)."""
LARGEST_SIZE: Final = 1000.0
"""Metres beyond which no object's side is believed."""
_NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_INTEGER: Final = re.compile(r"[+-]?[0-9]{1,19}")
_INT64: Final = range(-(2**63), 2**63)
_EXACT: Final = 2**53
"""The integers up to which a double tells neighbours apart."""
_LARGEST_MEMBER: Final = 2**30
"""Bytes beyond which no file inside an archive is unpacked."""


@dataclass(frozen=True)
class Place:
    """The place in a dataset's files that an error about a value names."""

    file: Path
    frame: object = None
    object_id: object = None
    rows: tuple[int, ...] = ()

    def error(self, problem: str, **details: Any) -> InputError:
        """An `InputError` that says where."""
        where = {"file": self.file, "frame": self.frame, "object_id": self.object_id}
        return InputError(problem, **{**where, "rows": self.rows, **details})

    def integer(
        self, token: str, name: str, *, at_least: int | None = None, at_most: int | None = None
    ) -> int:
        """A decimal integer of at most 64 bits."""
        value = int(token) if _INTEGER.fullmatch(token) else None
        if value is None or value not in _INT64:
            raise self.error("not an integer", field=name, expected="an integer", got=token)
        if (at_least is not None and value < at_least) or (at_most is not None and value > at_most):
            raise self.error(
                "an integer out of range",
                field=name,
                expected=_bounds(at_least, at_most),
                got=token,
            )
        return value

    def whole(
        self, token: str, name: str, *, at_least: int | None = None, at_most: int | None = None
    ) -> int:
        """An integer, also as a decimal number without a fraction (`3.0`), which is how programs
        write it that keep a table of floats."""
        if _NUMBER.fullmatch(token) and not _INTEGER.fullmatch(token):
            value = float(token)
            if value.is_integer() and abs(value) < _EXACT:
                token = str(int(value))
        return self.integer(token, name, at_least=at_least, at_most=at_most)

    def number(
        self,
        token: str,
        name: str,
        *,
        above: float | None = None,
        within: float = LARGEST_LENGTH,
    ) -> float:
        """A finite decimal number of magnitude at most `within`."""
        if not _NUMBER.fullmatch(token):
            raise self.error("not a number", field=name, expected="a finite number", got=token)
        return self.finite(float(token), name, above=above, within=within)

    def finite(
        self,
        value: Any,
        name: str,
        *,
        above: float | None = None,
        within: float = LARGEST_LENGTH,
    ) -> float:
        """The same check of a number that has been parsed already."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self.error(
                "not a number", field=name, expected="a finite number", got=as_read(value)
            )
        if not abs(value) <= within or (above is not None and value <= above):
            floor = "" if above is None else f"above {above:g} and "
            raise self.error(
                "a number out of range",
                field=name,
                expected=f"{floor}of magnitude at most {within:g}",
                got=value,
            )
        return float(value)


def read_bytes(path: Path) -> bytes:
    """The file's bytes, which may lie in a zip archive (`results.zip/0000.txt`); InputError where
    there are none to read."""
    try:
        return path.read_bytes()
    except OSError as error:
        if _is_in_a_file(path):
            return _unpacked(path)
        raise unreadable(path, error) from None


def unreadable(path: Path, error: OSError) -> InputError:
    """The error for a file that the system does not read: where it is missing, with the folder that
    is missing or the nearest name in it."""
    if not isinstance(error, FileNotFoundError):
        return InputError(str(error.strerror), file=path)
    missing = [folder for folder in path.parents if not folder.exists()]
    if missing:
        return InputError("no such folder", file=missing[-1])
    siblings = sorted(p.name for p in path.parent.iterdir())[:1000]
    hint = nearest_hint(path.name, siblings, "file") if 0 < len(siblings) < 50 else None
    return InputError("no such file", file=path, hint=hint)


def files_in(folder: Path, pattern: str) -> list[Path]:
    """The files of a folder, which may lie in a zip archive, whose names fit, in order of name."""
    if folder.is_dir():
        return sorted(folder.glob(pattern))
    if not _is_in_a_file(folder / pattern):
        return []
    archive, inside = _archive(folder / pattern)
    start = inside.removesuffix(pattern)
    names = [name.removeprefix(start) for name in archive.namelist() if name.startswith(start)]
    return sorted(folder / name for name in names if Path(name).match(pattern) and "/" not in name)


def _is_in_a_file(path: Path) -> bool:
    return any(parent.is_file() for parent in path.parents)


def _unpacked(path: Path) -> bytes:
    archive, inside = _archive(path)
    if inside not in archive.namelist():
        raise InputError("no such file in the archive", file=path)
    if archive.getinfo(inside).file_size > _LARGEST_MEMBER:
        raise InputError(
            "too large a file in an archive", file=path, expected=f"{_LARGEST_MEMBER} bytes"
        )
    try:
        return archive.read(inside)
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError) as error:
        raise InputError(f"not a readable archive: {error}", file=path) from None


def _archive(path: Path) -> tuple[zipfile.ZipFile, str]:
    """The archive that is a parent of `path`, and the path's name in it."""
    file = next(parent for parent in path.parents if parent.is_file())
    state = file.stat()
    return _opened(file, state.st_mtime_ns, state.st_size), path.relative_to(file).as_posix()


@lru_cache(maxsize=1)
def _opened(file: Path, _changed: int, _size: int) -> zipfile.ZipFile:
    try:
        archive = zipfile.ZipFile(file)
    except (zipfile.BadZipFile, OSError, ValueError) as error:
        raise InputError(f"not a folder or a zip archive: {error}", file=file) from None
    names = archive.namelist()
    if len(set(names)) < len(names):
        raise InputError("an archive with two files of one name", file=file)
    return archive


def result_file(results: Path, name: str, sequences: Callable[[], Iterable[str]]) -> Path:
    """Where the results of a sequence stand: `results` itself where it is a file; in a folder the
    file of that name, or, where no file there is named after a sequence, the only one of its kind,
    which then holds those of all."""
    own = results / name
    if results.is_file():
        return results
    if own.exists():
        return own
    there = files_in(results, f"*{own.suffix}")
    named = {f"{sequence}{own.suffix}" for sequence in sequences()} if len(there) == 1 else ()
    return own if len(there) != 1 or there[0].name in named else there[0]


def read_text(path: Path) -> str:
    """The file's text, UTF-8, without the mark that some editors put before it."""
    content = read_bytes(path)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            "not a text file", file=path, expected="UTF-8", got=f"byte {error.start}"
        ) from None


def text_rows(path: Path, separator: str | None) -> Iterator[tuple[Place, list[str]]]:
    """The file's non-blank lines as tokens, each with its place (lines count from 1).

    Warns where the last line is not ended: a table of lines does not show what it was cut by."""
    text = read_text(path)
    if text and not text.endswith("\n"):
        warnings.warn(
            InputWarning(f"no line end at the end of the file: it may be cut short (file {path})"),
            stacklevel=2,
        )
    for number, line in enumerate(text.split("\n"), 1):
        if line.strip():
            tokens = [token.strip() for token in line.strip().split(separator)]
            yield Place(path, rows=(number,)), tokens


def read_json(path: Path) -> Any:
    """The file's JSON value.  Refused: repeated keys, which JSON leaves undefined; nesting deeper
    than the parser goes.  NaN and Infinity, which Python's JSON knows, are left to the fields."""
    text = read_text(path)
    try:
        return json.loads(text, object_pairs_hook=lambda pairs: _object(pairs, path))
    except RecursionError:
        raise InputError("nested too deeply", file=path) from None
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"not valid JSON: {error}", file=path) from None


def _object(pairs: list[tuple[str, Any]], path: Path) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise InputError("a key is given twice", file=path, field=twice)
    return value


def json_object(value: Any, place: Place, name: str | None = None) -> Mapping[str, Any]:
    """`value` if it is a JSON object."""
    if not isinstance(value, dict):
        raise place.error("not an object", field=name, expected="{...}", got=as_read(value))
    return value


def json_list(value: Any, place: Place, name: str | None = None) -> list[Any]:
    """`value` if it is a JSON list."""
    if not isinstance(value, list):
        raise place.error("not a list", field=name, expected="[...]", got=as_read(value))
    return value


def json_key(value: Mapping[str, Any], key: str, place: Place) -> Any:
    """The value under `key`, which must be there."""
    if key not in value:
        raise place.error("a field is missing", field=key, hint=nearest_hint(key, value, "field"))
    return value[key]


def as_read(value: Any) -> Any:
    """A value that is not of the type it should be, for an error's `got`: as its file writes it,
    `true` and `null` and not `True` and nothing."""
    if isinstance(value, list | dict):
        return Verbatim("a list" if isinstance(value, list) else "an object")
    known = value is None or isinstance(value, str | bool | int | float)
    if not known or (isinstance(value, str) and value):
        return value
    return Verbatim(json.dumps(value))


def text_value(value: Any, place: Place, name: str) -> str:
    """`value` if it is a non-empty string that can be written again."""
    good = isinstance(value, str) and value != ""
    if not good or any(0xD800 <= ord(c) < 0xE000 for c in value):
        raise place.error(
            "not a text", field=name, expected="a non-empty string", got=as_read(value)
        )
    return str(value)


def id_value(value: Any, place: Place, name: str) -> str:
    """An object's id: a non-empty string, or an integer, which stands for its digits.  A negative
    one is refused: trackers give it to what they are not sure of yet."""
    if isinstance(value, int) and not isinstance(value, bool):
        if value < 0:
            raise place.error(
                "not an id",
                field=name,
                expected="a non-empty string or an integer of at least 0",
                got=value,
                hint=NOT_YET_CONFIRMED,
            )
        return str(value)
    return text_value(value, place, name)


def integer_value(value: Any, place: Place, name: str) -> int:
    """`value` if it is an integer of at most 64 bits; never through a float, which would round
    nanoseconds."""
    if isinstance(value, bool) or not isinstance(value, int) or value not in _INT64:
        raise place.error("not an integer", field=name, expected="an integer", got=as_read(value))
    return value


def json_vector(
    value: Any,
    place: Place,
    name: str,
    length: int,
    *,
    above: float | None = None,
    within: float = LARGEST_LENGTH,
) -> list[float]:
    """A list of `length` finite numbers."""
    items = json_list(value, place, name)
    if len(items) != length:
        raise place.error("a list of the wrong length", field=name, expected=length, got=len(items))
    return [place.finite(item, name, above=above, within=within) for item in items]


def safe_name(name: str, place: Place, field: str) -> str:
    """`name` if it can be a file's or folder's name and nothing else."""
    if name in (".", "..") or not re.fullmatch(r"[A-Za-z0-9._\-]{1,200}", name):
        raise place.error(
            "not a plain name",
            field=field,
            expected="letters, digits, '.', '_' and '-'",
            got=name,
        )
    return name


def prepare_folder(path: Path) -> Path:
    """The folder, made where it is missing; InputError where it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot make the folder: {error.strerror}", file=path) from None
    return path


def write_zip(path: Path, members: Mapping[str, Path]) -> None:
    """Write the whole archive of text files or none of it; equal texts give equal bytes.

    members : name in the archive -> file.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, file in members.items():
            archive.writestr(zipfile.ZipInfo(name), read_text(file), zipfile.ZIP_DEFLATED)
    replace_bytes(path, buffer.getvalue())


def _bounds(at_least: int | None, at_most: int | None) -> str:
    if at_most is None:
        return f"at least {at_least}"
    return f"{'-inf' if at_least is None else at_least} to {at_most}"
