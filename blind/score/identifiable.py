"""How far an answer's numbers are from the truth, in combinations that flights can tell.

Parameters are compared together where only their combination means something (the components of a
wind), and effects where only a combination of them can be seen: mass and thrust gain as the change
of thrust over mass, (1 + gain) / (1 + e) - 1.

An offset of the centre of mass shows as thrust times offset over inertia. Beside a reference the
length of the rotors' arms and the loop's gains are unknown, too, and offset, inertia and arms that
grow together change no flight but for what rotors that climb differently say, which is little:
against RotorPy the offset counts in crazyflow's inertia (`seen`).

An estimate is efficient if its error, divided by the smallest standard deviation of an unbiased
estimator (the Cramer-Rao bound) that looks at the same windows, whose starts are unknown, is one in
the mean square.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

from blind.draw.catalogue import Withheld
from simulators.vehicle import VEHICLES

NEUTRAL = {"scale": 1.0}
"""Neutral values that are not 0, by parameter."""

SECONDARY = ("onset", "width")
"""Parameters that say when or how wide, not how strong; their errors are absolute."""

_VECTORS = (("x", "y", "z"), ("roll", "pitch"))
"""Parameters that are components of one vector."""

_THRUST_OVER_MASS = ("mass", "thrust_gain")


ROTORPY_INERTIA = (3.3e-5, 3.6e-5)
"""Of roll and pitch in RotorPy's Crazyflie Brushless [kg m^2]."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """One quantity of one effect, estimated and true."""

    quantity: str
    """Effect and parameter, or the combination that was compared."""
    error: float
    """Distance over the true distance from neutral [-]; absolute for times and widths."""
    relative: bool
    """Whether `error` is relative."""


def seen(truth: Withheld, reality: str) -> Withheld:
    """The truth in units in which flights of `reality` can tell it against crazyflow."""
    if reality != "rotorpy" or truth.name != "center_of_mass":
        return truth
    roll, pitch, _ = VEHICLES["cf21B_500"].inertia
    share = {"x": pitch / ROTORPY_INERTIA[1], "y": roll / ROTORPY_INERTIA[0]}
    parameters = {name: share[name] * value for name, value in truth.parameters.items()}
    return dataclasses.replace(truth, parameters=parameters)


def compare(truth: Withheld, name: str, values: Mapping[str, float]) -> list[Comparison]:
    """Errors of an answer that names the true effect or its partner in a combination.

    `values` are the estimated parameters by name. A component of a vector that the answer does not
    give stands at neutral; what the truth does not state is not compared.
    """
    if truth.name in _THRUST_OVER_MASS and name in _THRUST_OVER_MASS:
        true = _thrust_over_mass(truth.name, truth.parameters["e"])
        error = abs(_thrust_over_mass(name, values["e"]) - true) / abs(true)
        return [Comparison("thrust over mass", error, True)]
    if truth.name != name:
        return []
    found = []
    for group in _groups(truth.parameters):
        if not any(parameter in values for parameter in group):
            continue
        neutral = [NEUTRAL.get(p, 0.0) for p in group]
        estimate = [values.get(p, n) for p, n in zip(group, neutral, strict=True)]
        miss = math.dist(estimate, [truth.parameters[p] for p in group])
        size = distance(truth, group)
        relative = group[0] not in SECONDARY
        quantity = f"{truth.name} {' '.join(group)}"
        found.append(Comparison(quantity, miss / size if relative else miss, relative))
    return found


def distance(truth: Withheld, names: Sequence[str]) -> float:
    """How far some of the true parameters are from neutral."""
    return math.dist(
        [truth.parameters.get(p, NEUTRAL.get(p, 0.0)) for p in names],
        [NEUTRAL.get(p, 0.0) for p in names],
    )


def _groups(parameters: Mapping[str, float]) -> list[tuple[str, ...]]:
    vectors = [tuple(p for p in vector if p in parameters) for vector in _VECTORS]
    grouped = [vector for vector in vectors if vector]
    return grouped + [(p,) for p in parameters if not any(p in vector for vector in grouped)]


def _thrust_over_mass(name: str, e: float) -> float:
    """Relative change of the thrust over the mass."""
    return e if name == "thrust_gain" else 1.0 / (1.0 + e) - 1.0


Bounds = Mapping[str, Mapping[str, float]]
"""Smallest standard deviations by effect and parameter."""


def over_bound(truth: Withheld, found: Comparison, bounds: Bounds) -> float | None:
    """The error over its Cramer-Rao bound; None where no bound is known.

    `found` compares an answer with `truth`.
    """
    known = bounds.get(truth.name, {})
    if found.quantity == "thrust over mass":
        bound = known.get("e")
        if bound is not None and truth.name == "mass":
            # d/de of 1 / (1 + e).
            bound /= (1.0 + truth.parameters["e"]) ** 2
            size = abs(1.0 / (1.0 + truth.parameters["e"]) - 1.0)
        else:
            size = abs(truth.parameters["e"])
    else:
        parameters = found.quantity.removeprefix(truth.name).split()
        if any(parameter not in known for parameter in parameters):
            return None
        bound = math.hypot(*(known[parameter] for parameter in parameters))
        size = distance(truth, parameters)
    if not bound:
        return None
    return found.error * (size if found.relative else 1.0) / bound
