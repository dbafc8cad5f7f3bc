"""`bench site`: a static site over suites and diagnoses."""

from pathlib import Path


def site(
    directory: Path,
    /,
    *,
    results: Path = Path("results"),
    reports: Path = Path("reports"),
) -> int:
    """Write a static site over all suites, documents and diagnoses; it opens from a file.

    Parameters
    ----------
    directory
        Folder to write to; index.html is its start.
    results
        Folder whose subfolders hold tables.
    reports
        Folder of documents, diagnoses and replays.
    """
    from rich.console import Console

    from bench.site.build import build_site
    from bench.text.say import say

    console = Console()
    say(console, f"Site: {build_site(results, reports, directory, console)}")
    return 0
