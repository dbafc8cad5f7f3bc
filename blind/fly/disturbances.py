r"""The generator's own physics: everything that a blind case may do to a vehicle.

Independent of `simulators/effects`, of which only the abstract contract is used. Three classes, one
per door, hold all parameters with neutral defaults, so that every case runs through one compiled
program. With command u = (roll, pitch, yaw, thrust), mass m, which is m_0 where nothing is
disturbed, body axis b, speed v_h across it, at each of four rotors by its own velocity:

    command   u <- u + yaw offset, (1 + g) tilt + trim, delay d, lag tau, play of the thrust
    plant     m (1 + e_m), J (1 + e_J), rotor time constants * s, thrust (1 + e_f)(1 - r t)
    wrench    f = m_0 (-c v - k |v| v + w + gust(t >= t_0) + a sin(2 pi nu t + phi) + OU)
                  + f_T b C (r_p / 4 h)^2 - m_0 A exp(-d^2 / 2 s^2) e_z + m_0 l v_h^2 b
                  + m_0 S / (1 + (x_w / s_w)^2) n - m_0 kappa (p - p_0) + slung load,
              torque = -R (o x f_T e_z), and of what acts at the rotors

| symbol | field | unit | |
|---|---|---|---|
| C, h | `ground_effect` | - | extra thrust at height h over r_p = 23.1 mm rotors; h >= r_p |
| A, s | `downwash`, `downwash_width` | m/s^2, m | below another drone at lateral distance d |
| o | `offset` | m | centre of mass seen from the geometric centre, body frame |
| S, x_w, s_w | `suction`, `wall_distance`, `wall_width` | m/s^2, m | towards a wall |

The load on a massless rigid cable follows Sreenath, Lee and Kumar (2013), "Geometric control and
differential flatness of a quadrotor UAV with a cable-suspended load", eqs. 3 to 5.
"""

import dataclasses
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from simulators.effects.contract import CommandEffect, Parameter, PlantEffect, WrenchEffect
from simulators.flight import Flight
from simulators.vehicle import GRAVITY, Vehicle

ROTOR_RADIUS = 0.0231
"""Radius of a Crazyflie rotor [m]."""
_RING = 64
"""Commands that the delay remembers, one a physics step."""
_SWING_DAMPING = 0.3
"""Damping of the slung load's swing [1/s]; a guess."""
_LIMITS: dict[str, Parameter] = {}
"""Nothing here is ever fitted, so no parameter declares bounds."""


def _turn(quat: Float[Array, "drones 4"], body: Float[Array, "drones 3"]) -> Array:
    """Body vectors in the world frame, by the rotation matrix written out."""
    x, y, z, w = quat.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix = jnp.asarray(rows)
    return jnp.einsum("ijd,dj->di", matrix, body)


class CommandDisturbance(CommandEffect):
    """What may happen to a command between the log and the autopilot."""

    yaw_offset: Array | float = 0.0
    """Added to the commanded yaw [rad]."""
    tilt_gain: Array | float = 0.0
    """Relative excess of roll and pitch [-]."""
    trim: Array = eqx.field(default_factory=lambda: jnp.zeros(2))
    """Added to roll and pitch [rad]."""
    delay: Array | float = 0.0
    """Transport delay of the whole command [s], below 0.12."""
    lag: Array | float = 0.0
    """Time constant of a first-order lag of the angles [s]."""
    play: Array | float = 0.0
    """Half width of the backlash of the thrust [N]."""

    parameters: ClassVar[dict[str, Parameter]] = _LIMITS
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> tuple[Array, Array, Array]:
        """Ring of commands, how many were written, and what took effect last."""
        return jnp.zeros((_RING, n_drones, 4)), jnp.zeros((), jnp.int32), jnp.zeros((n_drones, 4))

    def command(
        self, memory: Any, flight: Flight, cmd: Float[Array, "drones 4"], dt: float
    ) -> tuple[Any, Float[Array, "drones 4"]]:
        """The command after offset, gain, trim, delay, lag and play."""
        ring, count, last = memory
        tilt = cmd[:, :2] * (1.0 + self.tilt_gain) + self.trim
        cmd = jnp.concatenate([tilt, cmd[:, 2:3] + self.yaw_offset, cmd[:, 3:]], axis=1)
        first = count == 0
        ring = jnp.where(first, jnp.broadcast_to(cmd, ring.shape), ring).at[count % _RING].set(cmd)
        # The small number keeps a delay of whole steps whole after rounding.
        steps = jnp.asarray(self.delay) / dt + 1e-4
        whole = jnp.floor(steps).astype(jnp.int32)
        part = jnp.maximum(steps - whole - 1e-4, 0.0)
        newer, older = ring[(count - whole) % _RING], ring[(count - whole - 1) % _RING]
        late = (1.0 - part) * newer + part * older
        last = jnp.where(first, late, last)
        lag = jnp.asarray(self.lag)
        kept = jnp.where(lag > 0, jnp.exp(-dt / jnp.where(lag > 0, lag, 1.0)), 0.0)
        angles = late[:, :3] + kept * (last[:, :3] - late[:, :3])
        thrust = jnp.clip(last[:, 3:], late[:, 3:] - self.play, late[:, 3:] + self.play)
        after = jnp.concatenate([angles, thrust], axis=1)
        return (ring, count + 1, after), after


class PlantDisturbance(PlantEffect):
    """How the vehicle may differ from what is believed."""

    excess_mass: Array | float = 0.0
    """Relative excess of the mass [-]."""
    excess_inertia: Array | float = 0.0
    """Relative excess of the moment of inertia, all axes [-]."""
    motor_slowness: Array | float = 1.0
    """Rotor time constants over the nominal ones [-]."""
    excess_thrust: Array | float = 0.0
    """Relative excess of the thrust [-]."""
    discharge: Array | float = 0.0
    """Thrust lost per second of flight [1/s]."""

    parameters: ClassVar[dict[str, Parameter]] = _LIMITS
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    version: ClassVar[str] = "1"

    def plant(
        self, memory: None, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[None, Vehicle]:
        """The vehicle as it really is at this time."""
        left = (1.0 + self.excess_thrust) * (1.0 - self.discharge * flight.t)
        return None, dataclasses.replace(
            vehicle,
            mass=vehicle.mass * (1.0 + self.excess_mass),
            inertia=vehicle.inertia * (1.0 + self.excess_inertia),
            thrust_gain=vehicle.thrust_gain * left,
            motor_lag_scale=vehicle.motor_lag_scale * self.motor_slowness,
        )


class WrenchDisturbance(WrenchEffect):
    """What may push, pull or turn a vehicle."""

    drag: Array | float = 0.0
    """Linear drag over mass [1/s]."""
    quadratic_drag: Array | float = 0.0
    """Quadratic drag over mass [1/m]."""
    wind: Array = eqx.field(default_factory=lambda: jnp.zeros(3))
    """Steady specific force, world [m/s^2]."""
    gust: Array = eqx.field(default_factory=lambda: jnp.zeros(3))
    """Specific force from `gust_onset` on, world [m/s^2]."""
    gust_onset: Array | float = 0.0
    """When the gust sets in [s]."""
    ground_effect: Array | float = 0.0
    """Coefficient C of the ground effect [-]."""
    downwash: Array | float = 0.0
    """Specific force below another drone [m/s^2]."""
    downwash_width: Array | float = 0.1
    """Standard width of the downwash [m]."""
    offset: Array = eqx.field(default_factory=lambda: jnp.zeros(2))
    """Centre of mass seen from the geometric centre, body x and y [m]."""
    swing: Array = eqx.field(default_factory=lambda: jnp.zeros(3))
    """Amplitude of a periodic wind, world [m/s^2]."""
    swing_freq: Array | float = 1.0
    """Its frequency [Hz]."""
    swing_phase: Array | float = 0.0
    """Its phase [rad]."""
    turbulence: Array | float = 0.0
    """Standard deviation of an Ornstein-Uhlenbeck specific force per axis [m/s^2]."""
    turbulence_time: Array | float = 0.5
    """Its correlation time [s]."""
    seed: Array | int = 0
    """Seed of the turbulence."""
    lift: Array | float = 0.0
    """Translational lift l along the thrust [1/m]."""
    axial_drag: Array | float = 0.0
    """Drag of the rotors along their axis in hover [1/s]."""
    lateral_drag: Array | float = 0.0
    """Drag of the rotors across their axis in hover [1/s]."""
    suction: Array | float = 0.0
    """Specific force at a wall, towards it [m/s^2]."""
    wall_normal: Array = eqx.field(default_factory=lambda: jnp.asarray([1.0, 0.0, 0.0]))
    """Direction to the wall."""
    wall_distance: Array | float = 2.0
    """Distance of the wall from the origin [m]."""
    wall_width: Array | float = 0.5
    """Distance from the wall at which half of the suction is left [m]."""
    spring: Array | float = 0.0
    """Specific stiffness of a pull towards `anchor` [1/s^2]."""
    anchor: Array = eqx.field(default_factory=lambda: jnp.zeros(3))
    """Where the pull points to [m]."""
    load: Array | float = 0.0
    """Mass of a slung load [kg]."""
    cable: Array | float = 0.5
    """Length of its cable [m]."""

    parameters: ClassVar[dict[str, Parameter]] = _LIMITS
    needs: ClassVar[tuple[str, ...]] = ("rotation",)
    version: ClassVar[str] = "1"

    def init(self, n_drones: int, dt: float) -> tuple[Array, Array, Array]:
        """Turbulence, direction of the cable, and how fast the cable turns [rad/s]."""
        still = jnp.zeros((n_drones, 3))
        return still, still.at[:, 2].set(-1.0), still

    def wrench(
        self, memory: Any, flight: Flight, vehicle: Vehicle, dt: float
    ) -> tuple[Any, Float[Array, "drones 3"], Float[Array, "drones 3"]]:
        """Force [N] and torque [N m], world frame."""
        air, cable, spin = memory
        up = _turn(flight.quat, jnp.zeros_like(flight.pos).at[:, 2].set(1.0))
        thrust = flight.thrust[:, None]
        air = self._turbulence(air, flight.t, dt)
        specific = self._air(flight) + air + self._places(flight)
        height = jnp.maximum(flight.pos[:, 2:], ROTOR_RADIUS)
        near = self.ground_effect * (ROTOR_RADIUS / (4.0 * height)) ** 2
        pushed, turning = self._rotors(flight, vehicle)
        force = vehicle.believed_mass * specific + near * thrust * up + _turn(flight.quat, pushed)
        # All that acts on rotors acts at the geometric centre, off the centre of mass.
        lever = jnp.concatenate([self.offset, jnp.zeros(1)])
        torque = -jnp.cross(lever, pushed.at[:, 2].add(flight.thrust))
        torque = _turn(flight.quat, torque + turning)
        pull, cable, spin = self._sling(cable, spin, thrust * up + force, vehicle.mass, dt)
        return (air, cable, spin), force + pull, torque

    def _rotors(self, flight: Flight, vehicle: Vehicle) -> tuple[Array, Array]:
        """Force and torque, body frame, of drag and lift at four rotors of their own velocity."""
        where = vehicle.arm * jnp.asarray([[1, 1, 0], [1, -1, 0], [-1, -1, 0], [-1, 1, 0]])
        # Thrusts that sum up to the collective one and to the torque about roll and pitch.
        x, y = where[:, 0], where[:, 1]
        tilting = flight.torque[:, :1] * y - flight.torque[:, 1:2] * x
        each = 0.25 * (flight.thrust[:, None] + tilting / vehicle.arm**2)
        hover = 0.25 * vehicle.believed_mass * GRAVITY * vehicle.thrust_gain
        spinning = jnp.sqrt(jnp.maximum(each, 1e-6) / hover)[:, :, None]
        back = flight.quat * jnp.asarray([-1.0, -1.0, -1.0, 1.0])
        air = _turn(back, flight.vel)[:, None] + jnp.cross(flight.ang_vel[:, None], where)
        rates = jnp.stack([self.lateral_drag, self.lateral_drag, self.axial_drag]) + jnp.zeros(3)
        drag = -0.25 * vehicle.believed_mass * spinning * rates * air
        lift = 0.25 * vehicle.believed_mass * self.lift * jnp.sum(air[..., :2] ** 2, axis=-1)
        push = drag.at[..., 2].add(lift)
        return jnp.sum(push, axis=1), jnp.sum(jnp.cross(where, push), axis=1)

    def _air(self, flight: Flight) -> Array:
        """Specific force of drag, wind, gust, periodic wind and downwash."""
        speed = jnp.linalg.norm(flight.vel, axis=1, keepdims=True)
        gust = jnp.where(flight.t >= self.gust_onset, self.gust, 0.0)
        angle = 2.0 * jnp.pi * self.swing_freq * flight.t + self.swing_phase
        wind = self.wind + gust + self.swing * jnp.sin(angle)
        apart = flight.pos[None] - flight.pos[:, None]  # [below, above, axis]
        lateral = jnp.sum(apart[..., :2] ** 2, axis=-1)
        bell = jnp.where(apart[..., 2] > 0, jnp.exp(-0.5 * lateral / self.downwash_width**2), 0.0)
        down = jnp.zeros_like(flight.pos).at[:, 2].set(-self.downwash * jnp.sum(bell, axis=1))
        return -(self.drag + self.quadratic_drag * speed) * flight.vel + wind + down

    def _places(self, flight: Flight) -> Array:
        """Specific force that depends on where the drone is: wall and spring."""
        gap = jnp.maximum(self.wall_distance - flight.pos @ self.wall_normal, 0.0)[:, None]
        wall = self.suction / (1.0 + (gap / self.wall_width) ** 2) * self.wall_normal
        return wall - self.spring * (flight.pos - self.anchor)

    def _turbulence(self, air: Array, t: Array, dt: float) -> Array:
        """The Ornstein-Uhlenbeck force one step later, exact in law."""
        key = jax.random.fold_in(jax.random.key(self.seed), jnp.round(t / dt).astype(jnp.int32))
        kept = jnp.exp(-dt / self.turbulence_time)
        step = jnp.sqrt(1.0 - kept**2) * self.turbulence
        return kept * air + step * jax.random.normal(key, air.shape)

    def _sling(
        self, cable: Array, spin: Array, force: Array, mass: Array, dt: float
    ) -> tuple[Array, Array, Array]:
        """Pull of the load [N], and the cable's direction and turn rate one step later."""
        along = jnp.sum(cable * force, axis=1, keepdims=True)
        turning = mass * self.cable * jnp.sum(spin**2, axis=1, keepdims=True)
        pull = -self.load / (mass + self.load) * (along - turning) * cable
        rate = -jnp.cross(cable, force) / (mass * self.cable) - _SWING_DAMPING * spin
        spin = spin + dt * rate
        cable = cable + dt * jnp.cross(spin, cable)
        cable = cable / jnp.linalg.norm(cable, axis=1, keepdims=True)
        return pull, cable, spin
