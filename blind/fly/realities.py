"""What a reality is: a world that flies commands under disturbances, one physics step at a time."""

import abc
import importlib
from typing import Any, NamedTuple

import equinox as eqx
from jaxtyping import Array, Float

from blind.fly.disturbances import CommandDisturbance, PlantDisturbance, WrenchDisturbance
from simulators.effects.contract import AbstractEffect
from simulators.vehicle import GRAVITY, VEHICLES


class Disturbance(NamedTuple):
    """Everything that may be different, neutral where it is not."""

    command: CommandDisturbance
    """What the commands meet."""
    plant: PlantDisturbance
    """What the vehicle's constants are."""
    wrench: WrenchDisturbance
    """What pushes and turns."""
    borrowed: tuple[AbstractEffect, ...] = ()
    """Effects of the library that the laboratory has no physics of its own for."""


DRONE = "cf21B_500"
"""The airframe of every case."""
MASS = VEHICLES[DRONE].mass
"""Mass that the operator believes [kg]."""
HOVER = MASS * GRAVITY
"""Thrust that she believes to carry it [N]."""
DT = 0.002
"""Physics step [s]."""


class AbstractReality(eqx.Module):
    """Flies one world; the functions are pure, so that `vmap` adds flights."""

    @abc.abstractmethod
    def start(self, disturbance: Disturbance, pos: Float[Array, "drones 3"]) -> Any:
        """The state of drones that have hovered at `pos` [m] on the believed hover thrust."""

    @abc.abstractmethod
    def truth(self, state: Any) -> Float[Array, "drones 13"]:
        """Position, velocity, quaternion (scalar last) and angular velocity (body)."""

    @abc.abstractmethod
    def step(self, disturbance: Disturbance, state: Any, cmd: Float[Array, "drones 4"]) -> Any:
        """The state `DT` later under roll, pitch, yaw [rad] and thrust [N]."""


REALITIES = {
    "crazyflow": "blind.fly.crazyflow_reality:CrazyflowReality",
    "rotorpy": "blind.fly.rotorpy_reality:RotorpyReality",
}
"""Where each reality is."""


def load(name: str) -> AbstractReality:
    """The reality called `name`.

    Raises:
        ValueError: There is none.
    """
    if name not in REALITIES:
        raise ValueError(f"`reality` must be one of {', '.join(REALITIES)}, got '{name}'.")
    module, kind = REALITIES[name].split(":")
    return getattr(importlib.import_module(module), kind)()
