"""Plug-ins that each break one promise; the conformance suite must name it."""

import dataclasses
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from methods.contract import AbstractMethod, Ledger, Trained
from methods.residuals.affine import Affine
from methods.residuals.contract import AbstractResidual, AbstractResidualModel
from methods.training.policy import AbstractPolicy, make_policy
from simulators.effects.contract import Parameter, WrenchEffect
from simulators.point_mass import PointMass
from tasks.circle import Circle


def parameter(low=0.0, high=1.0, neutral=0.0, unit="N", source="a guess"):
    return Parameter(unit=unit, low=low, high=high, neutral=neutral, source=source)


class Push(WrenchEffect):
    """A push to the side; whole, and the base of broken ones."""

    f: jax.Array = eqx.field(converter=jnp.asarray, default=0.0)

    parameters: ClassVar = {"f": parameter(high=0.1)}
    version: ClassVar[str] = "1"

    def wrench(self, memory, flight, vehicle, dt):
        force = jnp.zeros_like(flight.pos).at[:, 0].set(self.f)
        return None, force, jnp.zeros_like(force)


class WrongDoor(Push):
    """Says command, acts on wrenches."""

    door: ClassVar[str] = "command"


class NoVersion(Push):
    """Declares an empty version."""

    version: ClassVar[str] = ""


class NoUnit(Push):
    """A parameter without unit."""

    parameters: ClassVar = {"f": parameter(unit="")}


class SwappedBounds(Push):
    """low above high."""

    parameters: ClassVar = {"f": parameter(low=1.0, high=0.0)}


class Hidden(Push):
    """A number that is no parameter."""

    strength: float = 1.0


class NotNeutral(Push):
    """Pushes even when neutral."""

    def wrench(self, memory, flight, vehicle, dt):
        force = jnp.zeros_like(flight.pos).at[:, 0].set(self.f + 1e-3)
        return None, force, jnp.zeros_like(force)


class Idle(Push):
    """Never pushes."""

    def wrench(self, memory, flight, vehicle, dt):
        return None, jnp.zeros_like(flight.pos), jnp.zeros_like(flight.pos)


class Explosive(Push):
    """NaN at its upper bound."""

    def wrench(self, memory, flight, vehicle, dt):
        force = jnp.where(self.f > 0.09, jnp.nan, self.f) * jnp.ones_like(flight.pos)
        return None, force, jnp.zeros_like(force)


class Favourite(Push):
    """Pushes drone 0 only."""

    def wrench(self, memory, flight, vehicle, dt):
        force = jnp.zeros_like(flight.pos).at[0, 0].set(self.f)
        return None, force, jnp.zeros_like(force)


class Forgetful(Push):
    """Its memory changes shape."""

    def init(self, n_drones, dt):
        return jnp.zeros(n_drones)

    def wrench(self, memory, flight, vehicle, dt):
        return jnp.zeros(1), *Push.wrench(self, None, flight, vehicle, dt)[1:]


class Unfelt(Push):
    """Its derivative is cut."""

    def wrench(self, memory, flight, vehicle, dt):
        force = jnp.zeros_like(flight.pos).at[:, 0].set(jax.lax.stop_gradient(self.f))
        return None, force, jnp.zeros_like(force)


class Crashing(Push):
    """Raises."""

    def wrench(self, memory, flight, vehicle, dt):
        raise RuntimeError("the rope is torn")


class InTheAir(Circle):
    """Starts 1 m up."""

    def reset(self, key):
        pos, goal = Circle.reset(self, key)
        return pos + jnp.asarray([0.0, 0.0, 1.0]), goal


class Crowded(Circle):
    """Starts in a heap."""

    def reset(self, key):
        pos, goal = Circle.reset(self, key)
        return 0.1 * pos, goal


class Deaf(Circle):
    """Ignores the key."""

    def reset(self, key):
        return Circle.reset(self, jax.random.key(0))


class Backwards(Circle):
    """Offsets point away from the target."""

    def target(self, state):
        found = Circle.target(self, state)
        return eqx.tree_at(lambda t: t.offset, found, -found.offset)


class Perverse(Circle):
    """Pays for being far away."""

    def task_reward(self, distance, vel_error):
        return distance


class OneNumber(Circle):
    """One reward for all."""

    def task_reward(self, distance, vel_error):
        return jnp.sum(distance)


class Leader(Circle):
    """Drone 0 is paid twice."""

    def task_reward(self, distance, vel_error):
        return -distance.at[0].multiply(2.0)


class Mute(PointMass):
    """Never calls wrench effects, though it has the door."""

    def _integrate(self, state, cmd, h):
        bare = eqx.tree_at(lambda s: s.effects, self, ())
        after = PointMass._integrate(bare, eqx.tree_at(lambda s: s.memory, state, ()), cmd, h)
        return eqx.tree_at(
            lambda s: s.memory, after, state.memory, is_leaf=lambda x: isinstance(x, tuple)
        )


class Mirrored(PointMass):
    """Pitch flies backwards."""

    name: ClassVar[str] = "mirrored"

    def step_cmd(self, state, cmd, duration):
        if not duration > 0:
            raise ValueError("duration")
        return PointMass.step_cmd(self, state, cmd.at[:, 1].multiply(-1.0), duration)


class Drifting(PointMass):
    """Placing a drone leaves its velocity."""

    name: ClassVar[str] = "drifting"

    def with_motion(self, state, pos, vel):
        return dataclasses.replace(state, pos=pos)


class Stubborn(PointMass):
    """No drone can be turned."""

    name: ClassVar[str] = "stubborn"

    def with_attitude(self, state, quat, ang_vel, chosen):
        return state


class Whirling(PointMass):
    """Faster rotors of one drone are those of all."""

    name: ClassVar[str] = "whirling"

    def with_faster_rotors(self, state, faster, chosen):
        return dataclasses.replace(state, thrust=state.thrust * (1.0 + faster[:, 0]) ** 2)


class Lazy(PointMass):
    """Rotors of the chosen drones are not made as fast as was asked for."""

    name: ClassVar[str] = "lazy"

    def with_faster_rotors(self, state, faster, chosen):
        return dataclasses.replace(state, thrust=jnp.where(chosen, 1.01, 1.0) * state.thrust)


class Weak(PointMass):
    """Produces half of the thrust."""

    name: ClassVar[str] = "weak"

    def with_thrust(self, state, thrust):
        return dataclasses.replace(state, thrust=0.5 * thrust)


class Absent(PointMass):
    """Repeats another step than the one that was flown."""

    name: ClassVar[str] = "absent"

    def repeating(self, after):
        return dataclasses.replace(self, attitude_tau=0.5)


class Model(AbstractResidualModel):
    """Whatever a test wants."""

    scale: jax.Array

    def __call__(self, features):
        return self.scale * features[:, 3:6]


class Unbounded(AbstractResidual):
    """Extrapolates without end."""

    version: ClassVar[str] = "1"

    def fit(self, transitions, key, init=None):
        return Model(jnp.asarray(-0.4))


class Dice(AbstractResidual):
    """Fits by chance."""

    version: ClassVar[str] = "1"

    def fit(self, transitions, key, init=None):
        fitted = Affine().fit(transitions, key)
        noise = float(np.random.default_rng().normal())
        return jax.tree.map(
            lambda x: x * (1 + 0.01 * noise) if eqx.is_inexact_array(x) else x, fitted
        )


class Blind(AbstractResidual):
    """Ignores the weights."""

    version: ClassVar[str] = "1"

    def fit(self, transitions, key, init=None):
        even = eqx.tree_at(lambda t: t.weight, transitions, jnp.ones_like(transitions.weight))
        return Affine().fit(even, key, init)


class Honest(AbstractMethod):
    """Flies one step in reality, which bills it; whole, and the base of broken ones."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple] = ()
    simulator: ClassVar[str] = "point_mass"

    def train(self, setup, key, init=None):
        nominal = setup.nominal
        policy = init or make_policy(setup.task, nominal.spec, nominal.action_space, key)
        pos, _ = setup.task.reset(key)
        setup.reality.step(setup.reality.reset(pos, key), jnp.zeros((len(pos), 3)))
        setup.context.progress("training", 1, 1, -1.0)
        return self.result(policy, Ledger(epochs=1, train_seconds=0.1))

    def result(self, policy, ledger, **rest):
        return Trained(policy=policy, ledger=ledger, curves={"reward": np.zeros(1)}, **rest)


class Linear(AbstractPolicy):
    """A policy of an architecture of its own."""

    gain: jax.Array
    squash: Callable = jnp.tanh

    def __call__(self, obs):
        return self.squash(obs @ self.gain)


def linear(task, seed=0, **settings):
    return Linear(0.1 * jax.random.normal(jax.random.key(seed), (task.obs_size, 3)), **settings)


class Homemade(Honest):
    """Trains a policy of its own architecture; whole."""

    def train(self, setup, key, init=None):
        return Honest.train(self, setup, key, init or linear(setup.task))


class Nameless(Honest):
    """Its policy holds a function that nobody finds again."""

    def train(self, setup, key, init=None):
        policy = linear(setup.task, squash=lambda x: jnp.tanh(x))
        return Honest.train(self, setup, key, init or policy)


class Bookkeeper(Honest):
    """Bills its flight itself, as it sees fit."""

    def result(self, policy, ledger):
        return Honest.result(self, policy, dataclasses.replace(ledger, hf_fleet_seconds=0.01))


class Heir(Honest):
    """Bears flight that no parent of it flew."""

    def result(self, policy, ledger):
        return Honest.result(self, policy, dataclasses.replace(ledger, inherited_fleet_seconds=9.0))


class Unfinished(Honest):
    """Returns a policy of NaN."""

    def result(self, policy, ledger):
        nothing = jax.tree.map(lambda x: x * jnp.nan if eqx.is_inexact_array(x) else x, policy)
        return Honest.result(self, nothing, ledger)


class Loud(Honest):
    """A note with the name of a metric, and an unknown status."""

    def result(self, policy, ledger):
        return Honest.result(self, policy, ledger, notes={"reward": 1.0}, status="great")


class Orphan(Honest):
    """A parent that nobody registered."""

    parents: ClassVar[tuple] = ("lf_basline",)


class Lucky(Honest):
    """Another policy at every call."""

    def result(self, policy, ledger):
        shift = 0.01 * np.random.default_rng().normal()
        moved = jax.tree.map(lambda x: x + shift if eqx.is_inexact_array(x) else x, policy)
        return Honest.result(self, moved, ledger)
