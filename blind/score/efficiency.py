"""How close an estimate comes to the Cramer-Rao bound of its flights.

An error is divided by the smallest standard deviation of an unbiased estimator that looks at the
same windows, whose starts are unknown, in the combination in which the parameter is compared: with
efficient estimates the mean square is one.
"""

import math
from collections.abc import Mapping

from blind.draw.catalogue import Withheld
from blind.score.identifiable import Comparison, distance

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
