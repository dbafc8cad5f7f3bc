"""The paper's claims on how many calibration flights a Hybrid needs (Sec. V-B), from the tables.

Hybrids of few flights stand beside the one of the whole pool, 60 (N + 1) flights, and beside the LF
baseline, which is a Hybrid of none.
"""

import math
import re
from collections.abc import Callable, Collection

from bench import markdown
from bench.comparison import behind, undisturbed
from bench.numbers import MISSING, mean_std, number, span
from bench.paper_claims import HYBRID, LF, Claim
from bench.statistics import Cell, Estimate, cell_of, entry_of, estimate, matched, records
from bench.tables import Tables

ENOUGH = 0.15
"""Share of the whole pool's return by which a Hybrid of few flights may be behind."""
CIRCLE = 0.10
"""The same on circle with 8 flights."""
FEW = re.compile(r"flights=\d+")
"""Variant of a Hybrid of which nothing differs but the number of flights."""

Sweep = dict[Cell, dict[int, list[float]]]
"""By cell and number of flights, for each seed: by how much more it returns than the whole pool's
Hybrid does on average, as a share of the latter."""
Shares = dict[int, Estimate]
"""The same over seeds, in one cell."""


def calibration_claims(tables: Tables) -> list[Claim]:
    """Every claim with its verdict; none where the number of flights was not varied."""
    sweep = {
        cell: {k: estimate(shares) for k, shares in found.items()}
        for cell, found in calibration_sweep(tables).items()
    }
    if not sweep:
        return []
    return [_enough(sweep), _circle(sweep), *_uncorrected(sweep), _scatter(sweep)]


def calibration_sweep(tables: Tables) -> Sweep:
    """Deployed return against flights, in each cell with a whole pool's Hybrid and one of few."""
    flights = {
        (cell_of(row), entry_of(row)): row["calibration_flights"]
        for row in records(tables.results.drop_duplicates("run"))
    }
    found: Sweep = {}
    for cell, entries in undisturbed(tables, "reward").items():
        few = {e for e in entries if e._replace(variant="") == HYBRID and FEW.fullmatch(e.variant)}
        if few and HYBRID in entries:
            swept = [e for e in (LF, *few, HYBRID) if e in entries]
            shares = {flights[cell, e]: _relative(entries[e], entries[HYBRID]) for e in swept}
            found[cell] = dict(sorted(shares.items()))
    return found


def _relative(ours: dict[int, float], whole: dict[int, float]) -> list[float]:
    mine, theirs = matched(ours, whole)
    base = estimate(theirs.values()).mean
    return [-behind(value, base) for value in mine.values()]


def _enough(sweep: dict[Cell, Shares]) -> Claim:
    budgets = sorted({k for shares in sweep.values() for k in shares})
    known = [shares[32].mean for shares in sweep.values() if 32 in shares]
    lines = tuple(
        (
            markdown.escape(cell.label),
            *(_percent(shares[k], shares[max(shares)]) if k in shares else "" for k in budgets),
            _saturated(shares),
        )
        for cell, shares in sweep.items()
    )
    return Claim(
        "32 calibration flights come close to the whole pool, whatever the team size",
        "within roughly 10 to 15 % on all four tasks at N = 3, 7 and 12",
        f"within {100 * ENOUGH:.0f} % in {sum(x >= -ENOUGH for x in known)} of {len(known)} cells; "
        f"{number(100.0 * min(known), 1)} % in the worst"
        if known
        else MISSING,
        min(known) >= -ENOUGH if known else None,
        f"with 32 flights the mean reward lies at most {100 * ENOUGH:.0f} % of the whole pool's "
        "below it in every cell; the table says by how much of the whole pool's [%] the reward is "
        "higher with so many flights (0: the LF baseline), ± one standard deviation over seeds "
        "(n: seeds, where some were lost), and from how many flights on it is never more than "
        f"{100 * ENOUGH:.0f} % below",
        ("cell", *(f"{k}" for k in budgets), "enough from"),
        lines,
    )


def _saturated(shares: Shares) -> str:
    """The fewest flights from which on no more make a difference that counts."""
    poor = [k for k, share in shares.items() if not share.mean >= -ENOUGH]
    better = [k for k in shares if k > max(poor, default=-1)]
    return str(min(better)) if better else MISSING


def _circle(sweep: dict[Cell, Shares]) -> Claim:
    known = {c: s[8].mean for c, s in sweep.items() if c.task == "circle" and 8 in s}
    return Claim(
        "On circle 8 calibration flights are nearly enough",
        "within roughly 10 % at every team size (a single flight at N = 3)",
        ", ".join(f"{number(100.0 * x, 1)} % at N = {c.team_size}" for c, x in known.items())
        or MISSING,
        min(known.values()) >= -CIRCLE if known else None,
        f"with 8 flights the mean reward on circle lies at most {100 * CIRCLE:.0f} % of the whole "
        "pool's below it at every team size",
        (),
        (),
    )


def _uncorrected(sweep: dict[Cell, Shares]) -> list[Claim]:
    short = {cell: -100.0 * shares[0].mean for cell, shares in sweep.items() if 0 in shares}
    tasks = sorted({cell.task for cell in short})
    grows = {}
    for task in tasks:
        by_size = sorted((cell.team_size, x) for cell, x in short.items() if cell.task == task)
        if len(by_size) > 1:
            grows[task] = by_size[-1][1] > by_size[0][1]
    largest = ", ".join(
        f"{number(x, 0)} % on {cell.task} at N = {cell.team_size}"
        for cell, x in sorted(short.items(), key=lambda item: -item[1])[:2]
    )
    return [
        Claim(
            "Without a residual the LF baseline trails the whole pool's Hybrid",
            "by 18 to 164 %",
            f"by {_range(short.values())} %" if short else MISSING,
            min(short.values()) > 0.0 if short else None,
            "its mean reward is lower in every cell",
            (),
            (),
        ),
        Claim(
            "That gap expands with team size",
            "161 % on figure8 and 164 % on circle at N = 12",
            f"larger for the largest team in {sum(grows.values())} of {len(grows)} tasks; most: "
            f"{largest}"
            if grows
            else MISSING,
            all(grows.values()) if grows else None,
            "on each task it is larger for the largest team than for the smallest; no test over "
            "seeds",
            (),
            (),
        ),
    ]


def _scatter(sweep: dict[Cell, Shares]) -> Claim:
    large = {c: s for c, s in sweep.items() if c.task == "figure8" and c.team_size >= 7}
    before = {c: _spreads(s, lambda k: 0 < k < 32) for c, s in large.items()}
    after = {c: _spreads(s, lambda k: 32 <= k <= 64) for c, s in large.items()}
    cells = [c for c in large if before[c] and after[c]]
    text = "; ".join(
        f"N = {c.team_size}: {_range(before[c])} points below 32 flights, {_range(after[c])} from "
        "32 to 64"
        for c in cells
    )
    return Claim(
        "On figure8 seeds scatter widely with fewer than 32 calibration flights, less with more",
        "30 to 110 points at N >= 7, narrower from 32 to 64 flights",
        text or MISSING,
        all(max(after[c]) < max(before[c]) for c in cells) if cells else None,
        "the largest standard deviation over seeds is smaller from 32 to 64 flights than below, at "
        "every team size from 7; points are percent of what the whole pool's Hybrid returns",
        (),
        (),
    )


def _spreads(shares: Shares, chosen: Callable[[int], bool]) -> list[float]:
    stds = [100.0 * share.std for k, share in shares.items() if chosen(k)]
    return [x for x in stds if math.isfinite(x)]


def _range(points: Collection[float]) -> str:
    return span(min(points), max(points), 0)


def _percent(share: Estimate, whole: Estimate) -> str:
    lost = f" (n = {share.n})" if share.n < whole.n else ""
    return mean_std(100.0 * share.mean, 100.0 * share.std) + lost
