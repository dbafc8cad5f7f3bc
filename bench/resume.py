"""What of a plan is in the store, and what is still to do."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from bench.plan import Plan, Run


@dataclasses.dataclass(frozen=True)
class Standing:
    """The runs of a plan, each in one of three lists, in the plan's order."""

    done: list[Run]
    """Finished."""
    failed: list[Run]
    """Failed by themselves, so that they would fail again; not tried again."""
    missing: list[Run]
    """To do: not there, interrupted, or failed and to be tried again."""


def make_standing(plan: Plan, sound: Mapping[str, dict], retry_failed: bool) -> Standing:
    """How far a plan is.

    A run that failed from outside (its worker was killed, or its parent failed) is interrupted: it
    is tried again in any case.

    Args:
        plan: What should be there.
        sound: Content of run.json of every sound run, by name.
        retry_failed: Whether failed runs are tried again.
    """
    standing = Standing([], [], [])
    for run in plan.runs:
        content = sound.get(run.name)
        if content is None:
            standing.missing.append(run)
        elif content["status"] != "failed":
            standing.done.append(run)
        elif retry_failed or was_interrupted(content):
            standing.missing.append(run)
        else:
            standing.failed.append(run)
    return standing


def was_interrupted(content: Mapping[str, Any]) -> bool:
    """Whether a failed run ended from outside and is tried again; older files do not say."""
    return content.get("interrupted", True)


def stale_lines(done: Sequence[Run], sound: Mapping[str, dict]) -> list[str]:
    """A line for each plug-in or shared module that changed without a version since a run."""
    changed: dict[str, int] = {}
    for run in done:
        for plugin, source in run.sources.items():
            if sound[run.name]["sources"].get(plugin, source) != source:
                changed[plugin] = changed.get(plugin, 0) + 1
    return [_stale(name, count) for name, count in sorted(changed.items())]


def _stale(name: str, count: int) -> str:
    shared = name.startswith("module ")
    said = "no version tells" if shared else "its version has not"
    owner = "the `version` of what uses it" if shared else "its `version`"
    return (
        f"the source of {name} has changed but {said}; {count} stored runs are used as they are. "
        f"Change {owner} to run them again."
    )
