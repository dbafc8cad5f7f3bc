"""`bench replay`: a page that plays a stored flight."""

from pathlib import Path

from bench.cli.checks import check_tables


def replay(
    run: str,
    /,
    *,
    tables: Path | None = None,
    out: Path | None = None,
    video: Path | None = None,
) -> int:
    """Write a page that plays the stored flight of a run; it opens offline.

    Parameters
    ----------
    run
        Name of a run, as the report gives it, or its folder.
    tables
        Folder with runs.parquet and its companions; default: every folder in results/.
    out
        HTML file to write; default: replays/RUN.html beside the report.
    video
        Also render a film into this file: .gif, .webp or animated .png.
    """
    if tables is not None:
        check_tables(tables)
    from bench.report.replay import replay as replay_run

    return replay_run(run, tables, out, video)
