"""The formats that tables can be exported to: one module each, imported when it is asked for.

A format's module has one function, `write(tables, title, folder, place)`. It fills `folder`, which
exists and is empty, and returns a sentence on each thing that the format had to leave out. The
folder is moved to `place` when all is written, so that nothing half written is ever there.
"""

import dataclasses
import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from bench.store.new_folder import new_folder
from bench.text.errors import UsageError

if TYPE_CHECKING:
    from bench.store.tables import Tables

Name = Literal["tensorboard", "mlflow", "wandb", "marl-eval", "croissant", "huggingface"]
"""The formats."""


@dataclasses.dataclass(frozen=True)
class Format:
    """Where a format is written, and what that needs."""

    module: str
    """Module with its function `write`."""
    opens: str
    """A sentence on how to open the folder; `{}` stands for its path."""
    needs: tuple[str, ...] = ()
    """Packages that it imports."""
    extra: str = ""
    """Extra of this package that installs them."""


FORMATS: dict[Name, Format] = {
    "tensorboard": Format(
        "bench.sharing.export.to_tensorboard",
        "Open it with: tensorboard --logdir {}",
        ("tensorboardX",),
        "tensorboard",
    ),
    "mlflow": Format(
        "bench.sharing.export.to_mlflow",
        "Open it with: mlflow ui --backend-store-uri sqlite:///{}/mlflow.db",
        ("mlflow", "sqlalchemy", "alembic"),
        "mlflow",
    ),
    "wandb": Format(
        "bench.sharing.export.to_wandb",
        "Upload it with: wandb sync {}/wandb/offline-run-*",
        ("wandb",),
        "wandb",
    ),
    "marl-eval": Format(
        "bench.sharing.export.to_marl_eval",
        "Load {}/raw_data.json and give it to marl_eval's data_process_pipeline.",
    ),
    "croissant": Format(
        "bench.sharing.export.to_croissant",
        "Check it with: mlcroissant validate --jsonld {}/croissant.json",
        ("mlcroissant",),
        "croissant",
    ),
    "huggingface": Format(
        "bench.sharing.export.to_huggingface",
        "Upload it with: hf upload --repo-type dataset USER/NAME {}",
    ),
}
"""How each format is written."""


SILENT = {
    "DO_NOT_TRACK": "true",
    "MLFLOW_DISABLE_TELEMETRY": "true",
    "WANDB_ERROR_REPORTING": "false",
}
"""Variables with which the tools' libraries tell their makers nothing."""


def check_available(name: Name) -> None:
    """Refuses a format whose packages are not installed.

    Raises:
        UsageError: One is missing.
    """
    os.environ.update(SILENT)
    found = FORMATS[name]
    for package in found.needs:
        try:
            importlib.import_module(package)
        except ImportError as error:
            raise UsageError(
                f"`--to {name}` needs the package {package} ({error}): "
                f"pip install 'fidelity-bench[{found.extra}]'."
            ) from error


def export(tables: "Tables", title: str, name: Name, out: Path) -> list[str]:
    """Writes tables in a format into a new folder, whole or not at all.

    Args:
        tables: What is exported.
        title: Name of the collection in the other tool.
        name: The format.
        out: The folder.

    Returns:
        A sentence on each thing that was left out.

    Raises:
        UsageError: The folder is not free, or a package is missing.
    """
    check_available(name)
    with new_folder(out) as part:
        return importlib.import_module(FORMATS[name].module).write(
            tables, title, part, out.absolute()
        )
