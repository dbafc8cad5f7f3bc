"""Voltage sag: thrust fades with the battery's voltage, gain 1 - k (4.2 V - V).

V is the voltage that was logged, where a replay knows it (`at_voltage`); in a simulation it falls
from a full cell's 4.2 V by `FALL` t. For logs without voltage, `battery` goes by time instead.
"""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.card import VOLTAGE_COMPENSATION, EffectCard, Shown
from simulators.effects.contract import Number, PlantEffect, VoltageEffect, parameter
from simulators.flight import Flight
from simulators.vehicle import Vehicle

FULL = 4.2
"""Voltage of a full lithium-polymer cell [V]; every airframe here has one."""
FALL = 0.4 / 60.0
"""How fast the voltage falls in a simulation [V/s]; 0.3 to 0.5 V a minute were published."""


class VoltageSag(PlantEffect, VoltageEffect):
    """A battery whose voltage is not compensated for. Source: linear form of thrust over V^2."""

    k: Number = parameter(
        "1/V",
        0.0,
        1.0,
        source="thrust as voltage squared gives 0.48 near 4.2 V; the bound is a guess",
    )
    """Share of the thrust that is lost per volt below a full cell [1/V]."""

    order: ClassVar[int] = 7
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="voltage sag",
        noun="a battery that is not compensated for",
        physics="Thrust at the same command falls with the battery's voltage (that of one cell).",
        more="thrust that falls with the battery's voltage by {}",
        less="thrust that grows as the battery's voltage falls, by {}",
        shown={"k": Shown("thrust lost", 100.0, "% a volt")},
        families=("fading thrust",),
        flight="two flights of a minute, one from a full and one from a half-empty battery",
        check="charge the battery, and look at its age",
        changes=VOLTAGE_COMPENSATION,
    )

    def init(self, n_drones: int, dt: float) -> Float[Array, " 2"]:
        """One once a voltage was known, and how far it was below a full cell [V]."""
        return jnp.zeros(2)

    def at_voltage(self, voltage: Float[Array, ""]) -> Float[Array, " 2"]:
        """The memory at a measured voltage [V], the same for all drones."""
        return jnp.stack([jnp.ones_like(voltage), FULL - voltage])

    def plant(
        self, memory: Float[Array, " 2"], flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Float[Array, " 2"], Vehicle]:
        below = jnp.where(memory[0] > 0.0, memory[1], FALL * flight.t)
        gain = vehicle.thrust_gain * (1.0 - self.k * below)
        return memory, eqx.tree_at(lambda v: v.thrust_gain, vehicle, gain)
