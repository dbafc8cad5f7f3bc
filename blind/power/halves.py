"""How often the check of the interface names a fault in random halves of real flights.

    python -m blind.power.halves FLIGHTS --splits 40 --reference 12 --target 12

Flights are split at random into a reference and a target, a fault is written into the logs of the
target, and the check compares the two. Nothing is simulated. Splits of one set share flights, so
that Clopper-Pearson intervals, which stand for independent splits, are too narrow.
"""

import argparse
import dataclasses
import math
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from blind.draw.catalogue import Parameters
from blind.draw.faults import FAULTS
from blind.score.scoring import proportion
from diagnosis.interface.faults import checks, interface_faults
from diagnosis.logs.flights import FlightSet, load_flights

WRITTEN: Mapping[str, tuple[str, Parameters]] = {
    **{
        f"path turned by {x:g} degrees": ("path_turned_in_yaw", {"angle": math.radians(x)})
        for x in (2.5, 5.0, 10.0)
    },
    **{f"inputs act {x:g} ms later": ("delay", {"seconds": x / 1e3}) for x in (10.0, 20.0, 40.0)},
    **{
        f"inputs act {x:g} ms sooner": ("clock_offset", {"seconds": x / 1e3})
        for x in (20.0, 40.0, 80.0)
    },
    **{
        f"clock of inputs drifts by {x:g} %": ("clock_drift", {"rate": x / 100.0})
        for x in (0.05, 0.1, -0.1, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0)
    },
}
"""Faults of `blind.draw.faults` with their parameters, in words. Each is written into logs that
have the columns for it."""
NOTHING = "nothing"
"""Row of undisturbed halves, in which any part that is named is an alarm."""


def count(flights: FlightSet, splits: int, sizes: tuple[int, int], seed: int) -> Mapping[str, int]:
    """In how many random splits something is named that is right, by the words of `WRITTEN`.

    Splits have as many reference and target flights as `sizes` say.
    """
    rng = np.random.default_rng(seed)
    fitting = {words: one for words, one in WRITTEN.items() if FAULTS[one[0]].fits(flights)}
    named = dict.fromkeys([NOTHING, *fitting], 0)
    for _ in track(range(splits), "checking splits", console=Console(stderr=True)):
        order = [flights.flights[i] for i in rng.permutation(len(flights.flights))]
        before = dataclasses.replace(flights, flights=tuple(order[: sizes[0]]))
        after = dataclasses.replace(flights, flights=tuple(order[sizes[0] : sum(sizes)]))
        then = checks(before)
        named[NOTHING] += bool(interface_faults(after, before, then=then))
        for words, (name, parameters) in fitting.items():
            fault = FAULTS[name]
            found = interface_faults(fault.apply(after, parameters), before, then=then)
            named[words] += any(one.part in fault.parts for one in found)
    return named


def write(named: Mapping[str, int], splits: int) -> str:
    """The table, in Markdown."""
    lines = [f"| {words} | {proportion(k, splits).text()} |" for words, k in named.items()]
    return "\n".join(["| written into the logs | named |", "|---|---|", *lines])


def main() -> None:
    """Prints the table of a flight set."""
    parser = argparse.ArgumentParser(prog="python -m blind.power.halves", description=__doc__)
    parser.add_argument("flights", type=Path, help="folder of logs of one undisturbed vehicle")
    parser.add_argument("--splits", type=int, default=40, help="random splits")
    parser.add_argument("--reference", type=int, default=9, help="reference flights of a split")
    parser.add_argument("--target", type=int, default=9, help="target flights of a split")
    parser.add_argument("--seed", type=int, default=1, help="of the splits")
    given = parser.parse_args()
    sizes = given.reference, given.target
    named = count(load_flights(given.flights), given.splits, sizes, given.seed)
    sys.stdout.write(write(named, given.splits) + "\n")


if __name__ == "__main__":
    main()
