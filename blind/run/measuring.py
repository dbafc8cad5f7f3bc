"""What cases allow, measured with their labels, in processes that take many cases each.

`python -m blind.run.measuring` takes its settings as one JSON object. It writes a file a case; a
case that fails gets none, its traceback goes to the log, and running again tries it again.
"""

import json
import sys
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from blind.draw.cases import Case, read_labels
from blind.draw.folders import Folders, write_json
from blind.run.children import Task, end, leave_with_parent, python, run_tasks


def unmeasured(folders: Folders, cases: Mapping[str, Case]) -> list[Case]:
    """The cases that were not measured yet."""
    return [case for name, case in cases.items() if not _file(folders, name).is_file()]


def measure_all(
    folders: Folders, cases: list[Case], jobs: int, on_done: Callable[[int], None]
) -> None:
    """Measures cases in `jobs` processes; `on_done` gets the number that is done, now and then."""
    # Cases with as many drones share a compiled program.
    order = sorted(cases, key=lambda case: case.drones)
    size = -(-len(order) // jobs)
    shares = [order[i : i + size] for i in range(0, len(order), size)]
    runs = folders.runs.resolve()

    def task(number: int, share: list[Case]) -> Task:
        settings = {"out": str(folders.out.resolve()), "names": [case.id for case in share]}
        command = python("-m", "blind.run.measuring", json.dumps(settings))
        return Task(str(number), command, runs, runs / "logs" / f"measuring-{number}")

    def count() -> None:
        on_done(sum(_file(folders, case.id).is_file() for case in cases))

    tasks = [task(i, share) for i, share in enumerate(shares)]
    run_tasks(tasks, jobs, lambda _: None, on_poll=count)  # what is missing says more than a status
    count()


def read_measures(folders: Folders, cases: Mapping[str, Case]) -> dict[str, dict[str, Any]]:
    """What was measured, by case."""
    found = {}
    for name in cases:
        path = _file(folders, name)
        if path.is_file():
            found[name] = json.loads(path.read_text(encoding="utf-8"))
    return found


def _file(folders: Folders, name: str) -> Path:
    return folders.measures / f"{name}.json"


def _measure(folders: Folders, names: list[str]) -> int:
    """Exit status: 1 if some case could not be measured."""
    from blind.run.answering import sources_digest
    from blind.score.measures import Workbench, measure  # JAX, only in the child

    program = {"program": sources_digest(with_generator=True)}

    cases = read_labels(folders.labels, Case.of)
    desk = Workbench(folders, folders.read_state()["reality"])
    status = 0
    for name in names:
        try:
            write_json(_file(folders, name), measure(desk, cases[name]) | program)
        except Exception:
            # One case must not cost the others, whatever went wrong.
            print(f"Case {name}:", file=sys.stderr)  # noqa: T201
            traceback.print_exc()
            status = 1
    return status


if __name__ == "__main__":
    leave_with_parent()
    given = json.loads(sys.argv[1])
    end(_measure(Folders(Path(given["out"])), given["names"]))
