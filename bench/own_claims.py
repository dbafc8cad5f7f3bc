"""What this project claims beyond the paper, each computed from the tables, none typed in.

`grey_box` trains in the point mass with the named effects that a few calibration flights show. Its
aims: no worse than hot start, which trains in the high-fidelity simulator; better than Hybrid; for
at most half a fleet-minute.
"""

from bench import markdown
from bench.comparison import (
    Wins,
    behind,
    by_size,
    duels,
    pairs,
    shared,
    sizes_of,
    spread,
    undisturbed,
)
from bench.leaderboard import MISSING, number
from bench.paper_claims import HOTSTART, HYBRID, Claim
from bench.statistics import Entry, Values, estimate
from bench.tables import Tables

GREY_BOXES = (Entry("grey_box"), Entry("grey_box", "mlp"))
"""The variants."""
BEHIND = 0.05
"""Largest share of hot start's loss by which a cell may be behind it."""
MINUTES = 0.5
"""Most flight for calibration [fleet-minutes]."""


def own_claims(tables: Tables) -> list[Claim]:
    """Every claim with its verdict, for each variant that was run."""
    found = undisturbed(tables, "reward")
    entries = [e for e in GREY_BOXES if any(e in cell for cell in found.values())]
    return [
        claim
        for entry in entries
        for claim in (_hotstart(tables, entry), _hybrid(tables, entry), _minutes(tables, entry))
    ]


def _hotstart(tables: Tables, entry: Entry) -> Claim:
    rewards = undisturbed(tables, "reward")
    lines, wins = duels(rewards, entry, HOTSTART)
    found = pairs(rewards, entry, HOTSTART)
    lag = [behind(ours.mean, hot.mean) for _, ours, hot in found]
    mean = [estimate(s.mean for s in side).mean for side in _sides(found)]
    worst = f"; worst cell {number(-100.0 * max(lag), 1)} %" if found else ""
    holds = bool(found) and mean[0] >= mean[1] and max(lag) <= BEHIND
    means = f"; means {number(mean[0], 1)} and {number(mean[1], 1)}" if found else ""
    return Claim(
        f"{entry.label} deploys at or above hot start",
        f"mean at or above, no cell more than {100 * BEHIND:.0f} % below",
        f"higher in {wins.text}{means}{worst}" if found else MISSING,
        _settled(holds, rewards, wins),
        "the mean over cells of the deployed reward is at least hot start's, and no cell's lies "
        f"more than {100 * BEHIND:.0f} % of its size below",
        _headings(entry, "hot start"),
        lines,
    )


def _settled(holds: bool, rewards: Values, wins: Wins) -> bool | None:
    """`holds`; None where a missing cell, one that both rivals have, may still tell otherwise."""
    both = {cell for cell, found in rewards.items() if {HYBRID, HOTSTART} <= set(found)}
    if not wins.cells or (holds and both - set(wins.cells)):
        return None
    return holds


def _headings(entry: Entry, other: str) -> tuple[str, ...]:
    mine = markdown.escape(entry.label)
    return ("cell", mine, other, "difference", "95 % t-interval", "verdict")


def _sides(found: list) -> tuple[list, list]:
    return [ours for _, ours, _ in found], [theirs for _, _, theirs in found]


def _hybrid(tables: Tables, entry: Entry) -> Claim:
    rewards = undisturbed(tables, "reward")
    lines, wins = duels(rewards, entry, HYBRID)
    return Claim(
        f"{entry.label} deploys above Hybrid in every cell",
        "every cell",
        f"higher in {wins.text}",
        _settled(all(wins.won), rewards, wins),
        "the mean reward is higher in every cell",
        _headings(entry, "Hybrid"),
        lines,
    )


def _minutes(tables: Tables, entry: Entry) -> Claim:
    whole, shown = undisturbed(tables, "fleet_minutes"), (entry, HYBRID, HOTSTART)
    ours = [x for n in sizes_of(whole) for x in by_size(whole, entry, n)]
    values = shared(whole, shown)
    sizes = [n for n in sizes_of(values) if by_size(values, entry, n)]
    mean = {e: estimate(x for n in sizes for x in by_size(values, e, n)).mean for e in shown}
    theirs = f"Hybrid {number(mean[HYBRID], 0)}, hot start {number(mean[HOTSTART], 0)}"
    return Claim(
        f"{entry.label} needs at most {MINUTES:g} fleet-minutes, whatever the task and team",
        f"at most {MINUTES:g}",
        f"{spread(ours, 1)}; {theirs}" if ours else MISSING,
        max(ours) <= MINUTES + 1e-9 if ours else None,
        "no run is billed for more; the flights are the same for every task, team size and seed, "
        "and each run is billed for them in full",
        ("team size", markdown.escape(entry.label), "Hybrid", "hot start"),
        tuple((f"N = {n}", *(spread(by_size(values, e, n), 1) for e in shown)) for n in sizes),
    )
