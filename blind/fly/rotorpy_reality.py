r"""RotorPy as a reality: another airframe file, other aerodynamics, another attitude loop.

The vehicle is that of `simulators/rotorpy_vehicle.py`, with physics steps of 2 ms; here it is
disturbed. Mass, inertia, thrust and its decay, motor lag, centre of mass, rotor and quadratic drag
and translational lift are set through RotorPy's parameters. Linear drag, wind and gust are forces
as their labels say, because RotorPy has relatives of them only: a drag that grows with the rotors'
speed, and an air velocity, which changes every aerodynamic force.

Source: Folk, Paulos and Kumar (2023), "RotorPy: A Python-based Multirotor Simulator with
Aerodynamics for Education and Research", arXiv:2306.04485.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int
from rotorpy.vehicles.crazyfliebrushless_params import quad_params

from blind.fly.disturbances import WrenchDisturbance
from blind.fly.realities import DT, HOVER, AbstractReality, Disturbance
from simulators.flight import Flight
from simulators.rotorpy_vehicle import (
    AIRFRAME,
    derivative,
    make_multirotor,
    motor_speeds,
    runge_kutta,
)
from simulators.vehicle import GRAVITY, VEHICLES


class RotorpyState(eqx.Module):
    """One world now."""

    steps: Int[Array, ""]
    """Physics steps since the start."""
    body: Float[Array, "drones 17"]
    """Position, velocity, quaternion, angular velocity and rotor speeds [rad/s]."""
    memory: tuple
    """Memories of the command and the wrench disturbance."""


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

        body = runge_kutta(rate, state.body, DT)
        return RotorpyState(state.steps + 1, body, (told, pushed))


def disturbed_airframe(disturbance: Disturbance, t: Float[Array, ""]) -> dict[str, Any]:
    """RotorPy's parameters of the disturbed vehicle at time `t` [s]."""
    plant, wrench = disturbance.plant, disturbance.wrench
    mass = quad_params["mass"]
    speeds = 4.0 * (AIRFRAME["mass"] * GRAVITY / 4.0 / AIRFRAME["k_eta"]) ** 0.5  # in hover
    axial, lateral = (c * mass / speeds for c in (wrench.axial_drag, wrench.lateral_drag))
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
