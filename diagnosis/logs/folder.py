"""A folder of flights: what can be said of it by names and headers alone.

Nothing here takes long to import, so that commands can check a folder before any work.
"""

from pathlib import Path

from diagnosis.logs.columns import LogError, check_names, one_line, read_header
from diagnosis.logs.vehicle_file import VehicleText, find_vehicle


def find_flights(path: Path) -> tuple[VehicleText, list[Path]]:
    """What vehicle.toml says, and the files in the folder `flights`, by name.

    Raises:
        LogError: There is no such folder, its vehicle.toml is missing or wrong, or there are no
            files. The message has one line for each thing that is wrong.
    """
    if not path.is_dir():
        what = "is a file" if path.exists() else "does not exist"
        raise LogError(f"{path}: {what}; a folder with vehicle.toml and flights/ is expected.")
    vehicle = find_vehicle(path)
    folder = path / "flights"
    if not folder.is_dir():
        raise LogError(f"{folder}: there is no such folder; log files are expected in it.")
    files = sorted(file for file in folder.iterdir() if not file.name.startswith("."))
    if not files:
        raise LogError(f"{folder}: the folder is empty; NAME.parquet or NAME.csv is expected.")
    return vehicle, files


def check_folder(path: Path) -> None:
    """Nothing, if flights of the folder may be usable; the rows of no file are read.

    Raises:
        LogError: As `find_flights`, or the names or headers of all files are wrong.
    """
    _, files = find_flights(path)
    reasons = []
    for file in files:
        try:
            check_header(file)
        except LogError as error:
            reasons.append(reason_for(file, error))
    if len(reasons) == len(files):
        raise LogError("\n".join(f"{path}/{reason}" for reason in reasons))


def check_header(file: Path) -> None:
    """Nothing, if a file is there under a name of ours, not empty, and a CSV file has its columns.

    Raises:
        LogError: It is not. The message does not name the file.
    """
    if not file.is_file():
        raise LogError("this is not a file; NAME.parquet or NAME.csv is expected.")
    if file.suffix.lower() not in (".parquet", ".csv"):
        raise LogError("the name ends in neither .parquet nor .csv; one of them is expected.")
    try:
        if file.stat().st_size == 0:
            raise LogError("the file is empty (0 bytes); a log with rows is expected.")
        if file.suffix.lower() == ".csv":
            check_names(read_header(file))
    except OSError as error:
        raise LogError(f"the file cannot be read: {one_line(error)}.") from error


def reason_for(file: Path, error: LogError) -> str:
    """Why a file is left out, in one line that begins with its place in the folder."""
    return " ".join(f"{file.parent.name}/{file.name}: {error}".split())
