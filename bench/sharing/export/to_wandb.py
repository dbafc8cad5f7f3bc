"""Offline runs of Weights & Biases, which `wandb sync` uploads; nothing leaves this machine."""

import importlib
from pathlib import Path
from typing import Any

from bench.sharing.export.run_views import run_views
from bench.store.tables import Tables

SETTINGS = {
    "silent": True,
    "console": "off",
    "disable_git": True,
    "disable_job_creation": True,
    "save_code": False,
    "x_disable_meta": True,
    "x_disable_stats": True,
}
"""Nothing of this process is recorded: it did not train the run."""


def write(tables: Tables, title: str, folder: Path, place: Path) -> list[str]:
    """Fills `folder` with one offline run per run; a run's name is its id, so that it is one."""
    del place
    wandb: Any = importlib.import_module("wandb")
    for view in run_views(tables):
        run = wandb.init(
            project=title,
            id=view.name,
            name=view.name,
            group=f"{view.about['task']}-n{view.about['team_size']}",
            dir=str(folder),
            mode="offline",
            config=dict(view.about),
            reinit="finish_previous",
            settings=wandb.Settings(**SETTINGS),
        )
        for epoch, values in view.points():
            run.log(values, step=epoch)
        run.summary.update({f"final/{name}": value for name, value in view.metrics.items()})
        run.finish(exit_code=int(view.failed))
    (folder / "wandb" / "latest-run").unlink(missing_ok=True)  # it leads to where we write now
    return []
