"""Which runs of a plan a store holds, which are missing and why; it only reads."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from bench.plan.planned_run import Run
from bench.plan.settings import flatten
from bench.store.resume import failed_row, finished_rows, outdated_rows
from bench.store.store import Store, UnreadableRunError
from bench.store.tables import IDENTITY, Tables

MOST_CHANGES = 3
"""Changes that a reason names before it only counts them."""
LONGEST_VALUE = 24
"""Characters of a changed value that are shown."""


class State(NamedTuple):
    """A planned run and what the store has of it."""

    run: Run
    content: Mapping[str, Any] | None
    """Content of run.json if the run is finished; of a row whose folder is gone, its name."""
    reason: str
    """Why it is missing; empty if it is finished."""
    failed: bool = False
    """Whether it failed by itself, so that it is tried again only if asked for."""


def states(runs: list[Run], store: Store, recorded: Tables) -> list[State]:
    """The state of each of `runs`; nothing is moved or written, not even what is damaged."""
    finished, outdated = finished_rows(recorded), {*outdated_rows(runs, recorded).values()}
    causes = recorded.column("cause")
    by_prefix: dict[str, list[str]] = {}
    for name in store.names():
        by_prefix.setdefault(name.rpartition("-")[0], []).append(name)

    def state(run: Run) -> State:
        alike = by_prefix.get(run.name.rpartition("-")[0], [])  # without its key
        if run.name in finished:
            return State(run, {"run": run.name}, "")
        if run.name in alike:
            return _of_folder(run, store, causes)
        if (content := failed_row(run.name, causes)) is not None:
            return _failed(run, content)
        older = [found for name in alike if (found := _same(run, store, name)) is not None]
        if older:
            latest = max(older, key=lambda content: content["committed"])
            return State(run, None, f"changed: {_changes(latest['resolved'], run.resolved)}")
        if run.name in outdated:
            return State(run, None, "changed: its row is of another program, see `--replace`")
        return State(run, None, "never run")

    return [state(run) for run in runs]


def _of_folder(run: Run, store: Store, causes: Mapping[str, str]) -> State:
    """What a folder says of its run; where it is damaged, what a row says of a failure."""
    try:
        content = store.read(run.name)
    except UnreadableRunError as error:
        row = failed_row(run.name, causes)
        return _failed(run, row) if row else State(run, None, f"damaged: {error}")
    return _failed(run, content) if content["status"] == "failed" else State(run, content, "")


def _failed(run: Run, content: Mapping[str, Any]) -> State:
    """What was interrupted is tried again; what failed by itself only with --retry-failed."""
    interrupted = content["interrupted"]
    ended = "interrupted" if interrupted else "failed"
    return State(run, None, f"{ended}: {content['cause']}", not interrupted)


def _same(run: Run, store: Store, name: str) -> dict[str, Any] | None:
    """The run.json of the run called `name` if it is finished and has the identity of `run`."""
    if (content := store.content(name)) is None:
        return None
    same = all(content[column] == getattr(run, column) for column in IDENTITY)
    return content if same and content["status"] != "failed" else None


def _changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    """What differs between two records of everything that determines a result."""
    before, after = flatten(old), flatten(new)
    changes = []
    for path in sorted({*before, *after}):
        if before.get(path) == after.get(path):
            continue
        section, *rest = path.split(".")
        if section == "parents":
            changes.append(f"its parent {rest[0]} is another run")
            continue
        owner = {"versions": "version of ", "defaults": f"{rest[0]}'s " if rest else ""}
        name = owner.get(section, "") + ".".join(rest[1:] if section == "defaults" else rest)
        changes.append(f"{name or section} {_text(before, path)} -> {_text(after, path)}")
    more = len(changes) - MOST_CHANGES
    return "; ".join(changes[:MOST_CHANGES]) + (f"; {more} more" if more > 0 else "")


def _text(flat: Mapping[str, Any], path: str) -> str:
    if path not in flat:
        return "absent"
    text = json.dumps(flat[path])
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."
