"""The formats that tables can be exported to: one module each, imported when it is asked for.

A format's module, to_FORMAT, has one function, `write(tables, title, folder, place)`. It fills
`folder`, which exists and is empty, and returns a sentence on each thing that the format had to
leave out. The folder is moved to `place` when all is written, so that nothing half written is ever
there.
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
    """What a format needs, and how its folder is opened."""

    opens: str
    """A sentence on how to open the folder; `{}` stands for its path."""
    needs: tuple[str, ...] = ()
    """Packages that it imports; the extra of this package that installs them has its name."""


FORMATS: dict[Name, Format] = {
    "tensorboard": Format("Open it with: tensorboard --logdir {}", ("tensorboardX",)),
    "mlflow": Format(
        "Open it with: mlflow ui --backend-store-uri sqlite:///{}/mlflow.db",
        ("mlflow", "sqlalchemy", "alembic"),
    ),
    "wandb": Format("Upload it with: wandb sync {}/wandb/offline-run-*", ("wandb",)),
    "marl-eval": Format("Load {}/raw_data.json and give it to marl_eval's data_process_pipeline."),
    "croissant": Format(
        "Check it with: mlcroissant validate --jsonld {}/croissant.json", ("mlcroissant",)
    ),
    "huggingface": Format("Upload it with: hf upload --repo-type dataset USER/NAME {}"),
}
"""The formats, by name."""


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
    for package in FORMATS[name].needs:
        try:
            importlib.import_module(package)
        except ImportError as error:
            raise UsageError(
                f"`--to {name}` needs the package {package} ({error}): "
                f"pip install 'fidelity-bench[{name}]'."
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
    module = importlib.import_module(f"bench.sharing.export.to_{name.replace('-', '_')}")
    with new_folder(out) as part:
        return module.write(tables, title, part, out.absolute())
