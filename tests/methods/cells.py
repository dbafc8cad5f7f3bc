"""Tiny cells that several test modules share: one toy task, methods with a few epochs."""

import dataclasses
import io
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from methods.contract import Ledger, Setup, Trained
from methods.residuals.contract import AbstractResidualModel
from methods.training.bptt import BPTT
from methods.training.checkpoint import AbstractKeeper
from methods.training.context import Context
from methods.training.policy import Policy, make_policy
from simulators import registry
from simulators.point_mass import PointMass
from simulators.vehicle import VEHICLES, ActionSpace
from tasks.contract import AbstractTargetTask, Target

SPEC = VEHICLES["cf21B_500"]
METHODS = registry.load_all("method")
RESIDUALS = registry.load_all("residual")
FLIGHTS = 4
TINY = BPTT(epochs=3, lr=3e-3, n_worlds=1, smoothing=1, final_lr=1.0)
# Whatever setting of these a method has is replaced; the rest of its defaults stay.
SMALL = {
    "trainer": TINY,
    "epochs_base": 3,
    "epochs_per_drone": 0.0,
    "flights": FLIGHTS,
    "spread": 0.0,
}


class Hold(AbstractTargetTask):
    """Every drone starts at rest at a point and should be `goal` beside it, at rest."""

    n_drones: int = eqx.field(static=True, default=3)
    horizon: int = eqx.field(static=True, default=15)
    n_neighbors: int = eqx.field(static=True, default=1)
    observe_attitude: bool = eqx.field(static=True, default=False)
    altitude: float = eqx.field(static=True, default=1.0)
    goal: tuple = eqx.field(static=True, default=(0.0, 0.0, 0.0))
    spacing: tuple = eqx.field(static=True, default=(0.25, 3.0))
    jitter: float = eqx.field(static=True, default=0.0)
    vel_weight: float = eqx.field(static=True, default=0.5)
    weight: float = eqx.field(static=True, default=1.0)

    version: ClassVar[str] = "1"
    station_keeping: ClassVar[bool] = True

    def reset(self, key):
        """The first two are `spacing[0]` apart, the others `spacing[1]` from their neighbour."""
        near, far = self.spacing
        x = jnp.asarray([0.0, *(near + far * i for i in range(self.n_drones - 1))])
        pos = jnp.zeros((self.n_drones, 3)).at[:, 0].set(x).at[:, 2].set(self.altitude)
        noise = jax.random.uniform(key, (self.n_drones, 2), minval=-1.0)
        pos = pos.at[:, :2].add(self.jitter * noise)
        return pos, pos + jnp.asarray(self.goal)

    def target(self, state):
        rest = jnp.zeros_like(state.flight.pos)
        return Target(offset=state.goal - state.flight.pos, vel=rest, acc=rest)

    def task_reward(self, distance, vel_error):
        return self.weight * (-distance - self.vel_weight * vel_error)


class Braking(AbstractResidualModel):
    """A residual that was fitted: air that slows drones down."""

    rate: jax.Array = eqx.field(converter=jnp.asarray, default=0.5)

    def __call__(self, features):
        return -self.rate * features[:, 3:6]


FLOWN = Ledger(hf_fleet_seconds=70.0, calibration_flights=7, calibration_crashes=2)
"""What a Hybrid that is a parent has cost."""


class Memory(AbstractKeeper):
    """Keeps files in memory, of every epoch or of none before the end."""

    def __init__(self, always=True):
        self.files = {}
        self.saves = 0
        self.always = always

    def load(self, stage, fingerprint):
        if (stage, fingerprint) not in self.files:
            return None
        with np.load(io.BytesIO(self.files[stage, fingerprint]), allow_pickle=False) as stored:
            return dict(stored)

    def save(self, stage, fingerprint, arrays):
        file = io.BytesIO()
        np.savez(file, allow_pickle=False, **arrays)
        self.files[stage, fingerprint] = file.getvalue()
        self.saves += 1

    def due(self):
        return self.always


class OpenLoop(eqx.Module):
    """Deploys actions by step, whatever happens."""

    actions: jax.Array  # (time, drones, 3)

    def __call__(self, state):
        return self.actions[state.step]


def lift(task, excess):
    """Level flight at `excess` over the thrust action of hover."""
    hover = ActionSpace().hover(SPEC.mass)
    actions = jnp.zeros((task.horizon, task.n_drones, 3))
    return OpenLoop(actions.at[:, :, 2].set(hover + excess))


CLIMB = Hold(n_drones=2, goal=(0.0, 0.0, 100.0), vel_weight=0.0, spacing=(3.0, 3.0))
"""Return = height gained, but for a constant: its slope by the height is `weight`."""


def climb_gradient(task, decay, limit=np.inf):
    """Derivative of the return by each step's thrust action in the nominal point mass.

    Height and velocity (z, v) follow a linear recursion, so the adjoint (z, v)-derivative is one
    too, backwards: l_k = (w, 0) + clip(decay A^T l_{k+1}), gradient_k = B l_{k+1}.
    """
    h = 0.02
    step = np.array([[1.0, h], [0.0, 1.0]])
    push = 0.5 * ActionSpace().thrust_max / SPEC.mass * h * np.array([h, 1.0])
    slope = np.array([task.weight, 0.0])
    adjoint, gradient = slope, []
    for _ in range(task.horizon):
        gradient.append(push @ adjoint)
        adjoint = slope + np.clip(decay * step.T @ adjoint, -limit, limit)
    return np.array(gradient[::-1])


def fresh(task, seed=0):
    """A fresh policy."""
    return make_policy(task, SPEC, ActionSpace(), jax.random.key(seed))


def leaning(task, tilt=0.8, thrust=0.5):
    """A policy that always asks for nearly the same action."""
    bias = jnp.arctanh(jnp.asarray([tilt, -tilt, thrust]))
    return eqx.tree_at(lambda p: p.net.layers[-1].bias, fresh(task), bias)


def small(name, **settings):
    """A method that trains in no time."""
    cls = METHODS[name]
    fields = {field.name for field in dataclasses.fields(cls)}
    fields -= {"flights"} if name == "grey_box" else set()  # three are what it is
    return cls(**{k: v for k, v in SMALL.items() if k in fields}, **settings)


def setup(task, reality, policy, context=None):
    """A cell whose parents all have the same policy; the Hybrid among them has a residual."""
    trained = Trained(policy=policy, ledger=Ledger(), curves={})
    parents = {name: trained for cls in METHODS.values() for name in cls.parents}
    parents["hybrid"] = dataclasses.replace(trained, ledger=FLOWN, residual=Braking())
    return Setup(task, PointMass(), reality, parents, context or Context())


def same(a: Policy, b: Policy):
    """Whether two pytrees are equal bit for bit."""
    return bool(eqx.tree_equal(eqx.filter(a, eqx.is_array), eqx.filter(b, eqx.is_array)))
