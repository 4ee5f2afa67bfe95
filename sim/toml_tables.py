"""TOML files and their tables, read into dataclasses: the one place where they are judged."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

from pmbm.errors import InputError, nearest_hint
from pmbm.wording import expected_of

_T = TypeVar("_T")


def read_toml(path: Path) -> dict[str, Any]:
    """The document in a TOML file.

    Raises InputError, with the line, where it cannot be read.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"cannot read it: {error.strerror}", file=path) from error
    except (UnicodeDecodeError, RecursionError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"not TOML: {error}", file=path) from error


def validated(kind: type[_T], table: Any, *, file: object = None) -> _T:
    """A dataclass of this kind from the document or table of a file.

    Raises InputError naming file and dotted key, with the nearest valid name for an unknown key.
    """
    from pydantic import ValidationError

    form: Any = kind
    try:
        # Only the strict JSON mode takes tables for dataclasses and yet no text for numbers.
        value: _T = _adapter(form).validate_json(json.dumps(table, default=str), strict=True)
        return value
    except ValidationError as failure:
        # Unknown keys first: a mistyped key is also a missing one.
        error = min(failure.errors(), key=lambda e: e["type"] != "unexpected_keyword_argument")
    place = [str(part) for part in error["loc"] if part != "[key]"]
    cause = error.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        if cause.field:
            place.append(cause.field)
        raise cause.located(file=file, field=".".join(place))
    key = ".".join(place)
    if error["type"] == "unexpected_keyword_argument":
        valid = [f.name for f in fields(_kind_at(kind, place[:-1]))]
        raise InputError(
            "unknown key", file=file, field=key, hint=nearest_hint(place[-1], valid, "key")
        )
    if error["type"] == "missing":
        raise InputError("missing key", file=file, field=key)
    raise InputError(
        "bad value", file=file, field=key, expected=expected_of(error), got=error["input"]
    )


def toml_text(document: Mapping[str, Any], *path: str) -> str:
    """A document as TOML: plain values first, then tables; curves and lists in one line."""
    lines, tables = [], []
    for key, value in document.items():
        if isinstance(value, Mapping) and value.keys() != {"at", "value"}:
            tables.append((key, value))
        elif value is not None:
            lines.append(f"{_toml_key(key)} = {_toml_value(value)}\n")
    head = f"[{'.'.join(map(_toml_key, path))}]\n" if path and lines else ""
    parts = [head + "".join(lines), *(toml_text(table, *path, key) for key, table in tables)]
    return "\n".join(part for part in parts if part)


def _toml_key(key: str) -> str:
    plain = key and all(c.isascii() and (c.isalnum() or c in "-_") for c in key)
    return key if plain else json.dumps(key)


def _toml_value(value: Any) -> str:
    if isinstance(value, Mapping):
        inside = (f"{_toml_key(k)} = {_toml_value(v)}" for k, v in value.items())
        return "{ " + ", ".join(inside) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml_value, value)) + "]"
    # JSON's strings, numbers and booleans are TOML's.
    return json.dumps(float(value) if isinstance(value, float) else value)


def table_of(document: Mapping[str, Any], *path: str, file: object = None) -> dict[str, Any]:
    """The table at that path, empty where there is none.

    Raises InputError where something else than a table is there.
    """
    table: Any = document
    for depth, key in enumerate(path, start=1):
        table = table.get(key, {})
        if not isinstance(table, Mapping):
            raise InputError(
                "not a table",
                file=file,
                field=".".join(path[:depth]),
                expected="a table",
                got=table,
            )
    return dict(table)


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(kind)


def _kind_at(kind: Any, place: Sequence[str]) -> Any:
    """The dataclass that is expected at that place inside a dataclass."""
    for part in place:
        if is_dataclass(kind):
            kind = get_type_hints(kind)[part]
        else:
            kind = get_args(kind)[-1]
    return kind
