r"""RotorPy as a reality: another airframe file, other aerodynamics, another attitude loop.

Its `Multirotor` runs as it is published, with the package's file for the Crazyflie Brushless:
rotor drag and inflow that grow with rotor speed, translational lift, one motor time constant,
attitude and thrust commands (`cmd_ctatt`). A private copy of its module is evaluated with
`jax.numpy`, so that hundreds of cases need one compilation; only the assembly of the state's
derivative is written here (in RotorPy it fills an array in place), and tests compare it with the
package's own.

    m v' = -m g e_z + R F + f,  J w' = M - w x J w + R' t,  Omega' = (Omega_cmd - Omega) / tau_m

F, M are RotorPy's body wrench, f, t what it has no parameter for. Runge-Kutta of fourth order; the
attitude loop acts at every step. Mass, inertia, thrust and its decay, motor lag, centre of mass,
rotor and quadratic drag and translational lift are set through RotorPy's parameters. Linear drag,
wind and gust are forces as their labels say, because RotorPy has relatives of them only: a drag
that grows with the rotors' speed, and an air velocity, which changes every aerodynamic force.

Source: Folk, Paulos and Kumar (2023), "RotorPy: A Python-based Multirotor Simulator with
Aerodynamics for Education and Research", arXiv:2306.04485.
"""

import dataclasses
import functools
import importlib.util
from types import ModuleType, SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.scipy.spatial.transform import Rotation
from jaxtyping import Array, Float, Int
from rotorpy.vehicles.crazyfliebrushless_params import quad_params

from blind.fly.disturbances import WrenchDisturbance
from blind.fly.realities import DT, HOVER, AbstractReality, Disturbance
from simulators.flight import Flight
from simulators.vehicle import GRAVITY, VEHICLES

ATTITUDE_GAINS = {"kp_att": 150.0, "kd_att": 25.0}
"""Gains of the attitude loop [1/s^2, 1/s]. With those of the file, which calls them hand picked,
the loop rings with the motor's lag (damping 0.06) and is unstable with motors 2.5 times as slow;
these give a pole at 7 rad/s and a pair at 20 rad/s with a damping of 0.31, stable with slow motors
too."""

AIRFRAME = {**quad_params, **ATTITUDE_GAINS}
"""Parameters of the undisturbed vehicle."""


class RotorpyState(eqx.Module):
    """One world now."""

    steps: Int[Array, ""]
    """Physics steps since the start."""
    body: Float[Array, "drones 17"]
    """Position, velocity, quaternion, angular velocity and rotor speeds [rad/s]."""
    memory: tuple
    """Memories of the command and the wrench disturbance."""


@functools.cache
def _rotorpy() -> ModuleType:
    """A copy of RotorPy's module, the imported one untouched, that computes with JAX."""
    spec = importlib.util.find_spec("rotorpy.vehicles.multirotor")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    # JAX does not take a list for an array where RotorPy joins thrust and moment.
    numpy = SimpleNamespace(**vars(jnp))
    numpy.concatenate = lambda parts: jnp.concatenate([jnp.asarray(part) for part in parts])
    module.__dict__.update(np=numpy, inv=jnp.linalg.inv, Rotation=Rotation)
    return module


def make_multirotor(airframe: dict[str, Any]) -> Any:
    """RotorPy's vehicle with the given parameters, which may be traced."""
    return _rotorpy().Multirotor(airframe, control_abstraction="cmd_ctatt")


class RotorpyReality(AbstractReality):
    """An independent reality; compared with flights of its own undisturbed vehicle."""

    def start(self, disturbance: Disturbance, pos: Float[Array, "drones 3"]) -> RotorpyState:
        """Rotors turn at the speed of the believed hover thrust.

        Raises:
            ValueError: An effect acts through the doors of our simulators, which RotorPy lacks.
        """
        if disturbance.borrowed:
            names = ", ".join(type(effect).__name__ for effect in disturbance.borrowed)
            raise ValueError(f"RotorPy has no doors for effects; fly {names} in 'crazyflow'.")
        command, wrench = disturbance.command, disturbance.wrench
        n_drones = len(pos)
        body = jnp.zeros((n_drones, 17)).at[:, :3].set(pos).at[:, 9].set(1.0)
        body = body.at[:, 13:].set((HOVER / 4.0 / quad_params["k_eta"]) ** 0.5)
        memory, start = command.init(n_drones, DT), jnp.zeros((), jnp.int32)
        hover = jnp.zeros((n_drones, 4)).at[:, 3].set(HOVER)
        for _ in range(2):  # fills the delay's ring, then lets the trim act at once
            memory, _ = command.command(memory, _flight(start, body, 0.0), hover, DT)
        return RotorpyState(start, body, (memory, wrench.init(n_drones, DT)))

    def truth(self, state: RotorpyState) -> Float[Array, "drones 13"]:
        """Everything but the rotors."""
        return state.body[:, :13]

    def step(
        self, disturbance: Disturbance, state: RotorpyState, cmd: Float[Array, "drones 4"]
    ) -> RotorpyState:
        """One step; commands, wrench and motor speeds are held during it."""
        command, wrench = disturbance.command, disturbance.wrench
        t = state.steps * DT
        airframe = disturbed_airframe(disturbance, t)
        multirotor, believed = make_multirotor(airframe), make_multirotor(AIRFRAME)
        flight = _flight(state.steps, state.body, airframe["k_eta"])
        told, cmd = command.command(state.memory[0], flight, cmd, DT)
        vehicle = eqx.tree_at(
            lambda v: (v.mass, v.believed_mass),
            VEHICLES["cf21B_500"].vehicle(drag=False),
            (multirotor.mass, jnp.asarray(quad_params["mass"])),
        )
        pushed, force, torque = _rest_of(wrench).wrench(state.memory[1], flight, vehicle, DT)
        speeds = jax.vmap(lambda body, u: motor_speeds(believed, body, u))(state.body, cmd)

        def rate(body: Array) -> Array:
            return jax.vmap(derivative, in_axes=(None, 0, 0, 0, 0))(
                multirotor, body, speeds, force, torque
            )

        body = state.body
        k1 = rate(body)
        k2 = rate(body + 0.5 * DT * k1)
        k3 = rate(body + 0.5 * DT * k2)
        k4 = rate(body + DT * k3)
        body = body + DT / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        quat = body[:, 6:10] / jnp.linalg.norm(body[:, 6:10], axis=1, keepdims=True)
        return RotorpyState(state.steps + 1, body.at[:, 6:10].set(quat), (told, pushed))


def disturbed_airframe(disturbance: Disturbance, t: Float[Array, ""]) -> dict[str, Any]:
    """RotorPy's parameters of the disturbed vehicle at time `t` [s]."""
    plant, wrench = disturbance.plant, disturbance.wrench
    mass = quad_params["mass"]
    axial, lateral = (
        c * mass / _rotor_speed_sum(AIRFRAME) for c in (wrench.axial_drag, wrench.lateral_drag)
    )
    offset = jnp.concatenate([jnp.asarray(wrench.offset), jnp.zeros(1)])
    changed: dict[str, Any] = {
        "mass": mass * (1.0 + plant.excess_mass),
        "tau_m": quad_params["tau_m"] * plant.motor_slowness,
        "k_eta": quad_params["k_eta"] * (1.0 + plant.excess_thrust) * (1.0 - plant.discharge * t),
        "rotor_pos": {name: pos - offset for name, pos in quad_params["rotor_pos"].items()},
        "k_d": quad_params["k_d"] + lateral,
        "k_z": quad_params["k_z"] + axial,
        "k_h": quad_params["k_h"] + 0.25 * mass * wrench.lift,
    }
    for axis in "xyz":
        name = f"I{axis}{axis}"
        changed[name] = quad_params[name] * (1.0 + plant.excess_inertia)
        changed[f"c_D{axis}"] = quad_params[f"c_D{axis}"] + mass * wrench.quadratic_drag
    return {**AIRFRAME, **changed}


def derivative(
    multirotor: Any,
    body: Float[Array, " 17"],
    speeds: Float[Array, " 4"],
    force: Float[Array, " 3"],
    torque: Float[Array, " 3"],
) -> Float[Array, " 17"]:
    """Rate of one drone's state in still air; force [N] and torque [N m] in the world frame."""
    vel, quat, ang_vel, rotors = body[3:6], body[6:10], body[10:13], body[13:]
    matrix = Rotation.from_quat(quat).as_matrix()
    own_force, own_torque = multirotor.compute_body_wrench(ang_vel, rotors, matrix.T @ vel)
    acc = (multirotor.weight + matrix @ own_force + force) / multirotor.mass
    turning = own_torque + matrix.T @ torque
    turning = turning - jnp.cross(ang_vel, multirotor.inertia @ ang_vel)
    spin = (speeds - rotors) / multirotor.tau_m
    quat_rate = _rotorpy().quat_dot(quat, ang_vel)
    return jnp.concatenate([vel, acc, quat_rate, multirotor.inv_inertia @ turning, spin])


def motor_speeds(
    multirotor: Any, body: Float[Array, " 17"], cmd: Float[Array, " 4"]
) -> Float[Array, " 4"]:
    """Speeds that RotorPy's attitude loop asks for, on what it believes of the vehicle."""
    half = 0.5 * cmd[:3]
    (cr, cp, cy), (sr, sp, sy) = jnp.cos(half), jnp.sin(half)
    quat = [
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    ]
    speeds = multirotor.get_cmd_motor_speeds(
        {"q": body[6:10], "w": body[10:13]}, {"cmd_thrust": cmd[3], "cmd_q": jnp.stack(quat)}
    )
    return jnp.clip(speeds, multirotor.rotor_speed_min, multirotor.rotor_speed_max)


def _rest_of(wrench: WrenchDisturbance) -> WrenchDisturbance:
    """What RotorPy has no parameter for."""
    own = dict.fromkeys(("axial_drag", "lateral_drag", "quadratic_drag", "lift"), 0.0)
    return dataclasses.replace(wrench, **own, offset=jnp.zeros(2))


def _flight(steps: Array, body: Float[Array, "drones 17"], k_eta: Array | float) -> Flight:
    thrust = k_eta * jnp.sum(body[:, 13:] ** 2, axis=1)
    untold = jnp.zeros_like(body[:, :3])  # the drags that depend on it are RotorPy's own
    return Flight(
        steps * DT, body[:, :3], body[:, 3:6], body[:, 6:10], body[:, 10:13], thrust, untold
    )


def _rotor_speed_sum(airframe: dict[str, Any]) -> float:
    """Sum of the rotor speeds in hover [rad/s]."""
    return 4.0 * (airframe["mass"] * GRAVITY / 4.0 / airframe["k_eta"]) ** 0.5
