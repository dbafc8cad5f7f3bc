"""One contract suite over every registered residual, and what each class must be able to fit."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import RESIDUALS

from bench.conformance.command import findings
from methods.residuals.affine import Affine
from methods.residuals.contract import (
    BOUND,
    HISTORY,
    Transitions,
    command_history,
    inputs,
    make_scale,
)
from methods.residuals.history import History
from methods.residuals.mlp import MLPEnsemble
from methods.residuals.sindy import TERMS, Sindy
from simulators.vehicle import GRAVITY

KEY = jax.random.key(5)
SIZE = np.array([2, 2, 2, 1.5, 1.5, 1.5, 0.4, 0.4, 0, 6, 6, 6])
"""Half the range of each feature: m, m/s, rad (yaw is always zero), m/s^2."""


def sample(n, seed=0):
    """Features that fill their range."""
    return jnp.asarray(np.random.default_rng(seed).uniform(-1, 1, (n, 12)) * SIZE, jnp.float32)


def transitions(x, y):
    history = jnp.zeros((len(x), HISTORY, 4))
    return Transitions(x, jnp.asarray(y, jnp.float32), jnp.ones(len(x)), history)


def of(model, x):
    """What a model makes of features, after idle commands if it looks at them."""
    return model(inputs(model, transitions(x, jnp.zeros((len(x), 3)))))


def bound(y):
    return BOUND * np.tanh(np.asarray(y) / BOUND)


def some_physics(x):
    """A little of everything, the same for all classes."""
    return np.asarray(-0.4 * x[:, 3:6] + 0.1 * x[:, 9:] + jnp.asarray([0.0, 0.3, -0.5]))


every_residual = pytest.mark.parametrize("name", sorted(RESIDUALS))


@every_residual
def test_it_keeps_the_contract(name):
    assert [x for x in findings("residual", RESIDUALS[name], {}, {}) if x.problem] == []


@every_residual
def test_a_linear_law_is_learned(name):
    known, x = sample(150), sample(200, seed=1)
    model = RESIDUALS[name]().fit(transitions(known, some_physics(known)), KEY)
    error = of(model, x) - some_physics(x)
    assert float(jnp.std(error)) < 0.25 * some_physics(x).std()


@every_residual
def test_a_huge_target_cannot_exceed_the_bound(name):
    x = sample(150)
    model = RESIDUALS[name]().fit(transitions(x, 1e3 * some_physics(x)), KEY)
    y = np.asarray(of(model, x))
    assert (np.abs(y) <= BOUND).all()
    assert np.abs(y).max() > 0.5 * BOUND


def test_an_affine_target_is_recovered_exactly():
    rng = np.random.default_rng(4)
    weight, x, fresh = rng.normal(size=(12, 3)) / 10, sample(300), sample(100, seed=6)
    model = Affine().fit(transitions(x, np.asarray(x) @ weight + [1.0, 0.0, -2.0]), KEY)
    expected = bound(np.asarray(fresh) @ weight + [1.0, 0.0, -2.0])
    np.testing.assert_allclose(model(fresh), expected, atol=1e-4)


def test_a_sparse_law_is_recovered_with_its_coefficients():
    """-0.5 v + 0.1 f_z e_z with f = nominal acceleration + g, and nothing else."""
    x = sample(400)
    force = np.asarray(x[:, 9:] + jnp.asarray([0.0, 0.0, GRAVITY]))
    y = -0.5 * np.asarray(x[:, 3:6])
    y[:, 2] += 0.1 * force[:, 2]
    model = Sindy().fit(transitions(x, y), KEY)
    expected = np.zeros((len(TERMS), 3))
    expected[[TERMS.index("v_x"), TERMS.index("v_y"), TERMS.index("v_z")], [0, 1, 2]] = -0.5
    expected[TERMS.index("f_z"), 2] = 0.1
    np.testing.assert_allclose(model.coefficients, expected, atol=2e-3)
    assert (np.asarray(model.coefficients)[expected == 0.0] == 0.0).all()


def test_quadratic_drag_is_told_from_linear_drag():
    x = sample(400)
    vel = np.asarray(x[:, 3:6])
    model = Sindy().fit(
        transitions(x, -0.3 * np.linalg.norm(vel, axis=1, keepdims=True) * vel), KEY
    )
    found = {term: np.asarray(row) for term, row in zip(TERMS, model.coefficients, strict=True)}
    assert found["s v_x"][0] == pytest.approx(-0.3, abs=0.01)
    assert found["v_x"][0] == pytest.approx(0.0, abs=0.01)


def smooth(x):
    """No class but a network can have this."""
    a, b = x[:, 3], x[:, 6] * 3.0
    return np.stack([np.sin(2 * a), a * b, np.tanh(a - b)], axis=-1)


def test_a_smooth_nonlinear_law_is_fitted_by_the_networks_alone():
    x, fresh = sample(500), np.asarray(sample(200, seed=7))
    errors = {}
    for fit in (MLPEnsemble(members=2, width=64, epochs=300, lr=5e-3, max_samples=5000), Affine()):
        model = fit.fit(transitions(x, smooth(np.asarray(x))), KEY)
        wrong = np.asarray(model(jnp.asarray(fresh))) - smooth(fresh)
        errors[type(fit)] = np.sqrt(np.mean(wrong**2)) / smooth(fresh).std()
    assert errors[MLPEnsemble] < 0.25
    assert errors[MLPEnsemble] < 0.5 * errors[Affine]


def test_features_are_clipped_at_five_standard_deviations():
    x = sample(150)
    scale = make_scale(x)
    far = jnp.full((1, 12), 1e4)
    np.testing.assert_allclose(scale(far)[0, :8], 5.0)
    np.testing.assert_allclose(scale.clipped(x), x, atol=1e-5)
    assert float(scale.std[8]) == 1.0  # yaw is constant


def test_a_law_of_the_last_commands_is_learned_by_the_history_alone():
    """The push of a rotor that lags by three steps, which no state tells."""
    rng = np.random.default_rng(8)
    cmd = jnp.asarray(rng.uniform(0.2, 0.6, (600, 4)), jnp.float32)
    history, x = command_history(cmd), sample(600)
    y = jnp.concatenate([jnp.zeros((600, 2)), 20.0 * (history[:, 1, 3:] - history[:, 4, 3:])], 1)
    rows = Transitions(x, y, jnp.ones(600), history)
    known, fresh = (jax.tree.map(lambda a, s=s: a[s], rows) for s in (slice(400), slice(400, 600)))
    left = {}
    for kind in (History, MLPEnsemble):
        model = kind(members=2, width=64).fit(known, KEY)
        error = model(inputs(model, fresh)) - fresh.target
        left[kind] = float(jnp.sqrt(jnp.mean(error[:, 2] ** 2)) / jnp.std(fresh.target[:, 2]))
    assert left[History] < 0.5
    assert left[MLPEnsemble] > 0.8


def test_a_history_starts_with_idle_commands_and_ends_with_that_of_the_step():
    cmd = jnp.arange(28.0).reshape(7, 4)
    history = np.asarray(command_history(cmd))
    np.testing.assert_array_equal(history[0], [*np.zeros((HISTORY - 1, 4)), cmd[0]])
    np.testing.assert_array_equal(history[6], cmd[2:7])


def test_a_history_that_was_not_recorded_is_asked_for():
    rows = Transitions(sample(20), jnp.zeros((20, 3)), jnp.ones(20))
    with pytest.raises(ValueError, match="last 5 commands of each row, got None"):
        History().fit(rows, KEY)
