"""Feather and Parquet files, read column by column and checked (extras `argoverse2`, `waymo`)."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Any

from pmbm.datasets.files import LARGEST_LENGTH, Place, read_bytes
from pmbm.durable import replace_bytes
from pmbm.errors import InputError, Verbatim, nearest_hint


@dataclass(frozen=True)
class Columns:
    """A table's columns as lists; what is null is None."""

    file: Path
    values: Mapping[str, list[Any]]
    length: int
    note: Mapping[str, Any]

    def rows(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Row number and row."""
        for row in range(self.length):
            yield row, {name: values[row] for name, values in self.values.items()}


def read_columns(
    path: Path, needed: Sequence[str], *, parquet: bool, optional: Sequence[str] = ()
) -> Columns:
    """The needed columns and those optional ones that there are.

    Raises InputError where the file is no such table, lacks a column, or has one of half precision,
    which cannot hold a place to better than metres.
    """
    arrow = _arrow()
    content = read_bytes(path)
    try:
        if parquet:
            import pyarrow.parquet

            table = pyarrow.parquet.read_table(BytesIO(content))
        else:
            import pyarrow.feather

            table = pyarrow.feather.read_table(BytesIO(content))
        # Buffers that point outside themselves are found here, before anything reads them.
        table.validate(full=True)
        names = table.column_names
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError("a column is given twice", file=path, field=twice)
        wanted = [name for name in (*needed, *optional) if name in names]
        for name in wanted:
            if arrow.types.is_float16(table.schema.field(name).type):
                raise InputError(
                    "a column of half precision",
                    file=path,
                    field=name,
                    expected="float32 or float64",
                    got=Verbatim("float16"),
                )
        values = {name: table.column(name).to_pylist() for name in wanted}
        note = _note(table.schema.metadata or {})
    except InputError:
        raise
    except (arrow.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        what = " ".join(str(error).split())[:200]
        raise InputError(f"not a readable table: {what}", file=path) from None
    for name in needed:
        if name not in values:
            raise InputError(
                "a column is missing", file=path, field=name, hint=nearest_hint(name, names)
            )
    return Columns(path, values, table.num_rows, note)


def write_columns(
    path: Path, columns: Mapping[str, Sequence[Any]], note: Mapping[str, Any]
) -> None:
    """A feather file with these columns, and a note that comes back with them."""
    arrow = _arrow()
    import pyarrow.feather

    table = arrow.table({name: arrow.array(values) for name, values in columns.items()})
    table = table.replace_schema_metadata({b"pmbm": json.dumps(note).encode()})
    buffer = BytesIO()
    pyarrow.feather.write_feather(table, buffer, compression="uncompressed")
    replace_bytes(path, buffer.getvalue())


def numbers(
    row: Mapping[str, Any],
    names: Sequence[str],
    place: Place,
    *,
    above: float | None = None,
    within: float = LARGEST_LENGTH,
) -> list[float]:
    """Finite numbers of a row."""
    return [place.finite(row[name], name, above=above, within=within) for name in names]


def _note(metadata: Mapping[bytes, bytes]) -> Mapping[str, Any]:
    try:
        note = json.loads(metadata.get(b"pmbm", b"{}"))
    except (ValueError, RecursionError):
        return {}
    return note if isinstance(note, dict) else {}


def _arrow() -> Any:
    try:
        import pyarrow
    except ImportError:
        raise InputError(
            "this dataset needs pyarrow",
            hint="pip install pyarrow; pmbm[argoverse2] and pmbm[waymo] bring it",
        ) from None
    return pyarrow


def int_list(value: Any) -> tuple[int, ...] | None:
    """A list of integers from a note, or None."""
    if isinstance(value, list) and all(type(item) is int for item in value):
        return tuple(value)
    return None
