"""Inertia: J = J_nominal (1 + e), the same factor for all axes."""

from typing import ClassVar

from simulators.effects.card import MELLINGER, EffectCard, Input, Probe, gain, percent
from simulators.effects.contract import Number, ScalingEffect, excess

GAINS = (
    *(gain("px4", f"MC_{axis}RATE_K", e=1.0) for axis in ("ROLL", "PITCH", "YAW")),
    *(
        gain("crazyflie", f"ctrlMel.{name}", MELLINGER, e=1.0)
        for name in ("kR_xy", "kw_xy", "kd_omega_rp", "ki_m_xy", "kR_z", "kw_z", "ki_m_z")
    ),
)
"""All that turns into a torque, which must grow as the inertia does."""


class Inertia(ScalingEffect):
    """Mass further out or closer in than believed. Source: spread of published airframe data."""

    e: Number = excess(
        -0.5,
        3.0,
        "16.8e-6 (cf2x_L250) to 25e-6 kg m^2 (cf21B_500) in crazyflow 0.4.0; the outer "
        "bounds are a guess",
    )
    """Relative excess moment of inertia [-]."""

    scales: ClassVar[str] = "inertia"
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    order: ClassVar[int] = 3
    version: ClassVar[str] = "1"
    card: ClassVar[EffectCard] = EffectCard(
        label="inertia",
        noun="another inertia",
        physics="The drone resists rotation more or less than the simulator believes.",
        more="{} more inertia than {base}",
        less="{} less inertia than {base}",
        shown={"e": percent()},
        families=("how fast it turns",),
        inputs=frozenset({Input.ATTITUDE_CMD}),
        prior=0.2,  # crazyflow's and RotorPy's files of one Crazyflie differ by 0.20 to 0.32
        flight="attitude steps of 0.3 rad every 0.4 s",
        separated_from={
            "motor_lag": (
                "attitude steps and thrust steps in turn: inertia rounds the first alone, slow "
                "rotors round both"
            ),
        },
        probe=Probe("rotation", {"e": 0.5}),
        check="look for mass that was moved outwards or inwards, such as a longer battery",
        changes=GAINS,
    )
