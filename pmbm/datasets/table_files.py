"""CSV and Parquet files of boxes, in and out (extra `tables`)."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Literal

from numpy.typing import NDArray

from pmbm.datasets.files import read_bytes
from pmbm.durable import replace_bytes
from pmbm.errors import InputError, InputWarning
from pmbm.tables.cells import Cells, arrow_package
from pmbm.tables.columns import COLUMNS

Format = Literal["csv", "parquet"]
FORMATS: Final[tuple[Format, ...]] = ("csv", "parquet")


def table_file(folder: Path, name: str) -> Path | None:
    """The file of a sequence's table, None where there is none; InputError where there are two."""
    found = [path for form in FORMATS if (path := folder / f"{name}.{form}").is_file()]
    if len(found) > 1:
        raise InputError("two tables of one sequence", file=found[0], got=found[1].name)
    return found[0] if found else None


def table_names(folder: Path) -> list[str]:
    """The sequences that have a table in a folder."""
    return sorted({path.stem for form in FORMATS for path in folder.glob(f"*.{form}")})


def read_table(path: Path, what: str, ignored: Sequence[str] = ()) -> Cells:
    """A table of that kind, but for the columns that are ignored.

    Raises InputError where the file cannot be read or its columns are not the table's; rows in
    messages are lines of a CSV file, and of a Parquet file count from 0.
    """
    parquet = path.suffix == ".parquet"
    table = _read_parquet(path) if parquet else _read_csv(path, read_bytes(path), what)
    names = [name for name in table.column_names if name not in ignored]
    with located(path):
        return Cells(what, table.select(names) if len(names) < table.num_columns else table)


def texts_in(path: Path, name: str) -> list[str]:
    """The different texts of one column, nothing of the others read, or none without the column."""
    arrow = arrow_package()
    content = read_bytes(path)
    try:
        if path.suffix == ".parquet":
            import pyarrow.parquet

            file = pyarrow.parquet.ParquetFile(arrow.BufferReader(content))
            table = file.read([name]) if name in file.schema_arrow.names else None
        else:
            import pyarrow.csv

            options = pyarrow.csv.ConvertOptions(
                include_columns=[name],
                include_missing_columns=True,
                column_types={name: arrow.string()},
                null_values=[""],
                strings_can_be_null=True,
            )
            table = pyarrow.csv.read_csv(arrow.BufferReader(content), convert_options=options)
    except (arrow.ArrowException, OSError, ValueError, OverflowError, MemoryError):
        # What is wrong is said where the whole table is read.
        return []
    if table is None:
        return []
    return [str(text) for text in table.column(0).unique().to_pylist() if text is not None]


def write_table(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write a table; what is read of it has the same bits."""
    arrow = arrow_package()
    # NaN is no value of any column.
    table = arrow.table({name: arrow.array(v, from_pandas=True) for name, v in columns.items()})
    buffer = BytesIO()
    if path.suffix == ".parquet":
        import pyarrow.parquet

        pyarrow.parquet.write_table(table, buffer)
    else:
        import pyarrow.csv

        buffer.write(",".join(table.column_names).encode() + b"\n")
        options = pyarrow.csv.WriteOptions(
            include_header=False, quoting_style=_quoting(path, table)
        )
        pyarrow.csv.write_csv(table, buffer, options)
    replace_bytes(path, buffer.getvalue())


def _quoting(path: Path, table: Any) -> Literal["needed", "none"]:
    """Texts are quoted where one of them has to be; InputError for a line break, which readers of
    CSV take for the end of a row."""
    arrow = arrow_package()
    style: Literal["needed", "none"] = "none"
    for name in table.column_names:
        if not arrow.types.is_string(table.schema.field(name).type):
            continue
        texts = {text for text in table.column(name).unique().to_pylist() if text is not None}
        if any(set(text) & set("\r\n") for text in texts):
            raise InputError(
                "a text with a line break", file=path, field=name, hint="write Parquet"
            )
        if any(not text or set(text) & set(',"') for text in texts):
            style = "needed"
    return style


@contextmanager
def located(path: Path) -> Any:
    """Give errors about a table's cells the file, and rows of a CSV file as its lines."""
    try:
        yield
    except InputError as error:
        if error.file is not None:
            raise
        rows = error.rows
        if rows and path.suffix != ".parquet":
            lines = _lines(read_bytes(path))
            rows = tuple(lines[row + 1] for row in rows)
        raise error.located(file=path, rows=rows) from None


def _lines(content: bytes) -> list[int]:
    """The line numbers, from 1, of the header and the rows: blank lines are none."""
    return [n for n, line in enumerate(content.splitlines(), 1) if line.strip(b"\r\n")]


def _read_parquet(path: Path) -> Any:
    arrow = arrow_package()
    import pyarrow.parquet

    try:
        # By its bytes, so that nothing is taken from the path: folders such as "class=car".
        with arrow.memory_map(str(path)) as content, pyarrow.parquet.ParquetFile(content) as file:
            table = file.read()
        # Buffers that point outside themselves are found here, before anything reads them.
        table.validate(full=True)
    except (arrow.ArrowException, OSError, ValueError, OverflowError, MemoryError) as error:
        raise _unreadable(path, error) from None
    return table


def _read_csv(path: Path, content: bytes, what: str) -> Any:
    arrow = arrow_package()
    import pyarrow.csv

    if not content.strip():
        raise InputError("an empty file", file=path, expected="a line of column names")
    if not content.endswith((b"\n", b"\r")):
        text = f"no line end at the end of the file: it may be cut short (file {path})"
        warnings.warn(InputWarning(text), stacklevel=2)
    _refuse_other_text(path, content)
    words = arrow.dictionary(arrow.int32(), arrow.string())
    kinds = {
        "number": arrow.float64(),
        "integer": arrow.int64(),
        "flag": arrow.string(),
        "text": words,
    }
    types = {column.name: kinds[column.kind] for column in COLUMNS[what]}
    while True:
        options = pyarrow.csv.ConvertOptions(
            column_types=types,
            null_values=[""],
            strings_can_be_null=True,
            quoted_strings_can_be_null=False,
        )
        try:
            return pyarrow.csv.read_csv(arrow.BufferReader(content), convert_options=options)
        except (arrow.ArrowException, ValueError, OverflowError, MemoryError) as error:
            _refuse_ragged(path, content)
            # A column that is not as it should be is read as it is, and judged cell by cell.
            place = re.search(r"In CSV column #(\d+):", str(error))
            name = None if place is None else _header(content)[int(place[1])]
            if types.get(str(name)) not in (arrow.float64(), arrow.int64()):
                raise _unreadable(path, error) from None
            wider = types[str(name)] == arrow.int64()
            types[str(name)] = arrow.float64() if wider else arrow.string()


def _refuse_other_text(path: Path, content: bytes) -> None:
    """Raise InputError for a text that is not in UTF-8, or has other separators than commas."""
    try:
        content.decode("utf-8")
    except UnicodeDecodeError as error:
        row = content.count(b"\n", 0, error.start) + 1
        raise InputError(
            "not a text in UTF-8", file=path, rows=(row,), got=f"byte 0x{content[error.start]:02x}"
        ) from None
    names = _header(content)
    other = next((mark for mark in ";\t|" if len(names) == 1 and mark in names[0]), None)
    if other is not None:
        raise InputError("columns not set apart by commas", file=path, expected="','", got=other)


def _header(content: bytes) -> list[str]:
    return _fields(next(line for line in content.splitlines() if line.strip()))


def _fields(line: bytes) -> list[str]:
    import csv

    return next(csv.reader([line.decode("utf-8-sig", "replace")]))


def _refuse_ragged(path: Path, content: bytes) -> None:
    """Raise InputError for the first line that has more or fewer cells than there are columns."""
    lines, expected = content.splitlines(), len(_header(content))
    for number in _lines(content):
        found = len(_fields(lines[number - 1]))
        if found != expected:
            raise InputError(
                "a line with another number of cells",
                file=path,
                rows=(number,),
                expected=f"{expected}, as there are columns",
                got=found,
            )


def _unreadable(path: Path, error: Exception) -> InputError:
    text = " ".join(str(error).split())[:200]
    return InputError(f"not a readable table: {text}", file=path)
