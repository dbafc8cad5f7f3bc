"""What the folder of a run holds, and back."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from outcomes import outcome, plan

from bench.store.record import load_arrays, run_files
from methods.residuals.contract import HISTORY, Transitions, blank, inputs
from simulators import registry


def test_a_stored_residual_comes_back_as_the_model_it_was(tmp_path, plugins):
    """Of every class: stored, and loaded into a blank one."""
    rng = np.random.default_rng(0)
    rows = Transitions(
        features=jnp.asarray(rng.normal(size=(80, 12)), jnp.float32),
        target=jnp.asarray(rng.normal(size=(80, 3)), jnp.float32),
        weight=jnp.ones(80),
        history=jnp.asarray(rng.normal(size=(80, HISTORY, 4)), jnp.float32),
    )
    for name, kind in registry.load_all("residual").items():
        template = blank(kind())
        model = jax.tree.map(lambda x: 1.5 * x if eqx.is_inexact_array(x) else x, template)
        path, left = tmp_path / f"{name}.npz", outcome(plan().runs[0])
        trained = dataclasses.replace(left.trained, residual=model)
        path.write_bytes(run_files(dataclasses.replace(left, trained=trained))["residual.npz"])
        restored = load_arrays(path, template)
        np.testing.assert_array_equal(restored(inputs(model, rows)), model(inputs(model, rows)))
