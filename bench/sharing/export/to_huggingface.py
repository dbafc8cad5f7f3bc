"""A folder for a data set of the Hugging Face Hub: Parquet files and a README with front matter.

Its viewer shows each table as a configuration. Format: the Hub's documentation on dataset cards
and on the key `configs`. The front matter is JSON, of which YAML is a superset.
"""

import json
from pathlib import Path

from bench.sharing.export.column_words import ABOUT, COLUMN_WORDS, LICENSE, TABLE_WORDS, save_tables
from bench.store.tables import SCHEMAS, Tables
from bench.text.markdown import escape, table

SIZES = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"), (1_000_000, "100K<n<1M"))
"""The Hub's names for numbers of rows, each with what it stays below."""
MANY = "1M<n<10M"
"""Its name for more."""


def write(tables: Tables, title: str, folder: Path, place: Path) -> list[str]:
    """Fills `folder` with data/ and README.md."""
    del place
    names = list(save_tables(tables, folder / "data"))
    header = {
        "license": LICENSE,
        "pretty_name": title,
        "tags": ["robotics", "drones", "multi-agent", "sim-to-real", "benchmark"],
        "size_categories": [_size(max(len(getattr(tables, name)) for name in names))],
        "configs": [
            {"config_name": name, "data_files": f"data/{name}.parquet", "default": name == "runs"}
            for name in names
        ],
    }
    parts = [f"---\n{json.dumps(header, indent=1)}\n---", f"# {escape(title)}", ABOUT]
    for name in names:
        columns = SCHEMAS[name].columns
        rows = [[f"`{column}`", escape(COLUMN_WORDS[column])] for column in columns]
        parts += [f"## `{name}`", TABLE_WORDS[name], table(("column", "meaning"), rows, (0, 1))]
    (folder / "README.md").write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return []


def _size(rows: int) -> str:
    return next((name for most, name in SIZES if rows < most), MANY)
