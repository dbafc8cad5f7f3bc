r"""RotorPy's vehicle as functions of arrays: its airframe, its attitude loop, its derivative.

The vehicle runs as it is published, with the package's file for the Crazyflie Brushless; a private
copy of its module is evaluated with `jax.numpy`, so that it can be compiled and differentiated.
Only the assembly of the state's derivative is written here (in RotorPy it fills an array in place);
tests compare it with the package's own. The equations are those of `simulators/rotorpy.py`.

Source: Folk, Paulos and Kumar (2023), arXiv:2306.04485; airframe: Grafe et al. (2026), "How to
Model Your Crazyflie Brushless", arXiv:2603.05944, as in RotorPy 3.0.0.
"""

import functools
import importlib.util
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.spatial.transform import Rotation
from jaxtyping import Array, Float
from rotorpy.vehicles.crazyfliebrushless_params import quad_params

from simulators.algebra.products import opaque
from simulators.algebra.rotation import rpy_to_quat
from simulators.vehicle import Vehicle, VehicleSpec

ATTITUDE_GAINS = {"kp_att": 150.0, "kd_att": 25.0}
"""Gains of the attitude loop [1/s^2, 1/s]. With those of the file, which calls them hand picked,
the loop rings with the motor's lag (damping 0.06) and is unstable with motors 2.5 times as slow;
these give a pole at 7 rad/s and a pair at 20 rad/s with a damping of 0.31, stable with slow motors
too."""

AIRFRAME = {
    **quad_params,
    **ATTITUDE_GAINS,
    "rotor_directions": np.asarray(quad_params["rotor_directions"], float),
}
"""Parameters of the undisturbed vehicle. Whole numbers become floats: JAX keeps programs of 32-bit
integers that it then hands 64-bit ones where double precision is switched on and off."""

K_ETA = quad_params["k_eta"]
"""Thrust of a rotor over its squared speed [N s^2/rad^2]."""

STANDING = 1.0
"""Squared rotor speed [rad^2/s^2] below which its root has no slope: the slope of a root grows
without bound towards 0. A rotor at 1 rad/s gives 4e-8 N."""


def _spec() -> VehicleSpec:
    """RotorPy's file as an airframe of ours."""
    per_rev = 2.0 * np.pi / 60.0
    return VehicleSpec(
        name="cf_brushless_rotorpy",
        mass=quad_params["mass"],
        inertia=(quad_params["Ixx"], quad_params["Iyy"], quad_params["Izz"]),
        drag=(0.0, 0.0, 0.0),
        thrust_min=0.0,
        thrust_max=float(4.0 * quad_params["k_eta"] * quad_params["rotor_speed_max"] ** 2),
        rpm2thrust=(0.0, 0.0, quad_params["k_eta"] * per_rev**2),
        arm=float(quad_params["rotor_pos"]["r1"][0]),
        rotor_lag=quad_params["tau_m"],
    )


SPEC = _spec()
"""The airframe of RotorPy's file."""


@functools.cache
def _rotorpy() -> ModuleType:
    """A copy of RotorPy's module, the imported one untouched, that computes with JAX."""
    spec = importlib.util.find_spec("rotorpy.vehicles.multirotor")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    numpy = SimpleNamespace(**vars(jnp))
    # JAX does not take a list for an array where RotorPy joins thrust and moment.
    numpy.concatenate = lambda parts: jnp.concatenate([jnp.asarray(part) for part in parts])
    numpy.sqrt = lambda x: jnp.sqrt(jnp.maximum(x, STANDING))
    module.__dict__.update(np=numpy, inv=jnp.linalg.inv, Rotation=Rotation)
    module.Multirotor._norm = staticmethod(_length)
    return module


def _length(vector: Float[Array, " 3"]) -> Float[Array, ""]:
    """The length of a vector, whose slope at zero is zero where RotorPy's is not a number."""
    square = jnp.sum(vector**2)
    return jnp.where(square > 0.0, jnp.sqrt(jnp.where(square > 0.0, square, 1.0)), 0.0)


@functools.cache
def rotor_directions() -> Float[np.ndarray, "4 2"]:
    """Where the rotors are, in arms from the roll and from the pitch axis."""
    places = np.stack([quad_params["rotor_pos"][name][:2] for name in quad_params["rotor_pos"]])
    return places / SPEC.arm


def make_multirotor(airframe: dict[str, Any]) -> Any:
    """RotorPy's vehicle with the given parameters, which may be traced."""
    # NumPy's arrays must not reach a function of JAX: where double precision is switched on and
    # off, JAX 0.10 may hand a program of one precision to an array of the other.
    here = jax.tree.map(lambda x: jnp.asarray(x, float) if _of_numpy(x) else x, airframe)
    return _rotorpy().Multirotor(here, control_abstraction="cmd_ctatt")


def _of_numpy(x: Any) -> bool:
    return isinstance(x, np.ndarray | np.generic)


def airframe_of(vehicle: Vehicle) -> dict[str, Any]:
    """RotorPy's parameters of a vehicle; what is not in it is the file's."""
    inertia = vehicle.inertia
    names = zip(("r1", "r2", "r3", "r4"), rotor_directions(), strict=True)
    arm, center = vehicle.arm * vehicle.arm_scale, vehicle.center_of_mass
    return AIRFRAME | {
        "mass": opaque(vehicle.mass),
        **{f"I{a}{b}": inertia["xyz".index(a), "xyz".index(b)] for a, b in _PRODUCTS},
        "rotor_pos": {name: arm * jnp.asarray([*place, 0.0]) - center for name, place in names},
        "k_eta": K_ETA * vehicle.thrust_gain,
        "k_m": quad_params["k_m"] * vehicle.rotor_torque_scale,
        "tau_m": vehicle.rotor_lag * vehicle.motor_lag_scale,
    }


_PRODUCTS = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Entries of the inertia matrix that RotorPy is given."""


def hover_speed(thrust: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Speed [rad/s] at which four equal rotors are believed to give `thrust` [N]."""
    speed = jnp.sqrt(jnp.maximum(thrust / 4.0 / K_ETA, STANDING))
    return jnp.clip(speed, quad_params["rotor_speed_min"], quad_params["rotor_speed_max"])


def derivative(
    multirotor: Any,
    body: Float[Array, " 17"],
    speeds: Float[Array, " 4"],
    force: Float[Array, " 3"],
    torque: Float[Array, " 3"],
    slowing: Float[Array, ""] | float = 1.0,
) -> Float[Array, " 17"]:
    """Rate of one drone's state in still air.

    Args:
        multirotor: RotorPy's vehicle.
        body: Position [m], velocity [m/s], quaternion, angular velocity and rotor speeds [rad/s].
        speeds: Rotor speeds that are asked for [rad/s].
        force: Force of effects, world frame [N].
        torque: Torque of effects, world frame [N m].
        slowing: Time constants of rotors that slow down over those of others [-].
    """
    vel, quat, ang_vel, rotors = body[3:6], body[6:10], body[10:13], body[13:]
    matrix = Rotation.from_quat(quat).as_matrix()
    own_force, own_torque = multirotor.compute_body_wrench(ang_vel, rotors, matrix.T @ vel)
    acc = (multirotor.weight + matrix @ own_force + force) / multirotor.mass
    turning = own_torque + matrix.T @ torque
    turning = turning - jnp.cross(ang_vel, multirotor.inertia @ ang_vel)
    lag = multirotor.tau_m * jnp.where(speeds < rotors, slowing, 1.0)
    quat_rate = _rotorpy().quat_dot(quat, ang_vel)
    return jnp.concatenate(
        [vel, acc, quat_rate, multirotor.inv_inertia @ turning, (speeds - rotors) / lag]
    )


def motor_speeds(
    multirotor: Any, body: Float[Array, " 17"], cmd: Float[Array, " 4"]
) -> Float[Array, " 4"]:
    """Speeds [rad/s] that RotorPy's attitude loop asks for, on what it believes of the vehicle.

    Args:
        multirotor: RotorPy's vehicle as it is believed to be.
        body: As for `derivative`.
        cmd: Roll, pitch, yaw [rad] and thrust [N].
    """
    speeds = multirotor.get_cmd_motor_speeds(
        {"q": body[6:10], "w": body[10:13]},
        {"cmd_thrust": cmd[3], "cmd_q": rpy_to_quat(cmd[None, :3])[0]},
    )
    return jnp.clip(speeds, multirotor.rotor_speed_min, multirotor.rotor_speed_max)


def runge_kutta(
    rate: Callable[[Array], Array], body: Float[Array, "drones 17"], dt: float
) -> Float[Array, "drones 17"]:
    """States `dt` [s] later by Runge and Kutta's method of fourth order, quaternions unit."""
    k1 = rate(body)
    k2 = rate(body + 0.5 * dt * k1)
    k3 = rate(body + 0.5 * dt * k2)
    k4 = rate(body + dt * k3)
    body = body + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    quat = body[:, 6:10] / jnp.linalg.norm(body[:, 6:10], axis=1, keepdims=True)
    return body.at[:, 6:10].set(quat)
