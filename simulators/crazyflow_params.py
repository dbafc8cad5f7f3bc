"""crazyflow's parameters of a vehicle that is not the nominal one, and of its rotors."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from simulators.algebra.products import opaque
from simulators.effects.contract import AbstractEffect, PlantEffect
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, GRAVITY, AutopilotGains, Vehicle

PARAMS_FILE = "dynamics/first_principles/params.toml"
"""Where crazyflow 0.4.0 keeps the numbers of its airframes, in its own folder."""
SimData = Any
"""crazyflow's structs are flax dataclasses, whose `replace` type checkers do not know."""


def scaled_params(data: SimData, vehicle: Vehicle) -> Any:
    """Dynamics parameters of a vehicle; the controller's are not touched."""
    params = data.params
    return params.replace(
        mass=opaque(jnp.broadcast_to(vehicle.mass, params.mass.shape)),
        J=vehicle.inertia,
        J_inv=jnp.linalg.inv(vehicle.inertia),
        drag_matrix=-jnp.diag(vehicle.drag),
        rpm2thrust=params.rpm2thrust * vehicle.thrust_gain,
        L=params.L * vehicle.arm_scale,
        rpm2torque=params.rpm2torque * vehicle.rotor_torque_scale,
        prop_inertia=params.prop_inertia * vehicle.rotor_inertia_scale,
        rotor_dyn_coef=rotor_coef(data, vehicle),
    )


def changed_params(data: SimData, vehicle: Vehicle) -> dict[str, Any]:
    """Entries of `PARAMS_FILE` that another vehicle changes."""
    before, after = data.params, scaled_params(data, vehicle)
    changed = {}
    for name in (field.name for field in dataclasses.fields(before) if field.name != "J_inv"):
        old, new = (
            np.asarray(getattr(params, name), float).squeeze() for params in (before, after)
        )
        if not np.allclose(new, old, rtol=1e-6, atol=0.0):
            changed[name] = new.tolist()
    gain = float(vehicle.thrust_gain)
    if "rpm2thrust" in changed and gain > 0.0:
        # crazyflow makes the range of its rotors' speeds of these, which stays.
        limits = data.controls.force_torque.params
        changed |= {n: gain * float(np.ravel(limits[n])[0]) for n in ("thrust_min", "thrust_max")}
    return changed


def constant_plant(effect: AbstractEffect, vehicle: Vehicle) -> Vehicle | None:
    """The vehicle with an effect that crazyflow's file can say; None with any other effect.

    It must change the plant alone, alike in every flight, and not where the centre of mass is.
    """
    if not isinstance(effect, PlantEffect) or effect.init(1, CONTROL_DT) is not None:
        return None
    one, other = (effect.plant(None, _flight(x), vehicle, CONTROL_DT)[1] for x in (0.0, 1.0))
    same = all(map(jnp.array_equal, jax.tree.leaves(one), jax.tree.leaves(other)))
    moved = not jnp.array_equal(one.center_of_mass, vehicle.center_of_mass)
    return one if same and not moved else None


def _flight(x: float) -> Flight:
    """A level flight in which every number that may change a plant is `x`."""
    row, level = jnp.full((1, 3), x), jnp.asarray([[0.0, 0.0, 0.0, 1.0]])
    return Flight(
        t=jnp.asarray(x),
        pos=row,
        vel=row,
        quat=level,
        ang_vel=row,
        thrust=jnp.full(1, x),
        torque=row,
    )


def rotor_coef(data: SimData, vehicle: Vehicle) -> Float[Array, "*rotors 4"]:
    """Linear [1/s] and quadratic coefficients of rotors that speed up, then of those slowing down.

    What a quadratic coefficient loses, the linear one gains at the speed of hover.
    """
    coef = data.params.rotor_dyn_coef
    hover = hover_rotor_vel(data, GRAVITY * data.params.mass[None])[0]
    lost = (1.0 - vehicle.quadratic_lag_scale) * coef[..., 1::2]
    law = jnp.stack([2.0 * hover * lost, -lost], axis=-1).reshape(coef.shape)
    slower = vehicle.motor_lag_scale * jnp.stack([1.0, 1.0, *(vehicle.slowing_scale,) * 2])
    return (coef + law) / slower


def scaled_gains(data: SimData, gains: AutopilotGains) -> SimData:
    """`data` with the attitude controller's gains scaled; the dynamics are not touched."""
    params = data.controls.attitude.params
    attitude = data.controls.attitude.replace(
        params=params
        | {
            "kR": params["kR"] * gains.attitude,
            "ki_m": params["ki_m"] * gains.integral,
            "kw": params["kw"] * gains.rate,
            "kd_omega": params["kd_omega"] * gains.acceleration,
        }
    )
    return data.replace(controls=data.controls.replace(attitude=attitude))


def limited(data: SimData, low: float, high: float) -> SimData:
    """`data` with motors that give collective thrusts [N] from `low` to `high`.

    The autopilot's PWM counts as much thrust as before, from its new range.
    """
    attitude, force = data.controls.attitude, data.controls.force_torque
    per_newton = attitude.params["pwm_max"] / attitude.params["thrust_max"]
    pwm = {"pwm_min": per_newton * low / 4.0, "pwm_max": per_newton * high / 4.0}
    attitude = attitude.replace(params=attitude.params | pwm | {"thrust_max": high / 4.0})
    limits = {"thrust_min": low / 4.0, "thrust_max": high / 4.0}
    force = force.replace(params=force.params | limits)
    return data.replace(controls=data.controls.replace(attitude=attitude, force_torque=force))


def rotor_wrench(
    params: Any, rotor_vel: Float[Array, "drones 4"]
) -> tuple[Float[Array, " drones"], Float[Array, "drones 3"]]:
    """Thrust [N] of rotor speeds [rev/min], and its torque about roll and pitch [N m, body]."""
    c0, c1, c2 = (params.rpm2thrust[..., i] for i in range(3))
    each = c0 + c1 * rotor_vel + c2 * rotor_vel**2
    torque = params.L[..., None] * jnp.matmul(each, jnp.swapaxes(params.mixing_matrix, -1, -2))
    return jnp.sum(each, axis=-1), torque * jnp.asarray([1.0, 1.0, 0.0])


def hover_rotor_vel(
    data: SimData, thrust: Float[Array, "time drones"]
) -> Float[Array, "time drones 1"]:
    """Rotor speed [rev/min] at which four equal rotors give `thrust` [N], within the range."""
    limits = data.controls.force_torque.params
    each = jnp.clip(thrust / 4.0, limits["thrust_min"], limits["thrust_max"])[..., None]
    c, b, a = (data.params.rpm2thrust[..., i] for i in range(3))
    return (-b + jnp.sqrt(b**2 - 4.0 * a * (c - each))) / (2.0 * a)
