"""Power, coverage and false alarms of the twin, by faults put into halves of real flights.

    python -m blind.power.twin FLIGHTS --splits 200 --fault-splits 40 --reference 9 --target 9

Flights are split at random into a reference and a target. Undisturbed targets count false alarms;
targets with a fault in their commands count how often it is named, or stands among the aliases of
what is named, and how often its interval holds its true size. "Drift falls by" is how much of the
drift that the fault makes goes with what is named, where something is. A second table counts
targets with a turned path, which the check of the interface names. Splits of one set share flights,
so that Clopper-Pearson intervals, which stand for independent splits, are too narrow.
"""

import argparse
import dataclasses
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import track

from blind.draw.catalogue import Parameters
from blind.draw.faults import FAULTS
from blind.score.scoring import proportion
from diagnosis.decision import Decision
from diagnosis.interface.faults import interface_faults
from diagnosis.logs.flights import FlightLog, FlightSet, load_flights
from diagnosis.logs.inputs import choose_inputs
from diagnosis.replay.replay import Replay
from diagnosis.twin.answer import ChangedParameter, TwinAnswer
from diagnosis.twin.channels import Channels
from diagnosis.twin.diagnose_change import answer_change
from diagnosis.twin.drift import Scored
from diagnosis.twin.flown import Fly, flight_of, seen, twin_replay
from diagnosis.twin.twin import Twin, make_twin


@dataclasses.dataclass(frozen=True)
class Studied:
    """One parameter of a fault, and the size of it that a diagnosis should find."""

    fault: str
    """Name in `blind.draw.faults`."""
    parameter: str
    """Name of the parameter that varies."""
    unit: str
    """SI unit of its size."""
    aim: float
    """Size that should be found with a probability of 95 %."""
    others: Parameters = dataclasses.field(default_factory=dict)
    """Values of the fault's other parameters, which stay."""

    @property
    def effect(self) -> str:
        """Registered name of the effect that describes it best."""
        return next(iter(FAULTS[self.fault].answers({**self.others, self.parameter: self.aim})))

    def apply(self, flights: FlightSet, size: float) -> FlightSet:
        """The flights as they would have been logged with a fault of that size."""
        return FAULTS[self.fault].apply(flights, {**self.others, self.parameter: size})


STUDIED: Mapping[str, Studied] = {
    "thrust": Studied("thrust_gain", "e", "-", 0.05),
    "delay": Studied("delay", "seconds", "s", 0.02),
    "roll offset": Studied("trim", "roll", "rad", float(np.deg2rad(1.5)), {"pitch": 0.0}),
    "pitch offset": Studied("trim", "pitch", "rad", float(np.deg2rad(1.5)), {"roll": 0.0}),
    "attitude gain": Studied("attitude_gain", "g", "-", 0.1),
    "frame": Studied("tilt_turned_in_yaw", "angle", "rad", float(np.deg2rad(5.0))),
}
"""What is studied, by name, with the sizes that the twin aims at."""
TURNS = (0.0, 2.5, 5.0, 10.0)
"""Turns of the path in yaw that are studied [deg]."""
Case = tuple[str, float]
"""A fault's name and size; the empty name stands for undisturbed flights."""
CLEAN: Case = ("", 0.0)


@dataclasses.dataclass(frozen=True)
class Tally:
    """The answers to one case."""

    case: Case
    """What was put into the logs."""
    answers: tuple[TwinAnswer, ...]
    """One a split."""
    falls: tuple[tuple[float, float], ...]
    """By how much the drift of the changed flights falls in each split [m]: with what is named in
    the sizes that other flights show, and without the fault."""

    @property
    def alarms(self) -> int:
        """Answers that say that something changed."""
        return sum(a.change not in ("none", "too_few") for a in self.answers)

    @property
    def named(self) -> int:
        """Answers that name the fault or hold it in their class."""
        effect = STUDIED[self.case[0]].effect
        return sum(effect in (*a.effects, *a.aliases) for a in self.answers)

    @property
    def first(self) -> int:
        """Answers that name the fault first."""
        effect = STUDIED[self.case[0]].effect
        return sum(bool(a.effects) and a.effects[0] == effect for a in self.answers)

    def estimates(self) -> list[ChangedParameter]:
        """The fault's parameter as each split estimates it, whether it was named or not."""
        fault = STUDIED[self.case[0]]
        return [
            p
            for a in self.answers
            for c in a.candidates
            if c.effect == fault.effect
            for p in c.parameters
            if p.parameter == fault.parameter
        ]


@dataclasses.dataclass(frozen=True)
class Flown:
    """All flights with one fault in their logs."""

    channels: tuple[Channels, ...]
    """What they show beside the nominal simulator."""
    again: Callable[[Collection[str]], Fly] | None = None
    """Given names, what simulates the flights of these names at any vector of the library."""


def told(flights: FlightSet, replay: Replay) -> list[str]:
    """What can be studied: faults of columns that were logged, by effects that the replay shows."""
    return [
        name
        for name, studied in STUDIED.items()
        if FAULTS[studied.fault].fits(flights) and studied.effect in replay.library.candidates
    ]


def fly(
    flights: FlightSet, scales: Sequence[float]
) -> tuple[Mapping[Case, Flown], Callable[[Sequence[Channels]], Twin]]:
    """Every case as it flies, and what makes a twin of some flights."""
    replay = twin_replay(flights, choose_inputs(flights), "crazyflow")
    cases = [CLEAN]
    for name in told(flights, replay):
        cases += [(name, STUDIED[name].aim * scale) for scale in scales]
    made = {}
    for name, size in cases:
        logs = choose_inputs(STUDIED[name].apply(flights, size) if name else flights).flights

        def again(names: Collection[str], logs: Sequence[FlightLog] = logs) -> Fly:
            return flight_of(replay, [log for log in logs if log.name in names])

        channels = flight_of(replay, logs)(replay.library.neutral)
        made[name, size] = Flown(channels, again)
        sys.stderr.write(f"flown: {name or 'undisturbed'} {size:g}\n")

    def twin_of(chosen: Sequence[Channels]) -> Twin:
        return make_twin(chosen, replay.library, seen(replay))

    return made, twin_of


def measure(
    flown: Mapping[Case, Flown],
    twin_of: Callable[[Sequence[Channels]], Twin],
    splits: int,
    fault_splits: int,
    sizes: tuple[int, int],
    seed: int,
) -> list[Tally]:
    """The answers to every case over random splits; faults in the first `fault_splits` of them."""
    clean = flown[CLEAN].channels
    rng, names = np.random.default_rng(seed), [c.name for c in clean]
    found: dict[Case, list[tuple[TwinAnswer, tuple[float, float]]]] = {c: [] for c in flown}
    for k in track(range(splits), "answering", console=Console(stderr=True)):
        order = [names[i] for i in rng.permutation(len(names))]
        before, after = order[: sizes[0]], order[sizes[0] : sum(sizes)]
        twin = twin_of([c for c in clean if c.name in before])
        for case, flights in flown.items():
            if case == CLEAN or k < fault_splits:
                chosen = [c for c in flights.channels if c.name in after]
                again = flights.again(after) if flights.again else None
                answer, scored = answer_change(twin, chosen, Decision(), again)
                found[case].append((answer, _falls(twin, scored, clean)))
    return [
        Tally(case, tuple(a for a, _ in made), tuple(f for _, f in made))
        for case, made in found.items()
    ]


def _falls(
    twin: Twin, scored: Sequence[Scored], undisturbed: Sequence[Channels]
) -> tuple[float, float]:
    """By how much the drift falls with what is named, and without the fault [m], in the mean."""
    clean = {c.name: c for c in undisturbed if c.name in {one.name for one in scored}}
    intact = [
        dataclasses.replace(one, valid=clean[one.name].valid).drift(twin.errors(clean[one.name]))
        for one in scored
    ]
    before, after, without = (
        np.nanmean(np.concatenate(each))
        for each in (
            [one.drift(one.before) for one in scored],
            [one.drift(one.after) for one in scored],
            intact,
        )
    )
    return float(before - after), float(before - without)


def turns_named(
    flights: FlightSet, splits: int, sizes: tuple[int, int], seed: int
) -> Mapping[float, int]:
    """In how many random splits each of `TURNS` is named beside the reference."""
    rng, fault = np.random.default_rng(seed), FAULTS["path_turned_in_yaw"]
    named = dict.fromkeys(TURNS, 0)
    for _ in range(splits):
        order = [flights.flights[i] for i in rng.permutation(len(flights.flights))]
        before = dataclasses.replace(flights, flights=tuple(order[: sizes[0]]))
        after = dataclasses.replace(flights, flights=tuple(order[sizes[0] : sum(sizes)]))
        for degrees in TURNS:
            turned = fault.apply(after, {"angle": float(np.deg2rad(degrees))})
            parts = {found.part for found in interface_faults(turned, before)}
            named[degrees] += bool(parts & {*fault.parts})
    return named


def write_table(tallies: Sequence[Tally]) -> str:
    """The table of all cases, in Markdown."""
    lines = [
        "| fault | named or alias | named first | mean estimate | coverage | limit | misfit left "
        "| drift falls by |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for tally in tallies:
        n = len(tally.answers)
        if tally.case == CLEAN:
            aside = np.mean([len(a.set_aside) for a in tally.answers])
            alarms = proportion(tally.alarms, n).text()
            lines.append(f"| none: alarms | {alarms} | | | | | {aside:.2f} aside | |")
            continue
        (name, size), fault = tally.case, STUDIED[tally.case[0]]
        lines.append(_line(tally, name, size, fault, n))
    return "\n".join(lines)


def write_turns(named: Mapping[float, int], splits: int) -> str:
    """The table of turned paths, in Markdown."""
    lines = [f"| {degrees:g} | {proportion(k, splits).text()} |" for degrees, k in named.items()]
    return "\n".join(["| path turned in yaw [deg] | named |", "|---|---|", *lines])


def _line(tally: Tally, name: str, size: float, fault: Studied, n: int) -> str:
    shown = tally.estimates()
    held = sum(p.low <= size <= p.high for p in shown)
    misfits = [a.misfit for a in tally.answers if a.effects]
    left = np.mean([after / before for before, after in misfits]) if misfits else np.nan
    mean = np.mean([p.value for p in shown]) if shown else np.nan
    limit = np.median([p.limit for p in shown]) if shown else np.nan
    falls = np.asarray([f for a, f in zip(tally.answers, tally.falls, strict=True) if a.effects])
    drift = f"{100 * falls[:, 0].sum() / falls[:, 1].sum():.0f} %" if len(falls) else ""
    unit = "" if fault.unit == "-" else f" {fault.unit}"
    return (
        f"| {name} {size:+.4g}{unit} | {proportion(tally.named, n).text()} | {tally.first}/{n} | "
        f"{mean:+.4f} | {held}/{len(shown)} | {limit:.4f} | {left:.2f} | "
        f"{drift} |"
    )


def main() -> None:
    """Prints the table of a flight set."""
    parser = argparse.ArgumentParser(prog="python -m blind.power.twin", description=__doc__)
    parser.add_argument("flights", type=Path, help="folder of logs of one undisturbed vehicle")
    parser.add_argument("--splits", type=int, default=200, help="undisturbed splits")
    parser.add_argument("--fault-splits", type=int, default=40, help="splits of every fault")
    parser.add_argument("--reference", type=int, default=9, help="reference flights of a split")
    parser.add_argument("--target", type=int, default=9, help="target flights of a split")
    parser.add_argument(
        "--scales", type=float, nargs="*", default=[1.0, -1.0], help="sizes over those aimed at"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the splits")
    given = parser.parse_args()
    flights, sizes = load_flights(given.flights), (given.reference, given.target)
    flown, twin_of = fly(flights, given.scales)
    tallies = measure(flown, twin_of, given.splits, given.fault_splits, sizes, given.seed)
    turned = turns_named(flights, given.splits, sizes, given.seed)
    sys.stdout.write(f"{write_table(tallies)}\n\n{write_turns(turned, given.splits)}\n")


if __name__ == "__main__":
    main()
