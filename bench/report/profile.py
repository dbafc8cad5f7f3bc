"""`bench profile`: where an epoch of a method goes, team size by team size."""

from collections.abc import Mapping, Sequence

import jax
from rich.console import Console
from rich.table import Table

from bench.plan.keys import Setting
from bench.plan.planned_run import REALITY
from bench.plan.realities import NOMINAL
from bench.plan.settings import build
from bench.text.errors import UsageError
from methods.contract import AbstractMethod, Setup
from methods.running.profile import NoTrainerError, Profile, profile, trained_in
from simulators import registry
from tasks.contract import AbstractTask

PARTS = ("physics", "task", "policy", "backward")
"""What an epoch's time is divided into."""


def run_profile(
    method_name: str, task_name: str, team_sizes: Sequence[int], settings: Mapping[str, Setting]
) -> int:
    """Prints a table, a row a team size.

    Raises:
        UsageError: The method does not train by back-propagation, or the team is too small.
    """
    console = Console()
    where = f"Method '{method_name}'"
    method = build(registry.load("method", method_name), settings, where)
    task_class = registry.load("task", task_name)
    device = jax.devices()[0]
    console.print(f"{method_name} on {task_name}, one process on {device.device_kind}.")
    console.print("Calibration and fits that come before training are made, but not shown.")
    found = []
    for team_size in team_sizes:
        task = build(task_class, {"n_drones": team_size}, f"Task '{task_name}'")
        with console.status(f"measuring {team_size} drones"):
            found.append(_measured(method, task))
    console.print(table_of(found))
    console.print(
        "Ratio: an epoch over its forward part. Limit: time that the matrix products of the "
        "policy and of a frozen residual need at the rate of the policy's, over an epoch's. "
        "Memory: per drone and episode."
    )
    return 0


def _measured(method: AbstractMethod, task: AbstractTask) -> Profile:
    nominal, reality = (registry.load("simulator", name)() for name in (NOMINAL, REALITY))
    try:
        simulator = trained_in(method, Setup(task, nominal, reality))
    except NoTrainerError as error:
        raise UsageError(str(error)) from error
    trainer = method.trainer  # pyright: ignore[reportAttributeAccessIssue]
    return profile(task, simulator, trainer)


def table_of(profiles: Sequence[Profile]) -> Table:
    """Times, their shares, and what limits them."""
    table = Table(box=None, pad_edge=False)
    shares = [f"{part}\n%" for part in PARTS]
    names = ("drones", "worlds", "epoch\nms", *shares, "ratio", "limit\n%", "rate\nGFLOP/s")
    for name in (*names, "memory\nMB", "compile\ns"):
        table.add_column(name, justify="right")
    for one in profiles:
        epoch = one.seconds["epoch"]
        table.add_row(
            str(one.n_drones),
            str(one.n_worlds),
            f"{1e3 * epoch:.1f}",
            *(f"{100.0 * one.seconds[part] / epoch:.0f}" for part in PARTS),
            f"{one.ratio:.1f}",
            f"{100.0 * one.share:.0f}",
            f"{one.rate / 1e9:.0f}",
            f"{one.memory / 1e6:.3f}",
            f"{one.compile_seconds:.0f}",
        )
    return table
