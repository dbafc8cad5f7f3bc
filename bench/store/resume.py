"""Which runs of a plan are in the store, and which are still to do."""

import dataclasses
import json
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any

from bench.plan.expansion import Plan, packages
from bench.plan.planned_run import Run
from bench.plan.provenance import provenance
from bench.store.record import Outcome
from bench.store.tables import INTERRUPTED, Tables
from bench.text.words import count, join
from simulators import registry

REPRODUCED = 1e-5
"""Relative difference up to which a number counts as the same: what is left of 32-bit rounding in
a mean over 64 episodes. The same program on the same processor gives the same bits."""
NAMED = 6
"""Names in a warning; of more, the number is said."""


@dataclasses.dataclass(frozen=True)
class Standing:
    """The runs of a plan, each in one of three lists, in the plan's order."""

    done: list[Run]
    """Finished."""
    failed: list[Run]
    """Failed by themselves, so that they would fail again; not tried again."""
    missing: list[Run]
    """To do: not there, interrupted, or failed and to be tried again."""
    again: list[Run]
    """Finished runs that are trained again, because their folder is gone and a missing run needs
    them as parents; they must reproduce their row. An earlier attempt at this may have failed."""
    restored: list[Run]
    """Further such parents, which are restored from their kept policy instead."""
    outdated: dict[str, str]
    """Rows of another program for runs of the plan: name of the row -> name of the run."""


def make_standing(
    plan: Plan,
    sound: Mapping[str, dict],
    recorded: Tables,
    retry_failed: bool = False,
    replace: bool = False,
    kept: Callable[[Run], Outcome | None] = lambda run: None,
) -> Standing:
    """How far a plan is. Tables are the record, folders of runs a cache.

    A run that failed from outside (its worker was killed, or its parent failed) is interrupted: it
    is tried again in any case.

    Args:
        plan: What should be there.
        sound: Content of run.json of every sound run, by name.
        recorded: The tables that are there.
        retry_failed: Whether failed runs are tried again.
        replace: Whether runs whose row is of another program or machine are done again.
        kept: What can be restored of a run from its kept policy.
    """
    standing = Standing([], [], [], [], [], outdated_rows(plan.runs, recorded))
    by_name = {run.name: run for run in plan.runs}
    rows = finished_rows(recorded)
    if replace:
        foreign = with_children(foreign_rows(plan, recorded), plan.runs) & rows
        standing.outdated.update({name: name for name in foreign})
        rows -= foreign
        sound = {n: c for n, c in sound.items() if n not in foreign or made_by(by_name[n], c)}
    causes = recorded.column("cause")
    for run in plan.runs:
        content = sound.get(run.name) or failed_row(run.name, causes)
        if run.name in rows or (content is not None and content["status"] != "failed"):
            standing.done.append(run)
        elif content is None or retry_failed or content["interrupted"]:
            standing.missing.append(run)
        else:
            standing.failed.append(run)
    _add_lost_parents(standing, by_name, sound, kept)
    return standing


def with_children(names: Collection[str], runs: Iterable[Run]) -> set[str]:
    """`names` and all runs that start from them, directly or not; `runs` has parents first."""
    found = set(names)
    for run in runs:
        if not found.isdisjoint(run.parents.values()):
            found.add(run.name)
    return found


def resumed_names(runs: Iterable[Run]) -> frozenset[str]:
    """Names of the runs whose residual some run of `runs` starts from."""
    return frozenset(run.parents[name] for run in runs for name in resumed_methods(run))


def resumed_methods(run: Run) -> tuple[str, ...]:
    """Methods of the parents whose residual a run starts from; a run that deploys needs none."""
    return () if run.deploys else registry.load("method", run.method).resumes_from


def _add_lost_parents(
    standing: Standing,
    by_name: Mapping[str, Run],
    sound: Mapping[str, dict],
    kept: Callable[[Run], Outcome | None],
) -> None:
    """Adds finished parents of missing runs from whose folder no child could start."""
    done, resumed = {run.name for run in standing.done}, resumed_names(standing.missing)
    wanted = [by_name[name] for run in standing.missing for name in run.parents.values()]
    while wanted:
        run = wanted.pop()
        # The row may be of an earlier attempt than the folder, which then holds a failure.
        content = sound.get(run.name, {"status": "failed"})
        bare = run.name in resumed and "residual.npz" not in content.get("files", ())
        lost = run.name in done and (content["status"] == "failed" or bare)
        if run in standing.again or run in standing.restored or not lost:
            continue
        left = (outcome := kept(run)) and outcome.trained
        if left and (left.residual is not None or run.name not in resumed):
            standing.restored.append(run)
        else:
            standing.again.append(run)
            wanted += [by_name[name] for name in run.parents.values()]


def finished_rows(recorded: Tables) -> set[str]:
    """Names of the runs whose row says that they did not fail, with a folder or without."""
    return {run for run, status in recorded.column("status").items() if status != "failed"}


def outdated_rows(runs: Iterable[Run], recorded: Tables) -> dict[str, str]:
    """Finished rows of another program for some of `runs`: name of the row -> name of the run."""
    identities, finished = recorded.identities(), finished_rows(recorded)
    rows = {identities.get(run.identity): run.name for run in runs}
    return {row: run for row, run in rows.items() if row in finished and row != run}


def failed_row(name: str, causes: Mapping[str, str]) -> dict[str, Any] | None:
    """What the row of a run whose folder is gone says of its failure; None without such a row.

    Args:
        name: The run.
        causes: Causes of failed runs by name, empty for those that did not fail.
    """
    if not (cause := causes.get(name)):
        return None
    return {
        "status": "failed",
        "cause": cause.removeprefix(INTERRUPTED),
        "interrupted": cause.startswith(INTERRUPTED),
    }


def foreign_rows(plan: Plan, recorded: Tables) -> set[str]:
    """Planned runs whose row another program or machine made, under the same key.

    Other versions of the packages make another program, too.
    """
    programs, machines = recorded.column("program"), recorded.column("machine")
    versions, here, now = recorded.column("versions"), provenance()["machine"], packages()

    def foreign(run: Run) -> bool:
        then = json.loads(versions[run.name] or "{}")
        same = all(then.get(name, version) == version for name, version in now.items())
        return (programs[run.name], machines[run.name]) != (run.program, here) or not same

    return {run.name for run in plan.runs if run.name in programs and foreign(run)}


def made_by(run: Run, content: Mapping[str, Any]) -> bool:
    """Whether the folder of a run was made by this program on this machine."""
    made = (content["program"], content["provenance"]["machine"])
    return made == (run.program, provenance()["machine"])


def reproduces(found: Mapping[str, float], row: Mapping[str, float]) -> str:
    """Why a run that was trained again is not the run of its row; empty if it is."""
    for metric in ("settled_reward", "reward", "training_reward"):
        new, old = found.get(metric, math.nan), row.get(metric, math.nan)
        if not math.isclose(new, old, rel_tol=REPRODUCED) and not (new != new and old != old):
            return (
                f"trained again, its {metric} is {new:.6g}, its row says {old:.6g}; give --replace "
                "to train it and what starts from it anew"
            )
    return ""


def stale_lines(done: Sequence[Run], recorded: Tables, sound: Mapping[str, dict]) -> list[str]:
    """What changed without a version since runs were made: plug-ins, shared modules, and unknown.

    Of runs whose folder is gone, only their number is known.
    """
    programs = recorded.column("program")
    changed: dict[bool, dict[str, set[str]]] = {False: {}, True: {}}
    gone = 0
    for run in done:
        if not sound.get(run.name, {}).get("sources"):  # the folder is gone or was restored
            gone += programs.get(run.name, run.program) != run.program
            continue
        for name, source in run.sources.items():
            if sound[run.name]["sources"].get(name, source) != source:
                changed[name.startswith("module ")].setdefault(name, set()).add(run.name)
    lines = [_stale(shared, runs) for shared, runs in changed.items() if runs]
    if gone:
        lines.append(f"{gone} rows were made by other source code under the same versions.")
    return lines


def _stale(shared: bool, runs: Mapping[str, set[str]]) -> str:
    """`runs`: of each plug-in or shared module that changed, by its name."""
    names = sorted(runs)
    left = len(names) - NAMED
    said = join([*names[:NAMED], *([f"{left} more"] if left > 0 else [])])
    told = "which no version tells" if shared else "but no `version` has"
    owner = "the `version` of what uses it" if shared else "the `version`"
    used = count(len(set().union(*runs.values())), "stored run")
    return (
        f"the source of {said} has changed, {told}; used as they are: {used}. "
        f"Change {owner} to run them again."
    )
