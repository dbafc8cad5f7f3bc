r"""The high-fidelity simulator: crazyflow 0.4.0, ``first_principles``, 500 Hz physics.

The only module that knows crazyflow. Each command is held for 10 physics steps of crazyflow's own
step pipeline: Mellinger attitude controller, motor mixing, rotor and rigid-body dynamics, explicit
Euler, floor. A state holds only what changes; everything
else (parameters, controller gains) is a constant of the compiled program, which keeps a rollout's
memory small: under `jax.checkpoint` per control step, reverse mode stores one state per control
step.

On purpose, as crazyflow does it:

- Rotors stand still at reset, so a drone rests on the floor until they spin up (lift-off 0.2 to
  0.9 s, depending on thrust).
- The floor clips z at -0.001 m and zeroes all of the velocity; no gradient passes there.
- Thrust outside [`spec.thrust_min`, `spec.thrust_max`] is clipped by the motor mixing; its
  gradient there is exactly zero. Angles are not clipped.
- Contacts between drones are flags in crazyflow, they never push back. Crashes are computed from
  distances (`tasks/contact.py`).

Effects attach to the pipeline: command and autopilot before ``attitude_controller`` (autopilot
writes the controller's gains); plant and wrench before ``integration`` (plant writes
``data.params``, never the controller's parameters; wrench writes ``states.force`` and
``states.torque``); state after the floor. Their memories live in ``data.plugins``.
"""

import contextlib
import functools
import io
import warnings
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from simulators.algebra.products import written_out
from simulators.algebra.rotation import rotate
from simulators.contract import Replayable
from simulators.crazyflow_params import (
    SimData,
    changed_params,
    constant_plant,
    hover_rotor_vel,
    limited,
    rotor_wrench,
    scaled_gains,
    scaled_params,
)
from simulators.crazyflow_state import CrazyflowState, packed, unpacked
from simulators.effects import chain
from simulators.effects.contract import (
    AbstractEffect,
    AutopilotEffect,
    CommandEffect,
    ListeningEffect,
    PlantEffect,
    StateEffect,
    WrenchEffect,
)
from simulators.flight import Flight
from simulators.vehicle import (
    CONTROL_DT,
    VEHICLES,
    ActionSpace,
    AutopilotGains,
    Vehicle,
    VehicleSpec,
    whole_steps,
)

# MuJoCo prints a line for each optional backend that is not installed.
with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
    import mujoco
    from crazyflow.control import Control
    from crazyflow.drones import Drone
    from crazyflow.dynamics import Dynamics
    from crazyflow.sim import Sim
    from crazyflow.sim.pipeline import append_fn, insert_fn_before


class Crazyflow(Replayable):
    """Source: Schuck et al., crazyflow 0.4.0, with the identified airframe `cf21B_500`."""

    spec: VehicleSpec = VEHICLES["cf21B_500"]
    """The airframe."""
    action_space: ActionSpace = ActionSpace()
    """How actions become commands."""
    freq: int = eqx.field(static=True, default=500)
    """Physics steps per second [Hz]; the attitude controller runs at the same rate."""
    effects: tuple[AbstractEffect, ...] = ()
    """Attached effects."""

    name: ClassVar[str] = "crazyflow"
    version: ClassVar[str] = "1"
    replay_dt: ClassVar[float] = 0.002
    airframes: ClassVar[Mapping[str, VehicleSpec]] = VEHICLES
    doors: ClassVar[tuple[str, ...]] = (
        "command",
        "autopilot",
        "plant",
        "wrench",
        "rotation",
        "rotors",
        "state",
    )

    def reset(self, pos: Float[Array, "drones 3"], key: PRNGKeyArray) -> CrazyflowState:
        zeros = jnp.zeros_like(pos)
        level = jnp.zeros((len(pos), 4), pos.dtype)
        return CrazyflowState(
            steps=jnp.zeros((), jnp.int32),
            pos=pos,
            vel=zeros,
            quat=level.at[:, 3].set(1.0),
            ang_vel=zeros,
            rotor_vel=level,
            prev_ang_vel=zeros,
            r_int_error=zeros,
            memory=chain.init(self.effects, len(pos), 1.0 / self.freq, key),
        )

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> CrazyflowState:
        """The state at a measured flight, rotors warmed up by the commands before.

        Rotors start steady at the first command and follow the others; the attitude controller's
        integral starts at zero, which roll and pitch do not use.
        """
        n_drones, dt = len(flight.pos), 1.0 / self.freq
        repeats = round(CONTROL_DT * self.freq)
        memory = chain.init(self.effects, n_drones, dt, key)
        memory, cmds = chain.warm_up(self.effects, memory, flight, cmd_history, repeats, dt)
        data = self._constants()
        targets = hover_rotor_vel(data, cmds[:, :, 3])
        _, vehicle = chain.plant(self.effects, memory, flight, self._vehicle(), dt)
        coef = scaled_params(data, vehicle).rotor_dyn_coef

        def spin(rotor_vel: Array, target: Array) -> tuple[Array, None]:
            for _ in range(repeats):
                up, down = target > rotor_vel, target**2 - rotor_vel**2
                linear, square = (jnp.where(up, coef[..., i], coef[..., i + 2]) for i in (0, 1))
                rotor_vel = rotor_vel + dt * (linear * (target - rotor_vel) + square * down)
            return rotor_vel, None

        rotor_vel, _ = jax.lax.scan(spin, targets[0], targets)
        return CrazyflowState(
            steps=jnp.round(flight.t * self.freq).astype(jnp.int32),
            pos=flight.pos,
            vel=flight.vel,
            quat=flight.quat,
            ang_vel=flight.ang_vel,
            rotor_vel=jnp.broadcast_to(rotor_vel, (n_drones, 4)),
            prev_ang_vel=flight.ang_vel,
            r_int_error=jnp.zeros_like(flight.pos),
            memory=memory,
        )

    def step_cmd(
        self, state: CrazyflowState, cmd: Float[Array, "drones 4"], duration: float
    ) -> CrazyflowState:
        """Held for `duration` [s], a whole number of physics steps."""
        n_steps = whole_steps(duration, self.freq)
        if n_steps == 1:
            return self._physics_step(state, cmd)

        # Checkpointed per physics step as well: stacking the intermediates of ten steps costs more
        # than computing them again (0.094 s against 0.043 s an epoch at N = 3, equal at N = 12).
        @jax.checkpoint
        def physics_step(state: CrazyflowState, _: None) -> tuple[CrazyflowState, None]:
            return self._physics_step(state, cmd), None

        state, _ = jax.lax.scan(physics_step, state, None, length=n_steps)
        return state

    def with_attitude(
        self,
        state: CrazyflowState,
        quat: Float[Array, "drones 4"],
        ang_vel: Float[Array, "drones 3"],
        chosen: Bool[Array, " drones"],
    ) -> CrazyflowState:
        """Rotor speeds and the controller's integral stay."""
        where = functools.partial(jnp.where, chosen[:, None])
        return eqx.tree_at(
            lambda s: (s.quat, s.ang_vel, s.prev_ang_vel),
            state,
            (
                where(quat, state.quat),
                where(ang_vel, state.ang_vel),
                where(ang_vel, state.prev_ang_vel),
            ),
        )

    def with_thrust(self, state: Any, thrust: Array) -> CrazyflowState:
        speeds = hover_rotor_vel(self._constants(), thrust[None])[0]
        return eqx.tree_at(
            lambda s: s.rotor_vel, state, jnp.broadcast_to(speeds, state.rotor_vel.shape)
        )

    def flight(self, state: CrazyflowState) -> Flight:
        data = self._constants()
        flight = self._seen(state.steps, state, data.params)
        if not chain.has(self.effects, PlantEffect):
            return flight
        _, vehicle = chain.plant(
            self.effects, state.memory, flight, self._vehicle(), 1.0 / self.freq
        )
        thrust = vehicle.thrust_gain * flight.thrust
        torque = vehicle.thrust_gain * vehicle.arm_scale * flight.torque
        return eqx.tree_at(lambda f: (f.thrust, f.torque), flight, (thrust, torque))

    def file_params(self) -> tuple[dict[str, Any], tuple[AbstractEffect, ...]]:
        """What crazyflow's own file of the airframe would say of the attached effects.

        Returns:
            Entries of `PARAMS_FILE` that change, with their new values, and the effects that no
            entry stands for.
        """
        vehicle, others = self._vehicle(), []
        for effect in self.effects:
            written = constant_plant(effect, vehicle)
            vehicle = vehicle if written is None else written
            others += [effect] if written is None else []
        template, _ = _template(self.spec.name, self.freq)
        return changed_params(template, vehicle), tuple(others)

    def _vehicle(self) -> Vehicle:
        return self.spec.vehicle(drag=True)

    def _constants(self) -> SimData:
        """Constants of crazyflow; those of `spec`, where it is not the airframe's file's own."""
        data, _ = _template(self.spec.name, self.freq)
        if self.spec == VEHICLES.get(self.spec.name):
            return data
        if self._other_range:
            data = limited(data, self.spec.thrust_min, self.spec.thrust_max)
        return data.replace(params=scaled_params(data, self._vehicle()))

    @property
    def _other_range(self) -> bool:
        """Whether thrust may have another range than the airframe's file gives it."""
        own, thrusts = VEHICLES.get(self.spec.name), (self.spec.thrust_min, self.spec.thrust_max)
        return own is None or thrusts != (own.thrust_min, own.thrust_max)

    def _physics_step(self, state: CrazyflowState, cmd: Float[Array, "drones 4"]) -> CrazyflowState:
        template, (_, pipeline) = self._constants(), _template(self.spec.name, self.freq)

        def step(state: CrazyflowState, cmd: Array) -> CrazyflowState:
            data = packed(template, state, cmd)
            for fn in self._pipeline(pipeline):
                data = fn(data)
            return unpacked(data, state.steps + 1)

        return written_out(step)(state, cmd)

    def _pipeline(self, stages: OrderedDict[str, Callable]) -> list[Callable[[SimData], SimData]]:
        """Stages of crazyflow with the effects' stages among them."""
        pipeline = stages.copy()
        if self._other_range:  # the motor mixing limits thrust, this stage to the file's range
            del pipeline["clip_rotor_vel_cmd"]
        if chain.has(self.effects, CommandEffect, ListeningEffect):
            insert_fn_before(pipeline, "attitude_controller", self._command, "effects_command")
        if chain.has(self.effects, AutopilotEffect):
            insert_fn_before(pipeline, "attitude_controller", self._autopilot, "effects_autopilot")
        if chain.has(self.effects, PlantEffect):
            insert_fn_before(pipeline, "integration", self._plant, "effects_plant")
        if chain.has(self.effects, WrenchEffect) or chain.has(self.effects, PlantEffect):
            insert_fn_before(pipeline, "integration", self._wrench, "effects_wrench")
        if chain.has(self.effects, StateEffect):
            append_fn(pipeline, self._project, "effects_state")
        return list(pipeline.values())

    def _command(self, data: SimData) -> SimData:
        memory, vehicle = data.plugins["effects"]
        attitude = data.controls.attitude
        memory, cmd = chain.command(
            self.effects, memory, self._now(data), attitude.staged_cmd[0], 1.0 / self.freq
        )
        attitude = attitude.replace(staged_cmd=cmd[None])
        data = data.replace(controls=data.controls.replace(attitude=attitude))
        return data.replace(plugins={"effects": (memory, vehicle)})

    def _autopilot(self, data: SimData) -> SimData:
        memory, vehicle = data.plugins["effects"]
        nominal = AutopilotGains(*[jnp.ones(3, data.states.pos.dtype)] * 4)
        memory, gains = chain.autopilot(
            self.effects, memory, self._now(data), nominal, 1.0 / self.freq
        )
        return scaled_gains(data, gains).replace(plugins={"effects": (memory, vehicle)})

    def _plant(self, data: SimData) -> SimData:
        memory, _ = data.plugins["effects"]
        memory, vehicle = chain.plant(
            self.effects, memory, self._now(data), self._vehicle(), 1.0 / self.freq
        )
        data = data.replace(params=scaled_params(data, vehicle))
        return data.replace(plugins={"effects": (memory, vehicle)})

    def _wrench(self, data: SimData) -> SimData:
        memory, vehicle = data.plugins["effects"]
        vehicle = self._vehicle() if vehicle is None else vehicle
        flight = self._now(data)
        dt = 1.0 / self.freq
        memory, force, torque = chain.wrench(self.effects, memory, flight, vehicle, dt, 0.5 * dt)
        up = jnp.zeros_like(flight.pos).at[:, 2].set(flight.thrust)
        torque = torque + vehicle.at_center(flight.quat, rotate(flight.quat, up))
        states = data.states.replace(force=force[None], torque=torque[None])
        return data.replace(states=states, plugins={"effects": (memory, vehicle)})

    def _project(self, data: SimData) -> SimData:
        memory, vehicle = data.plugins["effects"]
        memory, flight = chain.project(self.effects, memory, self._now(data))
        states = data.states.replace(pos=flight.pos[None], vel=flight.vel[None])
        return data.replace(states=states, plugins={"effects": (memory, vehicle)})

    def _now(self, data: SimData) -> Flight:
        states = jax.tree.map(lambda x: x[0], data.states)
        return self._seen(data.core.steps[0, 0], states, data.params)

    def _seen(self, steps: Int[Array, ""], states: Any, params: Any) -> Flight:
        thrust, torque = rotor_wrench(params, states.rotor_vel)
        return Flight(
            t=steps.astype(float) / self.freq,
            pos=states.pos,
            vel=states.vel,
            quat=states.quat,
            ang_vel=states.ang_vel,
            thrust=thrust,
            torque=torque,
        )


def _template(drone: str, freq: int) -> tuple[SimData, OrderedDict[str, Callable]]:
    """Constants and pipeline for one drone; states are put in by `packed`."""
    return _templates(drone, freq, jax.dtypes.canonicalize_dtype(float).name)


@functools.cache
def _templates(drone: str, freq: int, dtype: str) -> tuple[SimData, OrderedDict[str, Callable]]:
    # MuJoCo warns of an empty prefix in every scene of crazyflow, to Python and, without a handler
    # of its own, to a file in the working directory.
    handler = mujoco.get_mju_user_warning()  # pyright: ignore[reportAttributeAccessIssue]
    mujoco.set_mju_user_warning(lambda message: None)  # pyright: ignore[reportAttributeAccessIssue]
    with jax.ensure_compile_time_eval(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Attaching a spec with an empty prefix")
        try:
            sim = Sim(
                n_worlds=1,
                n_drones=1,
                drone=Drone(drone),
                dynamics=Dynamics.first_principles,
                control=Control.attitude,
                freq=freq,
                attitude_freq=freq,
                force_torque_freq=freq,
                device=jax.default_backend(),
            )
        finally:
            mujoco.set_mju_user_warning(handler)  # pyright: ignore[reportAttributeAccessIssue]
        # Arrays of crazyflow are float32 even in x64, and its gains are placed on one device.
        data = jax.tree.map(
            lambda x: jnp.asarray(x, dtype) if jnp.issubdtype(x.dtype, jnp.floating) else x,
            sim.data,
        )
        return data, sim.step_pipeline.copy()
