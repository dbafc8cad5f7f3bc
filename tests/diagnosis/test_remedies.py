"""What a diagnosis changes in an autopilot, and the next flight within a geofence."""

import dataclasses

import diagnoses_for_tests as made
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from diagnosis.decide.advice import pair_to_separate
from diagnosis.remedies.changes import firmware_changes, without_parameter
from diagnosis.remedies.flight_paths import GENERAL, PATHS
from diagnosis.remedies.trajectory import LOWEST, MARGIN, PIECES, Geofence, Trajectory, plan
from diagnosis.result import Effect, Parameter
from simulators import registry
from simulators.effects.card import load_cards, manoeuvre_path

UPSIDE = Rotation.from_euler("x", np.pi)
"""From forward, left, up to forward, right, down."""


def parameter(name, value, low=None, high=None, use="measured"):
    return Parameter(name=name, value=value, low=low, high=high, unit="-", at_bound="no", use=use)


def found(name, *parameters, aliases=(), verdict="effect", reference=False):
    """A diagnosis that names one effect."""
    base = made.load(made.reference() if reference else made.effect())
    effect = Effect(
        name=name, blamed=True, probability=0.99, aliases=aliases, parameters=parameters
    )
    return dataclasses.replace(base, verdict=verdict, effects=(effect,))


def test_the_thrust_that_a_path_asks_for_is_that_of_its_accelerations():
    coefficients = np.zeros((1, 4, 8))
    coefficients[0, [0, 2], 2] = 0.5 * 3.0, 0.5 * 2.0  # 3 m/s^2 along x and 2 upwards
    flight = Trajectory("made here", 1.0, np.asarray([1.0]), coefficients)
    assert flight.top_thrust == pytest.approx(np.hypot(3.0, 9.81 + 2.0) / 9.81, rel=1e-3)


def amounts(diagnosis, autopilot):
    return {
        name: change.amount
        for change in firmware_changes(diagnosis, autopilot)
        for name in change.parameters
    }


def test_a_heavier_vehicle_needs_more_thrust_to_hover_by_the_same_factor():
    (change,) = firmware_changes(found("mass", parameter("e", 0.1, 0.09, 0.12)), "px4")
    assert (change.parameters, change.how) == (("MPC_THR_HOVER",), "times")
    assert (change.amount, change.low, change.high) == pytest.approx((1.1, 1.09, 1.12))
    assert change.of(0.5) == pytest.approx(0.55)
    assert not change.descriptive


def test_weaker_rotors_need_more_command_by_the_inverse_factor_ends_in_order():
    diagnosis = found("thrust_gain", parameter("e", -0.2, -0.25, -0.15))
    (change,) = firmware_changes(diagnosis, "px4")
    assert change.amount == pytest.approx(1 / 0.8)
    assert (change.low, change.high) == pytest.approx((1 / 0.85, 1 / 0.75))


def test_the_believed_mass_is_what_a_controller_should_hold():
    diagnosis = found("mass", parameter("e", 0.1))
    (mass, *_) = firmware_changes(diagnosis, "crazyflie")
    assert mass.parameters == ("ctrlMel.mass",)
    assert mass.of(mass.was) == pytest.approx(1.1 * diagnosis.flights.mass)
    assert (mass.low, mass.high) == (None, None)


def test_gains_of_two_loops_are_undone_together_and_only_to_fly_as_before():
    sizes = [parameter("stiffness", 0.5, 0.4, 0.6), parameter("damping", 0.25, 0.2, 0.3)]
    sizes.append(parameter("roll", -0.3, -0.4, -0.2))  # all gains of roll, so not their ratio
    assert not firmware_changes(found("roll_pitch_gains", *sizes), "px4")
    before = found("roll_pitch_gains", *sizes, reference=True)
    assert amounts(before, "px4") == pytest.approx(
        {
            "MC_ROLL_P": 1.25 / 1.5,
            "MC_PITCH_P": 1.25 / 1.5,
            "MC_ROLLRATE_K": 1 / (1.25 * 0.7),
            "MC_PITCHRATE_K": 1 / 1.25,
        }
    )
    both = firmware_changes(before, "px4")[0]
    below = np.hypot(np.log(1.6 / 1.5), np.log(1.25 / 1.2))
    assert np.log(both.low) == pytest.approx(np.log(both.amount) - below)


@pytest.mark.parametrize(
    ("effect", "sizes", "board"),
    [
        # Where the autopilot believes to hold zero, the drone leans or looks by the effect's size.
        ("trim", {"roll": 0.02, "pitch": -0.03}, lambda v: Rotation.from_euler("xy", v).inv()),
        # The board's axes are turned in the drone by the effect's size, and tilts with them.
        ("frame_misalignment", {"angle": 0.05}, lambda v: Rotation.from_euler("z", v[0])),
    ],
)
def test_a_boards_offsets_undo_how_it_is_turned(effect, sizes, board):
    """PX4 turns measured vectors by its offsets, a Crazyflie by the inverse of its Euler angles."""
    diagnosis = found(effect, *(parameter(name, value) for name, value in sizes.items()))
    turned = board(list(sizes.values()))  # from the board's axes to the drone's, z up
    px4, crazyflie = amounts(diagnosis, "px4"), amounts(diagnosis, "crazyflie")
    offsets = [px4.get(f"SENS_BOARD_{axis}_OFF", 0.0) for axis in "XYZ"]
    wanted = UPSIDE * turned * UPSIDE
    assert (Rotation.from_euler("xyz", offsets, degrees=True).inv() * wanted).magnitude() < 1e-3
    angles = [crazyflie.get(f"imu_sensors.imu{name}", 0.0) for name in ("Phi", "Theta", "Psi")]
    passive = Rotation.from_euler("xyz", angles, degrees=True).inv()
    assert (passive.inv() * turned).magnitude() < 1e-3


def test_a_change_waits_for_an_alias_that_another_parameter_makes_up_for():
    diagnosis = found("mass", parameter("e", 0.1), aliases=("thrust_gain",))
    (hover,) = firmware_changes(diagnosis, "px4")
    assert (hover.alike, hover.waits_for) == (("thrust_gain",), ())
    waits = {c.parameters[0]: c.waits_for for c in firmware_changes(diagnosis, "crazyflie")}
    assert waits["posCtlPid.thrustBase"] == ()
    assert waits["ctrlMel.mass"] == waits["ctrlLee.mass"] == ("thrust_gain",)
    fading = found("mass", parameter("e", 0.1), aliases=("battery",))
    assert firmware_changes(fading, "px4")[0].waits_for == ("battery",)


def test_a_world_that_is_turned_is_mended_by_no_turn_of_the_board():
    """Heading and tilt turn together; a board's turn mends one and leaves the other."""
    turned = Rotation.from_euler("z", 0.2) * (asked := Rotation.from_euler("ZY", [0.5, 0.3]))
    mended = turned * Rotation.from_euler("z", -0.2)
    up = [r.apply([0.0, 0.0, 1.0])[:2] for r in (asked, turned, mended)]
    assert np.allclose(up[1], up[2])
    assert not np.allclose(up[0], up[2], atol=0.01)
    for autopilot in ("px4", "crazyflie"):
        diagnosis = found("yaw_misalignment", parameter("angle", 0.2))
        assert firmware_changes(diagnosis, autopilot) == ()
        assert without_parameter(diagnosis, autopilot) == ("yaw_misalignment",)


def test_a_parameter_changes_alike_only_where_both_changes_hold_on_the_same_vehicle():
    diagnosis = found("frame_misalignment", parameter("angle", 0.1), aliases=("yaw_misalignment",))
    for autopilot in ("px4", "crazyflie"):
        (change,) = firmware_changes(diagnosis, autopilot)
        assert (change.alike, change.waits_for) == ((), ("yaw_misalignment",))


def together(*effects):
    """A diagnosis of several effects: name, interval of `e`, names of what looks like it."""
    sizes = [
        Effect(
            name=name,
            blamed=True,
            probability=None,
            aliases=aliases,
            parameters=(parameter("e", *ends),),
        )
        for name, ends, aliases in effects
    ]
    return dataclasses.replace(made.load(made.effect()), verdict="partly", effects=tuple(sizes))


def test_two_effects_on_one_parameter_are_one_change_by_the_product():
    both = together(("mass", (0.6, 0.5, 0.7), ()), ("thrust_gain", (0.45, 0.4, 0.5), ()))
    (hover,) = firmware_changes(both, "px4")
    assert hover.effects == ("mass", "thrust_gain")
    assert hover.amount == pytest.approx(1.6 / 1.45)
    below = np.hypot(np.log(1.6 / 1.5), np.log(1.5 / 1.45))
    assert np.log(hover.low) == pytest.approx(np.log(hover.amount) - below)
    above = np.hypot(np.log(1.7 / 1.6), np.log(1.45 / 1.4))
    assert np.log(hover.high) == pytest.approx(np.log(hover.amount) + above)
    assert without_parameter(both, "px4") == ()
    # Two controllers of a Crazyflie take the mass, one the thrust, and one takes both.
    effects = {c.parameters: c.effects for c in firmware_changes(both, "crazyflie")}
    assert effects[("posCtlPid.thrustBase",)] == ("mass", "thrust_gain")
    assert effects[("ctrlMel.mass",)] == ("mass",)
    assert len(effects) == len(firmware_changes(both, "crazyflie"))


def test_one_change_of_two_effects_waits_for_neither_of_them_and_lacks_an_interval_as_one_does():
    sizes = ("mass", (0.1,), ("thrust_gain", "drag")), ("thrust_gain", (-0.1, -0.2, 0.0), ())
    (hover,) = firmware_changes(together(*sizes), "px4")
    assert (hover.low, hover.high) == (None, None)
    assert (hover.alike, hover.waits_for) == ((), ("drag",))


def test_what_may_be_biased_is_descriptive():
    for verdict, use in (("partly", "measured"), ("effect", "descriptive")):
        diagnosis = found("mass", parameter("e", 0.1, use=use), verdict=verdict)
        assert all(change.descriptive for change in firmware_changes(diagnosis, "crazyflie"))


def test_an_effect_of_the_air_has_no_parameter():
    diagnosis = found("wind", parameter("x", 0.5))
    assert firmware_changes(diagnosis, "px4") == ()
    assert without_parameter(diagnosis, "px4") == ("wind",)


def test_cards_name_their_own_parameters_paths_that_there_are_and_two_autopilots():
    cards = load_cards()
    for name, card in cards.items():
        own = registry.load("effect", name).parameters
        assert set(card.paths) <= set(card.separated_from)
        assert set(card.paths.values()) <= set(PATHS)
        for change in card.changes:
            assert change.autopilot in ("px4", "crazyflie")
            assert {*change.powers, *change.gains} <= set(own)
            ways = [bool(change.powers), bool(change.gains), change.value is not None]
            assert sum(ways) == 1
            for size in change.powers:
                assert own[size].neutral in (0.0, 1.0)
    assert any(card.changes for card in cards.values())


def test_the_pair_that_is_separated_is_one_whose_manoeuvre_was_tried():
    assert pair_to_separate({"mass": ("drag", "thrust_gain")}) == ("mass", "thrust_gain")
    assert manoeuvre_path("mass", "thrust_gain") == manoeuvre_path("thrust_gain", "mass")
    assert pair_to_separate({"mass": ()}) is None


@pytest.mark.parametrize("fence", [Geofence(), Geofence(2.0, 4.0, 1.4), Geofence(30.0, 30.0, 10.0)])
@pytest.mark.parametrize("path", PATHS)
def test_a_flight_keeps_to_its_geofence_and_comes_to_rest(path, fence):
    flight = plan(path, fence)
    assert len(flight.durations) <= PIECES
    t, values = flight.sampled(0.01)
    most, least = values[:, :3].max(axis=0), values[:, :3].min(axis=0)
    half = np.asarray([fence.length, fence.width]) / 2.0 - MARGIN + 0.01
    assert (most[:2] <= half).all()
    assert (least[:2] >= -half).all()
    assert most[2] <= fence.height - MARGIN + 0.01
    assert least[2] >= LOWEST - 0.01
    speed = np.gradient(values, t, axis=0)
    assert np.abs(speed[[0, -1]]).max() < 0.05
    assert 0.0 < flight.scale <= 1.0


def test_pieces_meet_with_their_speeds_and_accelerations():
    flight = plan(GENERAL)
    for order in range(3):
        ends, starts = [], []
        for duration, own in zip(flight.durations, flight.coefficients, strict=True):
            curves = [np.polynomial.Polynomial(axis) for axis in own]
            curves = [curve.deriv(order) if order else curve for curve in curves]
            starts.append([curve(0.0) for curve in curves])
            ends.append([curve(duration) for curve in curves])
        np.testing.assert_allclose(ends[:-1], starts[1:], atol=1e-6)


def test_a_smaller_flight_is_slower_and_leans_as_far():
    large, small = plan(GENERAL, Geofence(30.0, 30.0, 10.0)), plan(GENERAL, Geofence(2.0, 2.0, 2.0))
    assert small.scale < large.scale == 1.0
    assert small.top_speed == pytest.approx(np.sqrt(small.scale) * large.top_speed, rel=0.02)

    def hardest(flight):
        t, values = flight.sampled(0.01)
        acc = np.gradient(np.gradient(values[:, :3], t, axis=0), t, axis=0)
        return np.linalg.norm(acc[5:-5], axis=1).max()

    assert hardest(small) == pytest.approx(hardest(large), rel=0.05)


def test_an_ample_geofence_leaves_the_path_as_it_was_tried():
    flight = plan("tumbling", Geofence(30.0, 30.0, 10.0))
    t, values = flight.sampled(0.01)
    path, seconds = PATHS["tumbling"]
    whole = t < seconds - 2.0
    away = values[whole, :3] - path(t[whole]).pos
    np.testing.assert_allclose(away, np.broadcast_to(away[0], away.shape), atol=2e-3)
