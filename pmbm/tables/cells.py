"""The cells of one table, column by column, checked where they become arrays."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from pmbm.arrays import BoolArray, FloatArray, IntArray
from pmbm.errors import InputError, nearest_hint
from pmbm.tables.columns import COLUMNS, Column


@dataclass(frozen=True, eq=False)
class Cells:
    """The cells of one table as it was read.

    what : its name in `COLUMNS`.
    table : a pyarrow Table.
    """

    what: str
    table: Any

    def __post_init__(self) -> None:
        names = self.table.column_names
        known = {column.name: column for column in COLUMNS[self.what]}
        for name in names:
            if names.count(name) > 1:
                raise self.error("a column is given twice", name)
            if name not in known:
                raise self.error("unknown column", name, hint=nearest_hint(name, known, "column"))
        for column in known.values():
            if column.needed and column.name not in names:
                raise self.error("a column is missing", column.name, expected=list(known))
        if "frame" not in names and "time" not in names:
            raise self.error("a column is missing", "time", expected="time or frame")

    def __len__(self) -> int:
        return int(self.table.num_rows)

    def has(self, name: str) -> bool:
        """Whether the column is there and not all of its cells are empty."""
        return name in self.table.column_names and self.table.column(name).null_count < len(self)

    def error(self, problem: str, name: str, *rows: int, **details: Any) -> InputError:
        """An InputError that names table, column and rows."""
        return InputError(f"{self.what}: {problem}", field=name, rows=rows, **details)

    def column(self, name: str) -> Column:
        """The definition of the column."""
        return next(column for column in COLUMNS[self.what] if column.name == name)

    def numbers(self, name: str, default: float | FloatArray | None = None) -> FloatArray:
        """(R,) finite numbers within the column's bounds; where empty, the default, NaN for None.

        Raises InputError with the first row that is wrong, and for an empty cell of a needed one.
        """
        rows = len(self)
        empty = np.nan if default is None else default
        if not self.has(name):
            if self.column(name).needed and rows:
                raise self._bad(name, 0, None)
            return np.array(np.broadcast_to(np.asarray(empty, np.float64), rows))
        cells = self._cells(name)
        types = arrow_package().types
        if types.is_float16(cells.type):
            raise self.error("a column of half precision", name, expected="float32 or float64")
        if not (types.is_floating(cells.type) or types.is_integer(cells.type)):
            raise self._not_numbers(name, cells)
        values = np.asarray(cells.to_numpy(zero_copy_only=False), np.float64)
        bounds = self.column(name).bounds
        with np.errstate(invalid="ignore"):
            good = (values >= max(bounds.least, -1e300)) & (values <= min(bounds.most, 1e300))
            if bounds.above > -np.inf:
                good &= values > bounds.above
        if cells.null_count:
            missing = np.asarray(cells.is_null().to_numpy(zero_copy_only=False))
            if self.column(name).needed:
                good &= ~missing
            else:
                good |= missing
                values = np.where(missing, empty, values)
        if not good.all():
            row = int(np.argmin(good))
            raise self._bad(name, row, cells[row].as_py())
        return values

    def integers(self, name: str) -> tuple[IntArray, BoolArray]:
        """(R,) whole numbers of 64 bits, and where they are given, or 0 where they are not."""
        rows = len(self)
        if not self.has(name):
            return np.zeros(rows, np.int64), np.zeros(rows, bool)
        cells = self._cells(name)
        given = np.asarray(cells.is_valid().to_numpy(zero_copy_only=False))
        arrow = arrow_package()
        if not arrow.types.is_integer(cells.type):
            if not arrow.types.is_floating(cells.type):
                raise self._not_numbers(name, cells)
            # As programs write whole numbers that keep a table of floats.
            values = np.where(given, cells.to_numpy(zero_copy_only=False), 0.0)
            whole = (np.abs(values) < 2**53) & (values == np.round(values))
            if not whole.all():
                row = int(np.argmin(whole))
                raise self._bad(name, row, cells[row].as_py())
            return values.astype(np.int64), given
        if arrow.types.is_uint64(cells.type):
            large = np.asarray(cells.fill_null(0).to_numpy(zero_copy_only=False)) > 2**63 - 1
            if large.any():
                row = int(np.argmax(large))
                raise self._bad(name, row, cells[row].as_py())
        filled = cells.fill_null(0) if cells.null_count else cells
        return np.asarray(filled.to_numpy(zero_copy_only=False)).astype(np.int64), given

    def flags(self, name: str, default: BoolArray) -> BoolArray:
        """(R,) true or false, also as 1 or 0."""
        if not self.has(name):
            return default
        cells = self._cells(name)
        if _is_text(cells.type):
            return self._words(name, cells, default)
        if arrow_package().types.is_boolean(cells.type):
            given = np.asarray(cells.is_valid().to_numpy(zero_copy_only=False))
            values = np.asarray(cells.fill_null(False).to_numpy(zero_copy_only=False), bool)
            return np.where(given, values, default)
        numbers = self.numbers(name, default.astype(np.float64))
        wrong = (numbers != 0) & (numbers != 1)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise self._bad(name, row, cells[row].as_py())
        return numbers == 1

    def _words(self, name: str, cells: Any, default: BoolArray) -> BoolArray:
        """Flags as text files have them."""
        words = {"true": True, "false": False, "1": True, "0": False}
        values = default.copy()
        for row, word in enumerate(cells.to_pylist()):
            if word is not None:
                if word.lower() not in words:
                    raise self._bad(name, row, word)
                values[row] = words[word.lower()]
        return values

    def texts(self, name: str) -> tuple[IntArray, list[str]]:
        """(R,) place of each cell in the list of all different texts, -1 where empty; the list."""
        rows = len(self)
        if not self.has(name):
            if self.column(name).needed and rows:
                raise self._bad(name, 0, None)
            return np.full(rows, -1), []
        arrow = arrow_package()
        cells = self._cells(name)
        if arrow.types.is_floating(cells.type):
            # Ids beside empty cells, as pandas keeps them.
            whole, given = self.integers(name)
            cells = arrow.array(whole, mask=~given)
        if not arrow.types.is_dictionary(cells.type):
            if not (_is_text(cells.type) or arrow.types.is_integer(cells.type)):
                raise self._bad(name, int(np.argmax(cells.is_valid())), cells.type)
            cells = cells.dictionary_encode()
        found = [str(value) for value in cells.dictionary.to_pylist()]
        index = cells.indices.fill_null(-1).to_numpy(zero_copy_only=False).astype(np.int64)
        if self.column(name).needed and len(index) and index.min() < 0:
            raise self._bad(name, int(np.argmin(index)), None)
        return index, found

    def _cells(self, name: str) -> Any:
        """The column in one piece."""
        column = self.table.column(name)
        if arrow_package().types.is_dictionary(column.type):
            column = column.unify_dictionaries()
        whole = column.combine_chunks()
        # Older versions hand back a list of chunks where there are none.
        return whole.chunk(0) if hasattr(whole, "num_chunks") and whole.num_chunks else whole

    def _not_numbers(self, name: str, cells: Any) -> InputError:
        """The error for the first cell that is no number."""
        for row, value in enumerate(cells.to_pylist()):
            if value is not None and not _is_number(value):
                return self._bad(name, row, value)
        return self.error("not a column of numbers", name, got=str(cells.type))

    def _bad(self, name: str, row: int, got: object) -> InputError:
        column = self.column(name)
        kinds = {"number": "a number", "integer": "a whole number", "text": "a text"}
        expected = f"{kinds.get(column.kind, 'true, false, 1 or 0')}"
        if column.kind == "number":
            expected += f" {column.bounds}" + (f", {column.unit}" if column.unit else "")
        problem = "an empty cell" if got is None else "a bad cell"
        return self.error(problem, name, row, expected=expected, got=got)


def _is_text(kind: Any) -> bool:
    types = arrow_package().types
    return bool(types.is_string(kind) or types.is_large_string(kind) or types.is_string_view(kind))


def _is_number(value: object) -> bool:
    if isinstance(value, str):
        return re.fullmatch(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?", value) is not None
    return isinstance(value, int | float) and not isinstance(value, bool)


def arrow_package() -> Any:
    """pyarrow.  Raises InputError where it is not installed."""
    try:
        import pyarrow
    except ImportError:
        raise InputError(
            "tables need pyarrow", hint="install it with: pip install 'pmbm[tables]'"
        ) from None
    return pyarrow
