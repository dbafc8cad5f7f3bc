"""The contract of every registered effect, in every simulator that has its doors."""

import functools
import itertools
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    EFFECTS,
    HOVER,
    SIMULATORS,
    assert_near,
    attached,
    doors_of,
    fly,
    fly_from_rest,
    hold,
    hovering,
    positions,
    random_cmds,
)
from jax.flatten_util import ravel_pytree

from bench.conformance.effects import declarations
from bench.conformance.flights import demand_structure
from bench.conformance.suite import execute
from simulators.contract import MissingDoorError, with_effects
from simulators.effects import chain
from simulators.effects.clock_drift import ClockDrift
from simulators.effects.contract import DOORS, Number, StiffEffect, WrenchEffect, parameter
from simulators.effects.delay import Delay
from simulators.effects.late import LONGEST_DELAY_S

PAIRS = [
    (s, e) for s, e in itertools.product(SIMULATORS, EFFECTS) if doors_of(SIMULATORS[s], EFFECTS[e])
]
# Values inside the bounds at which every effect acts smoothly: the delay and the gust's onset lie
# between two whole steps of both simulators, and the floor lies above crazyflow's own, under a
# drone that sinks.
INTERIOR = {
    "attitude_gain": {"g": -0.1},
    "attitude_lag": {"tau": 0.03},
    "attitude_loop": {"natural_freq": 15.0, "damping": 0.7},
    "rotor_drag": {"axial": 0.7, "lateral": 0.4},
    "battery": {"rate": 0.008},
    "center_of_mass": {"x": 0.002, "y": -0.001},
    "collision": {
        **{"radius": 0.08, "clearance": 0.08, "stiffness": 500.0},
        **{"restitution": 0.6, "friction": 0.2},
    },
    "clock_drift": {"rate": 0.033},
    "delay": {"seconds": 0.033},
    "downwash": {"strength": 3.0, "width": 0.12},
    "drag": {"c": 1.3},
    "floor": {"height": 0.04},
    "ground_effect": {"c": 9.0},
    "gust": {"x": -0.9, "y": 1.3, "z": 0.5, "onset": 0.1633},
    "inertia": {"e": 0.3},
    "mass": {"e": 0.2},
    "motor_lag": {"scale": 1.4},
    "quadratic_drag": {"k": 0.6},
    "roll_pitch_gains": {"stiffness": 0.3, "damping": 0.4, "acceleration": -0.2, "roll": 0.1},
    "rotor_inertia": {"e": 0.4},
    "gyro_compensation": {"share": 0.65},  # half of what the inertia above needs
    "rotor_arm": {"e": 0.2},
    "rotor_torque": {"e": 0.6},
    "rotor_response": {"slowing": 1.5, "quadratic": 0.5},
    "thrust_gain": {"e": -0.1},
    "thrust_lag": {"up": 0.08, "down": 0.05},
    "trim": {"roll": 0.03, "pitch": -0.02},
    "translational_lift": {"k": 0.12},
    "voltage_sag": {"k": 0.3},
    "wind": {"x": 1.1, "y": -0.7, "z": 0.4},
    "yaw_gains": {"stiffness": 0.3, "integral": 0.5, "damping": 0.2},
    "frame_misalignment": {"angle": 0.2},
    "yaw_misalignment": {"angle": 0.2},
    "turbulence": {"wind": 5.0, "response": 0.6},
}
# Weights an integral that takes minutes to fill, far longer than these flights last; the gyroscopic
# torque of four rotors that turn in pairs against each other nearly cancels.
SLOW = {("yaw_gains", "integral"): 1e-3, ("gyro_compensation", "share"): 1e-1}
# Without effect at the neutral value by nature: while a gust has no force, its onset does not
# matter, and so on; drones without a radius do not touch; the loop's neutral frequency is infinite
# (see the test of 1 / frequency).
SILENT = {
    "attitude_loop": {"natural_freq", "damping"},
    "collision": {"radius", "clearance", "stiffness", "restitution", "friction"},
    "downwash": {"width"},
    "floor": {"height"},
    "gust": {"onset"},
    # Without wind there is no push; the air's own changes grow with the root of the wind.
    "turbulence": {"wind", "response"},
}
N, STEPS = 3, 50


# Floating-point rounding of one program compiled in two ways. On a processor there is none, because
# the environment's XLA options forbid fused multiply-adds; on an H200 positions were seen
# to differ by up to 1.2e-7 m.
ROUNDING = {"rtol": 0} if jax.default_backend() == "cpu" else {"rtol": 1e-5, "atol": 1e-6}


@pytest.mark.parametrize(
    ("simulator", "folded"), [("point_mass", False), ("point_mass", True), ("crazyflow", True)]
)
def test_all_neutral_effects_together_are_nominal_bit_for_bit(simulator, folded):
    """As arguments of the program, or as its constants, which the compiler may fold.

    On an accelerator to `ROUNDING`.
    """
    nominal = SIMULATORS[simulator]()
    every = with_effects(nominal, [EFFECTS[e]() for s, e in PAIRS if s == simulator])
    pos, cmds = positions(N), random_cmds(0, STEPS, N, yaw=0.3)

    def from_rest_and_restored(made, cmds):
        return fly_from_rest(made, pos, cmds), fly(made, hovering(made, pos), cmds)

    flown = functools.partial(from_rest_and_restored, every)
    flown = jax.jit(flown) if folded else flown
    assert_near(flown(cmds), from_rest_and_restored(nominal, cmds), **ROUNDING)


@pytest.mark.parametrize("effect", EFFECTS)
def test_it_says_what_it_is_and_its_default_is_neutral(effect):
    cls = EFFECTS[effect]
    assert [x for x in execute(cls, declarations(cls)) if x.problem] == []


def test_numbers_are_declared_once_and_an_effect_without_parameters_is_refused():
    class Pull(WrenchEffect):
        k: Number = parameter("N", 0.0, 2.0, source="a guess")
        version: ClassVar[str] = "1"

        def wrench(self, memory, flight, vehicle, dt):
            return None, self.k * flight.pos, flight.pos

    class Longer(Pull):
        tau: Number = parameter("s", 0.0, 1.0, 0.5, source="a guess")

    class Forgotten(WrenchEffect):
        k: Number = 0.0
        version: ClassVar[str] = "1"
        wrench = Pull.wrench

    assert [*Pull.parameters] == ["k"]
    assert [*Longer.parameters] == ["k", "tau"]
    assert (Longer(k=1).k.dtype, float(Longer().tau)) == (jnp.asarray(1).dtype, 0.5)
    with pytest.raises(TypeError, match="parameters"):
        Forgotten()


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_effects_keep_the_structure_and_types_of_the_state(simulator):
    made = attached(SIMULATORS[simulator](), **{e: INTERIOR[e] for s, e in PAIRS if s == simulator})
    demand_structure(made, "what all effects remember")


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_the_order_of_the_list_does_not_matter(simulator):
    effects = [EFFECTS[e](**INTERIOR[e]) for s, e in PAIRS if s == simulator]
    nominal = SIMULATORS[simulator]()
    forward, backward = with_effects(nominal, effects), with_effects(nominal, effects[::-1])
    one_by_one = nominal
    for effect in effects:
        one_by_one = with_effects(one_by_one, [effect])
    assert eqx.tree_equal(forward, backward)
    assert eqx.tree_equal(forward, one_by_one)
    doors = [DOORS.index(effect.door) for effect in forward.effects]
    assert doors == sorted(doors)


def test_the_canonical_text_does_not_depend_on_the_order():
    effects = [EFFECTS["wind"](x=1.5), EFFECTS["drag"](c=2.0)]
    text = "Drag(c=2); Wind(x=1.5, y=0, z=0)"
    assert chain.canonical(tuple(effects)) == chain.canonical(tuple(effects[::-1])) == text
    assert chain.canonical(()) == ""


def weight_of(path):
    """How much influence of a parameter is asked for, of the usual."""
    effect, parameter = (key.key for key in path)
    return SLOW.get((effect, parameter), 1.0)


def close_together(lowest):
    """A team within each other's downwash and the ground effect, from `lowest` [m] on."""
    return positions(N) * jnp.asarray([0.1, 0.1, 1.0]) - jnp.asarray([0.0, 0.0, 3.0 - lowest])


@pytest.mark.parametrize("simulator", SIMULATORS)
def test_derivatives_of_the_final_position_equal_finite_differences(simulator):
    """All effects act at once; drone 0 sinks onto the effect's floor, the others fly."""
    with jax.enable_x64(True):
        # A contact pushes harder than these differences resolve; test_collision has its slopes.
        names = [e for s, e in PAIRS if s == simulator and not issubclass(EFFECTS[e], StiffEffect)]
        pos = close_together(0.5).at[0, 2].set(0.058)
        cmds = random_cmds(0, 20, N).at[:, 0].multiply(jnp.asarray([1.0, 1.0, 1.0, 0.5]))
        flat, unravel = ravel_pytree({e: INTERIOR[e] for e in names})

        def final(parameters):
            made = attached(SIMULATORS[simulator](), **unravel(parameters))
            return fly(made, hovering(made, pos), cmds).pos[-1]

        # One program for values and derivatives: at the point itself, then h to either side.
        unit, h = jnp.eye(len(flat)), 1e-6
        points = jnp.concatenate([flat + step * unit for step in (0.0, h, -h)])
        tangents = jnp.concatenate([unit, unit, unit])
        both = jax.jit(jax.vmap(lambda p, t: jax.jvp(final, (p,), (t,))))(points, tangents)
        (_, plus, minus), (exact, _, _) = (jnp.split(x, 3) for x in both)
        numeric = (plus - minus) / (2 * h)
        assert exact.dtype == jnp.float64
        # Central differences err by h^2 and by rounding / h, both near 1e-9 here.
        np.testing.assert_allclose(exact, numeric, rtol=1e-5, atol=1e-7)
        labels = jax.tree_util.tree_leaves_with_path(unravel(flat))
        for (path, _), derivative in zip(labels, exact, strict=True):
            least = 1e-5 * weight_of(path)
            assert jnp.abs(derivative).max() > least, f"{path} has no influence"

        # Reverse mode: the same derivatives of one weighted sum, to 1e-7: crazyflow's clock counts
        # steps as int32, and a time made of it is single precision even here.
        weights = jnp.arange(1.0, 1.0 + 3 * N).reshape(N, 3)
        reverse = jax.jit(jax.grad(lambda p: jnp.sum(weights * final(p))))(flat)
        forward = jnp.sum(weights * exact, axis=(1, 2))
        np.testing.assert_allclose(reverse, forward, rtol=1e-6, atol=1e-8)


# `make test` has derivatives inside the bounds in crazyflow.
@pytest.mark.parametrize(
    "simulator", ["point_mass", pytest.param("crazyflow", marks=pytest.mark.exhaustive)]
)
def test_sensitivities_at_the_neutral_values_equal_one_sided_differences(simulator):
    """Where a parameter's bounds begin at its neutral value, only one side exists.

    All effects are attached and all are neutral. The screening of candidate effects stands on
    these derivatives, so none may vanish there.
    """
    with jax.enable_x64(True):
        names = [e for s, e in PAIRS if s == simulator]
        neutral = {e: {n: p.neutral for n, p in EFFECTS[e].parameters.items()} for e in names}
        loud = {
            e: {n: v for n, v in neutral[e].items() if n not in SILENT.get(e, ())} for e in names
        }
        flat, unravel = ravel_pytree(loud)
        labels = jax.tree_util.tree_leaves_with_path(loud)

        def travelled(parameters):
            values = {e: neutral[e] | p for e, p in unravel(parameters).items()}
            made = attached(SIMULATORS[simulator](), **values)
            return fly(made, hovering(made, close_together(0.1)), random_cmds(0, 20, N)).pos

        # Lags err by h / 2 ms, positions of 0.2 m over 200 steps by 1e-16 * 200 ** 0.5 / h.
        unit, h = jnp.eye(len(flat)), 1e-7
        points = jnp.concatenate([flat + h * unit, flat[None]])
        along = jax.jit(jax.vmap(lambda p, t: jax.jvp(travelled, (p,), (t,))))
        _, exact = along(jnp.broadcast_to(flat, unit.shape), unit)
        # The same program once more: another one would take longer to compile than to run.
        moved = jnp.concatenate([along(points[:-1], unit)[0], along(points[1:], unit)[0][-1:]])
        numeric = (moved[:-1] - moved[-1]) / h
        for (path, _), a, b in zip(labels, exact, numeric, strict=True):
            size = float(jnp.abs(b).max())
            assert size > 1e-5 * weight_of(path), f"{path} has no influence"
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-4 * size + 1e-7, err_msg=f"{path}")


def test_the_attitude_loop_has_a_sensitivity_to_the_inverse_of_its_frequency():
    """At 1 / natural_freq = 1e-8 s, beside the nominal 0: the neutral value itself is infinite."""
    with jax.enable_x64(True):
        nominal, cmds, a = SIMULATORS["point_mass"](), random_cmds(0, 20, N), 1e-8

        def travelled(inverse):
            made = attached(nominal, attitude_loop={"natural_freq": 1.0 / inverse})
            return fly_from_rest(made, positions(N), cmds).pos

        value, slope = jax.jvp(travelled, (a,), (1.0,))
        numeric = (value - fly_from_rest(nominal, positions(N), cmds).pos) / a
        assert jnp.abs(slope).max() > 0.1
        np.testing.assert_allclose(slope, numeric, rtol=1e-4, atol=1e-6)


def test_a_delay_shifts_the_commands_by_whole_steps():
    """The history of the restored flight is a hover, which is what arrives first."""
    cmds = random_cmds(0, STEPS, N)
    shifted = jnp.concatenate([hold([0, 0, 0, HOVER], 3, N), cmds[:-3]])
    nominal = SIMULATORS["point_mass"]()
    delayed = attached(nominal, delay={"seconds": 0.06})
    state = hovering(nominal, positions(N))
    flown = fly(delayed, hovering(delayed, positions(N)), cmds)
    np.testing.assert_allclose(flown.pos, fly(nominal, state, shifted).pos, atol=1e-5)
    assert jnp.abs(flown.pos - fly(nominal, state, cmds).pos).max() > 0.01


@pytest.mark.parametrize("duration", [0.004, 0.01, 0.02])
def test_a_delay_lasts_as_long_whatever_the_step(duration):
    """A thrust step in the point mass arrives 0.04 s later, to within one step."""
    simulator = attached(SIMULATORS["point_mass"](), delay={"seconds": 0.04})
    steps = round(0.1 / duration)
    cmds = hold([0, 0, 0, 1.2 * HOVER], steps)
    thrust = fly(simulator, hovering(simulator, positions(1)), cmds, duration).thrust[:, 0]
    middle = float(jnp.interp(1.1 * HOVER, thrust, duration * jnp.arange(1, steps + 1)))
    # u(t - d) with the command of a step acting from the step's start to its end.
    assert middle == pytest.approx(0.04 + duration, abs=0.011)


def test_a_missing_door_names_the_simulators_that_have_it():
    message = "AttitudeLoop .* 'response', .* 'crazyflow' does not have.* have it: point_mass"
    with pytest.raises(MissingDoorError, match=message):
        attached(SIMULATORS["crazyflow"](), attitude_loop={})


def test_a_delay_beyond_its_buffer_is_that_of_the_oldest_command():
    """The buffer reaches one step further than the longest delay, and is not extrapolated."""
    simulator, cmds = SIMULATORS["point_mass"](), random_cmds(0, 40, 1)
    flight = simulator.flight(hovering(simulator, positions(1)))
    effect = Delay(seconds=2.0 * LONGEST_DELAY_S)
    memory = effect.init(1, 0.01)
    step = jax.jit(lambda memory, cmd: effect.command(memory, flight, cmd, 0.01))
    for cmd in cmds:
        memory, late = step(memory, cmd)
    np.testing.assert_allclose(late, cmds[-len(memory[0])], atol=1e-6)


def test_a_drifting_clock_makes_a_ramp_less_steep():
    """U(t) = a t becomes u(t - r t) = (1 - r) a t."""
    simulator, slope = SIMULATORS["point_mass"](), jnp.asarray([[0.1, -0.2, 0.3, 0.4]])
    flight = simulator.flight(hovering(simulator, positions(1)))
    effect = ClockDrift(rate=0.05)
    memory = effect.init(1, 0.01)

    @jax.jit
    def step(memory, t):
        now = eqx.tree_at(lambda f: f.t, flight, t)
        return effect.command(memory, now, t * slope, 0.01)

    for t in 0.01 * jnp.arange(120):
        memory, late = step(memory, t)
        np.testing.assert_allclose(late, 0.95 * t * slope, atol=1e-6)
