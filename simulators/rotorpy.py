r"""A second high-fidelity simulator: RotorPy's `Multirotor`, 200 Hz, Runge-Kutta of fourth order.

The only module that knows RotorPy. Its vehicle runs as it is published, with the package's file for
the Crazyflie Brushless; a private copy of its module is evaluated with `jax.numpy`, so that it can
be compiled and differentiated. Only the assembly of the state's derivative is written here (in
RotorPy it fills an array in place); tests compare it with the package's own.

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
import importlib.util
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.spatial.transform import Rotation
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray
from rotorpy.vehicles.crazyfliebrushless_params import quad_params

from simulators.algebra.products import opaque, written_out
from simulators.algebra.rotation import rpy_to_quat
from simulators.contract import AbstractSimulator
from simulators.effects import chain
from simulators.effects.contract import AbstractEffect
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT, ActionSpace, Vehicle, VehicleSpec

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

GROUND = 0.001
"""Height at and below which a drone stands on the floor [m]; RotorPy's `_on_ground`."""

FRICTION = 0.3
"""Share of the horizontal velocity that a step on the floor takes; RotorPy's default."""

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


class Rotorpy(AbstractSimulator):
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
    doors: ClassVar[tuple[str, ...]] = ("command", "plant", "wrench", "rotation", "state")

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
            memory=chain.init(self.effects, len(pos), 1.0 / self.freq),
        )

    def restore(
        self, flight: Flight, cmd_history: Float[Array, "time drones 4"], key: PRNGKeyArray
    ) -> RotorpyState:
        """The state at a measured flight; rotors start steady and follow the commands before."""
        n_drones, dt = len(flight.pos), 1.0 / self.freq
        memory = chain.init(self.effects, n_drones, dt)
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
        n_steps = round(duration * self.freq)
        if n_steps < 1 or abs(n_steps - duration * self.freq) > 1e-6:
            raise ValueError(
                f"`duration` must be a positive multiple of {1 / self.freq:g} s, got {duration}."
            )

        # Not checkpointed: 500 control steps of 12 drones and their gradient take 92 ms so, 181 ms
        # with a checkpoint per physics step, 12 ms without gradient (crazyflow: 59 and 10 ms).
        def physics_step(state: RotorpyState, _: None) -> tuple[RotorpyState, None]:
            return written_out(self._physics_step)(state, cmd), None

        state, _ = jax.lax.scan(physics_step, state, None, length=n_steps)
        return state

    def turned(
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

    def spun(self, state: Any, faster: Array, chosen: Array) -> RotorpyState:
        speeds = state.rotor_vel * (1.0 + jnp.where(chosen[:, None], faster, 0.0))
        return eqx.tree_at(lambda s: s.rotor_vel, state, speeds)

    def producing(self, state: Any, thrust: Array) -> RotorpyState:
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
        each = vehicle.thrust_gain * quad_params["k_eta"] * state.rotor_vel**2
        x, y = _directions().T * self.spec.arm * vehicle.arm_scale
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
def _directions() -> Float[np.ndarray, "4 2"]:
    """Where the rotors are, in arms from the roll and from the pitch axis."""
    places = np.stack([quad_params["rotor_pos"][name][:2] for name in quad_params["rotor_pos"]])
    return places / SPEC.arm


def make_multirotor(airframe: dict[str, Any]) -> Any:
    """RotorPy's vehicle with the given parameters, which may be traced."""
    return _rotorpy().Multirotor(airframe, control_abstraction="cmd_ctatt")


def airframe_of(vehicle: Vehicle) -> dict[str, Any]:
    """RotorPy's parameters of a vehicle; what is not in it is the file's."""
    inertia = vehicle.inertia
    names = zip(("r1", "r2", "r3", "r4"), _directions(), strict=True)
    arm, center = vehicle.arm * vehicle.arm_scale, vehicle.center_of_mass
    return AIRFRAME | {
        "mass": opaque(vehicle.mass),
        **{f"I{a}{b}": inertia["xyz".index(a), "xyz".index(b)] for a, b in _PRODUCTS},
        "rotor_pos": {name: arm * jnp.asarray([*place, 0.0]) - center for name, place in names},
        "k_eta": quad_params["k_eta"] * vehicle.thrust_gain,
        "k_m": quad_params["k_m"] * vehicle.rotor_torque_scale,
        "tau_m": vehicle.rotor_lag * vehicle.motor_lag_scale,
    }


_PRODUCTS = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Entries of the inertia matrix that RotorPy is given."""


def hover_speed(thrust: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Speed [rad/s] at which four equal rotors are believed to give `thrust` [N]."""
    speed = jnp.sqrt(jnp.maximum(thrust / 4.0 / quad_params["k_eta"], STANDING))
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


def runge_kutta(rate: Any, body: Float[Array, "drones 17"], dt: float) -> Float[Array, "drones 17"]:
    """States `dt` [s] later by Runge and Kutta's method of fourth order, quaternions unit."""
    k1 = rate(body)
    k2 = rate(body + 0.5 * dt * k1)
    k3 = rate(body + 0.5 * dt * k2)
    k4 = rate(body + dt * k3)
    body = body + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    quat = body[:, 6:10] / jnp.linalg.norm(body[:, 6:10], axis=1, keepdims=True)
    return body.at[:, 6:10].set(quat)


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
