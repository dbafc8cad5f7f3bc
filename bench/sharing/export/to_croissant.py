"""The tables beside a description in Croissant 1.0 (MLCommons), which data-set searches read."""

import importlib
import json
from pathlib import Path
from typing import Any

import pandas as pd

from bench.sharing.export.column_words import (
    ABOUT,
    CITATION,
    COLUMN_WORDS,
    LICENSE,
    TABLE_WORDS,
    save_tables,
)
from bench.store.record import checksum
from bench.store.tables import Tables


def write(tables: Tables, title: str, folder: Path, place: Path) -> list[str]:
    """Fills `folder` with the Parquet files and croissant.json."""
    del place
    mlc: Any = importlib.import_module("mlcroissant")
    files = save_tables(tables, folder)
    objects = [_file_object(mlc, name, path) for name, path in files.items()]
    sets = [_record_set(mlc, name, getattr(tables, name)) for name in files]
    latest = pd.to_datetime(tables.runs["committed"].replace("", None), utc=True).max()
    metadata = mlc.Metadata(
        name=title,
        description=ABOUT,
        cite_as=CITATION,
        license=[f"https://opensource.org/license/{LICENSE}"],
        creators=[mlc.Organization(name="fidelity-bench")],
        date_published=None if pd.isna(latest) else latest.to_pydatetime(),
        version="1.0.0",
        distribution=objects,
        record_sets=sets,
    )
    text = json.dumps(metadata.to_json(), indent=1, default=str)
    (folder / "croissant.json").write_text(f"{text}\n", encoding="utf-8")
    return []


def _file_object(mlc: Any, name: str, path: Path) -> Any:
    return mlc.FileObject(
        id=path.name,
        name=path.name,
        description=TABLE_WORDS[name],
        content_url=path.name,
        encoding_formats=["application/x-parquet"],
        sha256=checksum(path.read_bytes()),
    )


def _record_set(mlc: Any, name: str, frame: pd.DataFrame) -> Any:
    return mlc.RecordSet(
        id=name,
        name=name,
        description=TABLE_WORDS[name],
        fields=[
            mlc.Field(
                id=f"{name}/{column}",
                name=column,
                description=COLUMN_WORDS[str(column)],
                data_types=_data_type(mlc, frame[column]),
                source=mlc.Source(
                    file_object=f"{name}.parquet", extract=mlc.Extract(column=str(column))
                ),
            )
            for column in frame
        ],
    )


def _data_type(mlc: Any, column: Any) -> str:
    """Croissant's name of a column's type."""
    if pd.api.types.is_bool_dtype(column):
        return mlc.DataType.BOOL
    if pd.api.types.is_integer_dtype(column):
        return mlc.DataType.INTEGER
    return mlc.DataType.FLOAT if pd.api.types.is_float_dtype(column) else mlc.DataType.TEXT
