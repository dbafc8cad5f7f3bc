"""The run that a row of the tables stands for, planned again by this installation.

A row keeps the settings of its method and task. From what differs from the defaults the run is
planned as a suite would plan it. The same key means that nothing that decides the result differs.
"""

import json
from collections.abc import Mapping
from typing import Any

from bench.plan.expansion import REALITY, Plan, expand
from bench.plan.keys import Setting, nested
from bench.plan.planned_run import Run
from bench.plan.settings import build, describe_fields, flatten
from bench.plan.suite import Row, Suite
from bench.text.errors import UsageError
from simulators import registry


def planned(row: Mapping[str, Any], simulator: str) -> tuple[Plan, Run]:
    """The plan of a row with its parents, and the run of the row in it.

    Args:
        row: A row of the table `runs`.
        simulator: Where it was deployed.

    Raises:
        UsageError: It cannot be planned, e.g. because its method is not installed.
    """
    try:
        stored = json.loads(row["settings"])
        stored = {kind: dict(stored[kind]) for kind in ("method", "task")}
    except (ValueError, KeyError, TypeError) as error:
        raise UsageError(f"{row['run']}: its settings cannot be read ({error}).") from error
    residual = {"residual": row["residual"]} if row["residual"] else {}
    asked = Row(
        row["method"],
        row["residual"],
        settings=_changed("method", row["method"], stored["method"], residual),
        task_settings=_changed("task", row["task"], stored["task"], {"n_drones": row["team_size"]}),
        simulator="" if simulator == REALITY else simulator,
    )
    suite = Suite(
        name="submission",
        description="One row.",
        tasks=(row["task"],),
        team_sizes=(int(row["team_size"]),),
        seeds=1,
        methods=(asked,),
        first_seed=int(row["seed"]),
    )
    plan = expand(suite)
    (run,) = (r for r in plan.runs if r.method == row["method"] and r.residual == row["residual"])
    return plan, run


def other_key(row: Mapping[str, Any], run: Run) -> str:
    """Why a run is not the one of its row, as a sentence; empty if the keys are the same."""
    if run.key == row["key"]:
        return ""
    then: dict[str, str] = json.loads(row["versions"])
    now: Mapping[str, Any] = run.resolved["versions"]  # pyright: ignore[reportAssignmentType]
    differing = [
        f"{name} is version {now[name]} here and {then[name]} there"
        for name in sorted(now.keys() & then.keys())
        if now[name] != then[name]
    ]
    if row["variant"] != run.variant:
        differing.append(f"its settings are '{run.variant}' here and '{row['variant']}' there")
    device = row["device"].partition(" ")[0]
    numerics: Mapping[str, Any] = run.resolved["numerics"]  # pyright: ignore[reportAssignmentType]
    if device and device != numerics["backend"]:
        differing.append(f"JAX computes on {numerics['backend']} here and on {device} there")
    reason = ", ".join(differing) or "something that its row does not keep, such as a parent"
    return f"{row['run']} is another run in this installation: {reason}."


def _changed(
    kind: str, name: str, stored: Mapping[str, Setting], given: Mapping[str, Setting]
) -> dict[str, Setting]:
    """The settings of a plug-in that are not its defaults, as a suite writes them."""
    where = f"The {kind} '{name}'"
    try:
        default = build(registry.load(kind, name), {}, where, **given)
    except (registry.UnknownPluginError, registry.BrokenPluginError) as error:
        raise UsageError(f"{error} Install the package that has it.") from error
    usual = flatten(describe_fields(default, where))
    different = {
        key: value
        for key, value in flatten(stored).items()
        if key not in given and value != usual.get(key, ...)
    }
    return nested(different)
