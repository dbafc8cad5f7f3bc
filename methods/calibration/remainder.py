"""Rows for a residual's fit from the flights of an identification.

Features and targets are those of Hybrid's calibration pool. Horizontal positions are drawn anew
within `ARENA`, because a few flights over one spot would let a residual take the place for the
cause.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

from methods.calibration.identification import along, fly, standing
from methods.calibration.pool import Calibration, TrackingFlight
from methods.calibration.residual_effect import features
from methods.residuals.contract import Transitions, command_history
from simulators.contract import AbstractSimulator
from simulators.vehicle import CONTROL_DT
from tasks.contact import onsets

ARENA = 10.0
"""Half the width of the square in which a team may be [m]; a choice."""


def remaining_transitions(
    corrected: AbstractSimulator, flights: TrackingFlight
) -> list[Transitions]:
    """Transitions of each flight whose target is the acceleration that `corrected` still lacks."""
    before, after = flights.before, flights.after
    predicted = along(corrected, flights)
    seen = eqx.tree_at(lambda f: (f.quat, f.thrust), before, (predicted.quat, predicted.thrust))
    transitions = []
    for i in range(len(flights.contact)):
        flight = jax.tree.map(lambda x, i=i: x[i, :, 0] if x.ndim > 2 else x[i], seen)
        rows = features(flight, corrected.spec.mass)
        where = jax.random.uniform(jax.random.key(i), (len(rows), 2), minval=-ARENA, maxval=ARENA)
        rows = rows.at[:, :2].set(where)
        target = (after.vel[i, :, 0] - predicted.vel[i, :, 0]) / CONTROL_DT
        # On the floor the floor's law holds, which no force reproduces.
        flying = ~np.asarray(standing(flights))[i]
        weight = jnp.ones(int(flying.sum()))
        cmds = command_history(corrected.action_space.to_cmd(flights.action[i, :, 0]))
        transitions.append(Transitions(rows[flying], target[flying], weight, cmds[flying]))
    return transitions


def calibrate_as_grey_box(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    key: PRNGKeyArray,
    n_flights: int,
    excitation: float,
) -> Calibration:
    """The calibration of a residual on the nominal simulator from a grey box's flights.

    `excitation` is the amplitude of their dither [-]. The tracking error is not known of them.
    """
    flights = fly(nominal, reality, key, n_flights, excitation)
    rows = remaining_transitions(nominal, flights)
    before, after = flights.before, flights.after
    left = np.asarray(after.pos - before.pos - CONTROL_DT * after.vel)
    return Calibration(
        transitions=jax.tree.map(lambda *x: jnp.concatenate(x), *rows),
        flights=n_flights,
        crashes=int(jnp.sum(onsets(flights.contact))),
        clipped_share=float(jnp.mean(flights.clipped)),
        tracking_error=float("nan"),
        pos_remainder=float(np.sqrt(np.mean(np.sum(left**2, axis=-1)))),
    )
