"""What to fly next, in a sentence."""

import pytest

from diagnosis.decide.advice import largest_regime, next_flight
from diagnosis.decision import Decision
from diagnosis.replay.library import make_library
from diagnosis.result_parts import ChannelGap, RegimeGap
from simulators import registry
from simulators.effects.card import Input, load_card, load_cards, manoeuvre


def test_of_several_pairs_one_with_a_tested_manoeuvre_comes_first():
    assert manoeuvre("mass", "drag") is None
    said = next_flight("effect", {"mass": ["drag", "thrust_gain"]}, None, [], 8)
    assert said.startswith("To separate mass from thrust gain: fast straight lines")


def test_a_pair_without_a_manoeuvre_is_flown_one_after_the_other():
    assert manoeuvre("yaw_gains", "rotor_arm") is None
    said = next_flight("effect", {"yaw_gains": ["rotor_arm"]}, None, [], 8)
    yaw, arm = (load_card(name).flight for name in ("yaw_gains", "rotor_arm"))
    assert said.startswith(f"To separate yaw gains from rotor arm: fly {yaw}, then {arm}")


def test_a_pair_that_one_flight_shows_is_flown_in_that_flight():
    assert manoeuvre("delay", "roll_pitch_gains") is None
    said = next_flight("effect", {"delay": ["roll_pitch_gains"]}, None, [], 8)
    assert said.count(load_card("delay").flight) == 1


def test_an_effect_without_a_flight_of_its_own_is_named_in_words():
    said = next_flight("effect", {"yaw_gains": ["center_of_mass"]}, None, [], 8)
    assert said.endswith(
        "then flights in which centre of mass matters, each in flights of their own."
    )


def test_what_nobody_explains_is_flown_again_where_it_is_largest():
    said = next_flight("unexplained", {}, "speed 1 to 2 m/s", [], 8)
    assert "where the gap is largest (speed 1 to 2 m/s)" in said
    assert "()" not in next_flight("unexplained", {}, None, [], 8)


def test_what_the_flights_hardly_show_is_named():
    assert "ground effect" in next_flight("none", {}, None, ["mass", "ground_effect"], 8)
    assert next_flight("none", {}, None, [], 8).startswith("Nothing: ")


def test_advice_is_about_effects_that_there_are():
    cards = load_cards()
    pairs = [(name, other) for name, card in cards.items() for other in card.separated_from]
    assert {other for _, other in pairs} <= cards.keys()
    assert len(pairs) == len({frozenset(pair) for pair in pairs}), "one card of a pair says it"
    for one, other in pairs:
        assert one != other
        assert manoeuvre(one, other) == manoeuvre(other, one) == cards[one].separated_from[other]


def test_too_few_flights_are_told_how_many_are_needed_and_of_which_set():
    few = Decision().few_flights
    said = next_flight("too_few", {}, None, ["ground_effect"], 3, 9)
    assert (
        said == f"Fly at least {few} flights of 5 to 10 s like the reference, and diagnose again."
    )
    said = next_flight("too_few", {}, None, [], few, few - 1)
    assert said == f"Fly at least {few} reference flights of 5 to 10 s, and diagnose again."
    said = next_flight("too_few", {}, None, [], few - 1, few - 1)
    assert "like the reference, and at least 5 reference flights" in said
    other = next_flight("too_few", {}, None, [], 3, 9, Decision(few_flights=7))
    assert "at least 7 flights" in other


def test_where_too_few_flights_flew_to_confirm_anything_more_are_asked_for():
    for n, more in ((1, True), (2, True), (3, False)):
        said = next_flight("unexplained", {}, "speed 1 to 2 m/s", [], n)
        assert ("at least 5 flights of 5 to 10 s" in said) == more
        assert ("where the gap is largest" in said) != more


def channel(share, regimes, edges=(0.0, 1.0, 2.0, 3.0)):
    lines = tuple(
        RegimeGap(variable=name, unit="-", edges=edges, gap=tuple(gap))
        for name, gap in regimes.items()
    )
    return ChannelGap(
        channel="any",
        unit="-",
        gap_rms=1.0,
        noise_floor=0.1,
        share=share,
        low=None,
        high=None,
        regimes=lines,
        onset_s=None,
        beyond_noise=True,
        main=True,
    )


@pytest.mark.parametrize(
    ("gaps", "found"),
    [
        ({"speed": [1.0, 1.0, 1.2], "tilt": [0.1, 0.1, 5.0]}, "tilt 2.0 to 3.0 -"),
        ({"speed": [0.1, 9.0, None], "tilt": [1.0, 1.1, 1.2]}, "speed 1.0 to 2.0 -"),
        ({"speed": [1.0, 1.0, 1.3], "tilt": [1.0, 1.1, 1.2]}, None),
        ({"speed": [None, 9.0, None], "tilt": [1.0, 1.1, 1.2]}, None),
        ({}, None),
    ],
)
def test_the_regime_that_holds_most_is_that_of_the_channel_with_the_largest_share(gaps, found):
    other = channel(0.3, {"height": [0.0, 0.0, 99.0]})
    assert largest_regime([other, channel(0.7, gaps)], {}) == found


@pytest.mark.parametrize(
    ("noise", "found"),
    [
        ({}, True),
        ({"climb rate": 4e-4}, True),
        ({"climb rate": 0.01}, False),
        ({"climb rate": None}, False),
    ],
)
def test_a_regime_within_the_noise_of_its_quantity_is_not_named(noise, found):
    """Nobody can fly again between -0.0010 and 0.0008 m/s."""
    hover = channel(1.0, {"climb rate": [0.1, 9.0]}, edges=(-0.3, -0.001, 0.0008))
    assert (largest_regime([hover], noise) is not None) == found


def test_without_channels_no_regime_stands_out():
    assert largest_regime([], {}) is None


@pytest.mark.parametrize("simulator", ["point_mass", "crazyflow"])
def test_why_an_effect_is_no_candidate_is_said_in_the_readers_words(simulator):
    library = make_library(registry.load("simulator", simulator)())
    kinds = registry.load_all("effect").items()
    said = {name: library.why_out(name, k) for name, k in kinds if name not in library.candidates}
    assert f"{simulator} cannot simulate it" in said.values()
    airframe = "never blamed as a cause: it differs between airframes"
    assert (airframe in said.values()) == (simulator == "crazyflow")
    assert not any(word in why for why in said.values() for word in ("door", "blind", "tells one"))
    assert Input.TWIN.value.startswith("looked for only with --reference")
