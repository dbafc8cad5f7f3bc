"""The plant's constants, and the one statement of the action space that both fidelities share.

Source of every number: crazyflow 0.4.0, ``dynamics/first_principles/params.toml`` and
``control/mellinger/params.toml`` (``tests/simulators/test_vehicle.py`` compares them).
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, ArrayLike, Float

from simulators.algebra.rotation import rotate

GRAVITY = 9.81
"""Gravitational acceleration [m/s^2], crazyflow's value."""

CONTROL_DT = 0.02
"""Time between two actions [s]; paper, Sec. IV-A."""

COLLISION_RADIUS = 0.15
"""Radius around a drone's centre that no other's may touch [m]; paper, Sec. IV-A."""


class Vehicle(eqx.Module):
    """What the plant is made of. The controller's belief is separate and stays nominal."""

    mass: Float[Array, ""]
    """Mass [kg]."""
    believed_mass: Float[Array, ""]
    """Mass that the operator believes [kg]; forces given over mass are given over this one, because
    air does not know what a drone weighs."""
    inertia: Float[Array, "3 3"]
    """Moment of inertia about the centre of mass, body frame [kg m^2]."""
    believed_inertia: Float[Array, "3 3"]
    """That of the airframe file, which an autopilot computes with [kg m^2]."""
    center_of_mass: Float[Array, " 3"]
    """Offset of the centre of mass from the geometric centre, body frame [m]."""
    thrust_gain: Float[Array, ""]
    """Thrust that the rotors produce over the thrust they are believed to produce [-]."""
    rotor_lag: Float[Array, ""]
    """Nominal time constant of rotors that speed up, in hover [s]."""
    motor_lag_scale: Float[Array, ""]
    """Time constants of the rotors over their nominal time constants [-]."""
    slowing_scale: Float[Array, ""]
    """Time constants of rotors that slow down over their nominal ones, besides [-]."""
    quadratic_lag_scale: Float[Array, ""]
    """Quadratic parts of the rotors' lag over their nominal ones, time constants in hover kept
    [-]."""
    rotor_inertia_scale: Float[Array, ""]
    """Moments of inertia of the rotors over their nominal ones [-]."""
    rotor_torque_scale: Float[Array, ""]
    """Torques of the rotors about their axes over the nominal ones at the same speeds [-]."""
    drag: Float[Array, " 3"]
    """Linear drag along the body axes, positive against the motion [N s/m]."""
    arm: Float[Array, ""]
    """Nominal distance of each rotor from the roll and from the pitch axis [m]."""
    arm_scale: Float[Array, ""]
    """That distance over its nominal value [-]."""

    def at_center(
        self, quat: Float[Array, "drones 4"], force: Float[Array, "drones 3"]
    ) -> Float[Array, "drones 3"]:
        """Torque [N m] of a force [N] amid the rotors about the centre of mass, world frame."""
        return jnp.cross(rotate(quat, jnp.broadcast_to(-self.center_of_mass, force.shape)), force)


class AutopilotGains(eqx.Module):
    """Gains of the attitude controller over their nominal values, for roll, pitch and yaw [-]."""

    attitude: Float[Array, " 3"]
    """Of the attitude error."""
    integral: Float[Array, " 3"]
    """Of the integral of that error."""
    rate: Float[Array, " 3"]
    """Of the error in angular velocity."""
    acceleration: Float[Array, " 3"]
    """Of the rate at which that error changes."""

    def more(
        self,
        axes: tuple[float, float, float],
        attitude: ArrayLike = 0.0,
        integral: ArrayLike = 0.0,
        rate: ArrayLike = 0.0,
        acceleration: ArrayLike = 0.0,
    ) -> "AutopilotGains":
        """The gains with relative excesses [-] on some axes: 1 where they act, 0 elsewhere."""
        on = jnp.asarray(axes)
        return AutopilotGains(
            attitude=self.attitude * (1.0 + attitude * on),
            integral=self.integral * (1.0 + integral * on),
            rate=self.rate * (1.0 + rate * on),
            acceleration=self.acceleration * (1.0 + acceleration * on),
        )


class VehicleSpec(eqx.Module):
    """Nominal constants of one airframe, as plain numbers."""

    name: str = eqx.field(static=True)
    """Name of the crazyflow parameter set."""
    mass: float = eqx.field(static=True)
    """Mass [kg]."""
    inertia: tuple[float, float, float] = eqx.field(static=True)
    """Diagonal of the inertia matrix, body frame [kg m^2]."""
    drag: tuple[float, float, float] = eqx.field(static=True)
    """Linear drag along the body axes [N s/m]."""
    thrust_min: float = eqx.field(static=True)
    """Smallest collective thrust while the rotors turn [N]."""
    thrust_max: float = eqx.field(static=True)
    """Largest collective thrust [N]."""
    rpm2thrust: tuple[float, float, float] = eqx.field(static=True)
    """Thrust of one rotor [N] as a polynomial of its speed in rev/min, constant term first."""
    arm: float = eqx.field(static=True)
    """Distance of each rotor from the roll and from the pitch axis [m]."""
    rotor_lag: float = eqx.field(static=True)
    """Time constant of rotors that speed up, in hover [s]."""

    def vehicle(self, drag: bool) -> Vehicle:
        """The nominal plant, with the airframe's linear drag or without any."""
        return Vehicle(
            mass=jnp.asarray(self.mass, float),
            believed_mass=jnp.asarray(self.mass, float),
            inertia=jnp.diag(jnp.asarray(self.inertia, float)),
            believed_inertia=jnp.diag(jnp.asarray(self.inertia, float)),
            center_of_mass=jnp.zeros(3),
            thrust_gain=jnp.asarray(1.0),
            rotor_lag=jnp.asarray(self.rotor_lag, float),
            motor_lag_scale=jnp.asarray(1.0),
            slowing_scale=jnp.asarray(1.0),
            quadratic_lag_scale=jnp.asarray(1.0),
            rotor_inertia_scale=jnp.asarray(1.0),
            rotor_torque_scale=jnp.asarray(1.0),
            drag=jnp.asarray(self.drag if drag else (0.0, 0.0, 0.0), float),
            arm=jnp.asarray(self.arm, float),
            arm_scale=jnp.asarray(1.0),
        )


def whole_steps(duration: float, freq: int) -> int:
    """Number of physics steps at `freq` [Hz] in `duration` [s].

    Raises:
        ValueError: It is no whole number of at least 1.
    """
    n_steps = round(duration * freq)
    if n_steps < 1 or abs(n_steps - duration * freq) > 1e-6:
        raise ValueError(
            f"`duration` must be a positive multiple of {1 / freq:g} s, got {duration}."
        )
    return n_steps


# thrust_min = 4 thrust_max pwm_min / pwm_max: the attitude controller never asks for less.
VEHICLES = {
    "cf21B_500": VehicleSpec(
        name="cf21B_500",
        mass=0.0434,
        inertia=(25e-6, 28e-6, 49e-6),
        drag=(0.021643637770852733, 0.021643637770852733, 0.02477138502714662),
        thrust_min=4 * 0.02136263065537499,
        thrust_max=0.8,
        rpm2thrust=(0.0, -3.133427287299859e-07, 4.407354891648379e-10),
        arm=0.035355,
        rotor_lag=0.057065851968025084,
    ),
    "cf2x_L250": VehicleSpec(
        name="cf2x_L250",
        mass=0.0328,
        inertia=(16.8e-6, 16.8e-6, 29.8e-6),
        drag=(0.014953790232821078, 0.014953790232821078, 0.013900090000325344),
        thrust_min=4 * 0.012817578393224994,
        thrust_max=0.48,
        rpm2thrust=(0.0, -5.382196214637237e-07, 2.4582929831265485e-10),
        arm=0.03253,
        rotor_lag=0.1359504020990923,
    ),
}
"""Airframes by the name of their crazyflow parameter set."""


class ActionSpace(eqx.Module):
    """The action space [-1, 1]^3 = roll, pitch, thrust that both fidelities share.

        roll = tilt_limit a_0,  pitch = tilt_limit a_1,  yaw = 0,
        thrust = thrust_max (a_2 + 1) / 2

    Thrust is thereby "remapped to a non-negative range" (paper, Sec. IV-A).
    """

    tilt_limit: float = eqx.field(static=True, default=0.5)
    """Largest commanded roll and pitch [rad]; a guess, the paper does not state one."""
    thrust_max: float = eqx.field(static=True, default=VEHICLES["cf21B_500"].thrust_max)
    """Largest commanded collective thrust [N]."""

    def to_cmd(self, action: Float[Array, "drones 3"]) -> Float[Array, "drones 4"]:
        """Roll, pitch, yaw [rad] and thrust [N] that an action in [-1, 1] asks for."""
        tilt = self.tilt_limit * action[:, :2]
        thrust = 0.5 * self.thrust_max * (action[:, 2:] + 1.0)
        return jnp.concatenate([tilt, jnp.zeros_like(thrust), thrust], axis=-1)

    def to_action(self, cmd: Float[Array, "drones 4"]) -> Float[Array, "drones 3"]:
        """The action whose command is `cmd`, not limited to [-1, 1]; the yaw is dropped."""
        tilt = cmd[:, :2] / self.tilt_limit
        thrust = 2.0 * cmd[:, 3:] / self.thrust_max - 1.0
        return jnp.concatenate([tilt, thrust], axis=-1)

    def hover(self, mass: float) -> float:
        """Thrust component of the action at which the thrust carries `mass` [kg]."""
        return 2.0 * mass * GRAVITY / self.thrust_max - 1.0
