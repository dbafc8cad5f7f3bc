"""`bench claims`: the paper's claims beside a folder of tables."""

from pathlib import Path

from bench.text.pages import documents_of


def claims(directory: Path, /, *, out: Path | None = None, notes: Path | None = None) -> int:
    """Put the paper's claims beside what the tables in a folder say, as Markdown and HTML.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/paper.
    out
        Markdown file to write; without it, reports/NAME.md for results/NAME, else claims.md in
        DIRECTORY.

    Notes:
        Markdown file to append, such as reports/paper_notes.md.
    """
    from bench.paper.page import write_claims
    from bench.store.tables import Tables

    documents = documents_of(directory)
    default = directory / "claims.md" if documents == directory else documents.with_suffix(".md")
    path = out or default
    write_claims(Tables.load(directory), path, notes)
    print(f"Claims: {path}")  # noqa: T201
    return 0
