"""Policies of a method's own architecture: stored by structure, loaded and deployed again."""

import dataclasses

import broken_plugins as own
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from outcomes import make_template, outcome, plan

from bench.execution import policies
from bench.execution.policies import keep, kept_policy
from bench.store.record import STRUCTURE, load_policy, policy_bytes
from bench.store.store import Store, UnreadableRunError
from bench.store.structure import describe, rebuild
from methods.training.policy import AbstractPolicy, is_shared
from tasks.spread import Spread

TASK = Spread(n_drones=2)
KEY = jax.random.key(2)


class Stacked(AbstractPolicy):
    """Layers of several kinds, with settings, in containers."""

    parts: list
    settings: tuple

    def __call__(self, obs):
        for part in self.parts:
            obs = jax.vmap(part)(obs)
        return obs


def stacked():
    one, two = jax.random.split(KEY)
    layers = [
        eqx.nn.LayerNorm(TASK.obs_size),
        eqx.nn.Linear(TASK.obs_size, 8, use_bias=False, key=one),
        eqx.nn.Lambda(jax.nn.relu),
        eqx.nn.MLP(8, 3, 4, 1, activation=jax.nn.swish, final_activation=jnp.tanh, key=two),
    ]
    return Stacked(layers, (0.5, "hover", None, True))


def arrays(tree):
    return [np.asarray(x) for x in jax.tree.leaves(eqx.filter(tree, eqx.is_array))]


def test_a_policy_is_the_same_after_its_structure_was_text(tmp_path):
    policy = stacked()
    again = rebuild(describe(policy), arrays(policy))
    assert eqx.tree_equal(again, policy)
    obs = jax.random.normal(KEY, (2, TASK.obs_size))
    np.testing.assert_array_equal(again(obs), policy(obs))


def test_the_structure_of_the_shared_policy_is_not_stored(tmp_path):
    """So that its files stay what they were, and outlive a change of its class."""
    for policy, stored in ((make_template(), False), (own.linear(TASK), True)):
        path = tmp_path / "policy.npz"
        path.write_bytes(policy_bytes(policy))
        with np.load(path, allow_pickle=False) as found:
            assert (STRUCTURE in found.files) == stored
        assert eqx.tree_equal(load_policy(path, make_template(seed=5)), policy)


def test_a_shared_policy_of_another_width_is_not_the_shared_one():
    shared = make_template()
    net = eqx.nn.MLP(
        TASK.obs_size, 3, 64, 2, activation=jnp.tanh, final_activation=jnp.tanh, key=KEY
    )
    assert is_shared(shared)
    assert not is_shared(dataclasses.replace(shared, net=net))
    assert not is_shared(own.linear(TASK))


@pytest.mark.parametrize(
    ("value", "said"),
    [
        (lambda x: x, r"policy.squash is <function .*cannot be found by name"),
        ({1, 2}, "policy.squash is a set, which cannot be stored"),
    ],
)
def test_what_cannot_be_stored_is_named(value, said):
    policy = own.linear(TASK)
    object.__setattr__(policy, "squash", value)
    with pytest.raises(TypeError, match=said):
        describe(policy)


def test_a_structure_that_does_not_fit_is_refused():
    policy = own.linear(TASK)
    text, found = describe(policy), arrays(policy)
    for bad, given, said in (
        (text, [], "cannot be rebuilt"),
        (text, found * 2, "more arrays"),
        (text, [found[0].T], "has the shape"),
        ("{}", found, "cannot be rebuilt"),
        (text.replace("broken_plugins:Linear", "json:loads"), found, "no equinox module"),
    ):
        with pytest.raises(ValueError, match=said):
            rebuild(bad, given)
    with pytest.raises(ImportError):
        rebuild(text.replace("broken_plugins", "not_installed_here"), found)


def test_a_run_and_what_is_kept_of_it_hold_the_policy_of_its_own_architecture(
    plugins, tmp_path, monkeypatch
):
    monkeypatch.setattr(policies, "runs_to_resume", set)
    run, store, policy = plan().runs[0], Store(tmp_path), own.linear(TASK, 4)
    store.commit(run, outcome(run, policy=policy))
    assert eqx.tree_equal(store.trained(run.name, make_template()).policy, policy)
    store.tables(store.sound(print), {run.name}).save(store.directory)
    keep(store.directory, (), ())
    assert eqx.tree_equal(kept_policy(store.directory, TASK, "spread", run.name), policy)


def test_a_policy_whose_package_is_gone_is_said(tmp_path):
    path = tmp_path / "policy.npz"
    found = {"000": arrays(own.linear(TASK))[0]}
    text = describe(own.linear(TASK)).replace("broken_plugins", "not_installed_here")
    np.savez(path, allow_pickle=False, **found, **{STRUCTURE: np.asarray(text)})
    with pytest.raises(UnreadableRunError, match="No module named 'not_installed_here'"):
        load_policy(path, make_template())
