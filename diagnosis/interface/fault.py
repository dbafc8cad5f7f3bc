"""What is said of the interface: a fault with its numbers, and what flights do not tell."""

import dataclasses
from collections.abc import Iterable


@dataclasses.dataclass(frozen=True, kw_only=True)
class Evidence:
    """One number that the flights show."""

    quantity: str
    """What it is."""
    value: float
    """Its value."""
    low: float | None
    """Lower end of its interval at the level of the test; null where it has none."""
    high: float | None
    """Upper end."""
    unit: str
    """Unit."""
    allowed: str
    """What is allowed, in words."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class InterfaceFault:
    """One part of the interface that does not say what the format asks for."""

    part: str
    """Which part, such as `attitude`, or `attitude of the reference` where that has it wrong."""
    readings: tuple[str, ...]
    """What the part seems to hold instead, likeliest first; those after the first fit as well."""
    advice: str
    """What to check, in one line."""
    evidence: tuple[Evidence, ...]
    """The numbers behind it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Untold:
    """One check that could not be made."""

    part: str
    """Which part was not checked, such as `heading`."""
    what: str
    """What of it was not checked."""
    fly: tuple[str, ...]
    """Motions that would tell: steps in x or y, climbs (z), turns (yaw)."""


MOTOR_CLOCK = "motor clock"
"""The part whose fault is a drift, which is taken out before physics."""
PARTS = (
    "position",
    "height",
    "velocity",
    "angular velocity",
    "accelerometer",
    "attitude",
    "attitude command",
    "command clock",
    "thrust",
    "motor order",
    MOTOR_CLOCK,
    "motor clock since the reference",
    "frame of the path",
    "frame of the path since the reference",
    "frame of the commands",
    "heading",
)
"""Every part that is checked, in the order in which faults are listed."""
ORDERED = frozenset({"position", "velocity", "attitude", "attitude command"})
"""Parts of order, sign, frame and unit that a replay reads, in the reference as well."""
OWN = ORDERED | {MOTOR_CLOCK}
"""Parts whose fault needs no reference to show; a reference's own faults of them are named, too."""
SIZED = frozenset(
    {"height", "command clock", "thrust", "frame of the path", "frame of the commands", "heading"}
)
"""Parts whose fault is a size; beside a reference that has it, too, it is no change."""


def of_reference(part: str) -> str:
    """What a part is called where the reference has it wrong."""
    return f"{part} of the reference"


def in_reference(fault: InterfaceFault) -> InterfaceFault:
    """A fault of the reference, as it is said of the flights beside it."""
    advice = f"In the reference flights: {fault.advice[0].lower()}{fault.advice[1:]}"
    return dataclasses.replace(fault, part=of_reference(fault.part), advice=advice)


def in_order(faults: Iterable[InterfaceFault]) -> tuple[InterfaceFault, ...]:
    """The faults, sorted as `PARTS` are. Faults of the reference come last."""
    order = [*PARTS, *map(of_reference, PARTS)]
    return tuple(sorted(faults, key=lambda fault: order.index(fault.part)))
