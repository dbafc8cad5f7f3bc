r"""Calibrate once: three flights of one drone, and the named effects that they show.

The paths depend on no task or team size; dither and measurement noise are drawn from a key, so that
every seed of a training has flights of its own. Each begins on the floor, rotors standing, as every
episode does; the PD controller then tracks a path of its own, a dither on its actions:

    rise     steps of height              thrust lag, thrust gain
    steps    steps along x and y          attitude loop, delay, trim
    turns    two sines, ever faster       drag, which needs speed

A step of size s at time t_k is the critically damped s (1 - exp(-r) (1 + r)), r = (t - t_k) / T.

The rows from when the drone moves are diagnosed (`diagnosis`): candidate sets of the whole library
are refitted in the simulator in which policies will be trained, at its step, and compared by
evidence, twice: first as if all that is left were noise, then with how far the flights disagree
about what that choice leaves; of sets that this cannot tell apart the best fit is taken. What is
logged carries the noise of motion capture; `SIGMA` weighs what no point mass can reproduce, too.

The semi-implicit Euler of the point mass applies a force at the end of the step in which it arises,
so it is half a step ahead of the reality; a delay of half a step is put in before anything is
fitted, and counted with what delay is found. Without it, thrust lags come out too long and too far
ahead at high frequency, and a policy trained that way can reach gains at which it oscillates.

A floor has no slope and is no candidate: it is where the drone stood while its produced thrust,
the identified lag included, was below its weight.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Key, PRNGKeyArray

from diagnosis.fit.equations import dispersion
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.search import Fits, search
from diagnosis.logs.flights import DroneLog, FlightLog
from diagnosis.logs.segments import cut
from diagnosis.replay.library import Library, make_library
from diagnosis.replay.replay import make_replay
from methods.calibration.pool import MEMBER, TrackingFlight, track_dithered
from methods.calibration.reference_paths import ReferencePath
from methods.training.meter import billed
from simulators import registry
from simulators.algebra.rotation import quat_to_rpy, rpy_to_quat
from simulators.contract import AbstractSimulator, replayable, with_effects
from simulators.drawn.drawn_team import one_member
from simulators.effects.contract import AbstractEffect, OnsetEffect
from simulators.effects.delay import Delay
from simulators.effects.floor import Floor
from simulators.effects.late import LONGEST_DELAY_S
from simulators.flight import Flight
from simulators.vehicle import CONTROL_DT
from tasks.contact import onsets

SECONDS = 10.0
"""Length of a flight [s]; with three, 0.5 fleet-minutes."""
NOISE_POS, NOISE_VEL, NOISE_ATTITUDE = 1e-3, 1e-2, 3e-3
"""Standard deviations of what is logged [m, m/s, rad]: white, of the size of motion capture, as in
the flights of `bench blind`. crazyflow itself adds no sensor noise."""
SIGMA = np.asarray([1e-2] * 3 + [1e-2] * 3 + [1e-2] * 3)
"""Size of what may stay unexplained: 1 cm (a semi-implicit Euler step of 0.01 s is off by half of
it times the change of velocity), 1 cm/s, 10 mrad (yaw couples into tilt); a choice."""
DITHER = 0.2
"""Amplitude of the dither on the actions [-], as in Hybrid's calibration flights."""
HELD = 5
"""Control steps for which each of its values is held, half of Hybrid's: it must shake up to the
frequencies at which a height loop of high gain would begin to oscillate; a choice."""
MOVING = 0.05
"""Speed from which a drone counts as flying [m/s]; a choice."""
SETTLING = 0.1
"""Time after that which is left out, because the rotors spin up otherwise than they run [s]."""
EQUAL = 2.0
"""Sets whose log evidence differs by less count as equally likely [nats]; a choice."""
HARD_TO_TELL = ("rotor_drag",)
"""No candidates, unless all are asked for: a point mass can hardly tell drag of the rotors, which
acts along the axis too, from the way in which thrust follows its command."""
PATHS = ("rise", "steps", "turns")
"""Names of the paths, in the order in which they are flown."""
_HEIGHT = 1.2
_RISE = ((2.0, 0.5), (3.0, -0.5), (4.0, -0.3), (4.7, 0.6), (5.6, -0.6), (6.4, 0.7), (7.6, -0.4))
_STEPS_X = ((1.5, 0.8), (3.0, -0.8), (4.0, -0.6), (5.5, 1.0), (7.0, -0.8), (8.5, 0.6))
_STEPS_Y = ((2.2, -0.8), (3.5, 0.8), (4.6, 0.6), (6.2, -1.0), (7.4, 0.8), (8.9, -0.6))


@dataclasses.dataclass(frozen=True)
class Identification:
    """What the flights show."""

    flights: TrackingFlight
    """The flights, leading axes flights and control steps."""
    effects: tuple[AbstractEffect, ...]
    """Identified effects of the nominal simulator, by name."""
    notes: dict[str, float]
    """Every parameter as effect.parameter, and the fit's chi-square per degree of freedom."""

    @property
    def n_flights(self) -> int:
        """How many were flown."""
        return len(self.flights.contact)

    @property
    def crashes(self) -> int:
        """Crashes of the drone."""
        return int(jnp.sum(onsets(self.flights.contact)))


def identify(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    dt: float,
    largest: int,
    key: PRNGKeyArray,
    n_flights: int = len(PATHS),
    excitation: float = DITHER,
    all_candidates: bool = False,
) -> Identification:
    """At most `largest` named effects, and a floor, that `nominal` lacks; flown in `reality`.

    `dt` is the integration step of `nominal` [s]; `key` draws dither and noise; `excitation` is the
    amplitude of the dither [-]; `all_candidates` tries those of `HARD_TO_TELL`, too.

    Raises:
        ValueError: A drone never left the ground.
    """
    flights = fly(nominal, reality, key, n_flights, excitation)
    names = [f"{name} {i + 1}" for i, name in enumerate(flown_paths(n_flights))]
    logs = [_log(nominal, flights, i, name) for i, name in enumerate(names)]
    excluded = _no_candidates() if all_candidates else [*HARD_TO_TELL, *_no_candidates()]
    library = make_library(with_effects(nominal, [Delay(dt / 2)]), exclude=excluded)
    likelihood = Likelihood(make_replay(library, dt), cut(logs, dt), SIGMA)
    fit = choose(likelihood, len(logs), largest)
    found: dict[str, dict[str, Any]] = {
        name: library.named(fit.total, name) for name in sorted(fit.effects)
    }
    # What ended where it does nothing would only cost time.
    found = {name: values for name, values in found.items() if _acts(library, name, values)}
    late = found.get("delay", {"seconds": 0.0})["seconds"] + dt / 2
    found["delay"] = {"seconds": min(late, LONGEST_DELAY_S)}
    effects: tuple[AbstractEffect, ...] = tuple(
        library.effects[name](**values) for name, values in sorted(found.items())
    )
    height = floor_height(with_effects(nominal, effects), flights)
    if height is not None:
        found["floor"] = {"height": height}
        effects = (*effects, Floor(jnp.asarray(height)))
    notes = {f"{name}.{p}": value for name, values in found.items() for p, value in values.items()}
    notes["identification_chi2"] = fit.normal.chi2 / float(fit.normal.dof.sum())
    return Identification(flights=flights, effects=effects, notes=notes)


def _no_candidates() -> list[str]:
    """Effects that are not identified: those that set in at a moment of one flight."""
    kinds = registry.load_all("effect").items()
    return [name for name, kind in kinds if issubclass(kind, OnsetEffect)]


def _acts(library: Library, name: str, values: Mapping[str, float]) -> bool:
    """Whether an effect does anything at these values.

    An effect whose neutral value is infinite does nothing beyond its bounds. A fit can end there.
    A training draws the value anew within the bounds, and would add an effect that nothing showed.
    """
    parameters = library.effects[name].parameters
    if endless := [p for p, info in parameters.items() if np.isinf(info.neutral)]:
        return any(parameters[p].low <= values[p] <= parameters[p].high for p in endless)
    return any(values[p] != info.neutral for p, info in parameters.items())


def choose(likelihood: Likelihood, n_flights: int, largest: int) -> Fit:
    """The best fit among the sets of effects whose evidence is near the highest.

    Evidence is weighed by how much the flights differ.

    A diagnosis prefers fewer names; a training prefers the better fit of two equally likely sets.
    """
    fits = search(Fits.of(Evidence.of(likelihood)), largest)
    fits = search(fits.weighed(dispersion(fits.best.normal, n_flights)), largest)
    least = fits.below_best(EQUAL)
    likely = [fit for fit in fits.ranked() if fits.evidence.log_evidence(fit) > least]
    return min(likely, key=lambda fit: fit.objective)


def flown_paths(n_flights: int) -> list[str]:
    """Names of the paths of `n_flights` flights; one alone moves fast along all axes.

    More flights than paths begin anew with the first path.
    """
    return ["turns"] if n_flights == 1 else [PATHS[i % len(PATHS)] for i in range(n_flights)]


def fly(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    key: PRNGKeyArray,
    n_flights: int = len(PATHS),
    excitation: float = DITHER,
) -> TrackingFlight:
    """Flights, as they are logged, with a dither of amplitude `excitation` [-] on the actions."""
    dither_key, noise_key = jax.random.split(key)
    known = paths()
    chosen = [known[name] for name in flown_paths(n_flights)]
    references = jax.tree.map(lambda *x: jnp.stack(x), *chosen)
    n_steps = references.pos.shape[1]
    shape = (n_flights, -(-n_steps // HELD), 1, 3)
    drawn = jax.random.uniform(dither_key, shape, minval=-1.0)
    dither = excitation * jnp.repeat(drawn, HELD, axis=1)[:, :n_steps]
    bare = one_member(billed(reality, n_flights * n_steps), jax.random.fold_in(key, MEMBER))
    keys = jax.random.split(jax.random.fold_in(key, MEMBER + 1), n_flights)
    return logged(_fly(nominal, bare, references, dither, keys), noise_key)


def logged(flights: TrackingFlight, key: PRNGKeyArray) -> TrackingFlight:
    """`flights` with noise on position, velocity and attitude; a state is logged once.

    What stands `before` a step is what stood `after` the one before it.
    """
    n_flights, n_steps, n_drones, _ = flights.before.pos.shape
    drawn = jax.random.normal(key, (3, n_flights, n_steps + 1, n_drones, 3))

    def noisy(flight: Flight, steps: slice) -> Flight:
        pos, vel, turn = drawn[:, :, steps]
        rpy = quat_to_rpy(flight.quat) + NOISE_ATTITUDE * turn
        values = (flight.pos + NOISE_POS * pos, flight.vel + NOISE_VEL * vel, rpy_to_quat(rpy))
        return eqx.tree_at(lambda f: (f.pos, f.vel, f.quat), flight, values)

    before, after = noisy(flights.before, slice(None, -1)), noisy(flights.after, slice(1, None))
    return eqx.tree_at(lambda f: (f.before, f.after), flights, (before, after))


@eqx.filter_jit
def _fly(
    nominal: AbstractSimulator,
    reality: AbstractSimulator,
    references: ReferencePath,
    dither: Float[Array, "flights time 1 3"],
    keys: Key[Array, " flights"],
) -> TrackingFlight:
    def one(reference: ReferencePath, dither: Array, key: PRNGKeyArray) -> TrackingFlight:
        return track_dithered(nominal, reality, reference, "filtered", dither, key)

    return jax.vmap(one)(references, dither, keys)


def paths() -> dict[str, ReferencePath]:
    """The paths, by name."""
    t = np.arange(round(SECONDS / CONTROL_DT) + 1) * CONTROL_DT
    lift = _step(t, 0.0, 0.4)
    rise = np.stack([0.3 * np.sin(1.3 * t), 0.3 * np.sin(0.9 * t), _HEIGHT * lift], axis=1)
    rise[:, 2] += sum(size * _step(t, at, 0.15) for at, size in _RISE)
    x, y = (sum(s * _step(t, at, 0.22) for at, s in steps) for steps in (_STEPS_X, _STEPS_Y))
    phase = 2.0 * np.pi * (0.12 * t + 0.013 * t**2)
    turns = [
        0.9 * np.sin(phase),
        0.6 * (np.sin(1.5 * phase + 1.0) - np.sin(1.0)),
        _HEIGHT + 0.2 * np.sin(2.0 * t),
    ]
    found = {
        "rise": rise,
        "steps": np.stack([x, y, _HEIGHT * lift], axis=1),
        "turns": np.stack(turns, axis=1) * lift[:, None],
    }
    return {name: _reference(pos) for name, pos in found.items()}


def _step(t: Float[np.ndarray, " time"], at: float, width: float) -> Float[np.ndarray, " time"]:
    r = np.maximum(t - at, 0.0) / width
    return 1.0 - np.exp(-r) * (1.0 + r)


def _reference(pos: Float[np.ndarray, "time 3"]) -> ReferencePath:
    vel = np.gradient(pos, CONTROL_DT, axis=0)
    acc = np.diff(vel, axis=0) / CONTROL_DT
    return ReferencePath(*(jnp.asarray(x, float) for x in (pos[:-1], vel[:-1], acc)))


def _log(nominal: AbstractSimulator, flights: TrackingFlight, i: int, name: str) -> FlightLog:
    """One flight as a log, from when the drone flies."""
    before = jax.tree.map(lambda x: np.asarray(x[i], float), flights.before)
    cmd = np.asarray(jax.vmap(nominal.action_space.to_cmd)(flights.action[i])[:, 0], float)
    on_floor = int(np.asarray(standing(flights))[i].sum())
    if on_floor == len(cmd):
        raise ValueError(f"In calibration flight '{name}' the drone never left the ground.")
    rows = slice(on_floor + round(SETTLING / CONTROL_DT), None)
    quat = before.quat[:, 0]
    flips = np.sign(np.sum(quat[1:] * quat[:-1], axis=-1))
    quat = quat * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
    log = DroneLog(
        t=np.arange(len(cmd))[rows] * CONTROL_DT,
        pos=before.pos[rows, 0],
        vel=before.vel[rows, 0],
        quat=quat[rows],
        cmd=cmd[rows],
    )
    return FlightLog(name, (log,))


def standing(flights: TrackingFlight) -> Bool[Array, "flights time"]:
    """Rows in which a drone has not moved yet: those before the first above `MOVING`."""
    moving = jnp.linalg.norm(flights.before.vel[:, :, 0], axis=-1) > MOVING
    return ~jax.lax.cummax(moving.astype(int), axis=1).astype(bool)


def floor_height(simulator: AbstractSimulator, flights: TrackingFlight) -> float | None:
    """Height [m] of a floor that flights stood on and `simulator` lacks; None without one."""
    predicted = along(simulator, flights)
    fall = np.asarray(predicted.vel[..., 2] - flights.before.vel[..., 2]) < -0.01
    rest = np.asarray(flights.after.pos[..., 2])[fall & np.asarray(standing(flights))[..., None]]
    return float(np.median(rest)) if rest.size >= 2 else None


@eqx.filter_jit
def along(simulator: AbstractSimulator, flights: TrackingFlight) -> Flight:
    """The flight one step of `simulator` after every row.

    Position and velocity are those of the flight before the step; attitude, thrust and what else
    the simulator remembers run along on the flown actions.

    Raises:
        TypeError: `simulator` is not `Replayable`.
    """
    placed = replayable(simulator).with_motion

    def one(flight: TrackingFlight) -> Flight:
        def step(state: Any, row: TrackingFlight) -> tuple[Any, Flight]:
            state = placed(state, row.before.pos, row.before.vel)
            state = simulator.step(state, row.action)
            return state, simulator.flight(state)

        start = simulator.reset(flight.before.pos[0], jax.random.key(0))
        return jax.lax.scan(step, start, flight)[1]

    return jax.vmap(one)(flights)
