"""Options that several commands share."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from bench.cli.checks import check_files, check_unused
from bench.text.errors import UsageError

if TYPE_CHECKING:
    from bench.plan.suite import Suite

Repeatable = cyclopts.Parameter(negative=(), show_default=False)
"""For an option that has no opposite called `--no-...`."""


@cyclopts.Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Part:
    """The options of `bench run` and `bench plan` that choose a part of a suite."""

    task: Annotated[list[str] | None, Repeatable] = None
    """Only this task; may be repeated."""
    team_size: Annotated[list[int] | None, Repeatable] = None
    """Only this number of drones; may be repeated."""
    method: Annotated[list[str] | None, Repeatable] = None
    """Only this method; may be repeated."""
    residual: Annotated[list[str] | None, Repeatable] = None
    """Only methods with this residual; those that take none are kept if --method names them; may be
    repeated."""
    quick: Annotated[bool, Repeatable] = False
    """Only the small part of the suite that its table [quick] names."""
    deployed: Annotated[bool, Repeatable] = False
    """Only rows that train nothing and deploy elsewhere what another run trained."""
    seeds: int | None = None
    """Only this many seeds, counted from the suite's first; rows with fewer seeds keep theirs."""
    setting: Annotated[list[str] | None, Repeatable] = None
    """Another value for a setting of the methods, such as trainer.epochs=50, of the tasks, such as
    task_settings.horizon=100, or of the point mass, such as nominal.attitude_tau=0.05; may be
    repeated. `bench list methods --settings` shows what there is."""

    def of(self, suite: str) -> "Suite":
        """The chosen part of the suite called `suite`."""
        from bench.plan.keys import parse_settings
        from bench.plan.override import overridden
        from bench.plan.suite import load_suite

        settings = parse_settings(self.setting or ())
        whole = load_suite(suite)
        chosen = (whole.quickly() if self.quick else whole).select(
            self.task or (),
            self.team_size or (),
            self.method or (),
            self.residual or (),
            self.seeds,
        )
        return overridden(chosen.deploying() if self.deployed else chosen, settings)


@cyclopts.Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Remedy:
    """The options of `bench diagnose` that say what to change after a diagnosis."""

    remedy: Literal["crazyflow", "crazyflie", "px4"] | None = None
    """Write what to change, too, with intervals, and the next flight as a file: for the simulator
    crazyflow, for a Crazyflie's firmware, or for PX4. Instead of a folder of flights, the
    diagnosis.json of an earlier diagnosis may be given."""
    parameters: Path | None = None
    """With --remedy px4: the vehicle's parameters as QGroundControl saves them; the new values are
    written to changed.params."""
    geofence: str = "3x3x2"
    """With --remedy: length, width and height [m] of the box on the floor in which the next flight
    must stay."""
    home: str | None = None
    """With --remedy px4: latitude,longitude [degrees] of the middle of that box, such as
    47.397742,8.545594; a plan of QGroundControl is written, too."""

    def of_file(self, flights: Path | None) -> bool:
        """Whether a diagnosis was given in the place of flights."""
        return self.remedy is not None and flights is not None and flights.is_file()

    def check(self, flights: Path | None, others: Mapping[str, object]) -> None:
        """Refuses what does not belong together.

        Raises:
            UsageError: An option would be ignored, or makes no sense.
        """
        given = {"--home": self.home, "--parameters": self.parameters}
        if self.remedy is None:
            fence = None if self.geofence == type(self).geofence else self.geofence
            check_unused(given | {"--geofence": fence}, "without --remedy")
        elif self.remedy != "px4":
            check_unused(given, "without --remedy px4")
        if self.of_file(flights):
            check_unused(others, "with a diagnosis.json, whose flights are diagnosed already")
        check_files([self.parameters] if self.parameters else ())
        self._box()
        self._place()

    def write(self, found: Path, out: Path | None = None) -> int:
        """Writes the remedy of the diagnosis in a folder or a file, if one is asked for.

        Args:
            found: The folder or the file.
            out: Where the remedy's folder is made; None: beside the diagnosis.

        Raises:
            UsageError: The file is no diagnosis, or the remedy cannot be written.
        """
        if self.remedy is None:
            return 0
        from bench.diagnosis_report.mending.writing import load_diagnosis, write_remedy
        from diagnosis.remedies.trajectory import Geofence

        box, place = Geofence(*self._box()), self._place()
        try:
            diagnosis, beside = load_diagnosis(found)
            out = out or beside
            folder = write_remedy(diagnosis, out, self.remedy, box, place, self.parameters)
        except ValueError as error:
            raise UsageError(str(error)) from None
        print(f"Remedy: {folder / 'remedy.md'}")  # noqa: T201
        return 0

    def _box(self) -> tuple[float, ...]:
        """Length, width and height [m]."""
        length, width, height = numbers = _numbers("geofence", self.geofence, "x", 3)
        if min(length, width) < 1.0 or height < 1.3:
            raise UsageError(
                "`--geofence` must be at least 1 m long and wide and 1.3 m high, got "
                f"{self.geofence}."
            )
        return numbers

    def _place(self) -> tuple[float, float] | None:
        """Latitude and longitude [degrees]."""
        if self.home is None:
            return None
        latitude, longitude = _numbers("home", self.home, ",", 2)
        if abs(latitude) > 89.0 or abs(longitude) > 180.0:
            raise UsageError(
                "`--home` must be a latitude of at most 89 and a longitude of at most 180 degrees, "
                f"got {self.home}."
            )
        return latitude, longitude


def _numbers(option: str, text: str, between: str, count: int) -> tuple[float, ...]:
    """The numbers in an option's text.

    Raises:
        UsageError: There are others than `count` finite numbers.
    """
    try:
        numbers = tuple(float(part) for part in text.split(between))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        example = {"geofence": "3x3x2", "home": "47.397742,8.545594"}[option]
        raise UsageError(f"`--{option}` must be numbers such as {example}, got {text}.")
    return numbers
