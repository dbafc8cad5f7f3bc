r"""Calibration flights: stages 1 and 2 of the paper's pipeline, and the residual's targets.

1. A low-fidelity policy is rolled out in the low-fidelity simulator. Flight i of the pool takes
   role i mod N of an episode of its own; accelerations are exact differences of velocity.
2. One isolated drone tracks that reference in reality under the PD controller. Where reality is
   drawn anew for each drone, one member of the team flies all of them.
3. Each transition of that flight is compared with one nominal step from the same position and
   velocity under the same command: target = (v' - v) / dt - a_nominal. Where the nominal simulator
   has effects or takes several steps, a_nominal is what that step does to the velocity.

Two readings of "attitude" in the features and in a_nominal, the paper leaves it open:

- `measured`: the nominal lag starts from the attitude that the drone has.
- `filtered`: the nominal lag runs along the flight on the same commands. This is what a policy
  will meet in the corrected simulator, whose attitude is never set to a measured one.

Excitation. On a tracked path position, velocity and command hang together, so a flexible residual
can predict the acceleration from where the drone is instead of from what was commanded; in the
corrected simulator a policy's actions then hardly matter. A dither on the actions (uniform, held
for 0.2 s, zero mean) takes that dependence apart. The paper has none.
"""

import dataclasses
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Key, PRNGKeyArray

from methods.calibration.reference_paths import ReferencePath, team_reference
from methods.calibration.residual_effect import features
from methods.residuals.contract import Transitions, command_history
from methods.training.meter import billed
from methods.training.policy import AbstractPolicy, PolicyController
from simulators.contract import AbstractSimulator, replayable
from simulators.drawn.drawn_team import one_member
from simulators.flight import Flight
from simulators.tracking import PDTracker
from simulators.vehicle import CONTROL_DT
from tasks.contact import in_contact, onsets
from tasks.contract import AbstractTask

Attitude = Literal["filtered", "measured"]

HOVER_SPEED = 0.2
"""Speed below which a transition counts as near hover [m/s]; a choice."""
DITHER_STEPS = 10
"""Control steps for which each value of the dither is held; a choice."""
MEMBER = 1_000_033
"""What is folded into the key of calibration flights to draw the member of the team that flies."""
DRAWN = MEMBER + 2
"""What is folded into the key of one flight to draw what its simulators draw."""
_BATCH = 64


def pool_size(n_drones: int) -> int:
    """Flights in the calibration pool of a team; paper, Sec. V-A."""
    return 60 * (n_drones + 1)


class TrackingFlight(eqx.Module):
    """A flight, one row per control step: one drone on a reference or a team on its task."""

    before: Flight
    """The drone before the step."""
    after: Flight
    """The drone after the step."""
    nominal_quat: Float[Array, "*time drones 4"]
    """Attitude after one step of the nominal simulator."""
    nominal_thrust: Float[Array, "*time drones"]
    """Thrust of that step [N]."""
    nominal_vel: Float[Array, "*time drones 3"]
    """Velocity after it [m/s]; from the drone's own motion only if the nominal is `refined`."""
    action: Float[Array, "*time drones 3"]
    """What was flown, within [-1, 1]."""
    clipped: Bool[Array, "*time drones"]
    """Whether controller and dither asked for more than that."""
    contact: Bool[Array, "*time drones"]
    """Whether the drone touched the floor."""


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Result of the calibration flights."""

    transitions: Transitions
    """Rows for the residual's fit."""
    flights: int
    """How many were flown."""
    crashes: int
    """Crashes of the isolated drone."""
    clipped_share: float
    """Share of actions that had to be clipped."""
    tracking_error: float
    """Mean distance to the reference [m]."""
    pos_remainder: float
    """RMS of p' - (p + dt v'), which no correction of acceleration can reproduce [m]."""


def calibrate(
    task: AbstractTask,
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    policy: AbstractPolicy,
    key: PRNGKeyArray,
    n_flights: int,
    attitude: Attitude,
    hover_weight: float,
    excitation: float,
) -> Calibration:
    """Flies `n_flights` single-drone references of `policy` in `reality`.

    `excitation` is the amplitude of the dither on the actions [-], see the top of this module.

    `hover_weight` is the extra weight of a transition at rest, falling as
    exp(-|v|^2 / (2 HOVER_SPEED^2)).
    """
    role = jnp.arange(n_flights) % task.n_drones
    keys = jax.random.split(key, n_flights)
    bare = billed(reality, n_flights * task.horizon)
    bare = one_member(bare, jax.random.fold_in(key, MEMBER))
    references, flights = _fly(task, nominal, bare, policy, attitude, excitation, keys, role)
    before, after = flights.before, flights.after
    remainder = after.pos - before.pos - CONTROL_DT * after.vel
    error = jnp.linalg.norm(before.pos[:, :, 0] - references.pos, axis=-1)
    return Calibration(
        transitions=transitions_of(flights, nominal, hover_weight),
        flights=n_flights,
        crashes=int(jnp.sum(onsets(flights.contact))),
        clipped_share=float(jnp.mean(flights.clipped)),
        tracking_error=float(jnp.mean(error)),
        pos_remainder=float(np.sqrt(np.mean(np.sum(np.asarray(remainder) ** 2, axis=-1)))),
    )


def transitions_of(
    flights: TrackingFlight, nominal: AbstractSimulator, hover_weight: float
) -> Transitions:
    """Rows of flights from a reset: flight by flight, step by step, drone by drone.

    `hover_weight` as for `calibrate`.
    """
    before, after = flights.before, flights.after
    seen = eqx.tree_at(
        lambda f: (f.t, f.quat, f.thrust),
        before,
        (before.t[..., None], flights.nominal_quat, flights.nominal_thrust),
    )
    flat = jax.tree.map(lambda x: x.reshape(-1, *x.shape[3:]), seen)
    x = features(flat, nominal.spec.mass)
    change = (after.vel - before.vel).reshape(-1, 3) / CONTROL_DT
    foreseen = x[:, 9:]
    if refined(nominal):
        foreseen = (flights.nominal_vel - before.vel).reshape(-1, 3) / CONTROL_DT
    speed = jnp.linalg.norm(before.vel.reshape(-1, 3), axis=-1)
    weight = 1.0 + hover_weight * jnp.exp(-0.5 * (speed / HOVER_SPEED) ** 2)
    return Transitions(x, change - foreseen, weight, _histories(flights, nominal))


def refined(nominal: AbstractSimulator) -> bool:
    """Whether a nominal step does more to a velocity than its thrust and gravity say.

    Where it does not, the features hold its acceleration, from which committed runs were fitted.
    """
    return bool(nominal.effects) or getattr(nominal, "dt", CONTROL_DT) < CONTROL_DT


def tracked(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    states: tuple[Any, Any],
    before: Flight,
    action: Float[Array, "drones 3"],
    clipped: Bool[Array, " drones"],
) -> tuple[tuple[Any, Any], TrackingFlight]:
    """The states of reality and of a nominal lag after an action in the flight `before`, and both.

    If it is `refined`, the nominal simulator starts from the motion of the flight.
    """
    state, shadow = states
    if refined(nominal):  # else only its attitude and thrust are looked at
        shadow = replayable(nominal).with_motion(shadow, before.pos, before.vel)
    shadow, state = nominal.step(shadow, action), reality.step(state, action)
    after, lagged = reality.flight(state), nominal.flight(shadow)
    return (state, shadow), TrackingFlight(
        before=before,
        after=after,
        nominal_quat=lagged.quat,
        nominal_thrust=lagged.thrust,
        nominal_vel=lagged.vel,
        action=action,
        clipped=clipped,
        contact=in_contact(after.pos, after.t),
    )


def _histories(
    flights: TrackingFlight, nominal: AbstractSimulator
) -> Float[Array, "samples steps 4"]:
    """The last commands up to each row."""

    def one(action: Float[Array, "time drones 3"]) -> Float[Array, "time drones steps 4"]:
        cmd = jax.vmap(nominal.action_space.to_cmd)(action)
        return jax.vmap(command_history, in_axes=1, out_axes=1)(cmd)

    found = jax.vmap(one)(flights.action)
    return found.reshape(-1, *found.shape[3:])


@eqx.filter_jit
def _fly(
    task: AbstractTask,
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    policy: AbstractPolicy,
    attitude: Attitude,
    excitation: float,
    keys: Key[Array, " flights"],
    roles: Int[Array, " flights"],
) -> tuple[ReferencePath, TrackingFlight]:
    def one(args: tuple[PRNGKeyArray, Array]) -> tuple[ReferencePath, TrackingFlight]:
        key, role = args
        reference = make_reference(task, nominal, policy, key, role)
        return reference, track(nominal, reality, reference, attitude, excitation, key)

    return jax.lax.map(one, (keys, roles), batch_size=_BATCH)


def make_reference(
    task: AbstractTask,
    nominal: AbstractSimulator,
    policy: AbstractPolicy,
    key: PRNGKeyArray,
    role: Array,
) -> ReferencePath:
    """The path of one role in a low-fidelity episode, from the spawn to the last step but one."""
    team = team_reference(task, nominal, PolicyController(task, policy), key)
    return jax.tree.map(lambda x: x[:, role], team)


def track(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    reference: ReferencePath,
    attitude: Attitude,
    excitation: float,
    key: PRNGKeyArray,
) -> TrackingFlight:
    """One isolated drone tracks a reference in `reality`, a nominal lag running along.

    `excitation` is the amplitude of the dither on the actions [-].
    """
    n_steps = len(reference.pos)
    drawn = jax.random.uniform(key, (-(-n_steps // DITHER_STEPS), 1, 3), minval=-1.0)
    dither = excitation * jnp.repeat(drawn, DITHER_STEPS, axis=0)[:n_steps]
    return track_dithered(nominal, reality, reference, attitude, dither, key)


def track_dithered(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    reference: ReferencePath,
    attitude: Attitude,
    dither: Float[Array, "time 1 3"],
    key: PRNGKeyArray,
) -> TrackingFlight:
    """A flight as `track` flies it, with a given dither [-]."""
    tracker = PDTracker(mass=reality.spec.mass, action_space=reality.action_space)
    start = reference.pos[:1]

    def step(carry: tuple, inputs: tuple[ReferencePath, Array]) -> tuple[tuple, TrackingFlight]:
        (state, shadow), (target, dither) = carry, inputs
        before = reality.flight(state)
        action, clipped = tracker.action(
            reality.sensed(state), target.pos[None], target.vel[None], target.acc[None]
        )
        asked = action + dither
        clipped = clipped | jnp.any(jnp.abs(asked) > 1.0, axis=-1)
        action = jnp.clip(asked, -1.0, 1.0)
        if attitude == "measured":
            history = nominal.action_space.to_cmd(action)[None]
            shadow = nominal.restore(before, history, key)
        return tracked(nominal, reality, (state, shadow), before, action, clipped)

    # The reference was drawn from `key`; effects that draw numbers must not repeat it.
    drawn = jax.random.fold_in(key, DRAWN)
    carry = (reality.reset(start, drawn), nominal.reset(start, drawn))
    return jax.lax.scan(step, carry, (reference, dither))[1]
