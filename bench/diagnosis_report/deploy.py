"""What a diagnosis is worth to a team: policies trained in the corrected simulator, deployed.

In a simulated reality (`crazyflow+mass(e=0.2)+wind(x=1)`) the same task is trained four ways: in
the nominal point mass, in the point mass with the effects that the diagnosis identified from three
flights there, with a black-box residual, and in the reality itself from a hot start. All four are
deployed in that reality from the same initial states. The gap that counts is the one between the
settled rewards of the nominal policy and the hot start.
"""

from collections.abc import Mapping
from pathlib import Path

from rich.console import Console

from bench.diagnosis_report.documents import check_place
from bench.execution.sweep import INTERRUPTED, sweep
from bench.plan.expansion import expand
from bench.plan.realities import parse_reality, written
from bench.plan.suite import Row, Suite
from bench.stats.leaderboard_rows import leaderboard_rows
from bench.stats.scores import PRIMARY
from bench.stats.statistics import REALITY, Cell, Entry, seed_values
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.markdown import text_table
from bench.text.numbers import MISSING, number, seconds
from bench.text.pages import write_text
from bench.text.say import say
from simulators.effects.chain import canonical

WAYS = (Entry("lf_baseline"), Entry("grey_box"), Entry("hybrid", "mlp"), Entry("hf_hotstart"))
"""Methods and residuals that are compared; the first is the parent of the others."""
NAME = "deploy.md"
"""Page that a sweep's own documents stand beside."""
HEADINGS = (
    *("trained by", "settled reward", "gap closed", "reward", "crashes"),
    *("HF fleet-minutes", "training time", "runs"),
)


def deploy(task: str, reality_text: str, team_size: int, seeds: int, out: Path) -> int:
    """Trains and deploys all ways by a sweep in the folder `out`, and writes deploy.md there.

    Raises:
        UsageError: The reality is not understood, a number is out of range, or `out` cannot be
            written to.
    """
    if seeds < 1 or team_size < 2:
        raise UsageError(
            f"`--seeds` must be 1 or more and `--team-size` 2 or more, got {seeds} and {team_size}."
        )
    reality = parse_reality(reality_text)
    check_place(out, (NAME,))
    # A suite must not name the world in which policies are deployed anyway.
    elsewhere = "" if written(reality) == REALITY else reality_text
    rows = [Row(way.method, way.residual, reality=elsewhere) for way in WAYS[1:]]
    rows = (Row(WAYS[0].method, deployed_in=elsewhere), *rows)
    about = "What a diagnosis is worth to a team."
    plan = expand(Suite("deploy", about, (task,), (team_size,), seeds, rows))
    status = sweep(plan, out, out, None, replace=True)
    if status != INTERRUPTED:
        tables = Tables.load(out).of_runs({run.name for run in plan.runs})
        cell = Cell(task, team_size, reality.name, canonical(reality.effects))
        write_text(out / NAME, document(tables, cell))
        say(Console(), f"Written: {out / NAME}")
    return status


def document(tables: Tables, cell: Cell) -> str:
    """What each way gains in a cell, as Markdown."""
    rows = {_way(r["entry"]): r for r in leaderboard_rows(tables) if r["cell"] == cell}
    returns = seed_values(tables.results, PRIMARY).get(cell, {})
    shares = closed({_way(entry): own for entry, own in returns.items()})
    lines = [
        (
            way.label,
            number(row["reward"].mean, 1),
            f"{100 * shares[way]:.0f} %" if way in shares else MISSING,
            number(row["metrics"]["reward"], 1),
            number(row["metrics"]["crashes"], 2),
            number(row["metrics"]["fleet_minutes"], 1),
            seconds(row["metrics"]["train_seconds"]),
            row["runs"],
        )
        for way, row in sorted(rows.items(), key=lambda item: WAYS.index(item[0]))
    ]
    trained_in = tables.results.loc[tables.results["method"].eq("grey_box"), "trained_effects"]
    identified = sorted(set(trained_in) - {""})
    about = (
        "Means over seeds. Gap closed: 0 % is the nominal policy, 100 % the hot start; where that "
        "is no better there is no gap."
    )
    if any(row["entry"].variant and row["entry"].method == WAYS[0].method for row in rows.values()):
        about += (
            " The nominal policy was not trained for this reality, so its training is not billed."
        )
    parts = [
        f"# {cell.label}",
        about,
        text_table(HEADINGS, lines),
        "Identified effects: " + ("; ".join(f"`{text}`" for text in identified) or "none"),
    ]
    return "\n\n".join(parts) + "\n"


def closed(returns: Mapping[Entry, Mapping[int, float]]) -> dict[Entry, float]:
    """Share of the gap from the first of `WAYS` to the last that each closes, over common seeds.

    Ways without such seeds are left out, and all whose hot start is no better.
    """
    low, high = returns.get(WAYS[0], {}), returns.get(WAYS[-1], {})
    found = {}
    for way, own in returns.items():
        common = set(own) & set(low) & set(high)
        gap = sum(high[seed] - low[seed] for seed in common)
        if gap > 1e-9:
            found[way] = sum(own[seed] - low[seed] for seed in common) / gap
    return found


def _way(entry: Entry) -> Entry:
    """The entry without the world that its variant names."""
    return entry._replace(variant="")
