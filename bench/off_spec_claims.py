"""The paper's claims on a drone that is off its specification (Sec. V-C), computed from the tables.

A Hybrid that is recalibrated there stands beside the LF baseline as it is, a PD controller that
tracks that baseline's paths, and Hybrid as it is.
"""

from bench import markdown
from bench.comparison import behind, duels, pairs, summary, undisturbed
from bench.leaderboard import MISSING, number
from bench.paper_claims import HYBRID, LF, Claim
from bench.statistics import Cell, Entry, Values, seed_values
from bench.tables import Tables

RECALIBRATED = Entry("recalibrated")
TRACKED = Entry("lf_baseline", variant="PD tracking")
CLEAN = Entry("hybrid", "mlp", "on the nominal drone")
NAMES = {
    CLEAN: "Hybrid on the nominal drone",
    RECALIBRATED: "recalibrated",
    HYBRID: "Hybrid as it is",
    LF: "LF baseline as it is",
    TRACKED: "PD tracking",
}
"""What stands beside each other, as figures name it."""
LOST = 0.25
"""Largest share of Hybrid's return on the nominal drone that a recalibrated one may lose; the
paper's largest is -102 for -82."""


def off_spec_claims(tables: Tables) -> list[Claim]:
    """Every claim with its verdict; none where nothing was recalibrated."""
    values = off_spec_values(tables)
    if not values:
        return []
    return [_above(values, LF), _above(values, TRACKED), _kept(values), _tracking(values)]


def off_spec_values(tables: Tables) -> Values:
    """Deployed returns in each world in which something was recalibrated, by what it is there."""
    nominal = undisturbed(tables, "reward")
    found = {}
    for cell, entries in seed_values(tables.results, "reward").items():
        world = f"{cell.simulator}+{cell.deployed_effects}"
        named = {
            RECALIBRATED: entries.get(Entry("recalibrated", variant=f"reality={world}")),
            LF: entries.get(Entry("lf_baseline", variant=f"deployed_in={world}")),
            TRACKED: entries.get(
                Entry("lf_baseline", variant=f"deployed_in={world}, tracked=true")
            ),
            HYBRID: entries.get(Entry("hybrid", "mlp", f"deployed_in={world}")),
            CLEAN: nominal.get(Cell(cell.task, cell.team_size), {}).get(HYBRID),
        }
        if named[RECALIBRATED]:
            found[cell] = {entry: values for entry, values in named.items() if values}
    return found


def _above(values: Values, other: Entry) -> Claim:
    lines, wins = duels(values, RECALIBRATED, other)
    name = "PD tracking" if other == TRACKED else "the LF baseline"
    return Claim(
        f"Recalibrated on the off-spec drone, Hybrid deploys above {name} there",
        "every cell"
        if other == LF
        else "on figure8 by its text; on circle the margin narrows under drag",
        wins.text,
        all(wins.won) if wins.won else None,
        "its mean reward is higher in every cell",
        ("cell", "recalibrated", name, "difference", "95 % t-interval", "verdict"),
        lines,
    )


def _kept(values: Values) -> Claim:
    found = {cell: (ours, clean) for cell, ours, clean in pairs(values, RECALIBRATED, CLEAN)}
    as_is = {cell: theirs for cell, _, theirs in pairs(values, RECALIBRATED, HYBRID)}
    lost = {cell: behind(ours.mean, clean.mean) for cell, (ours, clean) in found.items()}
    lines = tuple(
        (
            markdown.escape(cell.label),
            summary(clean),
            summary(as_is[cell]) if cell in as_is else MISSING,
            summary(ours),
            number(100.0 * lost[cell], 1),
        )
        for cell, (ours, clean) in found.items()
    )
    share = [100.0 * x for x in lost.values()]
    text = f"loses {number(min(share), 1)} to {number(max(share), 1)} %" if share else MISSING
    return Claim(
        "Recalibrated, Hybrid keeps the return that it has on the nominal drone",
        "loses at most 24 % on figure8; on circle 5 to 8 % with more mass, 4 to 16 % in wind",
        text,
        max(lost.values()) <= LOST if lost else None,
        f"its mean reward lies at most {100 * LOST:.0f} % below in every cell",
        ("cell", "nominal drone", "off-spec, as it is", "recalibrated", "lost [%]"),
        lines,
    )


def _tracking(values: Values) -> Claim:
    chosen = {cell: found for cell, found in values.items() if cell.task == "figure8"}
    lines, wins = duels(chosen, TRACKED, LF)
    return Claim(
        "PD tracking trails the uncorrected LF baseline on figure8",
        "every cell",
        f"above in {wins.text}" if wins.won else MISSING,
        not any(wins.won) if wins.won else None,
        "its mean reward is higher in no cell",
        ("cell", "PD tracking", "LF baseline", "difference", "95 % t-interval", "verdict"),
        lines,
    )
