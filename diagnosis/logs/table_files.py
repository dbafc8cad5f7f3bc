"""Parquet and CSV files of the format read as numbers (`diagnosis.logs.columns`).

Rows are counted from 1 in all messages, a CSV file's header not included.
"""

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from jaxtyping import Float64

from diagnosis.logs.columns import LogError, check_names, one_line, read_header

Columns = dict[str, Float64[np.ndarray, " _rows"]]
"""Column -> its numbers, NaN where a cell is empty; one length for all columns of one dict."""


def read_columns(path: Path) -> Columns:
    """The known columns of a Parquet or CSV file, as they stand there.

    Raises:
        LogError: The file is truncated or not what its name says, columns are missing, or a column
            holds something other than numbers. The message does not name the file.
    """
    try:
        table = _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_csv(path)
    except OSError as error:
        raise LogError(f"the file cannot be read: {one_line(error)}.") from error
    return {name: _numbers(name, table.column(name)) for name in table.column_names}


def _read_parquet(path: Path) -> pa.Table:
    """The known columns of a Parquet file."""
    with path.open("rb") as file:
        starts = file.read(4) == b"PAR1"
        file.seek(max(0, path.stat().st_size - 4))
        ends = file.tell() >= 4 and file.read(4) == b"PAR1"
    if not starts:
        raise LogError("this is not a Parquet file, though its name ends in .parquet.")
    if not ends:
        raise LogError("the Parquet file is truncated: its end is missing; copy it again.")
    try:
        with path.open("rb") as opened, pa_parquet.ParquetFile(opened) as file:
            return file.read(columns=check_names(file.schema_arrow.names))
    except (pa.ArrowException, OSError) as error:
        raise LogError(f"the Parquet file is damaged: {one_line(error)}.") from error


def _read_csv(path: Path) -> pa.Table:
    """The known columns of a CSV file: 64-bit floats, or text where one of them holds text."""
    names = read_header(path)
    known = check_names(names)
    try:
        return _parse_csv(path, names, known, pa.float64())
    except pa.ArrowInvalid:
        # Slower, but then the cell that holds text can be named.
        try:
            return _parse_csv(path, names, known, pa.string())
        except pa.ArrowInvalid as error:
            raise LogError(f"the CSV file is damaged: {one_line(error)}.") from error


def _parse_csv(path: Path, names: list[str], known: list[str], kind: pa.DataType) -> pa.Table:
    """The `known` columns of a CSV file whose header holds `names`, each of type `kind`."""
    try:
        with path.open("rb") as file:  # a path must be UTF-8
            return pa_csv.read_csv(
                file,
                # In one thread, because only then are rows counted.
                read_options=pa_csv.ReadOptions(use_threads=False, column_names=names, skip_rows=1),
                convert_options=pa_csv.ConvertOptions(
                    include_columns=known, column_types=dict.fromkeys(known, kind)
                ),
            )
    except pa.ArrowInvalid as error:
        if "Could not skip initial" in str(error):
            raise LogError("no row follows the header; a log with rows is expected.") from error
        ragged = re.search(r"Row #(\d+): Expected (\d+) columns, got (\d+)", str(error))
        if not ragged:
            raise
        row, expected, got = map(int, ragged.groups())
        raise LogError(
            f"row {row - 1} has {got} cells and the header {expected}; is the file truncated there?"
        ) from error


def _numbers(name: str, column: pa.ChunkedArray) -> Float64[np.ndarray, " rows"]:
    """A column as 64-bit floats, NaN where a cell is empty."""
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_decimal(kind):
        return column.cast(pa.float64(), safe=False).to_numpy().astype(np.float64, copy=False)
    if pa.types.is_null(kind):
        return np.full(len(column), np.nan)
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        raise LogError(f"column '{name}' holds values of type {kind}; numbers are expected.")
    text = column.to_pandas()
    numbers = np.asarray(pd.to_numeric(text, errors="coerce"), np.float64)
    bad = np.flatnonzero(np.isnan(numbers) & ~text.isin(["", *_NAN]) & text.notna().to_numpy())
    if bad.size:
        value = str(text.iloc[bad[0]])[:30]
        comma = " Use a decimal point." if re.fullmatch(r"[+-]?\d*,\d+", value.strip()) else ""
        raise LogError(
            f"column '{name}', row {bad[0] + 1}: the text '{value}'; a number is expected.{comma}"
        )
    return numbers


_NAN = ("NaN", "nan", "NA", "N/A", "n/a", "null", "NULL", "-nan", "-NaN")
"""How files spell a number that is not there."""
