"""What everybody else needs to know of an effect, beside its physics: words, needs, prior, advice.

The card stands in the effect's own file. Whoever speaks of an effect, fits it, withholds it or
gives advice about it reads the card and names no effect. An effect without a card is shown under
its registered name, in the units of its parameters, and is a candidate wherever its doors are.
"""

import dataclasses
import enum
import math
from collections.abc import Mapping

from simulators import registry

DEGREES = 180.0 / math.pi
"""Degrees per radian."""


class Input(enum.Enum):
    """What flights must offer for an effect to show; each says why an effect is out without it."""

    VOLTAGE = "not every flight is of one drone that logs commands and its battery's voltage"
    THRUST_CMD = "the rotors' speeds are measured, so that how they lag cannot be seen"
    ATTITUDE_CMD = "the attitude is prescribed from measurement"
    NEIGHBOUR = "no flight has two drones"
    TWIN = "looked for only with --reference, where a twin is learned from it"


@dataclasses.dataclass(frozen=True)
class Shown:
    """How a parameter is shown to people."""

    label: str
    """Short name."""
    factor: float = 1.0
    """What a value in SI is multiplied by."""
    unit: str = ""
    """Unit after that; empty for the parameter's own."""
    opposite: str = ""
    """Name of the direction of values below 0, where `label` is that of values above 0."""


def percent(label: str = "relative change") -> Shown:
    """A share that is shown in percent."""
    return Shown(label, 100.0, "%")


@dataclasses.dataclass(frozen=True)
class Probe:
    """Proof that a simulator's door reaches its flights."""

    door: str
    """The door that is proven."""
    values: Mapping[str, float]
    """Parameters at which the effect must change a flight."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Change:
    """A parameter of an autopilot that makes up for an effect.

    Its new value is either the old one times a product of powers of factors, or the old one plus a
    sum of gains times sizes, or a value of its own. A size's factor is 1 + size where its neutral
    value is 0, and the size itself where that is 1.
    """

    autopilot: str
    """Whose parameter it is: crazyflie or px4."""
    parameter: str
    """Its name in the firmware; several that change alike, with commas between."""
    where: str = ""
    """In which controller or on which vehicles it acts; empty for everywhere."""
    powers: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Powers of the factors, by names of the effect's parameters."""
    gains: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Gains by names of the effect's parameters, in the parameter's unit over SI."""
    value: float | None = None
    """The new value, whatever the effect's size is."""
    unit: str = ""
    """Unit of the parameter; empty for none or where only a factor is said."""
    holds_mass: bool = False
    """Whether the parameter holds the believed mass now."""
    share: bool = False
    """Whether it is a share of what the vehicle can do at most, which lies between 0 and 1."""
    beside_reference: bool = False
    """Whether it is right only if the vehicle is to fly as its reference did. The simulator of a
    vehicle that was never like it is what should change."""


MELLINGER = "Mellinger controller"
"""Where gains of the Crazyflie's controller of that name act."""
HOVER_THRUST = "hover thrust, from which the estimator of it starts"
"""Where PX4's parameter of the hover acts."""
CRAZYFLIES = "Crazyflie 2.1 and Brushless"
"""Vehicles whose firmware takes how its sensors are mounted."""


def gain(autopilot: str, parameter: str, where: str = "", **powers: float) -> Change:
    """A gain of an attitude loop; it changes only where the vehicle is to fly as its reference."""
    return Change(
        autopilot=autopilot, parameter=parameter, where=where, powers=powers, beside_reference=True
    )


def factor(
    autopilot: str,
    parameter: str,
    where: str,
    unit: str = "",
    *,
    e: float,
    share: bool = False,
    holds_mass: bool = False,
) -> Change:
    """A parameter of an autopilot that is multiplied by 1 + the effect's `e`, to the power `e`."""
    return Change(
        autopilot=autopilot,
        parameter=parameter,
        where=where,
        unit=unit,
        powers={"e": e},
        share=share,
        holds_mass=holds_mass,
    )


def offset(autopilot: str, parameter: str, where: str, unit: str, **gains: float) -> Change:
    """A parameter of an autopilot to which an effect's sizes are added, each times its gain."""
    return Change(autopilot=autopilot, parameter=parameter, where=where, gains=gains, unit=unit)


VOLTAGE_COMPENSATION = (
    Change(
        autopilot="px4",
        parameter="MC_BAT_SCALE_EN",
        where="thrust scaled by the battery's voltage",
        value=1.0,
    ),
    Change(
        autopilot="crazyflie",
        parameter="CONFIG_ENABLE_THRUST_BAT_COMPENSATED",
        where="an option of the build, no parameter at run time",
        value=1.0,
    ),
)
"""What makes up for thrust that falls with the battery's voltage."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EffectCard:
    """What everybody else needs to know of an effect."""

    label: str
    """Short name."""
    noun: str
    """What is there if the effect is, with its article."""
    physics: str
    """One sentence on what it does."""
    more: str = ""
    """The effect by the size of its only parameter, `{}`; `{base}` is "believed" or "before"."""
    less: str = ""
    """The same where the parameter is negative, with its size."""
    shown: Mapping[str, Shown] = dataclasses.field(default_factory=dict)
    """How to speak of its parameters; one that is missing goes by its own name and unit."""

    families: tuple[str, ...] = ()
    """Names of the families of effects that ordinary flights often cannot tell apart, and that are
    excluded together."""
    combined: tuple[str, float] | None = None
    """Name of what flights tell that cannot tell this effect from another, and the power of this
    effect's only parameter in it, as a factor 1 + size."""
    special_cases: tuple[str, ...] = ()
    """Registered names of effects that this one is at the edge of its range."""

    inputs: frozenset[Input] = frozenset()
    """What flights must offer for the effect to show."""
    no_candidate: str = ""
    """Why the effect is never fitted; empty for one that is."""
    airframe: bool = False
    """Whether it tells one airframe from another and does not come or go: it is never blamed, but
    reference flights may show it."""
    local: bool = False
    """Whether every window may want some of it for itself. Its slopes measure what a fit leaves
    (`diagnosis.decide.verdict.structure`), so that it is attached even where it is excluded."""

    start: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Where a fit starts whose slope at neutral vanishes."""
    prior: float | None = None
    """Standard deviation of what an airframe file says of it; None where the range of its
    parameters says more than such a file."""
    unbelieved: bool = False
    """Whether nobody believes to know it, as of another autopilot or other rotors, so that the
    prior of a reference hardly keeps it near neutral."""
    shared: bool = True
    """Whether it is fitted to reference flights."""
    low_if_mapped: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Lower bounds where thrust is known by a map from PWM and voltage alone."""

    flight: str = ""
    """The flight that shows the effect best."""
    separated_from: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """By registered names of other effects, the flight that tells this effect from each of them;
    one of the two cards says it. Both effects act differently there, by their equations."""

    paths: Mapping[str, str] = dataclasses.field(default_factory=dict)
    """By names in `separated_from`, the path of `diagnosis.remedies.flight_paths` that is this
    flight; none where targets of position and heading cannot say it, as steps of attitude."""

    check: str = ""
    """What to look at on the vehicle before a number is changed; a sentence's end after "First"."""
    changes: tuple[Change, ...] = ()
    """What to change in autopilots; none where no parameter makes up for the effect."""
    instead: str = "Keep it in the simulator"
    """What to do where no parameter makes up for it; a sentence that "(`--remedy ...`)" ends."""

    drawn: tuple[Mapping[str, float], ...] = ()
    """Parameters of a small, a medium and a large case of `bench blind`, for an effect that is
    neutral at 0 and that the laboratory has no physics of its own for; empty for none."""
    probe: Probe | None = None
    """How the conformance suite proves a door with it."""


def plain_card(name: str) -> EffectCard:
    """The card of an effect that has none, by its registered name."""
    words = name.replace("_", " ")
    return EffectCard(label=words, noun=f"the effect {words}", physics="")


def load_card(name: str) -> EffectCard:
    """The card of the effect that is registered as `name`, or a plain one.

    A plain one also where nobody has registered the name: documents outlive plug-ins.
    """
    try:
        return registry.load("effect", name).card or plain_card(name)
    except (registry.UnknownPluginError, registry.BrokenPluginError):
        return plain_card(name)


def load_cards() -> dict[str, EffectCard]:
    """The cards of all registered effects that import, by name."""
    return {
        name: kind.card or plain_card(name) for name, kind in registry.load_all("effect").items()
    }


def manoeuvre(one: str, other: str) -> str | None:
    """The flight that tells two effects apart, as one of their cards says; None if neither does."""
    said = load_card(one).separated_from.get(other)
    return said or load_card(other).separated_from.get(one)


def manoeuvre_path(one: str, other: str) -> str | None:
    """Name of the path of that flight; None if targets of position and heading cannot say it."""
    return load_card(one).paths.get(other) or load_card(other).paths.get(one)
