"""`bench choose`: the method that suits a team size and a budget of flight."""

from pathlib import Path

from bench.cli.checks import check_tables
from bench.text.errors import UsageError


def choose(directory: Path, /, *, team_size: int, budget: float, task: str = "") -> int:
    """Say which method to choose for a team size and a budget of high-fidelity flight.

    Of the methods whose mean bill is at most the budget and that flew every task, the one with the
    highest mean score, and those that are not shown to be worse.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/paper.
    team_size
        Number of drones.
    budget
        High-fidelity flight that may be spent [fleet-minutes].
    task
        The one task to fly; without it, scores are means over all tasks.
    """
    if not budget >= 0.0:
        raise UsageError(f"`--budget` must be at least 0 fleet-minutes, got {budget}.")
    check_tables(directory)
    from rich.console import Console

    from bench.stats.choices import better_settings, on_task
    from bench.stats.choices import choose as find
    from bench.store.tables import Tables
    from bench.text.numbers import number, significant
    from bench.text.say import say

    tables, console = Tables.load(directory), Console()
    if task:
        flown = sorted({*tables.runs["task"]})
        if task not in flown:
            raise UsageError(f"{directory} has no runs of '{task}'; its tasks: {', '.join(flown)}.")
        tables = on_task(tables, task)
    found = find(tables, team_size, budget)
    if found is None:
        sizes = ", ".join(map(str, sorted({*tables.runs["team_size"]})))
        raise UsageError(
            f"{directory} has no scored method for {team_size} drones and {budget:g} "
            f"fleet-minutes. It has runs with these numbers of drones: {sizes}."
        )
    say(console, f"N = {team_size}, up to {budget:g} fleet-minutes: {found.best.label}.")
    say(
        console,
        f"It needs {significant(found.minutes)} fleet-minutes. Its mean score is "
        f"{number(found.score, 3)} on {', '.join(found.tasks)} "
        "(0: a team that stays at its spawn, 1: the upper reference).",
    )
    for tie in found.tied:
        say(
            console,
            f"Not shown to be worse: {tie.entry.label}, score {number(tie.score, 3)}, at most "
            f"{significant(tie.high)} below.",
        )
    for b in better_settings(tables):
        if b.team_size == team_size and b.minutes <= budget and b.score > found.score:
            say(
                console,
                f"With other settings: {b.entry.label} on {', '.join(b.tasks)} "
                f"({b.entry._replace(variant='').label} elsewhere), score {number(b.score, 4)}, "
                f"{significant(b.minutes)} fleet-minutes. It was found by comparing many settings "
                "on these tables, so the score is a little too good.",
            )
    return 0
