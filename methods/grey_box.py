"""Grey box: trained in the point mass with the named effects that three flights show it lacks.

No policy is flown in the high-fidelity simulator. The calibration flights depend on no task, team
size or seed (`methods/identification.py`), so one identification serves every run; each run is
billed for it in full all the same.

With a residual, a frozen black box on top corrects what the named effects leave: it is fitted to
the same flights, features and targets as Hybrid's but with the corrected point mass in the place
of the nominal one. Horizontal positions of its transitions are drawn anew within `ARENA`, because
three flights over one spot would let it take the place for the cause.
"""

import time
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from methods.bptt import BPTT
from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.identification import Identification, along, identify_once
from methods.policy import Policy, make_policy
from methods.residual_effect import ResidualEffect, features
from methods.residuals.contract import AbstractResidualModel, Transitions
from simulators import registry
from simulators.contract import AbstractSimulator, with_effects
from simulators.vehicle import CONTROL_DT

ARENA = 10.0
"""Half the width of the square in which a team may be [m]; a choice."""


class GreyBox(AbstractMethod):
    """Source: this project; grey-box identification as in Ljung (1999), Sec. 4.3."""

    residual: str | None = eqx.field(static=True, default=None)
    """Registered class of residual on what the effects leave; None: no residual."""
    largest: int = eqx.field(static=True, default=6)
    """Most named effects that the search may combine, the floor not counted."""
    trainer: BPTT = eqx.field(default=BPTT())
    """How the policy is trained."""

    version: ClassVar[str] = "1"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "point_mass"

    def __check_init__(self) -> None:
        if self.largest < 1:
            raise ValueError(f"`largest` must be at least 1, got {self.largest}.")

    def train(self, setup: Setup, key: PRNGKeyArray, init: Policy | None = None) -> Trained:
        start = time.perf_counter()
        policy_key, train_key = jax.random.split(key)
        task, nominal = setup.task, setup.nominal
        setup.progress("identification", 0, 1, float("nan"))
        found = identify_once(nominal, setup.reality, self.largest)
        corrected, model, notes = with_effects(nominal, found.effects), None, dict(found.notes)
        if self.residual is not None:
            setup.progress("residual fit", 0, 1, float("nan"))
            left = what_is_left(corrected, found)
            model = registry.load("residual", self.residual)().fit(left, jax.random.key(0))
            notes |= _fit_notes(left, model)
            corrected = with_effects(corrected, [ResidualEffect(model, nominal.spec.mass)])
        policy = init or make_policy(task, nominal.spec, nominal.action_space, policy_key)
        training = self.trainer.train(
            task, corrected, policy, train_key, setup.progress, "grey-box training"
        )
        return Trained(
            policy=training.policy,
            ledger=Ledger(
                hf_fleet_seconds=found.fleet_seconds,
                calibration_flights=found.n_flights,
                calibration_crashes=found.crashes,
                lf_collisions=training.crashes,
                epochs=training.epochs,
                skipped_updates=training.skipped,
                train_seconds=time.perf_counter() - start,
            ),
            curves=training.curves,
            status="diverged" if training.diverged else "ok",
            residual=model,
            effects=found.effects,
            notes={"training_reward": training.best_reward, **notes},
        )


def what_is_left(corrected: AbstractSimulator, found: Identification) -> Transitions:
    """Transitions of the flights whose target is what `corrected` still lacks."""
    before, after = found.flights.before, found.flights.after
    predicted = along(corrected, found.flights)
    seen = eqx.tree_at(lambda f: (f.quat, f.thrust), before, (predicted.quat, predicted.thrust))
    seen = eqx.tree_at(lambda f: f.t, seen, seen.t[..., None])
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), seen)
    rows = features(flat, corrected.spec.mass)
    target = (after.vel - predicted.vel).reshape(-1, 3) / CONTROL_DT
    where = jax.random.uniform(jax.random.key(1), (len(rows), 2), minval=-ARENA, maxval=ARENA)
    rows = rows.at[:, :2].set(where)
    # On the floor the floor's law holds, which no force reproduces.
    flying = np.linalg.norm(np.asarray(after.vel).reshape(-1, 3), axis=-1) > 1e-3
    return Transitions(features=rows[flying], target=target[flying], weight=jnp.ones(flying.sum()))


def _fit_notes(left: Transitions, model: AbstractResidualModel) -> dict[str, float]:
    rms = lambda x: float(jnp.sqrt(jnp.mean(jnp.sum(x**2, axis=-1))))  # noqa: E731
    return {
        "residual_target_rms": rms(left.target),
        "residual_error_rms": rms(left.target - model(left.features)),
    }
