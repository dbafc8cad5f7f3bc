"""What of crazyflow changes from step to step, and its way into crazyflow's data and back."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from simulators.algebra.products import opaque
from simulators.crazyflow_params import SimData


class CrazyflowState(eqx.Module):
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
    """Rotor speeds in crazyflow's unit [rev/min]."""
    prev_ang_vel: Float[Array, "drones 3"]
    """Angular velocity that the attitude controller saw last [rad/s]."""
    r_int_error: Float[Array, "drones 3"]
    """Integral of the attitude controller's rotation error [s]."""
    memory: tuple
    """Memories of the attached effects."""


def packed(data: SimData, state: CrazyflowState, cmd: Float[Array, "drones 4"]) -> SimData:
    """Data of crazyflow for one world in the given state, `cmd` staged for the controller."""
    zeros = jnp.zeros_like(state.pos)[None]
    idle = jnp.zeros((1, len(state.pos), 4), state.pos.dtype)
    # crazyflow's rotation by a vector has no derivative where the vector is exactly zero.
    ang_vel = state.ang_vel + jnp.where(state.ang_vel == 0.0, 1e-12, 0.0)
    states = data.states.replace(
        pos=state.pos[None],
        quat=state.quat[None],
        vel=state.vel[None],
        ang_vel=ang_vel[None],
        rotor_vel=state.rotor_vel[None],
        force=zeros,
        torque=zeros,
    )
    due = jnp.full((1, 1), -1, jnp.int32)  # both controllers run at every physics step
    attitude = data.controls.attitude.replace(
        cmd=cmd[None],
        staged_cmd=cmd[None],
        ang_vel_des=zeros,
        staged_ang_vel_des=zeros,
        steps=due,
        r_int_error=state.r_int_error[None],
        prev_ang_vel=state.prev_ang_vel[None],
    )
    force_torque = data.controls.force_torque.replace(cmd=idle, staged_cmd=idle, steps=due)
    controls = data.controls.replace(attitude=attitude, force_torque=force_torque, rotor_vel=idle)
    core = data.core.replace(steps=state.steps[None, None], n_drones=len(state.pos))
    plugins = {"effects": (state.memory, None)}
    params = data.params.replace(mass=opaque(data.params.mass))
    return data.replace(states=states, controls=controls, core=core, params=params, plugins=plugins)


def unpacked(data: SimData, steps: Int[Array, ""]) -> CrazyflowState:
    """The state in crazyflow's data, after so many steps."""
    states, attitude = data.states, data.controls.attitude
    return CrazyflowState(
        steps=steps,
        pos=states.pos[0],
        vel=states.vel[0],
        quat=states.quat[0],
        ang_vel=states.ang_vel[0],
        rotor_vel=states.rotor_vel[0],
        prev_ang_vel=attitude.prev_ang_vel[0],
        r_int_error=attitude.r_int_error[0],
        memory=data.plugins["effects"][0],
    )
