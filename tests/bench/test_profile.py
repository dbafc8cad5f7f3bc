"""`bench profile`: the parts of an epoch, the simulator that a method trains in, bad input."""

import types

import jax
import jax.numpy as jnp
import pytest

from bench.cli.app import main
from methods.calibration.residual_effect import ResidualEffect
from methods.contract import AbstractMethod, Setup
from methods.hf_hotstart import HFHotStart
from methods.hybrid import Hybrid
from methods.hybrid_once import HybridOnce
from methods.running.profile import (
    NoTrainerError,
    attainable,
    frozen_weights,
    profile,
    shortest,
    trained_in,
)
from methods.training.bptt import BPTT
from methods.training.policy import Policy, make_policy
from methods.training.varied import Varied, vary_around
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.delay import Delay
from simulators.point_mass import PointMass
from tasks.circle import Circle
from tasks.rollout import Episode

TASK = Circle(n_drones=3, horizon=20)
SETUP = Setup(TASK, PointMass(), Crazyflow())


def test_parts_are_what_each_program_takes_longer_than_the_one_before(monkeypatch):
    """Physics, with the task, with the policy, an epoch; last the matrix products alone."""
    lasting, results = iter([1.0, 1.5, 2.5, 6.0, 0.5]), []

    def timed(call):
        results.append(call())
        return next(lasting)

    monkeypatch.setattr("methods.running.profile.shortest", timed)
    found = profile(TASK, PointMass(), BPTT(n_worlds=2))
    parts = {"physics": 1.0, "task": 0.5, "policy": 1.0, "backward": 3.5}
    assert found.seconds == parts | {"epoch": 6.0}
    assert found.n_worlds == 2
    assert found.memory > 4 * TASK.horizon  # at least one number a step
    assert found.ratio == 2.4
    assert found.rate == found.flops / 0.5
    assert found.share == pytest.approx(0.5 / 6.0)
    state, idle, acting, updated, _ = results
    assert type(state) is type(PointMass().reset(jnp.zeros((3, 3)), jax.random.key(0)))
    assert type(idle) is type(acting) is Episode
    assert (idle.reward != acting.reward).all()
    assert isinstance(updated[0], Policy)
    assert sum(seconds for part, seconds in found.seconds.items() if part != "epoch") == 6.0


def test_the_limit_counts_forward_and_backward_products_of_every_weight(key):
    policy = make_policy(TASK, PointMass().spec, PointMass().action_space, key)
    weights = TASK.obs_size * 128 + 128 * 128 + 128 * 3
    flops, rate = attainable(policy, rows=6, steps=20)
    assert flops == 6 * 6 * 20 * weights
    assert rate > 0


def test_a_method_is_profiled_where_it_trains():
    assert isinstance(trained_in(HFHotStart(), SETUP), Crazyflow)
    once = trained_in(HybridOnce(), SETUP)
    assert [type(effect) for effect in once.effects] == [ResidualEffect]
    hybrid = trained_in(Hybrid(residual="affine", flights=2), SETUP)
    assert isinstance(hybrid, PointMass)
    assert [type(effect) for effect in hybrid.effects] == [ResidualEffect]
    varied = vary_around(with_effects(hybrid, [Delay(seconds=0.03)]), 0.5)
    assert isinstance(varied, Varied)
    assert frozen_weights(hybrid) == frozen_weights(varied) > 0
    assert frozen_weights(PointMass()) == 0


def test_a_method_without_a_trainer_is_refused():
    class Own(AbstractMethod):
        version = "1"
        parents = ()
        simulator = "point_mass"

        def train(self, setup, key, init=None):
            raise AssertionError("never called")

    with pytest.raises(NoTrainerError, match="no `trainer`"):
        trained_in(Own(), SETUP)


def test_the_shortest_of_several_calls_counts(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(
        "methods.running.profile.time", types.SimpleNamespace(perf_counter=lambda: clock[0])
    )
    lasting = iter([0.5, 3.0, 1.0, 2.0, *[4.0] * 100])  # the first one may compile

    def call():
        clock[0] += next(lasting)
        return jnp.zeros(())

    assert shortest(call) == 1.0


def test_the_command_prints_a_row_a_team_size(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    settings = ["--setting", "trainer.n_worlds=2"]
    assert main(["profile", "lf_baseline", "spread", "--team-size", "2", *settings]) == 0
    said = capsys.readouterr().out
    for word in ("drones", "backward", "limit", "memory", "Ratio: an epoch over its forward part"):
        assert word in said
    assert any(line.split()[:2] == ["2", "2"] for line in said.splitlines())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nix", "circle"], "No method is registered as 'nix'"),
        (["lf_baseline", "nix"], "No task is registered as 'nix'"),
        (["lf_baseline", "circle", "--team-size", "1"], "`n_drones` must be at least 2"),
        (["lf_baseline", "circle", "--setting", "trainer.nix=3"], "has no key 'nix'"),
    ],
)
def test_bad_input_is_one_line_and_status_2(capsys, arguments, message):
    assert main(["profile", *arguments]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
