"""Reading other people's files: every token is checked where it is read, and what is wrong is named
with its file, line or frame, object and field."""

from __future__ import annotations

import io
import json
import math
import re
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pmbm.durable import replace_bytes
from pmbm.errors import InputError, nearest_hint

LARGEST_LENGTH: Final = 1e8
"""Metres beyond which no coordinate is believed (more than twice the Earth's girth)."""
LARGEST_SIZE: Final = 1000.0
"""Metres beyond which no object's side is believed."""
_NUMBER: Final = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
_INTEGER: Final = re.compile(r"[+-]?[0-9]{1,19}")
_INT64: Final = range(-(2**63), 2**63)


@dataclass(frozen=True)
class Place:
    """Where in a dataset a value is read: what an error about it names."""

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
            raise self.error("not a number", field=name, expected="a finite number", got=value)
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
    """The file's bytes; InputError where there are none to read."""
    try:
        return path.read_bytes()
    except OSError as error:
        what = "no such file" if isinstance(error, FileNotFoundError) else str(error.strerror)
        hint = None
        if isinstance(error, FileNotFoundError) and path.parent.is_dir():
            siblings = sorted(p.name for p in path.parent.iterdir())[:1000]
            hint = nearest_hint(path.name, siblings, "file") if len(siblings) < 50 else None
        raise InputError(what, file=path, hint=hint) from None


def read_text(path: Path) -> str:
    """The file's text, UTF-8."""
    content = read_bytes(path)
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            "not a text file", file=path, expected="UTF-8", got=f"byte {error.start}"
        ) from None


def text_rows(path: Path, separator: str | None) -> Iterator[tuple[Place, list[str]]]:
    """The file's non-blank lines as tokens, each with its place (lines count from 1)."""
    for number, line in enumerate(read_text(path).split("\n"), 1):
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
        raise place.error("not an object", field=name, expected="{...}", got=type(value).__name__)
    return value


def json_list(value: Any, place: Place, name: str | None = None) -> list[Any]:
    """`value` if it is a JSON list."""
    if not isinstance(value, list):
        raise place.error("not a list", field=name, expected="[...]", got=type(value).__name__)
    return value


def json_key(value: Mapping[str, Any], key: str, place: Place) -> Any:
    """What stands under `key`, which must be there."""
    if key not in value:
        raise place.error("a field is missing", field=key, hint=nearest_hint(key, value, "field"))
    return value[key]


def json_text(value: Any, place: Place, name: str) -> str:
    """`value` if it is a non-empty string that can be written again."""
    good = isinstance(value, str) and value != ""
    if not good or any(0xD800 <= ord(c) < 0xE000 for c in value):
        raise place.error("not a text", field=name, expected="a non-empty string", got=repr(value))
    return str(value)


def json_integer(value: Any, place: Place, name: str) -> int:
    """`value` if it is an integer of at most 64 bits; never through a float, which would round
    nanoseconds."""
    if isinstance(value, bool) or not isinstance(value, int) or value not in _INT64:
        raise place.error("not an integer", field=name, expected="an integer", got=value)
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
    """Write the whole archive or none of it; equal files give equal bytes.

    members : name in the archive -> file.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, file in members.items():
            archive.writestr(zipfile.ZipInfo(name), read_bytes(file), zipfile.ZIP_DEFLATED)
    replace_bytes(path, buffer.getvalue())


def _bounds(at_least: int | None, at_most: int | None) -> str:
    if at_most is None:
        return f"at least {at_least}"
    return f"{'-inf' if at_least is None else at_least} to {at_most}"


def is_real(value: Any) -> bool:
    """Whether a parsed value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
