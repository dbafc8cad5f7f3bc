"""Columns of one log file as numbers: what the format calls them, and Parquet and CSV read.

| column | unit | |
|---|---|---|
| `t` | s | increases from row to row (per drone) |
| `drone` | - | integer; where several drones share a flight |
| `pos_*`, `vel_*` | m, m/s | world frame, z up |
| `quat_*` | - | body to world, scalar last |
| `ang_vel_*` | rad/s | body frame; optional |
| `acc_*` | m/s^2 | specific force, body frame; optional |
| `cmd_roll`, `cmd_pitch`, `cmd_yaw`, `cmd_thrust` | rad, N | commanded attitude and thrust |
| `rotor_vel_*` | rad/s | measured rotor speeds |
| `pwm_*`, `battery` | 0 to 1, V | motor duty commands, and voltage |
| `interpolated` | 0, 1 | 1: position and velocity of this row lie between measurements |

Other columns are ignored. A group is there with all of its columns or with none of them, but
`cmd_thrust` may stand alone. Rows are counted from 1 in all messages, a CSV file's header not
included.
"""

import csv
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.csv as pa_csv
import pyarrow.parquet as pa_parquet
from jaxtyping import Float64

from simulators import registry

GROUPS = {
    "pos": ("pos_x", "pos_y", "pos_z"),
    "vel": ("vel_x", "vel_y", "vel_z"),
    "quat": ("quat_x", "quat_y", "quat_z", "quat_w"),
    "ang_vel": ("ang_vel_x", "ang_vel_y", "ang_vel_z"),
    "acc": ("acc_x", "acc_y", "acc_z"),
    "cmd": ("cmd_roll", "cmd_pitch", "cmd_yaw", "cmd_thrust"),
    "rotor_vel": ("rotor_vel_1", "rotor_vel_2", "rotor_vel_3", "rotor_vel_4"),
    "pwm": ("pwm_1", "pwm_2", "pwm_3", "pwm_4"),
}
"""Columns that belong together, by the name of the field that holds them."""

ANGLES = GROUPS["cmd"][:3]
"""Columns of commands that may be missing beside the thrust."""

REQUIRED = ("t", *GROUPS["pos"], *GROUPS["vel"], *GROUPS["quat"])
"""Columns without which nothing can be said about a flight."""

KNOWN = (
    "t",
    "drone",
    *(name for group in GROUPS.values() for name in group),
    "battery",
    "interpolated",
)
"""Every column that is read."""

Columns = dict[str, Float64[np.ndarray, " _rows"]]
"""Column -> its numbers, NaN where a cell is empty; one length for all columns of one dict."""


class LogError(ValueError):
    """Logs that cannot be used; the message is one line for each thing that is wrong."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A question after the name in `known` that `name` is close to, empty where none is."""
    return registry.did_you_mean(name, known, likeness=0.6)


def read_columns(path: Path) -> Columns:
    """The known columns of a Parquet or CSV file, as they stand there.

    Raises:
        LogError: The file is empty, truncated or not what its name says, columns are missing, or
            a column holds something other than numbers. The message does not name the file.
    """
    try:
        if path.stat().st_size == 0:
            raise LogError("the file is empty (0 bytes); a log with rows is expected.")
        table = _read_parquet(path) if path.suffix.lower() == ".parquet" else _read_csv(path)
    except OSError as error:
        raise LogError(f"the file cannot be read: {one_line(error)}.") from error
    return {name: _numbers(name, table.column(name)) for name in table.column_names}


def one_line(error: Exception) -> str:
    """The message of an error of another library, in one line without a full stop."""
    text = (getattr(error, "strerror", None) or str(error)).strip()
    return " ".join(text.split()).rstrip(".") or type(error).__name__


def check_names(names: Sequence[str]) -> list[str]:
    """The known ones among a file's column names.

    Raises:
        LogError: A required column is missing, a group is incomplete, a name stands twice, or
            there is no complete input.
    """
    known = [name for name in names if name in KNOWN]
    extra = [name for name in names if name not in KNOWN]
    twice = [name for name in known if known.count(name) > 1]
    if twice:
        raise LogError(f"column '{twice[0]}' is there twice; each may be there once.")
    missing = [name for name in REQUIRED if name not in known]
    if missing:
        raise LogError(f"{_missing(missing, extra)} Required: {', '.join(REQUIRED)}.")
    for group in GROUPS.values():
        lacking = [name for name in group if name not in known]
        misspelt = any(did_you_mean(name, extra) for name in lacking)
        if 0 < len(lacking) < len(group) and (misspelt or lacking != list(ANGLES)):
            there = ", ".join(name for name in group if name in known)
            raise LogError(
                f"{_missing(lacking, extra)} With {there} alone the group is incomplete: "
                f"all of its columns are expected, or none."
            )
    if not {"cmd_thrust", "rotor_vel_1"} & set(known):
        if "pwm_1" in known and "battery" not in known:
            raise LogError(f"{_missing(['battery'], extra)} pwm_* is an input only with it.")
        if "pwm_1" not in known:
            hints = [did_you_mean(name, extra) for key in ("cmd", "pwm") for name in GROUPS[key]]
            raise LogError(
                "no input is there: cmd_roll, cmd_pitch, cmd_yaw and cmd_thrust are expected, or "
                "cmd_thrust alone, or rotor_vel_1 to rotor_vel_4, or pwm_1 to pwm_4 with battery."
                + next(filter(None, hints), "")
            )
    return known


def _missing(missing: Sequence[str], extra: Sequence[str]) -> str:
    """Which columns are missing, and what was probably meant."""
    if len(missing) == 1:
        text = f"column '{missing[0]}' is missing."
    else:
        text = f"columns {', '.join(repr(name) for name in missing)} are missing."
    if len(extra) == 1 and len(missing) == len(REQUIRED) and any(c in extra[0] for c in ";\t|"):
        return text + " The columns must be separated by commas."
    return text + next(filter(None, (did_you_mean(name, extra) for name in missing)), "")


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
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            names = [name.strip() for name in next(csv.reader(file), [])]
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError("this is not a CSV file (UTF-8 text), though its name ends in .csv.") from (
            error
        )
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
        raise LogError(
            f"column '{name}', row {bad[0] + 1}: the text '{value}'; a number is expected."
        )
    return numbers


_NAN = ("NaN", "nan", "NA", "N/A", "n/a", "null", "NULL", "-nan", "-NaN")
"""How files spell a number that is not there."""
