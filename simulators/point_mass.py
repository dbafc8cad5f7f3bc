r"""The paper's low-fidelity simulator: a point mass under a thrust vector.

With commanded roll, pitch, yaw and thrust (phi_c, theta_c, psi_c, T), h the step:

    (phi, theta, psi) += (1 - exp(-h / tau)) ((phi_c, theta_c, psi_c) - (phi, theta, psi))
    a = R_z(psi) [ T/m sin(theta) cos(phi), -T/m sin(phi), T/m cos(theta) cos(phi) ] - [0, 0, g]
    v += h a,     p += h v                                (semi-implicit Euler, first order)

The lag is the exact solution of its first-order equation under a held command; thrust follows at
once; actions command no yaw, so psi = 0 and the equations are those of the paper, Sec. IV-A.
A yaw command beyond +-pi, or that wraps there, is followed the short way.
There is no drag, no rotor, no moment of inertia and no floor.

| symbol | name | unit |
|---|---|---|
| tau | `attitude_tau`, time constant of roll, pitch and yaw | s |
| T | collective thrust | N |
| m | `spec.mass` | kg |
| h | `dt`, integration step, at most 0.02 | s |

Effects attach through command, plant (mass, thrust gain, drag), response, wrench and state.
"""

import math
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, PRNGKeyArray

from simulators.algebra.rotation import quat_to_rpy, rotate, rotate_back, rpy_to_quat
from simulators.contract import Replayable
from simulators.effects import chain
from simulators.effects.contract import (
    AbstractEffect,
    FrozenEffect,
    PlantEffect,
    ResponseEffect,
    StateEffect,
)
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, GRAVITY, VEHICLES, ActionSpace, VehicleSpec


class PointMassState(eqx.Module):
    """State of a team of point masses."""

    t: Float[Array, ""]
    """Time since the reset [s]."""
    pos: Float[Array, "drones 3"]
    """Position, world [m]."""
    vel: Float[Array, "drones 3"]
    """Velocity, world [m/s]."""
    rpy: Float[Array, "drones 3"]
    """Roll, pitch, yaw after the lag [rad]."""
    thrust: Float[Array, " drones"]
    """Collective thrust of the last step [N]."""
    lag: Float[Array, "drones 3"]
    """What the nominal lag alone makes of the commands [rad]; `rpy` unless effects respond."""
    memory: tuple
    """Memories of the attached effects."""


class PointMass(Replayable):
    """Source: Mednikov and Gal, arXiv 2609.17265, Sec. IV-A, "pmDrones"."""

    spec: VehicleSpec = VEHICLES["cf21B_500"]
    """The airframe whose mass and thrust range the point mass has."""
    action_space: ActionSpace = ActionSpace()
    """How actions become commands."""
    attitude_tau: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=0.104)
    """Time constant of the attitude lag [s]. The paper gives none; this is the first-order part
    2 z / w_n = 16.3 / 156.3 s of the second-order attitude loop that crazyflow 0.4.0 identified
    on the vehicle (``so_rpy_rotor_drag``: w_n = 12.5 rad/s, z = 0.65)."""
    dt: float = eqx.field(static=True, default=CONTROL_DT)
    """Longest integration step [s]; paper, Sec. IV-A."""
    effects: tuple[AbstractEffect, ...] = ()
    """Attached effects."""

    name: ClassVar[str] = "point_mass"
    version: ClassVar[str] = "1"
    replay_dt: ClassVar[float] = 0.005
    airframes: ClassVar[Mapping[str, VehicleSpec]] = VEHICLES
    doors: ClassVar[tuple[str, ...]] = ("command", "plant", "response", "wrench", "state")

    def __check_init__(self) -> None:
        if not self.dt > 0.0:
            raise ValueError(f"`dt` must be above 0 s, got {self.dt}.")
        tau = self.attitude_tau
        if eqx.is_array(tau) and not isinstance(tau, Tracer) and not (tau > 0.0).all():
            raise ValueError(f"`attitude_tau` must be above 0 s, got {tau}.")

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> PointMassState:
        zeros = jnp.zeros_like(pos)
        return PointMassState(
            t=jnp.zeros(()),
            pos=pos,
            vel=zeros,
            rpy=zeros,
            thrust=zeros[:, 0],
            lag=zeros,
            memory=chain.init(self.effects, len(pos), self.dt, key),
        )

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> PointMassState:
        n_drones = len(flight.pos)
        rpy = quat_to_rpy(flight.quat)
        memory = chain.init(self.effects, n_drones, self.dt, key)
        repeats = math.ceil(CONTROL_DT / self.dt - 1e-9)
        h = CONTROL_DT / repeats
        memory, _ = chain.warm_up(self.effects, memory, flight, cmd_history, repeats, h)
        steady = self._response(memory, flight, rpy, h)
        return PointMassState(
            t=flight.t,
            pos=flight.pos,
            vel=flight.vel,
            rpy=rpy,
            thrust=flight.thrust,
            lag=rpy,
            memory=chain.at(self.effects, memory, steady),
        )

    def step_cmd(
        self, state: PointMassState, cmd: Float[Array, "drones 4"], duration: float
    ) -> PointMassState:
        """Held for `duration` [s], in equal steps no longer than `dt`."""
        if not duration > 0:
            raise ValueError(f"`duration` must be above 0 s, got {duration}.")
        n_steps = math.ceil(duration / self.dt - 1e-9)
        for _ in range(n_steps):
            state = self._integrate(state, cmd, duration / n_steps)
        return state

    def with_attitude(
        self,
        state: PointMassState,
        quat: Float[Array, "drones 4"],
        ang_vel: Float[Array, "drones 3"],
        chosen: Bool[Array, " drones"],
    ) -> PointMassState:
        """Lags start steady at the attitude; a point mass has no angular velocity."""
        rpy = jnp.where(chosen[:, None], quat_to_rpy(quat), state.rpy)
        lag = jnp.where(chosen[:, None], rpy, state.lag)
        steady = self._response(state.memory, self.flight(state), rpy, self.dt)
        settled = chain.at(self.effects, state.memory, steady)
        memory = tuple(
            jax.tree.map(lambda new, old: _chosen(chosen, new, old), new, old)
            if isinstance(effect, ResponseEffect)
            else old
            for effect, new, old in zip(self.effects, settled, state.memory, strict=True)
        )
        return eqx.tree_at(
            lambda s: (s.rpy, s.lag, s.memory),
            state,
            (rpy, lag, memory),
            is_leaf=lambda x: x is state.memory,
        )

    def with_faster_rotors(
        self,
        state: PointMassState,
        faster: Float[Array, "drones 4"],
        chosen: Bool[Array, " drones"],
    ) -> PointMassState:
        """As it is: a point mass has no rotors."""
        return state

    def with_thrust(self, state: PointMassState, thrust: Float[Array, " drones"]) -> PointMassState:
        """As it is: thrust follows its command at once."""
        return state

    def repeating(self, after: PointMassState) -> "PointMass":
        """Frozen effects remember one integration step, so that a control step must be one."""
        if not chain.has(self.effects, FrozenEffect) or self.dt < CONTROL_DT - 1e-9:
            return self
        effects = tuple(
            effect.repeated(memory) if isinstance(effect, FrozenEffect) else effect
            for effect, memory in zip(self.effects, after.memory, strict=True)
        )
        return eqx.tree_at(lambda s: s.effects, self, effects, is_leaf=lambda x: x is self.effects)

    def flight(self, state: PointMassState) -> Flight:
        return Flight(
            t=state.t,
            pos=state.pos,
            vel=state.vel,
            quat=rpy_to_quat(state.rpy),
            ang_vel=jnp.zeros_like(state.pos),
            thrust=state.thrust,
            torque=jnp.zeros_like(state.pos),
        )

    def acceleration(
        self, rpy: Float[Array, "drones 3"], thrust: Float[Array, " drones"]
    ) -> Float[Array, "drones 3"]:
        """Nominal acceleration [m/s^2, world] at an attitude [rad] and thrust [N]."""
        return _thrust_vector(rpy, thrust) / self.spec.mass + jnp.asarray([0.0, 0.0, -GRAVITY])

    def _response(
        self, memory: tuple, flight: Flight, rpy: Float[Array, "drones 3"], h: float
    ) -> Float[Array, "drones 4"]:
        """What lags hold that are steady at an attitude and a thrust: that before the gain."""
        _, vehicle = chain.plant(self.effects, memory, flight, self.spec.vehicle(drag=False), h)
        return jnp.concatenate([rpy, flight.thrust[:, None] / vehicle.thrust_gain], axis=-1)

    def _integrate(
        self, state: PointMassState, cmd: Float[Array, "drones 4"], h: float
    ) -> PointMassState:
        effects, memory, flight = self.effects, state.memory, self.flight(state)
        memory, cmd = chain.command(effects, memory, flight, cmd, h)
        cmd = cmd.at[:, 2].set(_near(cmd[:, 2], state.lag[:, 2]))
        memory, vehicle = chain.plant(effects, memory, flight, self.spec.vehicle(drag=False), h)
        lag = state.lag + (1.0 - jnp.exp(-h / self.attitude_tau)) * (cmd[:, :3] - state.lag)
        response = jnp.concatenate([lag, cmd[:, 3:]], axis=-1)
        memory, response = chain.respond(effects, memory, response, cmd, h)
        rpy, thrust = response[:, :3], response[:, 3] * vehicle.thrust_gain

        force = _thrust_vector(rpy, thrust)
        if effects:
            flight = eqx.tree_at(lambda f: (f.quat, f.thrust), flight, (rpy_to_quat(rpy), thrust))
            memory, extra, _ = chain.wrench(effects, memory, flight, vehicle, h, -0.5 * h)
            force = force + extra
        if chain.has(effects, PlantEffect):
            force = force - rotate(flight.quat, vehicle.drag * rotate_back(flight.quat, state.vel))
        acc = force / vehicle.mass + jnp.asarray([0.0, 0.0, -GRAVITY])
        vel = state.vel + h * acc
        new = PointMassState(
            t=state.t + h,
            pos=state.pos + h * vel,
            vel=vel,
            rpy=rpy,
            thrust=thrust,
            lag=lag,
            memory=memory,
        )
        if not chain.has(effects, StateEffect):
            return new
        memory, flight = chain.project(effects, memory, self.flight(new))
        return eqx.tree_at(
            lambda s: (s.pos, s.vel, s.memory),
            new,
            (flight.pos, flight.vel, memory),
            is_leaf=lambda x: x is memory,
        )


def _chosen(
    chosen: Bool[Array, " drones"], new: Float[Array, "..."], old: Float[Array, "..."]
) -> Float[Array, "..."]:
    """`new` where a drone is chosen, `old` elsewhere."""
    return jnp.where(chosen.reshape(-1, *[1] * (new.ndim - 1)), new, old)


def _near(
    angle: Float[Array, " drones"], other: Float[Array, " drones"]
) -> Float[Array, " drones"]:
    """`angle` [rad], whole turns away from which it is nearest to `other`."""
    return angle - 2.0 * jnp.pi * jnp.round((angle - other) / (2.0 * jnp.pi))


def _thrust_vector(
    rpy: Float[Array, "drones 3"], thrust: Float[Array, " drones"]
) -> Float[Array, "drones 3"]:
    """Thrust as a vector in the world frame [N]."""
    roll, pitch, yaw = rpy[:, 0], rpy[:, 1], rpy[:, 2]
    x = thrust * jnp.sin(pitch) * jnp.cos(roll)
    y = -thrust * jnp.sin(roll)
    z = thrust * jnp.cos(pitch) * jnp.cos(roll)
    cos, sin = jnp.cos(yaw), jnp.sin(yaw)
    return jnp.stack([cos * x - sin * y, sin * x + cos * y, z], axis=-1)
