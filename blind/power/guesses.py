"""What answers hang on those values of `Decision` that are guesses: halved and doubled at random.

    python -m blind.power.guesses --cases 12 --out results/blind/guesses.parquet

Cases are drawn and flown as in `bench blind`, with a seed of their own. Each is diagnosed as it is,
and then `REDRAWN` times with every guess halved, kept or doubled by chance: if no answer changes
then, none hangs on a guess. Where some do, the table shows with which values. The table has a row a
diagnosis; the same call goes on where an earlier one ended.
"""

import argparse
import dataclasses
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from rich.console import Console
from rich.progress import track

from bench.stats.statistics import records
from blind.draw.cases import Case, draw_cases, fly_case, read_back
from diagnosis.decision import Decision
from diagnosis.engine import diagnose
from diagnosis.result import Diagnosis

SEED = 20261130
"""Of the cases; counted draws of simulated flights have seeds of the operating system."""
SHARES = {"single": 5, "pair": 4, "clean": 1, "unknown": 2}
"""Cases of each kind among twelve."""
FACTORS = (0.5, 1.0, 2.0)
"""What a guess is multiplied by."""
REDRAWN = 6
"""Diagnoses of a case with other values."""


def guesses(decision: Decision = Decision()) -> Mapping[str, float]:
    """Fields that nobody has measured, with their values in a decision."""
    fields = dataclasses.fields(decision)
    return {f.name: getattr(decision, f.name) for f in fields if f.metadata["source"] == "guess"}


def redrawn(rng: np.random.Generator) -> Decision:
    """All guesses multiplied by a factor each; a count stays one at least."""
    values: dict[str, float] = {}
    for name, value in guesses().items():
        changed = float(rng.choice(FACTORS)) * value
        values[name] = max(1, round(changed)) if isinstance(value, int) else changed
    return dataclasses.replace(Decision(), **values)


def drawn(n: int) -> list[Case]:
    """The first cases of as many draws of twelve as it takes."""
    cases: list[Case] = []
    while len(cases) < n:
        cases += draw_cases(SHARES, "crazyflow", SEED + len(cases))
    return cases[:n]


def rows_of(number: int, case: Case) -> Iterator[dict[str, object]]:
    """The answer to a case as it is, and with redrawn guesses."""
    flights = read_back([one.logged for one in fly_case(case)])
    told = {"case": number, "kind": case.kind, "flown": " + ".join(x.name for x in case.effects)}
    rng = np.random.default_rng([SEED, number])
    first = diagnose(flights)
    yield {**told, "redrawn": 0, **guesses(), **_answered(first), "moved": 0.0}
    for i in range(REDRAWN):
        decision = redrawn(rng)
        found = diagnose(flights, decision=decision)
        moved = _moved(first, found)
        yield {**told, "redrawn": i + 1, **guesses(decision), **_answered(found), "moved": moved}


def _answered(found: Diagnosis) -> dict[str, object]:
    named = [effect for effect in found.effects if effect.blamed]
    sets = ["/".join(sorted([effect.name, *effect.aliases])) for effect in named]
    return {"verdict": found.verdict, "named": " + ".join(sorted(sets))}


def _moved(first: Diagnosis, other: Diagnosis) -> float:
    """The largest change of a size that both answers give, in half-widths of its interval."""
    sizes = [
        {(e.name, p.name): p for e in found.effects if e.blamed for p in e.parameters}
        for found in (first, other)
    ]
    return max(
        (
            abs(sizes[1][key].value - size.value) / (0.5 * (size.high - size.low))
            for key, size in sizes[0].items()
            if key in sizes[1] and size.low is not None and size.high is not None
        ),
        default=0.0,
    )


def write(table: pd.DataFrame) -> str:
    """Which answers change, and how often by each guess's value, in Markdown."""
    plain = {row["case"]: row for row in records(table.loc[table["redrawn"].eq(0)])}
    others = table.loc[table["redrawn"].gt(0)]
    changed = [
        row
        for row in records(others)
        if any(row[key] != plain[row["case"]][key] for key in ("verdict", "named"))
    ]
    lines = [
        f"{len(changed)} of {len(others)} answers differ. Sizes move by at most "
        f"{others['moved'].max():.2f} half-widths of their intervals.",
        "",
        "| flown | answer | with other values | times |",
        "|---|---|---|---|",
    ]
    counted = Counter((row["case"], row["verdict"], row["named"]) for row in changed)
    for (case, verdict, named), times in counted.items():
        own = plain[case]
        lines.append(
            f"| {own['flown'] or 'nothing'} | {own['verdict']} {own['named']} | "
            f"{verdict} {named} | {times} |"
        )
    lines += ["", "| guess | value: answers that differ |", "|---|---|"]
    for name in guesses():
        parts = [
            f"{value:g}: {sum(row[name] == value for row in changed)} of {n}"
            for value, n in sorted(Counter(others[name]).items())
        ]
        lines.append(f"| `{name}` | {'; '.join(parts)} |")
    return "\n".join(lines)


def main() -> None:
    """Answers what the table lacks, and prints which answers differ."""
    parser = argparse.ArgumentParser(prog="python -m blind.power.guesses", description=__doc__)
    parser.add_argument("--cases", type=int, default=12, help="cases")
    parser.add_argument("--out", type=Path, required=True, help="table of answers")
    given = parser.parse_args()
    table = pd.read_parquet(given.out) if given.out.exists() else pd.DataFrame({"case": []})
    given.out.parent.mkdir(parents=True, exist_ok=True)
    cases = list(enumerate(drawn(given.cases)))
    missing = [one for one in cases if one[0] not in set(table["case"])]
    for number, case in track(missing, "cases", console=Console(stderr=True)):
        table = pd.concat([table, pd.DataFrame([*rows_of(number, case)])], ignore_index=True)
        table.to_parquet(given.out, index=False)
    sys.stdout.write(write(table) + "\n")


if __name__ == "__main__":
    main()
