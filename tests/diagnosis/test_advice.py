"""What to fly next, in a sentence."""

import pytest

from diagnosis.answer import _largest_regime
from diagnosis.decide.advice import next_flight
from diagnosis.result_parts import ChannelGap, RegimeGap
from simulators.effects.card import load_card, load_cards, manoeuvre


def test_a_pair_that_looks_alike_is_separated_by_its_manoeuvre():
    said = next_flight("effect", {"wind": [], "mass": ["thrust_gain"]}, None, ["drag"])
    assert said.startswith("To separate mass from thrust gain: fast straight lines at 2 m/s")


def test_of_several_pairs_one_with_a_tested_manoeuvre_comes_first():
    assert manoeuvre("mass", "drag") is None
    said = next_flight("effect", {"mass": ["drag", "thrust_gain"]}, None, [])
    assert said.startswith("To separate mass from thrust gain: fast straight lines")


def test_a_pair_without_a_manoeuvre_is_flown_one_after_the_other():
    assert manoeuvre("yaw_gains", "rotor_arm") is None
    said = next_flight("effect", {"yaw_gains": ["rotor_arm"]}, None, [])
    yaw, arm = (load_card(name).flight for name in ("yaw_gains", "rotor_arm"))
    assert said.startswith(f"To separate yaw gains from rotor arm: fly {yaw}, then {arm}")


def test_a_pair_that_one_flight_shows_is_flown_in_that_flight():
    assert manoeuvre("delay", "roll_pitch_gains") is None
    said = next_flight("effect", {"delay": ["roll_pitch_gains"]}, None, [])
    assert said.count(load_card("delay").flight) == 1


def test_an_effect_without_a_flight_of_its_own_is_named_in_words():
    said = next_flight("effect", {"yaw_gains": ["center_of_mass"]}, None, [])
    assert said.endswith(
        "then flights in which centre of mass matters, each in flights of their own."
    )


def test_what_nobody_explains_is_flown_again_where_it_is_largest():
    said = next_flight("unexplained", {}, "speed 1 to 2 m/s", [])
    assert "where the gap is largest (speed 1 to 2 m/s)" in said
    assert "()" not in next_flight("unexplained", {}, None, [])


def test_what_the_flights_hardly_show_is_named():
    assert "ground effect" in next_flight("none", {}, None, ["mass", "ground_effect"])
    assert next_flight("none", {}, None, []).startswith("Nothing: ")


def test_advice_is_about_effects_that_there_are():
    cards = load_cards()
    pairs = [(name, other) for name, card in cards.items() for other in card.separated_from]
    assert {other for _, other in pairs} <= cards.keys()
    assert len(pairs) == len({frozenset(pair) for pair in pairs}), "one card of a pair says it"
    for one, other in pairs:
        assert one != other
        assert manoeuvre(one, other) == manoeuvre(other, one) == cards[one].separated_from[other]


@pytest.mark.parametrize(
    ("gaps", "found"),
    [
        ({"speed": [1.0, 1.0, 1.2], "tilt": [0.1, 0.1, 5.0]}, "tilt 2.0 to 3.0 -"),
        ({"speed": [0.1, 9.0, None], "tilt": [1.0, 1.1, 1.2]}, "speed 1.0 to 2.0 -"),
        ({}, None),
    ],
)
def test_the_regime_that_stands_out_is_that_of_the_channel_with_the_largest_share(gaps, found):
    def channel(share, regimes):
        edges = (0.0, 1.0, 2.0, 3.0)
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

    other = channel(0.3, {"height": [0.0, 0.0, 99.0]})
    assert _largest_regime([other, channel(0.7, gaps)]) == found


def test_without_channels_no_regime_stands_out():
    assert _largest_regime([]) is None
