"""What commands check before they import anything heavy: a misspelt name is answered at once."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from bench.plan.names import SENSING, kind_of, require, world_text
from bench.text.errors import UsageError
from diagnosis.logs.folder import check_folder
from simulators import registry


def check_names(kind: str, names: Iterable[str]) -> None:
    """Refuses names of plug-ins that are not registered.

    Raises:
        UnknownPluginError: Nobody registered one of them.
    """
    for name in names:
        require(kind, name)


def check_registered(plugin: str) -> None:
    """Refuses a plug-in that is not registered; a class given as module:Class is left for later.

    Raises:
        UnknownPluginError: Nobody registered it, or several kinds have it.
    """
    module, _, name = plugin.partition(":")
    if not name or module in registry.GROUPS:
        kind_of(plugin)


def check_reality(text: str) -> None:
    """Refuses unknown names in a reality such as `crazyflow+mass(e=0.2)`; reads no parameter.

    Raises:
        UnknownPluginError: No simulator or effect has such a name.
    """
    simulator, *effects = (part.strip() for part in world_text(text).split("+"))
    require("simulator", simulator)
    named = (re.match(r"([a-z_0-9]+)\(", part) for part in effects)
    check_names("effect", (match[1] for match in named if match and match[1] != SENSING))


def check_number(option: str, value: int | None) -> None:
    """Refuses a number below 1; None stands for an option that was not given.

    Raises:
        UsageError: It is smaller.
    """
    if value is not None and value < 1:
        raise UsageError(f"`--{option}` must be at least 1, got {value}.")


def check_tables(*directories: Path) -> None:
    """Refuses folders without tables.

    Raises:
        UsageError: There is no such folder, or it holds no results.parquet.
    """
    for directory in directories:
        if not (directory / "results.parquet").is_file():
            raise UsageError(
                f"{directory} holds no results.parquet.{_near(directory)} Give a folder that "
                "`bench run` wrote its tables to, such as results/quick."
            )


def check_flights(folders: Sequence[Path]) -> None:
    """Refuses what are no folders of flights, as far as names and headers of files tell.

    Raises:
        UsageError: There is no such folder, or it is an earlier diagnosis.
        LogError: vehicle.toml, flights/ or the headers of all files are wrong; one line for each.
    """
    for folder in folders:
        if earlier_diagnosis(folder) != folder or (folder.is_file() and folder.suffix == ".json"):
            raise UsageError(
                f"{folder}: a folder with vehicle.toml and flights/ is expected. To write what to "
                "change after an earlier diagnosis, give `bench diagnose` its folder and add "
                "--remedy crazyflow, crazyflie or px4."
            )
        if not folder.is_dir():
            what = "is a file" if folder.exists() else "does not exist"
            raise UsageError(
                f"{folder}: {what}; a folder with vehicle.toml and flights/ is expected."
                f"{_near(folder)}"
            )
    for folder in folders:
        check_folder(folder)


def earlier_diagnosis(path: Path) -> Path:
    """The diagnosis.json in a folder that holds one and no flights; every other path as it is."""
    file = path / "diagnosis.json"
    return file if file.is_file() and not (path / "vehicle.toml").exists() else path


def check_files(paths: Iterable[Path]) -> None:
    """Refuses paths at which nothing lies.

    Raises:
        UsageError: There is no file or folder at one of them.
    """
    for path in paths:
        if not path.exists():
            raise UsageError(f"{path}: there is no such file or folder.{_near(path)}")


def check_place(*folders: Path) -> None:
    """Refuses places for folders at which there is a file.

    Raises:
        UsageError: There is one.
    """
    for folder in folders:
        if folder.exists() and not folder.is_dir():
            raise UsageError(
                f"{folder} must be a folder, but it is a file. Choose another one with --out."
            )


def check_unused(given: Mapping[str, object], why: str) -> None:
    """Refuses options that the command would ignore; None stands for one that was not given.

    Raises:
        UsageError: One of them was given.
    """
    needless = [option for option, value in given.items() if value is not None]
    if needless:
        raise UsageError(f"Leave out {', '.join(needless)}: not used {why}.")


def _near(path: Path) -> str:
    """A question whether a sibling with a similar name was meant; empty without one."""
    folder = path.parent
    siblings = [other.name for other in folder.iterdir()] if folder.is_dir() else []
    close = difflib.get_close_matches(path.name, siblings, n=1, cutoff=0.7)
    return f" Did you mean '{folder / close[0]}'?" if close and close[0] != path.name else ""
