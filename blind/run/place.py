"""What each command of the laboratory asks of its folders, and what it says of them at the end."""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, TypeVar

import filelock
from rich.console import Console

from bench.text.errors import UsageError
from blind.draw.cases import read_labels
from blind.draw.folders import Folders

C = TypeVar("C")


def check_request(folders: Folders, seed: int | None, jobs: int | None) -> None:
    """Refuses a seed or a number of processes that cannot be, and a folder that is a file.

    Raises:
        UsageError: One of them is wrong.
    """
    if seed is not None and seed < 0:
        raise UsageError(f"`--seed` must be at least 0, got {seed}.")
    if jobs is not None and jobs < 1:
        raise UsageError(f"`--jobs` must be at least 1, got {jobs}.")
    if folders.out.exists() and not folders.out.is_dir():
        raise UsageError(f"{folders.out} is not a folder, so nothing can be written there.")


def _check_no_tables(folders: Folders) -> None:
    """Refuses a new draw beside the tables of another, whose notes and studies would be mixed.

    Raises:
        UsageError: There are tables.
    """
    if (folders.out / "run.json").is_file():
        raise UsageError(
            f"{folders.out} holds the tables of a draw whose flights are not here. Give "
            "`--out DIR` for a draw of your own, or remove the folder to put another in its place."
        )


def check_draw(
    folders: Folders,
    seed: int | None,
    jobs: int | None,
    asked: Callable[[Mapping[str, Any]], Mapping[str, tuple[Any, str]]],
) -> None:
    """Refuses a request that makes no sense, or a folder that holds another draw or kept tables.

    Args:
        folders: Where the draw is, or will be.
        seed: Of the draw; None for any.
        jobs: Number of processes; None for one a core.
        asked: Of the content of `run.json`: by key, the wanted value, None for any, and a
            description of the draw that is there.

    Raises:
        UsageError: It is refused.
    """
    check_request(folders, seed, jobs)
    if not folders.state.is_file():
        _check_no_tables(folders)
        return
    state = folders.read_state()
    wanted = {**asked(state), "seed": (seed, f"with the seed {state['seed']}")}
    for key, (value, words) in wanted.items():
        if value is not None and state.get(key) != value:
            raise UsageError(
                f"{folders.runs} holds a draw {words}. Give another folder with `--out`."
            )


@contextlib.contextmanager
def alone(folders: Folders) -> Iterator[None]:
    """A context in which no other process works in these folders.

    Raises:
        UsageError: Another process works there.
    """
    folders.runs.mkdir(parents=True, exist_ok=True)
    try:
        with filelock.FileLock(folders.runs / ".lock", timeout=0):
            yield
    except filelock.Timeout as error:
        raise UsageError(f"Another `bench blind` works in {folders.runs}.") from error


def answer_sealed(
    folders: Folders,
    make: Callable[[Mapping[str, Any]], C],
    answer: Callable[[dict[str, C]], None],
    console: Console,
) -> dict[str, C] | None:
    """Lets `answer` answer the cases, and returns them; None if somebody changed the labels.

    The SHA-256 of the labels is checked and printed before the first answer, and checked again
    after the last. `make` makes a case of its label.
    """
    if _tampered(folders, console):
        return None
    sha256 = folders.read_state()["sha256"]
    console.print(f"SHA-256 of the labels: {sha256}", soft_wrap=True, highlight=False)
    cases = read_labels(folders.labels, make, sha256)
    answer(cases)
    if _tampered(folders, console, "Nothing is scored."):
        return None
    console.print("The labels are still those.")
    return cases


def _tampered(folders: Folders, console: Console, consequence: str = "") -> bool:
    """Whether the labels are not those of the draw; prints that, and the consequence."""
    if wrong := folders.tampered():
        console.print(f"[red]{f'{wrong} {consequence}'.strip()}[/]", soft_wrap=True)
    return bool(wrong)


def tell_end(folders: Folders, report: Path, failed: int, n: int, console: Console) -> int:
    """Exit status: 1 if diagnoses failed; says how many of `n`, and where tables and report are."""
    if failed:
        console.print(f"[red]{failed} of {n} diagnoses failed; the report names them.[/]")
    console.print(f"Tables: {folders.out}\nReport: {report}", soft_wrap=True, highlight=False)
    return 1 if failed else 0
