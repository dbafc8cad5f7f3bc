"""Hybrid: trained in the point mass under a frozen residual, no policy ever flown in HF."""

import dataclasses
import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import ClassVar, Literal, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from methods.calibration.identification import PATHS
from methods.calibration.pool import Attitude, Calibration, calibrate, pool_size
from methods.calibration.remainder import calibrate_as_grey_box
from methods.calibration.residual_effect import ResidualEffect
from methods.contract import AbstractMethod, Ledger, Setup, Trained
from methods.residuals.contract import (
    AbstractResidual,
    AbstractResidualModel,
    Transitions,
    inputs,
)
from methods.residuals.mlp import MLPEnsemble
from methods.running.low_fidelity import train_in_point_mass
from methods.training.bptt import BPTT
from methods.training.policy import AbstractPolicy, make_policy
from simulators import registry
from simulators.contract import with_effects
from tasks.contract import check_at_least

Flown = Literal["pool", "grey_box"]


class Hybrid(AbstractMethod):
    """The paper's method: calibrate on isolated drones, fit, freeze, train. Source: Sec. III.

    Every training seed flies its own pool along the paths of its own LF baseline, so that scatter
    over seeds holds that of the pools; the paper calibrates once per task and team size.
    """

    residual: str = eqx.field(static=True, default="mlp")
    """Registered class of residual: `affine`, `sindy`, `mlp`, `history` or a plug-in's."""
    attitude: Attitude = eqx.field(static=True, default="filtered")
    """Which attitude the residual is fitted on; `methods/calibration/pool.py` explains the two."""
    flights: int | None = eqx.field(static=True, default=None)
    """Calibration flights; None: the paper's pool of 60 (N + 1)."""
    hover_weight: float = eqx.field(static=True, default=4.0)
    """Extra weight of transitions at rest, in tasks that keep station; a choice."""
    excitation: float = eqx.field(static=True, default=0.2)
    """Amplitude of the dither on the calibration flights' actions [-]; 0 is the paper's."""
    flown: Flown = eqx.field(static=True, default="pool", metadata={"neutral": True})
    """`pool`: the paper's flights along the LF baseline's paths; `grey_box`: the flights, noise and
    rows that a grey box identifies from, three of them if `flights` does not say otherwise."""
    rows: int | None = eqx.field(static=True, default=None, metadata={"neutral": True})
    """Rows to which each member of the ensemble is fitted; None: as many as its class says."""
    trainer: BPTT = eqx.field(default=BPTT(lr=1e-3, decay=0.99))
    """How the policy is trained."""

    version: ClassVar[str] = "2"
    parents: ClassVar[tuple[str, ...]] = ("lf_baseline",)
    simulator: ClassVar[str] = "point_mass"

    def __check_init__(self) -> None:
        if self.attitude not in get_args(Attitude):
            allowed = " or ".join(f"'{name}'" for name in get_args(Attitude))
            raise ValueError(f"`attitude` must be {allowed}, got '{self.attitude}'.")
        if self.flown not in get_args(Flown):
            allowed = " or ".join(f"'{name}'" for name in get_args(Flown))
            raise ValueError(f"`flown` must be {allowed}, got '{self.flown}'.")
        if self.rows is not None and (self.rows < 1 or self.residual != "mlp"):
            raise ValueError(
                f"`rows` must be at least 1 and the residual 'mlp', got {self.rows} and "
                f"'{self.residual}'."
            )
        if self.flights is not None and self.flights < 1:
            raise ValueError(f"`flights` must be at least 1 or None, got {self.flights}.")
        check_at_least(self, 0, "hover_weight", "excitation")
        own = (self.attitude, self.hover_weight)
        if self.flown == "grey_box" and own != (type(self).attitude, type(self).hover_weight):
            raise ValueError(
                "`attitude` and `hover_weight` must have their defaults where `flown` is "
                f"'grey_box': its rows know neither; got '{own[0]}' and {own[1]:g}."
            )

    def train(self, setup: Setup, key: PRNGKeyArray, init: AbstractPolicy | None = None) -> Trained:
        residual = registry.load("residual", self.residual)()
        if self.rows is not None:
            residual = MLPEnsemble(max_samples=self.rows)
        return self.adapted(setup, key, init, residual)

    def adapted(
        self,
        setup: Setup,
        key: PRNGKeyArray,
        init: AbstractPolicy | None,
        residual: AbstractResidual,
        fitted: AbstractResidualModel | None = None,
    ) -> Trained:
        """Flies, fits `residual` and trains, as `train` does; the fit goes on from `fitted`."""
        flight_key, fit_key, policy_key, train_key = jax.random.split(key, 4)
        task, nominal = setup.task, setup.nominal
        with setup.context.in_turn():
            start = time.perf_counter()
            setup.context.progress("calibration flights", 0, 1, float("nan"))
            calibration = self._calibration(setup, flight_key)
            setup.context.progress("residual fit", 0, 1, float("nan"))
            model = residual.fit(calibration.transitions, fit_key, fitted)
            before = time.perf_counter() - start
        policy = init or make_policy(task, nominal.spec, nominal.action_space, policy_key)
        bill = Ledger(
            calibration_flights=calibration.flights,
            calibration_crashes=calibration.crashes,
            train_seconds=before,
        )
        notes = _fit_notes(calibration, model)
        return trained_under(model, setup, self.trainer, policy, train_key, bill, notes)

    def _calibration(self, setup: Setup, key: PRNGKeyArray) -> Calibration:
        task = setup.task
        if self.flown == "grey_box":
            return calibrate_as_grey_box(
                setup.nominal, setup.reality, key, self.flights or len(PATHS), self.excitation
            )
        return calibrate(
            task,
            setup.nominal,
            setup.reality,
            setup.parents["lf_baseline"].policy,
            key,
            n_flights=self.flights or pool_size(task.n_drones),
            attitude=self.attitude,
            excitation=self.excitation,
            hover_weight=self.hover_weight if task.station_keeping else 0.0,
        )


def trained_under(
    model: AbstractResidualModel,
    setup: Setup,
    trainer: BPTT,
    policy: AbstractPolicy,
    key: PRNGKeyArray,
    bill: Ledger,
    notes: Mapping[str, float] = MappingProxyType({}),
) -> Trained:
    """`policy` trained in the point mass under a frozen residual.

    `bill` is what calibration has cost, `notes` what is known of the residual's fit.
    """
    nominal = setup.nominal
    corrected = with_effects(nominal, [ResidualEffect(model, nominal.spec.mass)])
    stage = "hybrid training"
    trained = train_in_point_mass(trainer, setup, corrected, policy, key, stage, bill, notes)
    return dataclasses.replace(trained, residual=model)


def _fit_notes(calibration: Calibration, model: AbstractResidualModel) -> dict[str, float]:
    rms, left = _errors(calibration.transitions, model)
    return {
        "residual_target_rms": float(rms),
        "residual_error_rms": float(left),
        "pos_remainder_rms": calibration.pos_remainder,
        "tracking_error": calibration.tracking_error,
        "clipped_share": calibration.clipped_share,
    }


@eqx.filter_jit
def _errors(
    transitions: Transitions, model: AbstractResidualModel
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """RMS [m/s^2] of the target and of the model's error."""
    left = transitions.target - model(inputs(model, transitions))
    rms = lambda x: jnp.sqrt(jnp.mean(jnp.sum(x**2, axis=-1)))  # noqa: E731
    return rms(transitions.target), rms(left)
