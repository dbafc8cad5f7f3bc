"""One stored flight as a page that plays it, and as a film."""

from collections.abc import Iterable
from pathlib import Path

import pandas as pd
from rich.console import Console

from bench.report import film
from bench.report.flown import playable, positions
from bench.report.run_details import pretty, run_metrics
from bench.stats.statistics import entry_of, records
from bench.store.tables import TableError, Tables
from bench.text.errors import UsageError
from bench.text.pages import documents_of, environment, file_name, write_text
from bench.text.say import say
from simulators import registry


class NoFlightError(UsageError):
    """A run that is not in the tables, or of which they hold no flight."""


def replay(run: str, tables_dir: Path | None, out: Path | None, video: Path | None) -> int:
    """Writes the page, and the film if one is asked for.

    Args:
        run: Name of a run, as the report and the table `runs` have it, or path of its folder.
        tables_dir: Folder of tables; None: the one above the run's folder, or one of results/*.
        out: HTML file to write; None: replays/NAME.html among the documents of the tables.
        video: File to write the film to, by its ending a GIF, WebP or PNG animation.

    Raises:
        NoFlightError: There is no such run or no flight of it.
        UsageError: The film's ending says no format that can be written.
    """
    console = Console()
    if video is not None and video.suffix.lower() not in film.FORMATS:
        raise UsageError(
            f"`--video` must end in {', '.join(film.FORMATS)} (animated pictures), got '{video}'."
        )
    directory, tables = _find(run, tables_dir)
    name = Path(run).name
    page = out or documents_of(directory) / "replays" / f"{file_name(name)}.html"
    write_replay(tables, name, page)
    say(console, f"Replay: {page}")
    if video is None:
        return 0
    t, _, pos = positions(_rows(tables.trajectories, name))
    film.write_film(t, pos, video)
    say(console, f"Film: {video}")
    return 0


def write_replay(tables: Tables, name: str, path: Path) -> None:
    """Writes the page of one run.

    Raises:
        NoFlightError: The tables hold no such run or no flight of it.
    """
    (row,) = records(_rows(tables.runs, name)) or [None]
    if row is None:
        raise NoFlightError(_unknown(name, tables.runs["run"]))
    flight = playable(_rows(tables.trajectories, name))
    if flight is None:
        cause = f" It ended as '{row['status']}': {row['cause']}" if row["cause"] else ""
        raise NoFlightError(f"The tables hold no flight of run '{name}'.{cause}")
    facts = {
        "method": entry_of(row).label,
        "task": row["task"],
        "drones": row["team_size"],
        "seed": row["seed"],
        "status": row["status"],
    }
    page = environment().get_template("replay.html.j2")
    text = page.render(
        title=f"Replay of {name}",
        facts=list(facts.items()),
        cause=row["cause"],
        metrics=run_metrics(_rows(tables.results, name)).get(name, []),
        settings=pretty(row["settings"]),
        versions=pretty(row["versions"]),
        flight=flight,
    )
    write_text(path, text)


def _find(run: str, tables_dir: Path | None) -> tuple[Path, Tables]:
    """The folder of tables that a run is in, and the tables."""
    name = Path(run).name
    if tables_dir is None:
        above = [d for d in Path(run).absolute().parents if (d / "runs.parquet").is_file()]
        others = sorted(p.parent for p in Path("results").glob("*/runs.parquet"))
        folders = above[:1] if "/" in run else others
    else:
        folders = [tables_dir]
    known: list[str] = []
    broken: list[TableError] = []
    for folder in folders:
        try:
            tables = Tables.load(folder)
        except TableError as error:
            broken.append(error)
            continue
        if name in set(tables.runs["run"]):
            return folder, tables
        known += tables.runs["run"].tolist()
    if broken:
        raise broken[0]
    if not folders:
        raise NoFlightError(
            f"No tables were found to look for run '{name}' in. Name their folder with --tables."
        )
    raise NoFlightError(_unknown(name, known))


def _unknown(name: str, known: Iterable[str]) -> str:
    hint = registry.did_you_mean(name, known)
    return f"The tables hold no run '{name}'.{hint} `bench report` lists them all."


def _rows(frame: pd.DataFrame, name: str) -> pd.DataFrame:
    return frame.loc[frame["run"] == name]
