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

    from bench.report.answer import chosen
    from bench.stats.choices import choose as find
    from bench.stats.choices import on_task
    from bench.store.tables import Tables
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
            f"fleet-minutes. It has runs with these numbers of drones: {sizes}. A score needs runs "
            "of `upper_reference`, and two seeds of a method."
        )
    for line in chosen(found, tables):
        say(console, line)
    return 0
