"""What a method must keep to: an honest ledger, a policy to store, one result per key.

It is trained for a moment on a tiny cell: two drones, a fraction of a second, parents whose
policies are fresh. Whether it learns is for `bench run` to say.
"""

import dataclasses
import functools
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bench.conformance.suite import Check, declaration_checks, demand, equal, finite
from bench.plan.keys import Setting
from bench.plan.override import merged
from bench.plan.settings import build
from bench.store.record import load_policy, policy_bytes
from bench.store.tables import SCHEMAS, STATUSES, UNITS
from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.running.profile import untrained_parents
from methods.training.bptt import BPTT
from methods.training.context import Context
from methods.training.meter import Meter, metered
from methods.training.policy import AbstractPolicy, Policy, is_shared, make_policy
from simulators import registry
from simulators.point_mass import PointMass
from tasks.contract import AbstractTask
from tasks.spread import Spread

KEY = jax.random.key(7)
TASK = Spread(n_drones=2, horizon=10)
SHORT = {"epochs": 3, "n_worlds": 1, "patience": None, "smoothing": 1}
"""Settings of every `BPTT` among a method's settings while it is checked."""
SMALL: dict[str, Setting] = {
    "epochs_base": 3,
    "epochs_per_drone": 0.0,
    "flights": 3,
    "spread": 0.0,
    "epochs": 3,
    "n_worlds": 2,
}
"""Settings that make our own methods short; who has a field of that name gets it."""


def declarations(cls: type[Any], given: Mapping[str, Setting]) -> list[Check]:
    """Checks of what the class says of itself; the others need them."""
    return [
        *declaration_checks(cls, AbstractMethod, **given),
        Check("its parents are registered methods, in cells that there are", lambda: _parents(cls)),
        Check("it names the simulator in which it trains", lambda: _simulator(cls)),
    ]


def short_settings(cls: type[Any], wanted: Mapping[str, Setting]) -> dict[str, Setting]:
    """Settings with which a check takes seconds; `wanted` has the last word."""
    fields = {field.name: field.default for field in dataclasses.fields(cls) if field.init}
    found = {name: x for name, x in SMALL.items() if type(fields.get(name)) in (int, float)}
    found |= {name: dict(SHORT) for name, default in fields.items() if isinstance(default, BPTT)}
    return merged(found, wanted)


def behaviour(
    cls: type[Any],
    reality: type[Any],
    given: Mapping[str, Setting],
    wanted: Mapping[str, Setting],
) -> list[Check]:
    """Checks of one short training, and of a second one to compare it with."""
    settings = short_settings(cls, wanted)
    watched = _Watch(reality)
    made = functools.partial(build, cls, settings, f"`{cls.__name__}`", **given)

    @functools.cache
    def trained() -> Trained:
        return made().train(watched.setup(cls, TASK), KEY)

    sentences = {
        "`train` returns a Trained with a policy": lambda: _returns(trained()),
        "the policy can be stored and deployed": lambda: _stored(trained()),
        "the policy is finite": lambda: _finite_policy(trained()),
        "its status is one that a run can have": lambda: _status(trained()),
        "the ledger holds costs that can be": lambda: _ledger(trained()),
        "high-fidelity flight is left to the meter": lambda: _left_to_meter(
            trained(), watched, cls.simulator
        ),
        "training curves can be stored": lambda: _curves(trained()),
        "notes are numbers under names of their own": lambda: _notes(trained()),
        "progress is reported": lambda: _progress(trained(), watched),
        "the same key gives the same policy": lambda: _repeats(
            trained(), made().train(_Watch(reality).setup(cls, TASK), KEY)
        ),
        "training can start from a given policy": lambda: _starts(
            made().train(_Watch(reality).setup(cls, TASK), KEY, _other(trained().policy)), trained()
        ),
    }
    return [Check(text, check) for text, check in sentences.items()]


def fresh(seed: int) -> Policy:
    """A policy of the tiny cell."""
    nominal = PointMass()
    return make_policy(TASK, nominal.spec, nominal.action_space, jax.random.key(seed))


def _other(policy: AbstractPolicy) -> AbstractPolicy:
    """A policy of the same architecture with other numbers."""
    if is_shared(policy):
        return fresh(3)
    return jax.tree.map(lambda x: 0.9 * x if eqx.is_inexact_array(x) else x, policy)


class _Watch:
    """A cell whose reality is metered and which remembers what progress was told."""

    def __init__(self, reality: type[Any]) -> None:
        self.heard: list[tuple] = []
        self.meter = Meter()
        self.reality = metered(reality(), self.meter)

    def setup(self, cls: type[Any], task: AbstractTask) -> Setup:
        parents = untrained_parents(cls, map(fresh, range(len(cls.parents))))
        return Setup(task, PointMass(), self.reality, parents, Context(self._hear))

    def _hear(self, *message: object) -> None:
        self.heard.append(message)


def _parents(cls: type[Any]) -> None:
    demand(
        isinstance(cls.parents, tuple), f"`parents` must be a tuple of names, got {cls.parents!r}"
    )
    known = registry.names("method")
    for name in cls.parents:
        demand(name in known, registry.unknown("method", name, known))
    own = {name for name in cls.parents if registry.load("method", name) is cls}
    demand(not own, f"`parents` names the method itself, {', '.join(sorted(own))}")
    strangers = sorted({*cls.resumes_from, *cls.parent_cells} - {*cls.parents})
    demand(
        not strangers,
        f"`resumes_from` and `parent_cells` must name parents, got {', '.join(strangers)}",
    )
    for task, n_drones in cls.parent_cells.values():
        registry.load("task", task)(n_drones=n_drones)


def _simulator(cls: type[Any]) -> None:
    known = registry.names("simulator")
    demand(
        cls.simulator in known,
        f"`simulator` must be one of {', '.join(known)}, got {cls.simulator!r:.40}",
    )


def _returns(trained: Trained) -> None:
    demand(isinstance(trained, Trained), f"`train` must return a Trained, got {trained!r:.60}")
    demand(
        isinstance(trained.policy, AbstractPolicy),
        "`policy` must come from `make_policy`, or from your own subclass of `AbstractPolicy`; got "
        f"{trained.policy!r:.60}",
    )
    action = trained.policy(jnp.zeros((2, TASK.obs_size)))
    demand(
        action.shape == (2, 3),
        f"the policy must return actions of shape (2, 3) for two drones, got {action.shape}",
    )
    for scale in (1.0, 1e3):
        action = trained.policy(scale * jax.random.normal(KEY, (64, TASK.obs_size)))
        largest = float(jnp.max(jnp.abs(action)))
        demand(
            not largest > 1.0 + 1e-5,
            f"the policy must return actions between -1 and 1, got {largest:.3g}; beyond, a drone "
            "would be commanded what no other policy may command",
        )


def _stored(trained: Trained) -> None:
    """Demands that the policy that `bench run` stores acts as the one that was trained."""
    _returns(trained)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "policy.npz"
        try:
            path.write_bytes(policy_bytes(trained.policy))
        except TypeError as error:
            demand(False, str(error))
        again = load_policy(path, fresh(0))
    obs = jax.random.normal(KEY, (2, TASK.obs_size))
    demand(
        equal(again(obs), trained.policy(obs)),
        "the policy acts otherwise once it is stored and loaded; keep all that it needs in fields",
    )


def _finite_policy(trained: Trained) -> None:
    demand(
        finite(eqx.filter(trained.policy, eqx.is_array)),
        "the policy holds NaN; keep the best policy so far, leave out updates that are not finite, "
        "and return the status `diverged` if nothing else is left",
    )


def _status(trained: Trained) -> None:
    allowed = [status for status in STATUSES if status != "failed"]
    demand(
        trained.status in allowed,
        f"`status` must be one of {', '.join(allowed)} (raise to fail), got {trained.status!r}",
    )


def _ledger(trained: Trained) -> None:
    ledger = trained.ledger
    demand(isinstance(ledger, Ledger), f"`ledger` must be a Ledger, got {type(ledger).__name__}")
    for field in dataclasses.fields(Ledger):
        value = getattr(ledger, field.name)
        whole = isinstance(field.default, int)
        demand(
            isinstance(value, int | float) and np.isfinite(value) and value >= 0,
            f"`ledger.{field.name}` must be a plain number of at least 0, got {value!r:.60}",
        )
        demand(
            not whole or float(value).is_integer(),
            f"`ledger.{field.name}` must be a whole number, got {value!r}",
        )
    demand(ledger.epochs > 0, "`ledger.epochs` is 0; count the updates of the policy")
    demand(
        ledger.train_seconds > 0.0, "`ledger.train_seconds` is 0; measure the wall time of `train`"
    )


def _left_to_meter(trained: Trained, watched: _Watch, simulator: str) -> None:
    if simulator == watched.reality.name:
        demand(
            watched.meter.fleet_seconds > 0.0,
            f"it trains in '{simulator}', but flew nothing there that was counted; fly "
            "`setup.reality`, not a simulator of your own",
        )
    seconds = trained.ledger.hf_fleet_seconds
    demand(
        seconds == 0.0,
        f"it sets `ledger.hf_fleet_seconds` to {seconds:g} s, which is replaced by what "
        "`setup.reality` counted; leave it out, and put flight of a parent that the run bears "
        "into `inherited_fleet_seconds`",
    )
    inherited = trained.ledger.inherited_fleet_seconds
    demand(
        inherited == 0.0,
        f"it inherits {inherited:g} s of high-fidelity flight, but its parents here flew nothing",
    )


def _curves(trained: Trained) -> None:
    allowed = [name for name in SCHEMAS["curves"].columns if name not in ("run", "epoch")]
    lengths = {name: np.shape(values) for name, values in trained.curves.items()}
    demand("reward" in lengths, "`curves` must hold `reward`, the training return of each epoch")
    demand(
        all(len(shape) == 1 for shape in lengths.values()) and len(set(lengths.values())) == 1,
        f"`curves` must hold one number per epoch, got the shapes {lengths}",
    )
    stored = sorted(set(lengths) & set(allowed))
    demand(stored, f"of `curves`, {', '.join(allowed)} are stored, got {', '.join(lengths)}")


def _notes(trained: Trained) -> None:
    for name, value in trained.notes.items():
        demand(
            isinstance(name, str) and isinstance(value, int | float | np.number | jax.Array),
            f"`notes` must map names to numbers, got {name!r}: {value!r:.60}",
        )
        demand(np.ndim(value) == 0, f"the note '{name}' must be one number, got {value!r:.60}")
        demand(
            name == "training_reward" or name not in UNITS,
            f"a note cannot be called '{name}', which is a metric of every run",
        )


def _progress(trained: Trained, watched: _Watch) -> None:
    demand(watched.heard, "`setup.context.progress` was never called; call it after every epoch")
    for message in watched.heard:
        demand(
            len(message) == 4
            and isinstance(message[0], str)
            and all(isinstance(x, int | float | np.number | jax.Array) for x in message[1:]),
            f"progress is told (stage, epoch, epochs, return), got {message!r:.80}",
        )


def _repeats(first: Trained, second: Trained) -> None:
    demand(
        equal(first.policy, second.policy),
        "two trainings with the same key end with different policies; take randomness from `key` "
        "alone",
    )


def _starts(trained: Trained, without: Trained) -> None:
    _returns(trained)
    _finite_policy(trained)
    demand(
        not equal(trained.policy, without.policy),
        "the policy that `train` is given as `init` changes nothing; start from it",
    )
