"""How often the check of the interface names a fault in random halves of real flights.

    python -m blind.power.halves FLIGHTS --splits 40 --reference 12 --target 12

Flights are split at random into a reference and a target, a fault is written into the logs of the
target, and the check compares the two. Nothing is simulated. Splits of one set share flights, so
that Clopper-Pearson intervals, which stand for independent splits, are too narrow.
"""

import argparse
import collections
import dataclasses
import math
import sys
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from blind.draw.faults import FAULTS
from blind.score.scoring import proportion
from diagnosis.interface.faults import checks, interface_faults
from diagnosis.logs.flights import FlightSet, load_flights


@dataclasses.dataclass(frozen=True)
class Written:
    """A fault of one size."""

    fault: str
    """Name in `blind.draw.faults`."""
    parameter: str
    """Name of the parameter that is not zero."""
    size: float
    """Its value [SI]."""
    words: str
    """Both in words."""

    def apply(self, flights: FlightSet) -> FlightSet:
        """The flights as they would have been logged."""
        return FAULTS[self.fault].apply(flights, {self.parameter: self.size})


WRITTEN = (
    *(
        Written("path_turned_in_yaw", "angle", math.radians(x), f"path turned by {x:g} degrees")
        for x in (2.5, 5.0, 10.0)
    ),
    *(
        Written("delay", "seconds", x / 1e3, f"inputs act {x:g} ms later")
        for x in (10.0, 20.0, 40.0)
    ),
    *(
        Written("clock_offset", "seconds", x / 1e3, f"inputs act {x:g} ms sooner")
        for x in (20.0, 40.0, 80.0)
    ),
    *(
        Written("clock_drift", "rate", x / 100.0, f"clock of inputs drifts by {x:g} %")
        for x in (0.05, 0.1, -0.1, 0.5, -0.5, 1.0, -1.0, 2.0, -2.0)
    ),
)
"""What is written into logs that have the columns for it."""
NOTHING = "nothing"
"""Row of undisturbed halves, in which any part that is named is an alarm."""


def count(
    flights: FlightSet,
    splits: int,
    sizes: tuple[int, int],
    seed: int,
    each: Callable[[range], object] = iter,
) -> Mapping[str, int]:
    """In how many random splits something is named that is right, by words of `WRITTEN`.

    Splits have as many reference and target flights as `sizes` say. `each` shows progress.
    """
    rng = np.random.default_rng(seed)
    fitting = [one for one in WRITTEN if FAULTS[one.fault].fits(flights)]
    named = collections.Counter(dict.fromkeys([NOTHING, *(one.words for one in fitting)], 0))
    for _ in each(range(splits)):  # pyright: ignore[reportGeneralTypeIssues]
        order = [flights.flights[i] for i in rng.permutation(len(flights.flights))]
        before = dataclasses.replace(flights, flights=tuple(order[: sizes[0]]))
        after = dataclasses.replace(flights, flights=tuple(order[sizes[0] : sum(sizes)]))
        then = checks(before)
        named[NOTHING] += bool(interface_faults(after, before, then=then))
        for one in fitting:
            found = interface_faults(one.apply(after), before, then=then)
            named[one.words] += bool({fault.part for fault in found} & {*FAULTS[one.fault].parts})
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
    console = Console(stderr=True)
    named = count(
        load_flights(given.flights),
        given.splits,
        (given.reference, given.target),
        given.seed,
        lambda splits: track(splits, "checking splits", console=console),
    )
    sys.stdout.write(write(named, given.splits) + "\n")


if __name__ == "__main__":
    main()
