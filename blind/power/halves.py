"""How often the check of the interface names a fault in random halves of real flights.

    python -m blind.power.halves FLIGHTS --splits 40 --reference 12 --target 12

Flights are split at random into a reference and a target, a fault is written into the logs of the
target, and the check compares the two. Nothing is simulated. Splits of one set share flights, so
that Clopper-Pearson intervals, which stand for independent splits, are too narrow.
"""

import dataclasses
import math
import sys
from collections.abc import Mapping

from blind.draw.catalogue import Parameters
from blind.draw.faults import ALL
from blind.power.splits import parser_of, random_splits, read
from blind.score.scoring import proportion
from diagnosis.interface.faults import checks, interface_faults
from diagnosis.logs.flights import FlightSet

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
    fitting = {words: one for words, one in WRITTEN.items() if ALL[one[0]].fits(flights)}
    named = dict.fromkeys([NOTHING, *fitting], 0)
    for parts in random_splits(flights.flights, splits, sizes, seed, "checking splits"):
        before, after = (dataclasses.replace(flights, flights=tuple(part)) for part in parts)
        then = checks(before)
        named[NOTHING] += bool(interface_faults(after, before, then=then))
        for words, (name, parameters) in fitting.items():
            fault = ALL[name]
            found = interface_faults(fault.apply(after, parameters), before, then=then)
            named[words] += any(one.part in fault.parts for one in found)
    return named


def write(named: Mapping[str, int], splits: int) -> str:
    """The table, in Markdown."""
    lines = [f"| {words} | {proportion(k, splits).text()} |" for words, k in named.items()]
    return "\n".join(["| written into the logs | named |", "|---|---|", *lines])


def main() -> None:
    """Prints the table of a flight set."""
    given, flights, sizes = read(parser_of("python -m blind.power.halves", __doc__, 40, 1))
    named = count(flights, given.splits, sizes, given.seed)
    sys.stdout.write(write(named, given.splits) + "\n")


if __name__ == "__main__":
    main()
