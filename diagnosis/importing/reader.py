"""What a reader of log files gives: streams, each with a clock of its own, in the frames we use.

A reader knows one kind of file. It turns units and frames into ours (SI; world z up; body x
forward, y left, z up; quaternions from body to world, scalar last) and says what it took from
where. Clocks are brought together afterwards (`diagnosis.importing.resample`).
"""

import abc
import contextlib
import dataclasses
import gc
import importlib
import io
import traceback
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import ClassVar

import numpy as np
import pandas as pd
from jaxtyping import Float64

from diagnosis.logs.columns import GROUPS, LogError
from simulators.vehicle import GRAVITY

FIELDS = {
    **{name: columns for name, columns in GROUPS.items() if name != "cmd"},
    "cmd_angles": ("cmd_roll", "cmd_pitch", "cmd_yaw"),
    "cmd_thrust": ("cmd_thrust",),
    "battery": ("battery",),
}
"""What a stream may hold, and its columns in the format; commanded angles and thrust often come
from two messages."""

HEAD_BYTES = 4096
"""How much of a file's start tells its format; a choice, more than any magic number or header."""


@dataclasses.dataclass(frozen=True)
class Stream:
    """One field of one drone, as it was logged."""

    field: str
    """One of `FIELDS`."""
    t: Float64[np.ndarray, " rows"]
    """Time of each row on the log's clock [s]."""
    values: Float64[np.ndarray, "rows columns"]
    """Numbers in the units and frames of the format."""
    source: str
    """Message and fields that they were taken from."""
    change: str = "as it is"
    """What was done to units and frames."""


@dataclasses.dataclass(frozen=True)
class Recording:
    """What one source holds."""

    drones: Mapping[str, tuple[Stream, ...]]
    """Streams of each drone, by its name in the log."""
    missing: tuple[str, ...] = ()
    """One line for each thing that the diagnosis could use and that the source lacks."""
    notes: tuple[str, ...] = ()
    """One line for each thing that the operator should know."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What the operator says beside the files."""

    mass: float
    """Believed mass [kg]."""
    thrust_max: float
    """Largest collective thrust of the airframe [N]."""
    full_thrust: float | None = None
    """Collective thrust [N] at the largest command, where the operator knows it."""
    topics: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    """Field -> topics that it is to be taken from, one a drone."""
    columns: Path | None = None
    """The file columns.toml; without it, one beside a table is taken."""
    truncated: bool = False
    """Whether a file that breaks off is used up to there."""
    above: float | None = None
    """Height above the lowest of a log [m] up to which its rows are left out."""

    def scale(self, hover: float | None, said_by: str) -> tuple[float, str]:
        """Thrust [N] of a command of 1, and in words where it comes from.

        Args:
            hover: Command at which the autopilot believes that it hovers [-].
            said_by: Name of the parameter that holds it.

        Raises:
            LogError: Neither the operator nor the log says it.
        """
        if self.full_thrust is not None:
            return self.full_thrust, f"times {self.full_thrust:g} N (--full-thrust)"
        if hover is None or not 0.01 < hover <= 1.0:
            raise LogError(
                f"thrust is logged as a share of the largest, and no {said_by} in the log says "
                f"what that is in newtons; give the thrust of all rotors at full command with "
                f"--full-thrust N."
            )
        full = self.mass * GRAVITY / hover
        return (
            full,
            f"times {full:.4g} N: {said_by} = {hover:.3g} is taken to carry {self.mass:g} kg",
        )


class AbstractReader(abc.ABC):
    """A reader of one kind of log. Readers hold no state."""

    name: ClassVar[str]
    """What `--format` calls it."""
    label: ClassVar[str]
    """The format in words."""
    package: ClassVar[str] = ""
    """Module that reads it, where it is not ours."""
    extra: ClassVar[str] = ""
    """Extra of this package that installs the module."""

    @abc.abstractmethod
    def recognises(self, path: Path, head: bytes) -> bool:
        """Whether a file with these first bytes, or a folder (no bytes), is of this kind."""

    @abc.abstractmethod
    def read(self, path: Path, request: Request) -> Recording:
        """What the source holds.

        Raises:
            LogError: It cannot be read, or it breaks off. The message does not name it.
        """

    def module(self, name: str = "") -> ModuleType:
        """The module that reads the format, or one below it.

        Raises:
            LogError: It is not installed.
        """
        try:
            return importlib.import_module(name or self.package)
        except ImportError as error:
            raise LogError(
                f"{self.label} is read with the package '{self.package}', which is not installed; "
                f"install it with: pip install 'fidelity-bench[{self.extra}]'."
            ) from error


@contextlib.contextmanager
def reading(what: str) -> Iterator[io.StringIO]:
    """Errors of another package become a LogError; what it prints is caught.

    Raises:
        LogError: Anything went wrong inside.
    """
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            yield printed
    except LogError:
        raise
    except (Exception, SystemExit) as error:  # a hostile file may raise anything
        text = " ".join(str(error).split()).rstrip(".")[:200]
        with warnings.catch_warnings():  # files that the other package left open
            warnings.simplefilter("ignore", ResourceWarning)
            traceback.clear_frames(error.__traceback__)
            gc.collect()
        raise LogError(
            f"this is no whole {what}: {type(error).__name__}{': ' + text if text else ''}; copy "
            f"the file again."
        ) from error


def broken_off(what: str, request: Request, remedy: str = "") -> str:
    """The note that a source breaks off, if the operator allowed that.

    Raises:
        LogError: She did not.
    """
    if not request.truncated:
        raise LogError(
            f"{what}; copy the file again{remedy}, or use what comes before with --truncated."
        )
    return f"{what}; what comes before is used."


def separators(file: Path) -> dict[str, str]:
    """What separates columns and decimals of a CSV file, as pandas takes it."""
    with file.open(encoding="utf-8-sig") as opened:
        header, *rows = [opened.readline() for _ in range(3)]
    sep = max(",", ";", "\t", key=header.count)
    comma = sep != "," and any("," in row for row in rows)
    return {"sep": sep, "decimal": "," if comma else "."}


def read_csv(file: Path) -> pd.DataFrame:
    """A table of a CSV file; names of columns without spaces around them.

    Columns are separated by commas, semicolons or tabs, whichever the header has most of; where it
    is not commas, numbers may have a decimal comma. Rows may end with a separator, which makes no
    column.

    Raises:
        LogError: Rows have more cells than the header.
    """
    how = {"skipinitialspace": True, "encoding": "utf-8-sig", **separators(file)}
    frame = pd.read_csv(file, **how)
    if not isinstance(frame.index, pd.RangeIndex):  # the first column was taken for names of rows
        if frame.iloc[:, -1].notna().any() or frame.index.nlevels > 1:
            raise LogError(f"{file.name}: rows have more cells than the header has names.")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", pd.errors.ParserWarning)
            frame = pd.read_csv(file, index_col=False, **how)
    return frame.rename(columns=str.strip)


def known_voltage(
    volts: Float64[np.ndarray, "rows columns"],
) -> Float64[np.ndarray, "rows columns"]:
    """A battery's voltage [V], NaN where it is zero: so autopilots log what they do not measure."""
    return np.where(volts > 0.0, volts, np.nan)
