"""Event files of TensorBoard: a folder a run, with its curves and a row of the HPARAMS tab."""

import importlib
from pathlib import Path
from typing import Any

from bench.sharing.export.run_views import run_views
from bench.store.tables import Tables


def write(tables: Tables, title: str, folder: Path, place: Path) -> list[str]:
    """Fills `folder`; curves go under `training/`, final metrics under `final/`."""
    del title, place
    tensorboard: Any = importlib.import_module("tensorboardX")
    left_out = []
    for run in run_views(tables):
        if run.failed:
            left_out.append(f"{run.name} failed and has no values.")
            continue
        with tensorboard.SummaryWriter(str(folder / run.name)) as writer:
            for epoch, values in run.points():
                for name, value in values.items():
                    writer.add_scalar(name, value, epoch)
            final = {f"final/{name}": value for name, value in run.metrics.items()}
            writer.add_hparams(dict(run.about), final, name="row", global_step=0)
    return left_out
