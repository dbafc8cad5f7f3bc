"""Grey box: trained in the point mass with the named effects that three flights show it lacks.

No policy is flown in the high-fidelity simulator. The paths of the calibration flights depend on no
task or team size (`methods/calibration/identification.py`): every seed has flights of its own, and
what they show serves all its cells. Each run is billed for the flights in full all the same.

The point mass is stepped in halves of a control step. At 0.02 s its semi-implicit Euler turns a
policy's idea of "along the path" by half a step (1 m/s around 1 m: 10 mrad, 0.5 % of the speed at
every step of the episode), and the drag that fits it is 3 % off.

Every training episode draws its own lags and delays around the identified ones, so that a policy
does not live on the last degree of phase margin (`methods/training/varied.py`). With `delay`,
commands are late by a drawn time as well, which the calibration flights did not show: for teams
that will fly over a slower link than the calibration drone did. With `push`, a steady force acts in
every episode: it stands for wind, and for the differences of other drones from the calibrated one
in mass, thrust and level.

With a residual, a frozen black box on top corrects what the named effects leave: it is fitted to
the same flights, features and targets as Hybrid's but with the corrected point mass in the place
of the nominal one. Horizontal positions of its transitions are drawn anew within `ARENA`, because
three flights over one spot would let it take the place for the cause. What a fit to two of the
flights gets right on the third decides which share of the correction is believed.
"""

import dataclasses
import time
from collections.abc import Sequence
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from methods.calibration.identification import DITHER, Identification, identify
from methods.calibration.remainder import remaining_transitions
from methods.calibration.residual_effect import ResidualEffect
from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.residuals.contract import AbstractHistoryModel, AbstractResidualModel, inputs
from methods.running.low_fidelity import check_step, train_in_point_mass
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, make_policy
from methods.training.varied import MOST_PUSH, vary_around
from simulators import registry
from simulators.contract import AbstractSimulator, with_effects
from simulators.effects.late import LONGEST_DELAY_S
from tasks.contract import check_at_least


class GreyBox(AbstractMethod):
    """Source: this project; grey-box identification as in Ljung (1999), Sec. 4.3."""

    residual: str | None = eqx.field(static=True, default=None)
    """Registered class of residual on what the effects leave; None: no residual."""
    largest: int = eqx.field(static=True, default=6)
    """Most named effects that the search may combine, the floor not counted."""
    flights: int = eqx.field(static=True, default=3, metadata={"neutral": True})
    """Calibration flights; with more than three, the paths are flown again under another dither."""
    excitation: float = eqx.field(static=True, default=DITHER, metadata={"neutral": True})
    """Amplitude of the dither on their actions [-]."""
    all_candidates: bool = eqx.field(static=True, default=False, metadata={"neutral": True})
    """Whether effects are identified, too, that a point mass can hardly tell from others."""
    dt: float = eqx.field(static=True, default=0.01)
    """Integration step of the point mass [s]."""
    spread: float = eqx.field(static=True, default=0.5)
    """Largest change of the logarithm of an identified time in a training episode [-]."""
    delay: float = eqx.field(static=True, default=0.0, metadata={"neutral": True})
    """Most that commands are later in a training episode than was identified [s]."""
    push: float = eqx.field(static=True, default=0.0, metadata={"neutral": True})
    """Largest steady push along each axis in a training episode [m/s^2]."""
    trainer: BPTT = eqx.field(default=BPTT(decay=0.99))
    """How the policy is trained."""

    identifies: ClassVar[bool] = True
    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ()
    simulator: ClassVar[str] = "point_mass"

    def __check_init__(self) -> None:
        check_at_least(self, 1, "largest")
        check_at_least(self, 0, "excitation")
        if self.flights < (fewest := 1 if self.residual is None else 2):
            raise ValueError(
                f"`flights` must be at least {fewest} (2 with a residual), got {self.flights}."
            )
        check_step(self.dt)
        if not 0.0 <= self.spread < 2.0:
            raise ValueError(f"`spread` must lie in [0, 2), got {self.spread}.")
        if not 0.0 <= self.delay <= LONGEST_DELAY_S:
            raise ValueError(f"`delay` must lie in [0, {LONGEST_DELAY_S}] s, got {self.delay}.")
        if not 0.0 <= self.push <= MOST_PUSH:
            raise ValueError(f"`push` must lie in [0, {MOST_PUSH}] m/s^2, got {self.push}.")

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        flight_key, fit_key, policy_key, train_key = jax.random.split(key, 4)
        task, nominal = setup.task, dataclasses.replace(setup.nominal, dt=self.dt)
        with setup.context.in_turn():
            start = time.perf_counter()
            setup.context.progress("identification", 0, 1, float("nan"))
            chosen = (self.flights, self.excitation, self.all_candidates)
            found = identify(nominal, setup.reality, self.dt, self.largest, flight_key, *chosen)
            corrected, model, notes = with_effects(nominal, found.effects), None, dict(found.notes)
            if self.residual is not None:
                setup.context.progress("residual fit", 0, 1, float("nan"))
                model, fit_notes = fit_residual(self.residual, corrected, found, fit_key)
                notes |= fit_notes
                corrected = with_effects(corrected, [ResidualEffect(model, nominal.spec.mass)])
            seconds = time.perf_counter() - start
        policy = init or make_policy(task, nominal.spec, nominal.action_space, policy_key)
        bill = Ledger(
            calibration_flights=found.n_flights,
            calibration_crashes=found.crashes,
            train_seconds=seconds,
        )
        varied = vary_around(corrected, self.spread, self.delay, self.push)
        stage = "grey-box training"
        trained = train_in_point_mass(
            self.trainer, setup, varied, policy, train_key, stage, bill, notes
        )
        return dataclasses.replace(trained, residual=model, effects=found.effects)


class Trusted(AbstractResidualModel):
    """A share of a residual's correction."""

    model: AbstractResidualModel
    """The residual."""
    share: Float[Array, ""]
    """Share of it, from 0 to 1 [-]."""

    def __call__(self, features: Float[Array, "drones 12"]) -> Float[Array, "drones 3"]:
        return self.share * self.model(features)


class TrustedHistory(AbstractHistoryModel):
    """`Trusted`, for a residual that sees the last commands."""

    model: AbstractHistoryModel
    """The residual."""
    share: Float[Array, ""]
    """Share of it, from 0 to 1 [-]."""

    def __call__(self, features: Float[Array, "drones features"]) -> Float[Array, "drones 3"]:
        return self.share * self.model(features)


def fit_residual(
    residual: str, corrected: AbstractSimulator, found: Identification, key: PRNGKeyArray
) -> tuple[Trusted | TrustedHistory, dict[str, float]]:
    """A residual fitted to the accelerations that `corrected` still lacks, and its errors.

    `residual_share` is the multiple of the correction, limited to [0, 1], that fits each flight
    best when the residual was fitted to the others: sum(y h) / sum(h h), h predicted for y.
    """
    flights = remaining_transitions(corrected, found.flights)
    fit = lambda chosen: registry.load("residual", residual)().fit(  # noqa: E731
        jax.tree.map(lambda *x: jnp.concatenate(x), *chosen), key
    )
    right, power = 0.0, 0.0
    for i, flight in enumerate(flights):
        model = fit([*flights[:i], *flights[i + 1 :]])
        predicted = model(inputs(model, flight))
        right += float(jnp.sum(predicted * flight.target))
        power += float(jnp.sum(predicted**2))
    share = min(max(right / power, 0.0), 1.0) if power > 0.0 else 0.0
    fitted, trust = fit(flights), jnp.asarray(share)
    recalls = isinstance(fitted, AbstractHistoryModel)
    model = TrustedHistory(fitted, trust) if recalls else Trusted(fitted, trust)
    notes = {
        "residual_share": share,
        "residual_target_rms": _rms([f.target for f in flights]),
        "residual_error_rms": _rms([f.target - model(inputs(model, f)) for f in flights]),
    }
    return model, notes


def _rms(parts: Sequence[Float[Array, "_ 3"]]) -> float:
    """RMS length [m/s^2]."""
    return float(jnp.sqrt(jnp.mean(jnp.sum(jnp.concatenate(parts) ** 2, axis=-1))))
