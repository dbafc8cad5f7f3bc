"""What the paper says on the way to its main claims, each computed from the tables.

Source: Mednikov and Gal, "Calibrate Once, Fly Any Team" (arXiv 2609.17265), Sec. IV-C, V-A and V-D.
"""

from bench import markdown
from bench.comparison import behind, by_size, pairs, shared, sizes_of, spread, undisturbed
from bench.numbers import MISSING, number, span
from bench.paper_claims import AFFINE, HOTSTART, HYBRID, SCRATCH, SINDY, Claim
from bench.statistics import COUNTED, Entry, estimate, records
from bench.tables import Tables

LONGER = 3.0
"""Fewest epochs of HF scratch for one of hot start, in the paper."""
EPOCHS = 335
"""Most epochs after which the paper's hot start stopped, of 500."""
LARGE = 18
"""Drones of the paper's largest team."""


def side_claims(tables: Tables) -> list[Claim]:
    """Every claim with its verdict."""
    return [_longer(tables), _stops_early(tables), _degrades(tables), _best_at_three(tables)]


def _longer(tables: Tables) -> Claim:
    found = pairs(undisturbed(tables, "epochs"), SCRATCH, HOTSTART)
    ratios = [scratch.mean / hot.mean for _, scratch, hot in found]
    lines = tuple(
        (
            markdown.escape(cell.label),
            number(scratch.mean, 0),
            number(hot.mean, 0),
            number(ratio, 1),
        )
        for (cell, scratch, hot), ratio in zip(found, ratios, strict=True)
    )
    return Claim(
        "HF scratch trains for several times the epochs of hot start",
        "3 to 10 times, median about 6",
        f"{span(min(ratios), max(ratios), 1)} times in {len(ratios)} cells" if ratios else MISSING,
        min(ratios) >= LONGER if ratios else None,
        f"in every cell it takes at least {LONGER:g} times as many, mean over seeds; both stop "
        "where the return no longer rises, or at their limit",
        ("cell", "HF scratch", "hot start", "ratio"),
        lines,
    )


def _stops_early(tables: Tables) -> Claim:
    runs = tables.runs
    mine = runs.loc[(runs["method"] == HOTSTART.method) & (runs["variant"] == "")]
    limited = [row["status"] == "budget" for row in records(mine) if row["status"] in COUNTED]
    values = undisturbed(tables, "epochs")
    epochs = [x for n in sizes_of(values) for x in by_size(values, HOTSTART, n)]
    return Claim(
        "Hot start stops well before its 500 epochs",
        f"after 115 to {EPOCHS} epochs in all runs",
        f"after {spread(epochs)} epochs, {sum(limited)} of {len(limited)} runs at their limit"
        if epochs
        else MISSING,
        max(epochs) <= EPOCHS if epochs else None,
        f"no run takes more than {EPOCHS} epochs",
        (),
        (),
    )


def _degrades(tables: Tables) -> Claim:
    entries = (SCRATCH, HOTSTART, HYBRID)
    values = shared(undisturbed(tables, "reward"), entries)
    smallest = min(sizes_of(values), default=LARGE)
    mean = {
        (e, n): estimate(by_size(values, e, n)).mean for e in entries for n in (smallest, LARGE)
    }
    lost = {e: 100.0 * behind(mean[e, LARGE], mean[e, smallest]) for e in entries}
    known = smallest < LARGE and all(by_size(values, e, LARGE) for e in entries)
    text = ", ".join(
        f"{name} {number(lost[e], 0)} %"
        for e, name in ((SCRATCH, "scratch"), (HOTSTART, "hot start"), (HYBRID, "Hybrid"))
    )
    return Claim(
        f"Towards N = {LARGE} HF-trained policies degrade sharply, Hybrid mildly",
        "by its figure",
        f"mean return lower than at N = {smallest} by: {text}" if known else MISSING,
        lost[HYBRID] < min(lost[SCRATCH], lost[HOTSTART]) if known else None,
        f"from the smallest team to N = {LARGE} the mean return over tasks falls by the smallest "
        "share for Hybrid (grids, rings and spheres grow with the team, so that it falls for all)",
        (),
        (),
    )


def _best_at_three(tables: Tables) -> Claim:
    classes = (AFFINE, SINDY, HYBRID)
    values = shared(undisturbed(tables, "reward"), classes)
    sample: dict[Entry, list[float]] = {e: by_size(values, e, 3) for e in classes}
    mean = {e: estimate(sample[e]).mean for e in classes}
    known = all(sample.values())
    return Claim(
        "At N = 3 SINDy has the highest mean return of the residual classes",
        "SINDy, the classes being comparable",
        ", ".join(f"{e.residual} {number(mean[e], 1)}" for e in classes) if known else MISSING,
        mean[SINDY] == max(mean.values()) if known else None,
        "its mean deployed return over tasks and seeds at N = 3 is the highest; no test over seeds",
        (),
        (),
    )
