"""What each effect does, against its own closed form."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flying import (
    DT,
    HOVER,
    OWN_DRAG,
    SIMULATORS,
    SPEC,
    assert_near,
    attached,
    both,
    fly,
    fly_from_rest,
    hold,
    hover_flight,
    hovering,
    positions,
    random_cmds,
    restore,
)

from simulators.algebra.rotation import body_z, rpy_to_quat
from simulators.crazyflow import _template
from simulators.crazyflow_params import hover_rotor_vel

STEPS, H, G = 50, 0.02, 9.81
T = H * np.arange(1, STEPS + 1)
LEVEL = hold([0.0, 0.0, 0.0, HOVER], STEPS)


def disturbed(name, **effects):
    """A simulator with some of these effects; all are attached, so that it is one program."""
    neutral = {key: {} for key in ("thrust_gain", "battery", "quadratic_drag", "gust")}
    return attached(SIMULATORS[name](), **neutral | effects)


def hovering_flight(simulator, cmds=LEVEL, vel=None):
    pos = positions(cmds.shape[1])
    vel = jnp.zeros_like(pos) if vel is None else vel
    return fly(simulator, hovering(simulator, pos, vel), cmds)


def first_acceleration(simulator, pos):
    """Acceleration [m/s^2] in the first integration step of a hover at `pos`."""
    dt, pos = DT[simulator.name], jnp.asarray(pos)
    state = hovering(simulator, pos)
    return fly(simulator, state, hold([0.0, 0.0, 0.0, HOVER], 1, len(pos)), dt).vel[0] / dt


def coasting(rate, time):
    """The integral of exp(-rate t) from 0 to `time`."""
    return time if rate == 0 else (1 - np.exp(-rate * time)) / rate


@both
def test_thrust_gain_scales_thrust_and_lifts_a_hovering_drone(name):
    """dv/dt = e g - c0 v at the thrust that would carry the nominal drone."""
    flight = hovering_flight(disturbed(name, thrust_gain={"e": 0.1}))
    np.testing.assert_allclose(flight.thrust, 1.1 * HOVER, rtol=1e-4)
    expected = 0.1 * G * coasting(OWN_DRAG[name][2], T)
    np.testing.assert_allclose(flight.vel[:, 0, 2], expected, rtol=2e-3)


@both
def test_a_battery_runs_down_linearly(name):
    """Thrust (1 - rate t) of hover; dv/dt = -rate g t - c0 v, Euler errs by g rate h t / 2."""
    rate, c0 = 0.008, OWN_DRAG[name][2]
    flight = hovering_flight(disturbed(name, battery={"rate": rate}))
    np.testing.assert_allclose(flight.thrust[:, 0] / HOVER, 1 - rate * T, atol=rate * H + 1e-5)
    fall = T**2 / 2 if c0 == 0 else (T - coasting(c0, T)) / c0
    error = G * rate * DT[name] * T / 2
    assert (np.abs(flight.vel[:, 0, 2] + G * rate * fall) <= 1.01 * error + 2e-5).all()


@both
def test_thrust_follows_the_voltage_that_was_told_or_else_a_falling_one(name):
    """Thrust (1 - k (4.2 V - V)) of hover; untold, V falls by 0.4 V a minute."""
    made = attached(SIMULATORS[name](), voltage_sag={"k": 0.3})
    falling = hovering_flight(made).thrust[:, 0] / HOVER
    np.testing.assert_allclose(falling, 1 - 0.3 * 0.4 * T / 60, atol=1e-4)
    state = hovering(made, positions(1))
    state = eqx.tree_at(lambda s: s.memory[0], state, made.effects[0].at_voltage(jnp.asarray(3.7)))
    told = fly(made, state, LEVEL).thrust[:, 0] / HOVER
    np.testing.assert_allclose(told, 1 - 0.3 * 0.5, rtol=1e-4)


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_an_off_centre_mass_turns_a_hovering_drone_as_its_inertia_allows(e):
    """First step, before any rotor has reacted: J dw/dt = (-y, x, 0) thrust."""
    x, y, dt = 0.002, -0.001, 0.002
    effects = {"center_of_mass": {"x": x, "y": y}, "inertia": {"e": e}}
    made = attached(SIMULATORS["crazyflow"](), **effects)
    flight = fly(made, hovering(made, positions(1)), LEVEL[:1], dt)
    torque = HOVER * np.asarray([-y, x])
    expected = dt * torque / (np.asarray(SPEC.inertia[:2]) * (1 + e))
    np.testing.assert_allclose(flight.ang_vel[0, 0, :2], expected, rtol=1e-3)


def test_rotors_end_up_balancing_an_off_centre_mass():
    """In the steady tilt that the controller leaves, the rotors' torque is (y, -x, 0) thrust."""
    x, y = 0.002, -0.001
    made = attached(SIMULATORS["crazyflow"](), center_of_mass={"x": x, "y": y})

    @eqx.filter_jit
    def settled(state):
        return made.step_cmd(state, LEVEL[0], 2.0)

    state = settled(hovering(made, positions(1)))
    params = _template(SPEC.name, made.freq)[0].params
    curve = np.squeeze(np.asarray(params.rpm2thrust))
    thrusts = np.polyval(curve[::-1], np.asarray(state.rotor_vel[0], np.float64))
    mixed = np.squeeze(np.asarray(params.mixing_matrix)) @ (thrusts * np.squeeze(params.L))
    np.testing.assert_allclose(state.ang_vel[0], 0.0, atol=1e-3)
    expected = thrusts.sum() * np.asarray([y, -x])
    np.testing.assert_allclose(mixed[:2], expected, rtol=5e-3)


@pytest.mark.parametrize("target", [0.8, 1.2])
@pytest.mark.parametrize("scale", [0.5, 2.0])
def test_motor_lag_stretches_the_rotors_response_in_time(scale, target):
    """The time at which half of a step of the thrust is done, up and down."""
    cmds = hold([0.0, 0.0, 0.0, target * HOVER], 600)

    def half_time(made):
        thrust = fly(made, hovering(made, positions(1)), cmds, 0.002).thrust[:, 0]
        done = (thrust / HOVER - 1.0) / (target - 1.0)
        return float(jnp.interp(0.5, done, 0.002 * jnp.arange(1, 601)))

    nominal = SIMULATORS["crazyflow"]()
    ratio = half_time(attached(nominal, motor_lag={"scale": scale})) / half_time(nominal)
    assert ratio == pytest.approx(scale, rel=0.03)


@eqx.filter_jit
def stepped(simulator, state, cmd):
    return simulator.step_cmd(state, cmd, 0.002)


@pytest.mark.parametrize(("target", "coef"), [(0.8, 2), (1.2, 0)])
def test_rotors_without_a_quadratic_part_follow_exponentially(target, coef):
    """Explicit Euler of W' = (W_cmd - W) / tau, tau twice that of hover where they slow down."""
    made = attached(SIMULATORS["crazyflow"](), rotor_response={"slowing": 2.0, "quadratic": 0.0})
    state = hovering(made, positions(1))
    cmd = jnp.asarray([[0.0, 0.0, 0.0, target * HOVER]])
    data, _ = _template(SPEC.name, made.freq)
    start = state.rotor_vel[0, 0]
    end = hover_rotor_vel(data, jnp.asarray([[target * HOVER]]))[0, 0, 0]
    linear, square = data.params.rotor_dyn_coef[0, coef : coef + 2]
    rate = linear + 2.0 * square * start
    rate = rate / 2.0 if coef else rate
    for n in range(1, 60):
        state = stepped(made, state, cmd)
        left = (1.0 - 0.002 * rate) ** n
        np.testing.assert_allclose(state.rotor_vel[0], end + left * (start - end), rtol=2e-5)


def test_rotors_that_swing_lose_or_gain_thrust_by_the_law_they_follow():
    """Swings of 20 % around hover: nominal rotors, up faster than down, gain; slower up, lose."""
    swings = jnp.where(jnp.arange(600) // 10 % 2, 1.2, 0.8)[:, None, None] * hold(
        [0.0, 0.0, 0.0, HOVER], 600
    )

    def mean(**effects):
        made = attached(SIMULATORS["crazyflow"](), **effects)
        thrust = fly(made, hovering(made, positions(1)), swings, 0.002).thrust[100:, 0]
        return float(thrust.mean() / HOVER)

    fast_up, fast_down = (mean(rotor_response={"slowing": s}) for s in (2.0, 0.5))
    assert fast_down < mean() - 0.005 < mean() + 0.005 < fast_up


@both
def test_quadratic_drag_slows_a_coasting_drone(name):
    """v' = -c0 v - k v^2, solved by 1 / v = (1 / v0 + k / c0) exp(c0 t) - k / c0."""
    k, speed, c0 = 0.6, 2.0, OWN_DRAG[name][0]
    vel = jnp.zeros((1, 3)).at[:, 0].set(speed)
    flown = hovering_flight(disturbed(name, quadratic_drag={"k": k}), vel=vel).vel[:, 0, 0]
    slope = T if c0 == 0 else (np.exp(c0 * T) - 1) / c0
    expected = 1 / (np.exp(c0 * T) / speed + k * slope)
    np.testing.assert_allclose(flown, expected, rtol=1.2 * DT[name] + 1e-3)


@pytest.mark.parametrize("onset", [0.0, 0.4, 0.4133, 0.6])
def test_a_gust_starts_at_its_onset_to_a_fraction_of_a_step(onset):
    """In the point mass v = a (t - onset), exactly, at every multiple of the step."""
    acc = {"x": 1.2, "y": -0.8, "z": 0.3}
    vel = hovering_flight(disturbed("point_mass", gust=acc | {"onset": onset})).vel[:, 0]
    after = np.clip(T - onset, 0, None)[:, None]
    np.testing.assert_allclose(vel, after * [*acc.values()], atol=2e-5)


def test_a_gust_hits_crazyflow_at_its_onset():
    """v = a / c0 (1 - exp(-c0 (t - onset))), the onset between two physics steps."""
    onset, c0 = 0.4133, OWN_DRAG["crazyflow"][0]
    made = disturbed("crazyflow", gust={"x": 1.5, "onset": onset})
    expected = 1.5 * coasting(c0, np.clip(T - onset, 0, None))
    np.testing.assert_allclose(hovering_flight(made).vel[:, 0, 0], expected, rtol=2e-3, atol=1e-5)


@both
@pytest.mark.parametrize("height", [0.01, 0.0231, 0.05, 0.5])
def test_the_ground_effect_at_a_height(name, height):
    """Acceleration c g (r / 4 h)^2 at hover thrust, no more than at h = r."""
    c, r = 11.4, 0.0231
    acc = first_acceleration(attached(SIMULATORS[name](), ground_effect={"c": c}), [[0, 0, height]])
    expected = c * G * (r / (4 * max(height, r))) ** 2
    np.testing.assert_allclose(acc[0, 2], expected, rtol=2e-3, atol=5e-4)


@both
def test_the_ground_effect_acts_along_the_body(name):
    nominal = SIMULATORS[name]()
    made = attached(nominal, ground_effect={"c": 10.0})
    quat = rpy_to_quat(jnp.asarray([[0.2, -0.3, 0.0]]))
    flight = eqx.tree_at(lambda f: f.quat, hover_flight(jnp.asarray([[0.0, 0.0, 0.1]])), quat)
    cmds = hold([0.2, -0.3, 0.0, HOVER], STEPS)

    def velocity(simulator):
        return fly(simulator, restore(simulator, flight, cmds), cmds[:1], DT[name]).vel[0, 0]

    extra = np.asarray(velocity(made) - velocity(nominal))
    np.testing.assert_allclose(extra / np.linalg.norm(extra), body_z(quat)[0], atol=2e-3)


@both
@pytest.mark.parametrize(
    ("offset", "share"),
    [
        ((0.0, 0.0, 0.5), 1.0),
        ((0.06, -0.08, 0.5), np.exp(-0.5)),
        ((0.0, 0.2, 2.0), np.exp(-2.0)),
        ((0.0, 0.0, 0.025), 0.5),
    ],
)
def test_downwash_pushes_the_lower_of_two_drones(name, offset, share):
    """-strength exp(-d^2 / 2 width^2); half of it half way through the gate of 5 cm."""
    made = attached(SIMULATORS[name](), downwash={"strength": 4.0, "width": 0.1})
    low = np.asarray([0.3, -0.2, 2.0])
    acc = first_acceleration(made, [low, low + offset])
    np.testing.assert_allclose(acc[0, 2], -4.0 * share, rtol=2e-3)
    np.testing.assert_allclose(acc[1], 0.0, atol=2e-3)


@both
def test_the_downwash_of_two_drones_adds_up_and_one_alone_feels_none(name):
    nominal = SIMULATORS[name]()
    made = attached(nominal, downwash={"strength": 2.0, "width": 0.1})
    acc = first_acceleration(made, [[0.0, 0.0, 3.0], [0.0, 0.0, 2.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(acc[:, 2], [0.0, -2.0, -4.0], atol=5e-3)
    alone, free = hovering_flight(made), hovering_flight(nominal)
    assert_near(alone, free, rtol=0)


@pytest.mark.parametrize("tau", [0.05, 0.2])
def test_attitude_lag_answers_a_step_like_a_first_order_lag(tau):
    """c (1 - a^k) with the documented a; c (1 - exp(-t / tau)) as the step h shrinks."""
    nominal = SIMULATORS["point_mass"](attitude_tau=1e-6)
    cmds = hold([-0.2, 0.3, 0.1, HOVER], STEPS)
    made = attached(nominal, attitude_lag={"tau": tau})
    quat = fly(made, hovering(made, positions(1)), cmds).quat[:, 0]
    t = tau * (tau + H / 2) / (tau + H)
    done = 1 - (t / (t + H)) ** np.arange(1, STEPS + 1)
    rpy = np.stack([-0.2 * done, 0.3 * done, 0.1 * done], axis=-1)
    np.testing.assert_allclose(quat, rpy_to_quat(jnp.asarray(rpy)), atol=1e-5)

    fine = attached(
        SIMULATORS["point_mass"](attitude_tau=1e-6, dt=0.001), attitude_lag={"tau": tau}
    )
    pitch = 2 * np.arcsin(
        fly(fine, hovering(fine, positions(1)), hold([0, 0.3, 0, HOVER], STEPS)).quat[:, 0, 1]
    )
    # The factor is exp(-h / tau) to second order in h / tau.
    np.testing.assert_allclose(pitch, 0.3 * (1 - np.exp(-T / tau)), atol=0.06 * 0.001 / tau)


def test_attitude_lag_is_warmed_up_by_the_commands_before():
    """A flight restored after 0.5 s goes on as it was; without a warm-up it would start level."""
    made, cut = attached(SIMULATORS["point_mass"](), attitude_lag={"tau": 0.06}), 25
    cmds = random_cmds(2, STEPS, 1)
    whole = hovering_flight(made, cmds=cmds)
    record = jax.tree.map(lambda x: x[cut - 1], whole)
    rest = fly(made, restore(made, record, cmds[:cut]), cmds[cut:])
    np.testing.assert_allclose(rest.pos, whole.pos[cut:], atol=5e-5)


TURN = jax.scipy.linalg.block_diag(
    jnp.asarray([[jnp.cos(0.3), jnp.sin(0.3)], [-jnp.sin(0.3), jnp.cos(0.3)]]), jnp.eye(2)
)
"""Turns roll and pitch of a command, as a row, by 0.3 rad."""

ON_COMMANDS = {
    "attitude_gain": ({"g": -0.1}, lambda cmd: cmd * jnp.asarray([0.9, 0.9, 1.0, 1.0])),
    "trim": ({"roll": 0.03, "pitch": -0.02}, lambda cmd: cmd + jnp.asarray([0.03, -0.02, 0, 0])),
    "frame_misalignment": ({"angle": 0.3}, lambda cmd: cmd @ TURN),
    "yaw_misalignment": ({"angle": 0.2}, lambda cmd: cmd + jnp.asarray([0, 0, 0.2, 0])),
}
"""Effects that change the angles of a command, and what each makes of it."""


@both
@pytest.mark.parametrize("effect", ON_COMMANDS)
def test_an_effect_on_the_command_flies_as_the_changed_command(name, effect):
    nominal, (parameters, change) = SIMULATORS[name](), ON_COMMANDS[effect]
    cmds, state = random_cmds(1, STEPS, 2, yaw=0.3), hovering(nominal, positions(2))
    made = attached(nominal, **{e: {} for e in ON_COMMANDS} | {effect: parameters})
    flown = fly(made, hovering(made, positions(2)), cmds)
    expected = fly(nominal, state, change(cmds))  # rotors warmed up by a hover know no angles
    np.testing.assert_allclose(flown.pos, expected.pos, atol=2e-5)
    assert jnp.abs(flown.pos - fly(nominal, state, cmds).pos).max() > 0.002


@pytest.mark.parametrize(("target", "tau"), [(1.3, 0.08), (0.7, 0.05)])
def test_thrust_lag_rises_and_falls_with_its_own_time_constants(target, tau):
    """T_0 + (T - T_0) (1 - (tau / (tau + h))^k) at every step, from a steady hover."""
    made = attached(SIMULATORS["point_mass"](), thrust_lag={"up": 0.08, "down": 0.05})
    cmds = hold([0.0, 0.0, 0.0, target * HOVER], STEPS)
    thrust = hovering_flight(made, cmds=cmds).thrust[:, 0] / HOVER
    done = 1 - (tau / (tau + H)) ** np.arange(1, STEPS + 1)
    np.testing.assert_allclose(thrust, 1 + (target - 1) * done, atol=1e-5)


def test_thrust_lag_starts_with_standing_rotors_after_a_reset():
    made = attached(SIMULATORS["point_mass"](), thrust_lag={"up": 0.08})
    thrust = fly_from_rest(made, positions(1), LEVEL).thrust[:, 0] / HOVER
    done = 1 - (0.08 / 0.1) ** np.arange(1, STEPS + 1)
    np.testing.assert_allclose(thrust, done, atol=1e-5)


AIR = {
    "drag": {"c": 1.0},
    "quadratic_drag": {"k": 1.0},
    "rotor_drag": {"axial": 1.0, "lateral": 0.5},
    "translational_lift": {"k": 0.2},
    "wind": {"x": 1.0},
    "gust": {"x": 1.0, "onset": 0.0},
}
"""Effects of the air, and values at which each acts."""


@pytest.mark.parametrize("effect", AIR)
def test_a_payload_does_not_change_the_force_of_the_air(effect):
    """The acceleration that the air adds falls as 1 / (1 + e) with the mass."""
    vel = jnp.asarray([[2.0, 0.5, 0.7]])

    def flown(e, **effects):
        effects = {name: {} for name in AIR} | effects | {"mass": {"e": e}}
        return hovering_flight(attached(SIMULATORS["crazyflow"](), **effects), vel=vel).vel[0, 0]

    def pushed(e):
        return np.asarray(flown(e, **{effect: AIR[effect]}) - flown(e))

    np.testing.assert_allclose(pushed(0.5), pushed(0.0) / 1.5, rtol=0.1, atol=1e-5)


def test_a_payload_does_not_change_the_force_of_a_downwash():
    pos = np.asarray([[0.0, 0.0, 1.0], [0.0, 0.0, 1.5]])

    def pushed(e):
        plain, below = (
            first_acceleration(
                attached(SIMULATORS["crazyflow"](), downwash=downwash, mass={"e": e}), pos
            )
            for downwash in ({}, {"strength": 2.0, "width": 0.1})
        )
        return float((below - plain)[0, 2])

    assert pushed(0.0) < -1.0
    assert pushed(0.5) == pytest.approx(pushed(0.0) / 1.5, rel=1e-3)
