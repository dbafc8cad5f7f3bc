"""Power, coverage and false alarms of the twin, by faults put into halves of real flights.

    python -m blind.power.twin FLIGHTS --splits 200 --fault-splits 40 --reference 9 --target 9

Flights are split at random into a reference and a target. Undisturbed targets count false alarms;
targets with a fault in their commands count how often it is named, or stands among the aliases of
what is named, and how often its interval holds its true size. "Drift falls by" is how much of the
drift that the fault makes goes with what is named, where something is. A second table has targets
with two faults at once (`TOGETHER`). Splits of one set share flights, so that Clopper-Pearson
intervals, which stand for independent splits, are too narrow.
"""

import dataclasses
import sys
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from blind.draw.catalogue import Parameters
from blind.draw.faults import ALL
from blind.power.splits import parser_of, random_splits, read
from blind.score.scoring import proportion
from diagnosis.decision import Decision
from diagnosis.logs.flights import FlightLog, FlightSet
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
        return next(iter(ALL[self.fault].answers({**self.others, self.parameter: self.aim})))

    def apply(self, flights: FlightSet, size: float) -> FlightSet:
        """The flights as they would have been logged with a fault of that size."""
        return ALL[self.fault].apply(flights, {**self.others, self.parameter: size})


STUDIED: Mapping[str, Studied] = {
    "thrust": Studied("thrust_gain", "e", "-", 0.05),
    "delay": Studied("delay", "seconds", "s", 0.02),
    "clock drift": Studied("clock_drift", "rate", "s/s", 0.01),
    "roll offset": Studied("trim", "roll", "rad", float(np.deg2rad(1.5)), {"pitch": 0.0}),
    "pitch offset": Studied("trim", "pitch", "rad", float(np.deg2rad(1.5)), {"roll": 0.0}),
    "attitude gain": Studied("attitude_gain", "g", "-", 0.1),
    "frame": Studied("tilt_turned_in_yaw", "angle", "rad", float(np.deg2rad(5.0))),
}
"""What is studied, by name, with the sizes that the twin aims at."""
TOGETHER: tuple["Case", ...] = (
    (("thrust", -0.07), ("pitch offset", float(np.deg2rad(3.0)))),
    (("thrust", -0.2), ("roll offset", float(np.deg2rad(1.5)))),
    (("thrust", 0.05), ("frame", float(np.deg2rad(5.0)))),
    (("attitude gain", 0.1), ("roll offset", float(np.deg2rad(1.5)))),
    (("delay", 0.03), ("pitch offset", float(np.deg2rad(2.0)))),
    (("delay", 0.04), ("thrust", -0.1)),
)
"""Two faults at once, as of a cut blade, a payload beside the centre, a new frame or a new link."""
Case = tuple[tuple[str, float], ...]
"""Faults with their sizes; none in undisturbed flights."""
CLEAN: Case = ()


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
    def truths(self) -> set[str]:
        """Effects that describe the faults."""
        return {STUDIED[name].effect for name, _ in self.case}

    @property
    def named(self) -> int:
        """Answers that name every fault or hold it in the class of what they name."""
        return sum(self.truths <= {n for alike in _classes(a) for n in alike} for a in self.answers)

    @property
    def first(self) -> int:
        """Answers that name a fault first."""
        return sum(bool(a.effects) and a.effects[0] in self.truths for a in self.answers)

    @property
    def misled(self) -> int:
        """Answers that name an effect without a fault in its class."""
        return sum(any(not self.truths & alike for alike in _classes(a)) for a in self.answers)

    @property
    def misfit_left(self) -> float:
        """Misfit with the named effects over that without, mean over answers that name some."""
        misfits = [a.misfit for a in self.answers if a.effects]
        return float(np.mean([after / before for before, after in misfits])) if misfits else np.nan

    @property
    def drift_taken(self) -> str:
        """How much of the drift that the faults make goes with what is named."""
        named = [f for a, f in zip(self.answers, self.falls, strict=True) if a.effects]
        falls = np.asarray(named)
        return f"{100 * falls[:, 0].sum() / falls[:, 1].sum():.0f} %" if named else ""

    def estimates(self) -> list[ChangedParameter]:
        """The only fault's parameter as each split estimates it, whether it was named or not."""
        ((name, _),) = self.case
        fault = STUDIED[name]
        return [
            p
            for a in self.answers
            for c in a.candidates
            if c.effect == fault.effect
            for p in c.parameters
            if p.parameter == fault.parameter
        ]


def _classes(answer: TwinAnswer) -> list[set[str]]:
    """Each named effect with those that look like it."""
    return [{effect, *alike} for effect, alike in answer.aliases.items()]


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
        if ALL[studied.fault].fits(flights) and studied.effect in replay.library.candidates
    ]


def fly(
    flights: FlightSet, scales: Sequence[float], faults: Collection[str] = tuple(STUDIED)
) -> tuple[Mapping[Case, Flown], Callable[[Sequence[Channels]], Twin]]:
    """Every case of some faults as it flies, and what makes a twin of some flights."""
    replay = twin_replay(flights, choose_inputs(flights), "crazyflow")
    cases, known = [CLEAN], [name for name in told(flights, replay) if name in faults]
    for name in known:
        cases += [((name, STUDIED[name].aim * scale),) for scale in scales]
    cases += [case for case in TOGETHER if {name for name, _ in case} <= {*known}]
    made = {}
    for case in cases:
        changed = flights
        for name, size in case:
            changed = STUDIED[name].apply(changed, size)
        logs = choose_inputs(changed).flights

        def again(names: Collection[str], logs: Sequence[FlightLog] = logs) -> Fly:
            return flight_of(replay, [log for log in logs if log.name in names])

        channels = flight_of(replay, logs)(replay.library.neutral, None)
        made[case] = Flown(channels, again)
        sys.stderr.write(f"flown: {_written(case) or 'undisturbed'}\n")

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
    once: bool = False,
) -> list[Tally]:
    """The answers to every case over random splits; faults in the first `fault_splits` of them.

    With `once`, flights are not flown again at what is found, as a diagnosis does.
    """
    clean = flown[CLEAN].channels
    names = [c.name for c in clean]
    found: dict[Case, list[tuple[TwinAnswer, tuple[float, float]]]] = {c: [] for c in flown}
    parts = random_splits(names, splits, sizes, seed, "answering")
    for k, (before, after) in enumerate(parts):
        twin = twin_of([c for c in clean if c.name in before])
        for case, flights in flown.items():
            if case == CLEAN or k < fault_splits:
                chosen = [c for c in flights.channels if c.name in after]
                again = flights.again(after) if flights.again and not once else None
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


def write_table(tallies: Sequence[Tally]) -> str:
    """The table of undisturbed flights and of single faults, in Markdown."""
    lines = [
        "| fault | named or alias | named first | wrong effect | mean estimate | coverage | limit "
        "| misfit left | drift falls by |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for tally in tallies:
        if tally.case == CLEAN:
            aside = np.mean([len(a.set_aside) for a in tally.answers])
            alarms = proportion(tally.alarms, len(tally.answers)).text()
            lines.append(f"| none: alarms | {alarms} | | | | | | {aside:.2f} aside | |")
        elif len(tally.case) == 1:
            lines.append(_line(tally))
    return "\n".join(lines)


def write_together(tallies: Sequence[Tally]) -> str:
    """The table of two faults at once, in Markdown."""
    lines = [
        "| faults | both named or alias | wrong effect | misfit left | drift falls by |",
        "|---|---|---|---|---|",
    ]
    for tally in tallies:
        if len(tally.case) > 1:
            n = len(tally.answers)
            lines.append(
                f"| {_written(tally.case)} | {proportion(tally.named, n).text()} | "
                f"{tally.misled}/{n} | {tally.misfit_left:.2f} | {tally.drift_taken} |"
            )
    return "\n".join(lines)


def _line(tally: Tally) -> str:
    shown, n, ((_, size),) = tally.estimates(), len(tally.answers), tally.case
    held = sum(p.low <= size <= p.high for p in shown)
    mean = np.mean([p.value for p in shown]) if shown else np.nan
    limit = np.median([p.limit for p in shown]) if shown else np.nan
    return (
        f"| {_written(tally.case)} | {proportion(tally.named, n).text()} | {tally.first}/{n} | "
        f"{tally.misled}/{n} | {mean:+.4f} | {held}/{len(shown)} | {limit:.4f} | "
        f"{tally.misfit_left:.2f} | {tally.drift_taken} |"
    )


def _written(case: Case) -> str:
    """Faults with their sizes and units."""
    units = [STUDIED[name].unit for name, _ in case]
    return ", ".join(
        f"{name} {size:+.4g}" + (f" {unit}" if unit != "-" else "")
        for (name, size), unit in zip(case, units, strict=True)
    )


def main() -> None:
    """Prints the table of a flight set."""
    parser = parser_of("python -m blind.power.twin", __doc__, 200, 0)
    parser.add_argument("--fault-splits", type=int, default=40, help="splits with every fault")
    parser.add_argument(
        "--scales", type=float, nargs="*", default=[1.0, -1.0], help="sizes over those aimed at"
    )
    parser.add_argument(
        "--faults", nargs="*", choices=STUDIED, default=[*STUDIED], help="those to put in"
    )
    parser.add_argument(
        "--once", action="store_true", help="do not fly again at what is found, which is faster"
    )
    given, flights, sizes = read(parser)
    flown, twin_of = fly(flights, given.scales, given.faults)
    counts = given.splits, given.fault_splits
    tallies = measure(flown, twin_of, *counts, sizes, given.seed, given.once)
    sys.stdout.write(f"{write_table(tallies)}\n\n{write_together(tallies)}\n")


if __name__ == "__main__":
    main()
