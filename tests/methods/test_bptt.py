"""The trainer: tiny tasks with a known optimum, what is skipped, when it ends, what it keeps."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import SPEC, TINY, Hold, fresh, same, setup
from scipy.optimize import linprog

from methods.hf_hotstart import HFHotStart
from methods.lf_baseline import LFBaseline
from methods.training import bptt
from methods.training.bptt import BPTT, Training
from methods.training.context import Context, silent
from methods.training.policy import PolicyController
from simulators.contract import with_effects
from simulators.effects.contract import WrenchEffect
from simulators.point_mass import PointMass
from simulators.vehicle import GRAVITY, ActionSpace
from tasks.rollout import episode

KEY = jax.random.key(21)
H, NORM = 0.02, 1e-3
"""Control step [s]; what the tasks' smooth norm makes of zero."""


def train(task, settings, simulator=None, policy=None, progress=silent):
    simulator, policy = simulator or PointMass(), policy or fresh(task)
    return settings.train(task, simulator, policy, KEY, Context(progress), "test")


def returns(task, policy, key, simulator=None):
    """Training return of a policy, mean over drones."""
    controller = PolicyController(task, policy)
    flown = eqx.filter_jit(episode)(task, simulator or PointMass(), controller, key)
    return float(flown.smooth_reward) / task.n_drones


# --- A ladder of tasks with a known optimum -------------------------------------------------


def best_climb(height, horizon):
    """The largest -sum |z - height| of a drone that starts at rest at zero: a linear program.

    Variables: thrust u_k, distance d_k >= |z_k - height|; z and v follow from u.
    """
    most = ActionSpace().thrust_max / SPEC.mass
    steps = np.arange(1, horizon + 1)
    # z_k = h^2 sum_{j < k} (k - j) (u_j - g)
    lever = H**2 * np.maximum(steps[:, None] - np.arange(horizon)[None, :], 0)
    fallen = lever.sum(axis=1) * GRAVITY
    eye = np.eye(horizon)
    solved = linprog(
        np.concatenate([np.zeros(horizon), np.ones(horizon)]),
        A_ub=np.block([[lever, -eye], [-lever, -eye]]),
        b_ub=np.concatenate([height + fallen, -height - fallen]),
        bounds=[(0.0, most)] * horizon + [(0.0, None)] * horizon,
    )
    assert solved.success
    return -solved.fun


def test_holding_a_place_is_learned_to_the_optimum():
    """Stay at rest at the start: the optimum is zero, but for the norm's 1e-3 m."""
    task = Hold(n_drones=2, horizon=40, spacing=(3.0, 3.0))
    settings = BPTT(epochs=150, lr=3e-3, n_worlds=1, smoothing=5)
    before = returns(task, fresh(task), KEY)
    after = returns(task, train(task, settings).policy, KEY)
    best = -40 * NORM * 1.5
    assert before < -3.0
    assert best - 0.15 < after <= best


def test_reaching_a_height_is_learned_to_near_the_optimum():
    """0.4 m in 0.8 s, full thrust and braking: the bound of the linear program."""
    task = Hold(n_drones=2, horizon=40, spacing=(3.0, 3.0), goal=(0.0, 0.0, 0.4), vel_weight=0.0)
    settings = BPTT(epochs=250, lr=5e-3, n_worlds=1, smoothing=5)
    best = best_climb(0.4, 40)
    after = returns(task, train(task, settings).policy, KEY)
    assert 1.15 * best < after < best


# --- Updates that are not finite ------------------------------------------------------------


class Spike(WrenchEffect):
    """No force at all, but a derivative that is not a number where the first drone is beyond."""

    beyond: jax.Array

    parameters: ClassVar[dict] = {}
    version: ClassVar[str] = "1"

    def wrench(self, memory, flight, vehicle, dt):
        here = (flight.pos[0, 0] > self.beyond) & (flight.t > 0.1)
        broken = jnp.sqrt(jnp.where(here, 0.0 * flight.vel**2, 1.0))
        return None, jnp.where(here, broken, 0.0), jnp.zeros_like(flight.vel)


SPIKED = Hold(n_drones=2, horizon=10, spacing=(3.0, 3.0), jitter=0.5)
SKIPPING = dataclasses.replace(TINY, epochs=8)


def spiked(beyond):
    return with_effects(PointMass(), [Spike(jnp.asarray(beyond))])


def test_the_spike_changes_no_flight():
    policy = fresh(SPIKED)
    assert returns(SPIKED, policy, KEY, spiked(-9.0)) == returns(SPIKED, policy, KEY, spiked(9.0))


def test_updates_that_are_not_finite_are_left_out_and_the_policy_stays():
    policy = fresh(SPIKED)
    training = train(SPIKED, SKIPPING, spiked(-9.0), policy)
    assert training.skipped == training.epochs == SKIPPING.epochs
    assert same(training.policy, policy)
    assert training.diverged
    # The return varies with the spawn alone: nothing was learned, nothing was broken.
    for epoch, found in enumerate(training.curves["smooth_reward"]):
        key = jax.random.split(jax.random.fold_in(KEY, epoch), 1)[0]
        assert found == pytest.approx(returns(SPIKED, policy, key), rel=1e-5)


def test_only_the_broken_updates_are_left_out():
    training = train(SPIKED, SKIPPING, spiked(0.0))
    start = []
    for epoch in range(SKIPPING.epochs):
        key = jax.random.split(jax.random.fold_in(KEY, epoch), 1)[0]
        start.append(float(SPIKED.reset(jax.random.split(key)[0])[0][0, 0]))
    broken = np.array(start) > 0.0
    assert np.abs(start).min() > 0.02  # clear cases only: drones drift by millimetres
    assert 1 < broken.sum() < SKIPPING.epochs - 1
    np.testing.assert_array_equal(training.curves["skipped"], broken)
    np.testing.assert_array_equal(np.isfinite(training.curves["grad_norm"]), ~broken)
    leaves = jax.tree.leaves(eqx.filter(training.policy, eqx.is_array))
    assert all(np.isfinite(leaf).all() for leaf in leaves)


def test_skipped_updates_reach_the_ledger_and_the_status():
    cell = setup(SPIKED, spiked(-9.0), fresh(SPIKED))
    trained = HFHotStart(trainer=SKIPPING).train(cell, KEY)
    assert trained.ledger.skipped_updates == SKIPPING.epochs
    assert trained.status == "diverged"
    assert same(trained.policy, cell.parents["lf_baseline"].policy)


# --- Ending and choosing --------------------------------------------------------------------

HOLD = Hold(n_drones=2, horizon=40, spacing=(3.0, 3.0))


@pytest.mark.parametrize(("last", "diverged"), [(-10.0, False), (-19.0, False), (-21.0, True)])
def test_a_run_that_ends_far_below_its_best_is_called_diverged(last, diverged):
    reward = np.concatenate([np.full(20, -10.0), np.full(10, last)])
    run = Training(
        policy=fresh(HOLD),
        curves={"reward": reward, "smooth_reward": reward, "skipped": np.zeros(30)},
        out_of_budget=False,
        best_reward=-10.0,
        final_reward=last,
        seconds=1.0,
    )
    assert run.diverged is diverged


def test_a_run_without_a_best_policy_is_called_diverged():
    """An epoch without a return in every average: nothing was ever chosen."""
    reward = np.where(np.arange(40) % 20 == 10, np.nan, -10.0)
    run = Training(
        policy=fresh(HOLD),
        curves={"reward": reward, "smooth_reward": reward, "skipped": np.isnan(reward)},
        out_of_budget=False,
        best_reward=-np.inf,
        final_reward=-10.0,
        seconds=1.0,
    )
    assert run.skipped == 2
    assert run.diverged


def marked(epoch):
    """A policy that shows how many updates made it."""
    return eqx.tree_at(lambda p: p.net.layers[-1].bias, fresh(HOLD), jnp.full(3, float(epoch)))


def updates_of(policy):
    return int(policy.net.layers[-1].bias[0])


@pytest.fixture
def scripted(monkeypatch):
    """A function: makes trainings see these returns, whatever flies; updates count themselves."""

    def script(returns):
        def step(given):
            policy, opt_state = given[3:5]
            flown = updates_of(policy)
            row = {"reward": returns[flown] - 1.0, "smooth_reward": returns[flown]}
            row |= dict.fromkeys(("crashes", "contact_steps", "grad_norm", "skipped"), 0.0)
            return (marked(flown + 1), opt_state, row), 0.0

        monkeypatch.setattr(bptt, "_step", lambda team, room: step)

    return script


HILL = [-9.0, -8.0, -7.0, -2.0, -2.5, -2.0, -5.0, -1.0, -8.0, -6.0, -6.5, -7.0]
"""Averages over three epochs rise to -13/6, that of epochs 3 to 5; the best single return, -1 at
epoch 7, is chance."""
BEST = 5
COUNTED = BPTT(epochs=len(HILL), n_worlds=1, smoothing=3)
PATIENT = dataclasses.replace(COUNTED, patience=len(HILL))
IMPATIENT = dataclasses.replace(COUNTED, patience=4)


def test_without_patience_the_whole_budget_is_flown_and_the_last_policy_returned(scripted):
    scripted(HILL)
    training = train(HOLD, COUNTED, policy=marked(0))
    assert training.epochs == updates_of(training.policy) == len(HILL)
    assert not training.out_of_budget
    assert training.best_reward == pytest.approx(-6.5 / 3.0)
    assert training.final_reward == pytest.approx(-6.5)


def test_with_patience_the_policy_of_the_best_average_is_returned_and_not_the_last(scripted):
    scripted(HILL)
    training = train(HOLD, PATIENT, policy=marked(0))
    assert training.epochs == len(HILL)
    assert updates_of(training.policy) == BEST
    assert training.out_of_budget
    assert training.best_reward == pytest.approx(-6.5 / 3.0)
    assert training.final_reward == pytest.approx(-6.5)


def test_patience_ends_a_training_that_no_longer_improves_before_its_budget(scripted):
    scripted(HILL)
    training = train(HOLD, IMPATIENT, policy=marked(0))
    assert training.epochs == BEST + IMPATIENT.patience + 1
    assert updates_of(training.policy) == BEST
    assert not training.out_of_budget
    np.testing.assert_allclose(training.curves["smooth_reward"], HILL[: training.epochs])


def test_patience_that_ends_exactly_at_the_last_epoch_was_not_cut_by_the_budget(scripted):
    scripted(HILL)
    exact = dataclasses.replace(COUNTED, patience=len(HILL) - 1 - BEST)
    training = train(HOLD, exact, policy=marked(0))
    assert training.epochs == len(HILL)
    assert not training.out_of_budget


def test_the_last_average_counts_the_last_epochs_only(scripted):
    scripted([-5.0] * 20 + [-3.0, -2.0, -1.0])
    training = train(HOLD, dataclasses.replace(COUNTED, epochs=23), policy=marked(0))
    assert training.final_reward == training.best_reward == pytest.approx(-2.0)
    assert updates_of(training.policy) == 23


@pytest.mark.parametrize(
    ("trainer", "low", "high"),
    [(COUNTED, "ok", "ok"), (PATIENT, "ok", "budget"), (IMPATIENT, "ok", "ok")],
    ids=["whole budget", "patience lasts", "patience ends"],
)
def test_only_a_high_fidelity_run_that_patience_should_have_ended_says_budget(
    scripted, trainer, low, high
):
    # Never far below its best: it would be called diverged.
    scripted([0.1 * value - 10.0 for value in HILL])
    cell = setup(HOLD, PointMass(), marked(0))
    trained = [m(trainer=trainer).train(cell, KEY, marked(0)) for m in (LFBaseline, HFHotStart)]
    assert [t.status for t in trained] == [low, high]
    for t in trained:
        last = np.mean(t.curves["smooth_reward"][-trainer.smoothing :])
        assert t.notes["training_reward"] == pytest.approx(last)
        assert t.ledger.epochs == len(t.curves["reward"])


def test_the_policy_that_is_returned_has_seen_the_last_update():
    """At a constant learning rate a longer training flies it in its next epoch."""
    steady = BPTT(epochs=4, lr=1e-3, final_lr=1.0, n_worlds=1, smoothing=3)
    longer = train(HOLD, dataclasses.replace(steady, epochs=6)).curves["smooth_reward"]
    last = returns(HOLD, train(HOLD, steady).policy, KEY)
    assert last == pytest.approx(float(longer[4]), rel=1e-5)
    assert np.abs(np.diff(longer)).min() > 1e-3 * abs(last)  # neighbours are told apart


def test_a_run_shorter_than_the_average_still_keeps_its_best_policy():
    short = BPTT(epochs=3, lr=3e-3, n_worlds=1, smoothing=10, patience=2)
    training = train(HOLD, short)
    assert np.isfinite(training.best_reward)
    assert training.best_reward == pytest.approx(training.curves["smooth_reward"].mean(), rel=1e-6)
    assert returns(HOLD, training.policy, KEY) == pytest.approx(
        float(training.curves["smooth_reward"][-1]), rel=1e-5
    )


def test_impatience_waits_for_the_first_average():
    hasty = BPTT(epochs=30, lr=3e-3, n_worlds=1, smoothing=10, patience=2)
    training = train(HOLD, hasty)
    assert training.epochs >= hasty.smoothing
    assert np.isfinite(training.best_reward)


def test_large_teams_fly_fewer_episodes():
    settings = BPTT(n_worlds=16, max_drones=96)
    assert [settings.worlds(n) for n in (2, 6, 7, 18, 200)] == [16, 16, 13, 5, 1]


@pytest.mark.parametrize("name", ["epochs", "n_worlds", "max_drones", "smoothing"])
def test_counts_below_one_are_refused(name):
    with pytest.raises(ValueError, match=f"`{name}` must be at least 1, got 0"):
        BPTT(**{name: 0})


@pytest.mark.parametrize("decay", [0.0, 1.5])
def test_a_decay_outside_its_range_is_refused(decay):
    with pytest.raises(ValueError, match=r"`decay` must lie in \(0, 1\]"):
        BPTT(decay=decay)


def test_the_learning_rate_falls_as_a_cosine():
    trainer = BPTT(epochs=100, lr=2e-3, final_lr=0.1)
    rates = [float(trainer.learning_rate(epoch)) for epoch in (0, 50, 100)]
    assert rates == pytest.approx([2e-3, 0.5 * (2e-3 + 2e-4), 2e-4])
