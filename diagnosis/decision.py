"""What decides in a diagnosis: value, unit and the evidence for it, in one frozen record."""

import dataclasses
from typing import Any, Literal

Source = Literal["guess", "statistics", "cases", "convention"]
"""Where a value is from: nobody's measurement; a distribution; development cases; a usage."""


def _decided(value: float | int, unit: str, source: Source, evidence: str) -> Any:
    """A field of `Decision`."""
    metadata = {"unit": unit, "source": source, "evidence": evidence}
    return dataclasses.field(default=value, metadata=metadata)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decision:
    """What decides, from the windows that count to the words of an answer.

    Development cases are those of `blind` whose answers were known by then, earlier draws among
    them, before the counted ones were drawn (`reports/blind.md`). Not here, but beside what they
    belong to: tolerances and step counts of solvers, what a column of a log may hold
    (`diagnosis.interface`), and what a twin is made of (`diagnosis.twin`).

    `python -m blind.power.guesses` counts what hangs on the guesses: it diagnoses cases again with
    all of them halved, kept or doubled at random. Four cases were run, in forty minutes, each with
    six such sets of values (`results/blind/guesses.parquet`). Where an effect of the library acts
    (two pairs and a single), all 18 answers stayed; sizes moved by at most 0.75 half-widths of
    their intervals. Where none does (one case), the verdict `partly` stayed in all six, and what
    was blamed beside the unknown cause changed in all six.
    """

    # Which windows count.
    distrust_sigmas: float = _decided(2.5, "standard deviations", "guess", "nobody has measured it")
    """Misfit beyond which a window soon after an unknown command is left out."""
    reference_distrust_sigmas: float = _decided(
        6.0, "standard deviations", "guess", "nobody has measured it"
    )
    """The same in reference flights."""
    doubtful_share: float = _decided(
        0.25,
        "-",
        "cases",
        "with two drones nearly all are: 94 of 125 were left out with the gust in them, when it "
        "was excluded from the library",
    )
    """Most windows that may be left out, of those soon after an unknown command."""
    alone_misfit: float = _decided(
        4.0,
        "misfits of the median window",
        "cases",
        "noise alone reaches 1.4; in flights with a centre of mass 5 mm off, one upset of 53 "
        "degrees that RotorPy's attitude loop catches otherwise had 80, 12 and 5 in a row, and the "
        "offset came out at 0.4 of its size",
    )
    """Misfit of a window that stands out."""
    alone_share: float = _decided(0.025, "-", "guess", "nobody has measured it")
    """Most windows that may stand out alone, all in one flight; one at least."""
    alone_flights: int = _decided(
        3, "flights", "statistics", "that of a gust's onset would stand out"
    )
    """Flights below which no window is taken to stand out."""

    # Which set of effects.
    effect_cost: float = _decided(
        4.0,
        "nats",
        "cases",
        "about one over the number of effects, squared off by development cases",
    )
    """Log prior odds against one effect more."""
    alias_nats: float = _decided(4.0, "nats", "guess", "nobody has measured it")
    """A rival whose evidence is this close cannot be told apart."""
    twin_alias_nats: float = _decided(
        6.0,
        "nats",
        "cases",
        "with commands 20 ms late or early in 32 splits of real flights, another effect led the "
        "true one by at most 5.7 in 28, by 6.8 to 9.5 in the others",
    )
    """The same beside a twin, where flights differ by more than noise."""
    worthy_share: float = _decided(
        0.002,
        "-",
        "cases",
        "false second effects explained up to 0.0005 on development cases in RotorPy when it was "
        "not, true ones 0.006 or more but for a downwash beside an offset of the centre of mass "
        "(0.0004 to 0.001)",
    )
    """Share of the gap that an effect must explain to be named where reference flights are not
    followed: what a change does there is known no better."""
    least_share: float = _decided(
        2e-5,
        "-",
        "cases",
        "one false third effect explained 4e-6 of a gap that an offset of the centre of mass and a "
        "lost thrust made, true second ones 4e-4 or more",
    )
    """That share beside any reference."""
    interval_widening: float = _decided(
        1.2,
        "-",
        "cases",
        "1.19 of 108 parameters of development cases, of unknown cause; 1.12 of the 358 that were "
        "counted next",
    )
    """Standard deviation of errors over their standard errors."""

    # Whether it explains the flights.
    structure: float = _decided(
        1.45, "-", "cases", "the right set left at most 1.36 on 80 s development cases"
    )
    """Structure that the right set never left."""
    unexplained_share: float = _decided(
        0.0015,
        "-",
        "cases",
        "the right set left at most 0.0008 on development cases with a structure above 1.15",
    )
    """Share of the gap below which structure left over is not worth a verdict."""
    unfollowed_share: float = _decided(
        0.025,
        "-",
        "cases",
        "the right set left up to 0.023 on development cases in RotorPy with a structure above "
        "1.45",
    )
    """What stands there in its place where reference flights are not followed."""
    slight_structure: float = _decided(
        1.15,
        "-",
        "cases",
        "80 s of undisturbed flight had at most 1.04 on development cases and 1.14 on the cases "
        "that were counted next",
    )
    """Structure that is worth a verdict where much of the gap is left."""
    much_share: float = _decided(0.2, "-", "cases", "the right set left at most 0.05")
    """Share of the gap that no effect may leave beyond `slight_structure`."""
    chance_sigmas: float = _decided(
        3.0,
        "standard deviations",
        "cases",
        "of 24 undisturbed flights of 10 s, whose structure has a standard deviation of 0.16, 5 "
        "exceeded 1.15",
    )
    """Standard deviations of a structure of mere noise that it must exceed to count."""
    true_share: float = _decided(
        0.995,
        "-",
        "cases",
        "213 of 214 on development cases in RotorPy, however probable they were among the sets "
        "looked at",
    )
    """Share of effects that are true where the named set leaves at most `slight_structure`."""
    doubted_share: float = _decided(0.6, "-", "cases", "17 of 28 on development cases in RotorPy")
    """That share where it leaves more: something flies that no candidate describes."""

    # Whether the attitude is prescribed from measurement.
    attitude_lost: float = _decided(
        30.0,
        "-",
        "statistics",
        "five sigmas, so that forces are not judged through an attitude that is wrong",
    )
    """Chi-square per node of a roll, pitch or yaw that nothing explains, from which it is."""
    reference_lost: float = _decided(
        4.0,
        "-",
        "cases",
        "references in RotorPy, which effects describe, had at most 1.1, real ones 565 "
        "(crazyflie_plain) and 886 (nanobench); at 12, simulated flights that scatter as real ones "
        "do, the fit called an undisturbed half unexplained, a twin did not",
    )
    """Chi-square per node of any channel of reference flights that effects do not describe, from
    which a twin is learned instead."""
    forces_explained: float = _decided(0.1, "-", "guess", "nobody has measured it")
    """Share of the gap in forces that may be left where it was prescribed for their sake."""

    # What is said.
    limit_sigmas: float = _decided(5.0, "standard deviations", "guess", "nobody has measured it")
    """Size of an effect that these flights would have shown, over its standard error."""
    blind_share: float = _decided(0.2, "-", "guess", "nobody has measured it")
    """Such a size over the allowed range from which flights are blind to an effect."""
    noteworthy_share: float = _decided(0.05, "-", "guess", "nobody has measured it")
    """Unexplained share of the gap from which the verdict mentions it."""
    mostly_share: float = _decided(0.2, "-", "guess", "nobody has measured it")
    """Unexplained share below which most of the gap counts as explained."""
    main_share: float = _decided(0.5, "-", "guess", "nobody has measured it")
    """Share of the gap that its main channels hold between them."""
    regime_contrast: float = _decided(2.0, "-", "guess", "nobody has measured it")
    """Gap of a regime's bin over the RMS gap of the other bins, from which advice names the bin."""
    main_channels: int = _decided(3, "channels", "guess", "nobody has measured it")
    """Most main channels."""

    # Which sets are tried: a set that is never fitted is never named.
    largest_set: int = _decided(3, "effects", "guess", "pairs are what cases hold at most")
    """Most effects of a set."""
    refits: int = _decided(4, "sets", "guess", "nobody has measured it")
    """Most sets of one size that are refitted."""
    near_share: float = _decided(
        0.2,
        "-",
        "guess",
        "far from neutral a linear gain says little, and from a wrong effect the search does not "
        "come back; how little, nobody has measured",
    )
    """Share of the best linear gain from which a set is worth refitting."""
    near_nats: float = _decided(30.0, "nats", "guess", "nobody has measured it")
    """Log evidence below the best promise down to which a set is refitted in any case."""
    front: int = _decided(3, "sets", "guess", "nobody has measured it")
    """Sets of one size from which larger ones are grown."""
    worth_nats: float = _decided(
        3.0, "nats", "guess", "below `effect_cost`, so that nothing that could be named is lost"
    )
    """Gain that another effect must promise to be tried."""
    needed_nats: float = _decided(500.0, "nats", "guess", "nobody has measured it")
    """Log evidence that an effect must bring, to first order, not to be tried without."""
    again_nats: float = _decided(100.0, "nats", "guess", "nobody has measured it")
    """Log evidence below the best down to which a set is fitted again where other windows count."""
    hopeless_nats: float = _decided(50.0, "nats", "guess", "nobody has measured it")
    """Log evidence below another set's at which a refit ends early."""
    quiet_windows: int = _decided(
        3, "windows", "guess", "what acts from the start is another effect than what sets in"
    )
    """Windows before the earliest onset."""

    # What reference flights say.
    prior_share: float = _decided(0.1, "-", "guess", "nobody has measured it")
    """Standard deviation of the prior of a parameter over its allowed range."""
    unbelieved_share: float = _decided(
        0.5,
        "-",
        "cases",
        "to keep near neutral what nobody believes to know moves others away from it; with 0.1, a "
        "share of gyro compensation of 1 that RotorPy has was found as 0.86, and arms of -14.1 % "
        "as -19.7 %, which 0.5 found as -14.4 %",
    )
    """The same for what nobody believes to know (`EffectCard.unbelieved`)."""
    loose_chance: float = _decided(0.001, "-", "convention", "one false alarm in a thousand")
    """Probability that scores of like flights differ more than what sets a parameter loose."""
    loose_flights: int = _decided(4, "flights", "guess", "the variance of fewer scores says little")
    """Flights below which it is not asked whether they draw parameters of their own."""
    shared_sigmas: float = _decided(2.0, "standard deviations", "convention", "95 %, about")
    """Difference from neutral from which a parameter is said to be shared with the reference."""

    # What changed beside a twin of the reference.
    alarm_chance: float = _decided(
        0.01, "-", "convention", "half of the false alarms that are allowed: 2 of 100 splits"
    )
    """Probability of naming anything in undisturbed flights, shared out among candidates."""
    limit_power: float = _decided(0.95, "-", "convention", "the power that is asked for")
    """Probability with which a change of the size of its limit is named."""
    least_chance: float = _decided(
        0.5, "-", "convention", "an answer is not stated that is likelier wrong than right"
    )
    """Probability below which an effect, with those that look like it, is not named."""
    most_left: float = _decided(
        0.5, "-", "convention", "a cause explains most of what is seen, or it is not the cause"
    )
    """Share of a gap that effects leave at most which are blamed for it; beside a twin, of one that
    is larger than what the twin misses."""
    few_flights: int = _decided(
        5, "flights", "guess", "the t quantile of four flights is 1.4 times that of many"
    )
    """Flights of either set below which silence is no answer."""
    flight_alone: float = _decided(4.0, "misfits of the median flight", "guess", "nobody has tried")
    """Misfit of a flight that no twin of the others follows."""

    # Which flights are held out.
    held_out_flights: int = _decided(
        10, "flights", "guess", "with fewer, a third of them would be too few to score"
    )
    """Flights from which on a third is kept out of everything."""
    fewest_flights: int = _decided(
        3, "flights", "statistics", "the t quantile of two flights is 12.7 standard errors"
    )
    """Flights below which nothing is said of flights that were left out."""

    # Whether a case could have been decided (the laboratory).
    decidable_chi2: float = _decided(
        25.0, "-", "statistics", "the log likelihood ratio has means five standard deviations apart"
    )
    """Smallest chi-square between the truth and its best rival."""
    close_share: float = _decided(0.03, "-", "guess", "nobody has measured it")
    """Share of the gap by which a screened rival may be worse and still be refitted."""
    rivals: int = _decided(4, "sets", "guess", "nobody has measured it")
    """Most rivals that are refitted, the most promising first."""

    def values(self) -> dict[str, float]:
        """Every field by name."""
        return {field.name: float(getattr(self, field.name)) for field in dataclasses.fields(self)}
