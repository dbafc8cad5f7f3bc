"""A library of four effects of one parameter each, for likelihoods that are linear."""

import dataclasses

from diagnosis.replay.library import Library, Slot
from simulators.effects.card import plain_card
from simulators.effects.contract import WrenchEffect
from simulators.point_mass import PointMass

NAMES = ("drag", "mass", "trim", "wind")


class Plain(WrenchEffect):
    """An effect that is never flown."""

    parameters = {}  # noqa: RUF012
    door, needs, order, version, card = "wrench", (), 0, "1", None

    def init(self, n_drones, dt):
        raise NotImplementedError

    def wrench(self, memory, flight, vehicle, dt):
        raise NotImplementedError


class Local(Plain):
    """One that every window may want some of for itself."""

    card = dataclasses.replace(plain_card("local"), local=True)


def toy_library(parameter, unit, bound, local=()):
    """Parameters go from minus to plus `bound`."""
    effects = {name: Local if name in local else Plain for name in NAMES}
    slots = tuple(Slot(name, parameter, unit, 0.0, -bound, bound) for name in NAMES)
    return Library(PointMass(), effects, slots)
