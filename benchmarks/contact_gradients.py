"""Gradients through an impact of two balls: ours and MJX's, over places within two steps.

    python -m benchmarks.contact_gradients

One ball at 1 m/s hits another at rest. The derivative of the velocity that the other is left with,
by the first one's velocity and by the distance, averaged over 24 distances; by the distance it is 0
in truth, because neither of them feels anything before they touch.
"""

import sys
import warnings

import equinox as eqx
import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from mujoco import mjx

from simulators.algebra.impacts import Balls, Surface, damping_of, push

MASS, RADIUS, SECONDS = 0.0434, 0.15, 0.15
LINEAR = (20000.0, 60.0)
STEPS = (2e-3, 5e-4, 1e-4)


def ours(vel, distance, dt):
    """Velocity that the other ball is left with."""
    made = Surface(
        *(jnp.asarray(x) for x in (RADIUS, 0.0, 2000.0)),
        damping_of(jnp.asarray(0.7)),
        jnp.asarray(0.0),
    )
    pos = jnp.zeros((3, 2)).at[0, 1].set(2 * RADIUS + distance)
    start = jnp.zeros((3, 2)).at[0, 0].set(vel)
    balls = Balls(pos, start, jnp.zeros((3, 2)), jnp.full(2, 1 / MASS), jnp.zeros((3, 3, 2)))

    def step(now, _):
        vel = now.vel + dt * now.inverse_mass * push(now, made, dt)[0]
        pos = now.pos + 0.5 * dt * (now.vel + vel)
        return eqx.tree_at(lambda b: (b.pos, b.vel), now, (pos, vel)), None

    return jax.lax.scan(step, balls, length=round(SECONDS / dt))[0].vel[0, 1]


def make_mjx(dt):
    contact = f'solref="{-LINEAR[0]} {-LINEAR[1]}" solimp="0.9999 0.9999 0.001 0.5 2" condim="1"'
    ball = f'<geom type="sphere" size="{RADIUS}" mass="{MASS}" {contact}/>'
    body = f'<joint type="slide" axis="1 0 0"/>{ball}'
    model = mjx.put_model(
        mujoco.MjModel.from_xml_string(
            f'<mujoco><option timestep="{dt}" gravity="0 0 0" iterations="1" ls_iterations="4"/>'
            f'<worldbody><body>{body}</body><body pos="{2 * RADIUS} 0 0">{body}</body></worldbody>'
            "</mujoco>"
        )
    )

    def left(vel, distance):
        data = mjx.make_data(model)
        data = data.replace(
            qvel=jnp.asarray([1.0, 0.0]) * vel, qpos=jnp.asarray([0.0, 1.0]) * distance
        )
        step = lambda data, _: (mjx.step(model, data), None)  # noqa: E731
        return jax.lax.scan(step, data, length=round(SECONDS / dt))[0].qvel[1]

    return left


def write(line):
    sys.stdout.write(f"{line}\n")


def main():
    jax.config.update("jax_enable_x64", True)
    write(
        "| step [ms] | code | second ball's velocity [m/s] | derivative by speed [-] "
        "| derivative by distance, rms [1/s] |"
    )
    write("|---|---|---|---|---|")
    for dt in STEPS:
        places = 0.005 + jnp.linspace(0.0, 2.0 * dt, 25)[:-1]
        for name, left in (("ours", lambda v, d, dt=dt: ours(v, d, dt)), ("MJX", make_mjx(dt))):
            found = jax.jit(jax.vmap(jax.value_and_grad(left, (0, 1)), in_axes=(None, 0)))
            value, (by_vel, by_distance) = found(jnp.asarray(1.0), places)
            rms = float(np.sqrt(np.mean(np.square(by_distance))))
            print(  # noqa: T201
                f"| {1e3 * dt:g} | {name} | {value.mean():.4f} | {by_vel.mean():.3f} | {rms:.3f} |"
            )


if __name__ == "__main__":
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        main()
