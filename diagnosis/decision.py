"""Every threshold of a diagnosis: value, unit and the evidence for it, in one frozen record."""

import dataclasses
from typing import Any


def _decided(value: float | int, unit: str, evidence: str) -> Any:
    """A field of `Decision`."""
    return dataclasses.field(default=value, metadata={"unit": unit, "evidence": evidence})


UNDERIVED = "not derived"
"""Evidence of a threshold that nobody has measured."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decision:
    """What decides, from the windows that count to the words of an answer.

    Development cases are those of `blind` whose answers were known by then, earlier draws among
    them, before the counted ones were drawn (`reports/blind.md`). How hard a search tries
    (`fit/search.py`) is not here: it costs time and states nothing.
    """

    # Which windows count.
    distrust_sigmas: float = _decided(2.5, "standard deviations", UNDERIVED)
    """Misfit beyond which a window soon after an unknown command is left out."""
    reference_distrust_sigmas: float = _decided(6.0, "standard deviations", UNDERIVED)
    """The same in reference flights."""
    doubtful_share: float = _decided(
        0.25,
        "-",
        "with two drones nearly all are: 94 of 125 were left out with the gust in them, when it "
        "was excluded from the library",
    )
    """Most windows that may be left out, of those soon after an unknown command."""
    alone_misfit: float = _decided(
        4.0,
        "misfits of the median window",
        "noise alone reaches 1.4; in flights with a centre of mass 5 mm off, one upset of 53 "
        "degrees that RotorPy's attitude loop catches otherwise had 80, 12 and 5 in a row, and the "
        "offset came out at 0.4 of its size",
    )
    """Misfit of a window that stands out."""
    alone_share: float = _decided(0.025, "-", UNDERIVED)
    """Most windows that may stand out alone, all in one flight; one at least."""
    alone_flights: int = _decided(3, "flights", "that of a gust's onset would stand out")
    """Flights below which no window is taken to stand out."""

    # Which set of effects.
    effect_cost: float = _decided(
        4.0, "nats", "about one over the number of effects, squared off by development cases"
    )
    """Log prior odds against one effect more."""
    alias_nats: float = _decided(4.0, "nats", UNDERIVED)
    """A rival whose evidence is this close cannot be told apart."""
    worthy_share: float = _decided(
        0.002,
        "-",
        "false second effects explained up to 0.0005 on development cases in RotorPy when it was "
        "not, true ones 0.006 or more but for a downwash beside an offset of the centre of mass "
        "(0.0004 to 0.001)",
    )
    """Share of the gap that an effect must explain to be named where reference flights are not
    followed: what a change does there is known no better."""
    least_share: float = _decided(
        2e-5,
        "-",
        "one false third effect explained 4e-6 of a gap that an offset of the centre of mass and a "
        "lost thrust made, true second ones 4e-4 or more",
    )
    """That share beside any reference."""
    interval_widening: float = _decided(
        1.2,
        "-",
        "1.19 of 108 parameters of development cases, of unknown cause; 1.12 of the 358 that were "
        "counted next",
    )
    """Standard deviation of errors over their standard errors."""

    # Whether it explains the flights.
    structure: float = _decided(
        1.45, "-", "the right set left at most 1.36 on 80 s development cases"
    )
    """Structure that the right set never left."""
    unexplained_share: float = _decided(
        0.0015,
        "-",
        "the right set left at most 0.0008 on development cases with a structure above 1.15",
    )
    """Share of the gap below which structure left over is not worth a verdict."""
    unfollowed_share: float = _decided(
        0.025,
        "-",
        "the right set left up to 0.023 on development cases in RotorPy with a structure above "
        "1.45",
    )
    """What stands there in its place where reference flights are not followed."""
    slight_structure: float = _decided(
        1.15,
        "-",
        "80 s of undisturbed flight had at most 1.04 on development cases and 1.14 on the cases "
        "that were counted next",
    )
    """Structure that is worth a verdict where much of the gap is left."""
    much_share: float = _decided(0.2, "-", "the right set left at most 0.05")
    """Share of the gap that no effect may leave beyond `slight_structure`."""
    chance_sigmas: float = _decided(
        3.0,
        "standard deviations",
        "of 24 undisturbed flights of 10 s, whose structure has a standard deviation of 0.16, 5 "
        "exceeded 1.15",
    )
    """Standard deviations of a structure of mere noise that it must exceed to count."""
    true_share: float = _decided(
        0.995,
        "-",
        "213 of 214 on development cases in RotorPy, however probable they were among the sets "
        "looked at",
    )
    """Share of effects that are true where the named set leaves at most `slight_structure`."""
    doubted_share: float = _decided(0.6, "-", "17 of 28 on development cases in RotorPy")
    """That share where it leaves more: something flies that no candidate describes."""

    # Whether the attitude is prescribed from measurement.
    attitude_lost: float = _decided(
        30.0, "-", "five sigmas, so that forces are not judged through an attitude that is wrong"
    )
    """Chi-square per node of a roll, pitch or yaw that nothing explains, from which it is."""
    forces_explained: float = _decided(0.1, "-", UNDERIVED)
    """Share of the gap in forces that may be left where it was prescribed for their sake."""

    # What is said.
    limit_sigmas: float = _decided(5.0, "standard deviations", UNDERIVED)
    """Size of an effect that these flights would have shown, over its standard error."""
    blind_share: float = _decided(0.2, "-", UNDERIVED)
    """Such a size over the allowed range from which flights are blind to an effect."""
    noteworthy_share: float = _decided(0.05, "-", UNDERIVED)
    """Unexplained share of the gap from which the verdict mentions it."""
    mostly_share: float = _decided(0.2, "-", UNDERIVED)
    """Unexplained share below which most of the gap counts as explained."""
    main_share: float = _decided(0.5, "-", UNDERIVED)
    """Share of the gap that its main channels hold between them."""
    main_channels: int = _decided(3, "channels", UNDERIVED)
    """Most main channels."""

    def values(self) -> dict[str, float]:
        """Every threshold by name."""
        return {field.name: float(getattr(self, field.name)) for field in dataclasses.fields(self)}


DECISION = Decision()
"""What decides unless another is given."""
