r"""A second high-fidelity simulator: RotorPy's `Multirotor`, 200 Hz, Runge-Kutta of fourth order.

The vehicle itself is the package's own, evaluated with JAX by `simulators/rotorpy_vehicle.py`, the
only module here that imports RotorPy; this one steps it, with effects.

    m v' = -m g e_z + R F + f,   J w' = M - w x J w + R' t,   Omega' = (Omega_cmd - Omega) / tau_m
    F = (0, 0, sum k_eta Omega^2 + k_h |v_xy|^2) - sum Omega K v_i,   K = diag(k_d, k_d, k_z)

| symbol | name | unit |
|---|---|---|
| F, M | force and torque of the rotors and the air, body frame | N, N m |
| f, t | force and torque of attached effects, world frame | N, N m |
| v_i | velocity of rotor i through the air, body frame | m/s |
| Omega | rotor speeds; Omega_cmd is what the attitude loop asks for | rad/s |

What crazyflow and our effects have no twin of: drag and inflow grow with the rotors' speeds,
translational lift acts at each rotor, the attitude loop is one of angle and rate, without integral.

On purpose, as in RotorPy: on the floor (z <= 1 mm) a drone is level, does not turn, does not sink,
and loses 30 % of its horizontal velocity at every step. Rotors stand still at reset.

The airframe's mass, inertia, arm and motor lag are those of `spec`, so that a diagnosis can put in
the operator's; thrust, drag and yaw torque of a rotor are always those of RotorPy's file.

Source: Folk, Paulos and Kumar (2023), "RotorPy: A Python-based Multirotor Simulator with
Aerodynamics for Education and Research", arXiv:2306.04485; airframe: Grafe et al. (2026), "How to
Model Your Crazyflie Brushless", arXiv:2603.05944, as in RotorPy 3.0.0.
"""

import functools
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from simulators.algebra.products import written_out
from simulators.contract import Replayable
from simulators.effects import chain
from simulators.effects.contract import AbstractEffect
from simulators.flight import Flight
from simulators.rotorpy_vehicle import (
    K_ETA,
    SPEC,
    airframe_of,
    derivative,
    hover_speed,
    make_multirotor,
    motor_speeds,
    quad_params,
    rotor_directions,
    runge_kutta,
)
from simulators.vehicle import CONTROL_DT, GRAVITY, ActionSpace, Vehicle, VehicleSpec, whole_steps

GROUND = 0.001
"""Height at and below which a drone stands on the floor [m]; RotorPy's `_on_ground`."""

FRICTION = 0.3
"""Share of the horizontal velocity that a step on the floor takes; RotorPy's default."""


class RotorpyState(eqx.Module):
    """What changes from physics step to physics step."""

    steps: Int[Array, ""]
    """Physics steps since the reset."""
    pos: Float[Array, "drones 3"]
    """Position, world [m]."""
    vel: Float[Array, "drones 3"]
    """Velocity, world [m/s]."""
    quat: Float[Array, "drones 4"]
    """Attitude, body to world, scalar last."""
    ang_vel: Float[Array, "drones 3"]
    """Angular velocity, body frame [rad/s]."""
    rotor_vel: Float[Array, "drones 4"]
    """Rotor speeds [rad/s]."""
    memory: tuple
    """Memories of the attached effects."""

    @property
    def body(self) -> Float[Array, "drones 17"]:
        """Everything that RotorPy integrates."""
        return jnp.concatenate(
            [self.pos, self.vel, self.quat, self.ang_vel, self.rotor_vel], axis=1
        )


class Rotorpy(Replayable):
    """Source: Folk et al. (2023), RotorPy 3, with its file of the Crazyflie Brushless."""

    spec: VehicleSpec = SPEC
    """The airframe."""
    action_space: ActionSpace = ActionSpace()
    """How actions become commands."""
    freq: int = eqx.field(static=True, default=200)
    """Physics steps per second [Hz]; the attitude loop runs at the same rate."""
    effects: tuple[AbstractEffect, ...] = ()
    """Attached effects."""

    name: ClassVar[str] = "rotorpy"
    version: ClassVar[str] = "1"
    replay_dt: ClassVar[float] = 0.002  # at 500 Hz acts the attitude loop of a Crazyflie
    airframes: ClassVar[Mapping[str, VehicleSpec]] = MappingProxyType({"cf21B_500": SPEC})
    """The Crazyflie Brushless, by the name that crazyflow gives it."""
    doors: ClassVar[tuple[str, ...]] = ("command", "plant", "wrench", "rotation", "state")

    @property
    def braking(self) -> Float[np.ndarray, " 3"]:
        """That of the rotors' drag at their speed in hover; its force is `sum Omega K v`."""
        turning = 4.0 * float(hover_speed(jnp.asarray(GRAVITY * self.spec.mass)))
        drag = [quad_params[name] for name in ("k_d", "k_d", "k_z")]
        return turning * np.asarray(drag) / self.spec.mass

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> RotorpyState:
        zeros = jnp.zeros_like(pos)
        four = jnp.zeros((len(pos), 4), pos.dtype)
        return RotorpyState(
            steps=jnp.zeros((), jnp.int32),
            pos=pos,
            vel=zeros,
            quat=four.at[:, 3].set(1.0),
            ang_vel=zeros,
            rotor_vel=four,
            memory=chain.init(self.effects, len(pos), 1.0 / self.freq, key),
        )

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> RotorpyState:
        """The state at a measured flight; rotors start steady and follow the commands before."""
        n_drones, dt = len(flight.pos), 1.0 / self.freq
        memory = chain.init(self.effects, n_drones, dt, key)
        repeats = round(CONTROL_DT * self.freq)
        memory, cmds = chain.warm_up(self.effects, memory, flight, cmd_history, repeats, dt)
        targets = hover_speed(cmds[:, :, 3])
        _, vehicle = chain.plant(self.effects, memory, flight, self._vehicle(), dt)
        lag = vehicle.rotor_lag * vehicle.motor_lag_scale

        def spin(speed: Array, target: Array) -> tuple[Array, None]:
            tau = lag * jnp.where(target < speed, vehicle.slowing_scale, 1.0)
            return target + (speed - target) * jnp.exp(-CONTROL_DT / tau), None

        speed, _ = jax.lax.scan(spin, targets[0], targets)
        return RotorpyState(
            steps=jnp.round(flight.t * self.freq).astype(jnp.int32),
            pos=flight.pos,
            vel=flight.vel,
            quat=flight.quat,
            ang_vel=flight.ang_vel,
            rotor_vel=jnp.broadcast_to(speed[:, None], (n_drones, 4)),
            memory=memory,
        )

    def step_cmd(
        self, state: RotorpyState, cmd: Float[Array, "drones 4"], duration: float
    ) -> RotorpyState:
        """Held for `duration` [s], a whole number of physics steps."""
        n_steps = whole_steps(duration, self.freq)

        # Not checkpointed: 500 control steps of 12 drones and their gradient take 92 ms so, 181 ms
        # with a checkpoint per physics step, 12 ms without gradient (crazyflow: 59 and 10 ms).
        def physics_step(state: RotorpyState, _: None) -> tuple[RotorpyState, None]:
            return written_out(self._physics_step)(state, cmd), None

        state, _ = jax.lax.scan(physics_step, state, None, length=n_steps)
        return state

    def with_attitude(
        self,
        state: RotorpyState,
        quat: Float[Array, "drones 4"],
        ang_vel: Float[Array, "drones 3"],
        chosen: Bool[Array, " drones"],
    ) -> RotorpyState:
        """Rotor speeds stay."""
        where = functools.partial(jnp.where, chosen[:, None])
        return eqx.tree_at(
            lambda s: (s.quat, s.ang_vel),
            state,
            (where(quat, state.quat), where(ang_vel, state.ang_vel)),
        )

    def with_thrust(self, state: Any, thrust: Array) -> RotorpyState:
        speeds = jnp.broadcast_to(hover_speed(thrust)[:, None], state.rotor_vel.shape)
        return eqx.tree_at(lambda s: s.rotor_vel, state, speeds)

    def flight(self, state: RotorpyState) -> Flight:
        nominal = self._seen(state, self._vehicle())
        _, vehicle = chain.plant(
            self.effects, state.memory, nominal, self._vehicle(), 1.0 / self.freq
        )
        return self._seen(state, vehicle)

    def _vehicle(self) -> Vehicle:
        return self.spec.vehicle(drag=False)

    def _seen(self, state: RotorpyState, vehicle: Vehicle) -> Flight:
        each = vehicle.thrust_gain * K_ETA * state.rotor_vel**2
        x, y = rotor_directions().T * self.spec.arm * vehicle.arm_scale
        torque = jnp.stack([each @ y, -each @ x, jnp.zeros(len(each), each.dtype)], axis=-1)
        return Flight(
            t=state.steps.astype(float) / self.freq,
            pos=state.pos,
            vel=state.vel,
            quat=state.quat,
            ang_vel=state.ang_vel,
            thrust=jnp.sum(each, axis=1),
            torque=torque,
        )

    def _physics_step(self, state: RotorpyState, cmd: Float[Array, "drones 4"]) -> RotorpyState:
        """One step; commands, wrench of effects and motor commands are held during it."""
        dt, nominal = 1.0 / self.freq, self._vehicle()
        flight = self._seen(state, nominal)
        memory, cmd = chain.command(self.effects, state.memory, flight, cmd, dt)
        memory, vehicle = chain.plant(self.effects, memory, flight, nominal, dt)
        flight = self._seen(state, vehicle)
        memory, force, torque = chain.wrench(self.effects, memory, flight, vehicle, dt, 0.0)
        believed = make_multirotor(airframe_of(nominal))
        true = make_multirotor(airframe_of(vehicle))
        speeds = jax.vmap(lambda body, u: motor_speeds(believed, body, u))(state.body, cmd)

        def rate(body: Array) -> Array:
            return jax.vmap(derivative, in_axes=(None, 0, 0, 0, 0, None))(
                true, body, speeds, force, torque, vehicle.slowing_scale
            )

        body = _on_floor(runge_kutta(rate, state.body, dt))
        after = RotorpyState(
            steps=state.steps + 1,
            pos=body[:, :3],
            vel=body[:, 3:6],
            quat=body[:, 6:10],
            ang_vel=body[:, 10:13],
            rotor_vel=body[:, 13:],
            memory=memory,
        )
        memory, flown = chain.project(self.effects, memory, self._seen(after, vehicle))
        return eqx.tree_at(
            lambda s: (s.pos, s.vel, s.memory), after, (flown.pos, flown.vel, memory)
        )


def _on_floor(body: Float[Array, "drones 17"]) -> Float[Array, "drones 17"]:
    """States after RotorPy's rules for drones on the floor."""
    down = (body[:, 2] <= GROUND)[:, None]
    pos, vel = body[:, :3].at[:, 2].set(0.0), body[:, 3:6]
    vel = jnp.concatenate([(1.0 - FRICTION) * vel[:, :2], jnp.maximum(vel[:, 2:], 0.0)], axis=1)
    yaw = body[:, 8:10]
    safe = jnp.where(down & (jnp.sum(yaw**2, axis=1, keepdims=True) > 0.0), yaw, 1.0)
    level = jnp.zeros_like(body[:, 6:10])
    level = level.at[:, 2:].set(safe / jnp.linalg.norm(safe, axis=1, keepdims=True))
    standing = jnp.concatenate([pos, vel, level, jnp.zeros_like(vel), body[:, 13:]], axis=1)
    return jnp.where(down, standing, body)
