"""A fresh policy hovers, where its vehicle can."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import SPEC, Hold

from methods.training.policy import LIFT, make_policy
from simulators.vehicle import GRAVITY, ActionSpace

TASK = Hold()


@pytest.mark.parametrize("mass", [SPEC.mass, 1.5])
def test_a_fresh_policy_commands_a_little_more_than_the_weight(mass):
    space = ActionSpace(thrust_max=SPEC.thrust_max / SPEC.mass * mass)
    policy = make_policy(TASK, dataclasses.replace(SPEC, mass=mass), space, jax.random.key(0))
    thrust = space.to_cmd(policy(jnp.zeros((1, TASK.obs_size))))[0, 3]
    excess = 0.5 * LIFT * space.thrust_max
    np.testing.assert_allclose(thrust, mass * GRAVITY + excess, rtol=5e-3)


def test_a_vehicle_that_cannot_take_off_is_refused():
    heavy = dataclasses.replace(SPEC, mass=0.2)
    with pytest.raises(ValueError, match=r"0\.2 kg cannot take off: at most 0\.8 N"):
        make_policy(TASK, heavy, ActionSpace(), jax.random.key(0))
