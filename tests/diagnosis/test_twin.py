"""The twin of reference flights: what its memory learns, and what it says of changed flights."""

import dataclasses
import functools
import itertools

import numpy as np
import pytest

from diagnosis.decision import Decision
from diagnosis.replay.library import make_library
from diagnosis.twin import diagnose_change
from diagnosis.twin.channels import Channels, headed
from diagnosis.twin.diagnose_change import answer_change, helps
from diagnosis.twin.drift import Scored
from diagnosis.twin.memory import fit_memories, gram, lagged, scale_of
from diagnosis.twin.twin import Score, fit_colour, make_twin, standing_out
from diagnosis.twin.units import compare, make_group
from simulators.point_mass import PointMass

LIBRARY = make_library(PointMass(), referenced=True, twin=True)
N_PARAMS = len(LIBRARY.slots)
EVERY = tuple(range(6))


def column(effect, parameter):
    return next(
        i for i, s in enumerate(LIBRARY.slots) if (s.effect, s.parameter) == (effect, parameter)
    )


def smooth(rng, n, width):
    kernel = np.hanning(width) / np.sqrt(np.sum(np.hanning(width) ** 2))
    return np.convolve(rng.normal(size=n + width), kernel, mode="same")[:n]


def flight(seed, change=(), response=(0.3, 0.15, 0.05), noise=0.02):
    """A flight whose vehicle follows its simulator with a memory of three samples.

    Every parameter moves the channels in a way of its own; `change` moves some parameters.
    """
    rng, n = np.random.default_rng(seed), 300
    simulated = np.stack([smooth(rng, n, 25) for _ in range(6)], axis=1)
    ways = np.random.default_rng(99)
    slopes = np.zeros((N_PARAMS, n, 6))
    for i, slot in enumerate(LIBRARY.slots):
        mixed = simulated @ ways.normal(size=(6, 6)) + ways.normal(size=6)
        slopes[i] = mixed / (slot.high - slot.low)
    moved = simulated + sum(value * slopes[i] for i, value in change)
    measured = moved.copy()
    for k, g in enumerate(response):
        later = np.concatenate([np.repeat(moved[:1], k, axis=0), moved[: n - k]])
        measured[:, :5] += g * later[:, :5]
    measured += noise * np.stack([smooth(rng, n, 5) for _ in range(6)], axis=1)
    valid = np.ones(n, bool)
    valid[100:110] = False
    return Channels(f"flight {seed}", measured, simulated, slopes, np.zeros((n, 3)), valid)


@functools.cache
def plain_twin():
    """The twin of eight flights in which nothing changed."""
    return make_twin([flight(i) for i in range(8)], LIBRARY, EVERY)


def test_lagged_holds_the_past_of_each_sample():
    past = lagged(np.arange(50.0))
    assert past[45, :4].tolist() == [45.0, 44.0, 43.0, 42.0]
    assert past[1, :4].tolist() == [1.0, 0.0, 0.0, 0.0]


def test_vectors_in_the_heading_frame_point_forward_along_the_yaw():
    turned = headed(np.asarray([[0.0, 2.0, 3.0]]), np.asarray([np.pi / 2]))
    np.testing.assert_allclose(turned, [[2.0, 0.0, 3.0]], atol=1e-12)


def test_the_memory_learns_the_response_and_predicts_flights_that_it_has_not_seen():
    flights = [flight(i) for i in range(5)]
    scale = scale_of(flights)
    memory, _ = fit_memories([gram(f, scale) for f in flights], scale)
    np.testing.assert_allclose(memory.weights[0][:3], [0.3, 0.15, 0.05], atol=0.03)
    new = flight(77)
    left = np.std((new.gap - memory.predict(new))[new.valid], axis=0)
    assert np.all(left < 0.3 * np.std(new.gap[new.valid], axis=0)[:5].min())


def test_the_vertical_memory_keeps_the_static_gain_of_the_simulator():
    """A controller that holds height makes thrust look as if it moved nothing."""
    flights = [
        dataclasses.replace(f, measured=f.measured * np.asarray([1, 1, 1, 1, 1, 0.0]))
        for f in (flight(i) for i in range(4))
    ]
    scale = scale_of(flights)
    memory, _ = fit_memories([gram(f, scale) for f in flights], scale)
    assert abs(memory.weights[3][:40].sum()) < 0.01
    assert abs(memory.weights[0][:40].sum()) > 0.3


def turning(seed, size, error=0.3):
    """A flight whose heading moves `size` times as far; of what moves, `error` is not followed."""
    plain, factor = flight(seed, noise=0.005, response=()), np.ones(6)
    factor[2] = size
    simulated = plain.simulated * factor
    measured = simulated + plain.gap
    measured[:, 2] -= error * simulated[:, 2]
    return dataclasses.replace(plain, measured=measured, simulated=simulated)


def test_of_a_heading_that_the_reference_hardly_moves_no_response_is_learned():
    flights = [turning(i, 0.001, 0.0) for i in range(8)]
    scale = scale_of(flights)
    memory, _ = fit_memories([gram(f, scale) for f in flights], scale)
    assert np.abs(memory.weights[1][:40]).max() < 1e-2


def test_a_motion_far_beyond_the_reference_is_no_evidence():
    twin = make_twin([turning(i, 0.01, 0.0) for i in range(8)], LIBRARY, EVERY)
    still, far = turning(50, 0.01, 0.0), turning(50, 1.0)
    assert np.all(twin.beyond(still) < 2.0)
    assert twin.beyond(far)[2] > 50.0
    assert twin.score(far).misfit < 2.0 * twin.score(still).misfit + 1.0
    answer, _ = answer_change(twin, [turning(100 + i, 1.0) for i in range(8)])
    assert (answer.change, answer.set_aside) == ("none", ())


def test_flights_that_no_candidate_can_reach_are_no_undisturbed_ones():
    """Logs that are turned over differ from the twin in no direction of an effect."""
    twin = plain_twin()
    flat = [dataclasses.replace(f, slopes=0.0 * f.slopes, measured=-20.0 * f.measured)
            for f in (flight(100 + i) for i in range(8))]  # fmt: skip
    answer, _ = answer_change(twin, flat)
    assert answer.change == "unexplained"


def test_slopes_pass_through_the_memory_as_a_change_of_the_vehicle_does():
    flights = [flight(i, noise=0.0) for i in range(4)]
    twin = make_twin(flights, LIBRARY, EVERY)
    at, size = column("attitude_gain", "g"), 0.05
    errors = twin.errors(flight(50, [(at, size)], noise=0.0)) - twin.errors(flight(50, noise=0.0))
    expected = size * twin.memory.respond(flight(50))[at]
    assert np.std((errors - expected)[:, :5]) < 0.02 * np.std(expected[:, :5])


def test_whitened_errors_of_a_coloured_noise_are_white():
    rng, errors = np.random.default_rng(0), []
    for _ in range(6):
        e = np.zeros((400, 6))
        for t in range(1, 400):
            e[t] = 0.9 * e[t - 1] + rng.normal(size=6)
        errors.append(e)
    valid = [np.ones(400, bool)] * 6
    colour = fit_colour(errors, valid, (1,) * 6, EVERY)
    white = colour.whiten(errors[0], valid[0]).reshape(-1, 6)
    np.testing.assert_allclose(colour.a[0], 0.9, atol=0.05)
    assert abs(np.mean(white[1:] * white[:-1])) < 0.1
    assert abs(np.std(white) - 1.0) < 0.1


def test_every_group_of_channels_has_a_colour_of_its_own():
    """Noise of the height's channel is correlated in time, noise of the others is not."""
    rng, flights = np.random.default_rng(1), []
    for i in range(9):
        plain = flight(i, noise=0.0)
        noise = rng.normal(size=(len(plain.measured), 6))
        noise[:, 5] = smooth(rng, len(noise), 25)
        measured = plain.measured + 0.02 * noise
        flights.append(dataclasses.replace(plain, measured=measured))
    colour = make_twin(flights, LIBRARY, EVERY).colour
    lags = np.count_nonzero(colour.a, axis=0)
    assert lags[5] > 0
    assert colour.a[0, 5] > 0.5
    assert np.abs(colour.a[:, :5]).max(initial=0.0) < 0.3


def test_a_change_is_named_with_an_interval_that_holds_it():
    twin = plain_twin()
    at, size = column("attitude_gain", "g"), 0.06
    found, scored = answer_change(twin, [flight(100 + i, [(at, size)]) for i in range(8)])
    assert found.change == "effect"
    assert found.effects == ("attitude_gain",)
    named = found.parameters[0]
    assert named.low < size < named.high
    assert named.low > 0.0
    assert found.misfit[1] < 0.5 * found.misfit[0]
    assert all(
        np.nanmean(one.drift(one.after)) < np.nanmean(one.drift(one.before)) for one in scored
    )


@pytest.mark.parametrize(("n", "change"), [(8, "none"), (2, "too_few")])
def test_undisturbed_flights_name_nothing(n, change):
    twin = plain_twin()
    found, _ = answer_change(twin, [flight(200 + i) for i in range(n)])
    assert found.change == change
    assert found.effects == ()


def test_a_flight_that_no_twin_follows_is_set_aside_by_name():
    flights = [flight(i) for i in range(8)]
    upset = dataclasses.replace(flights[3], measured=flights[3].measured * 2.0)
    twin = make_twin([*flights[:3], upset, *flights[4:]], LIBRARY, EVERY)
    assert twin.set_aside == ("flight 3",)


def test_standing_out_takes_four_flights_to_judge():
    assert not standing_out([1.0, 1.0, 100.0]).any()
    assert standing_out([1.0, 1.2, 0.9, 100.0]).tolist() == [False, False, False, True]


def test_intervals_cover_no_change_as_often_as_they_say():
    """Over many pairs of groups whose flights differ by more than their noise."""
    rng, held = np.random.default_rng(5), 0
    for _ in range(300):
        truth = 0.3 * rng.normal(size=12)
        scores = [_score(theta + 0.1 * rng.normal()) for theta in truth]
        group = make_group(scores, np.ones(1))
        parts = (slice(0, 6), slice(6, 12))
        both = [type(group)(*(x[at] for x in vars(group).values())) for at in parts]
        estimate = compare(both[0], both[1], [0]).estimate([0])
        held += abs(estimate.value[0]) < 2.14 * estimate.error[0]
    assert 0.91 < held / 300 < 0.99


def _score(theta):
    return Score("", np.asarray([[100.0]]), np.asarray([100.0 * theta]), 1.0, 1.0, 300)


def long_flight(seed, change=()):
    """A flight of 24 s."""
    each = [flight(1000 * seed + i, change) for i in range(4)]
    joined = {
        name: np.concatenate([getattr(f, name) for f in each])
        for name in ("measured", "simulated", "vel", "valid")
    }
    slopes = np.concatenate([f.slopes for f in each], axis=1)
    return Channels(name=f"long flight {seed}", slopes=slopes, **joined)


def test_drift_of_a_constant_acceleration_is_half_of_it_by_time_squared():
    errors = np.zeros((300, 6))
    errors[:, 5] = 0.8
    one = Scored("", np.ones(300, bool), errors, errors, errors, np.ones(6))
    np.testing.assert_allclose(one.drift(errors), 0.5 * 0.8 * 0.5**2, rtol=1e-6)


def nonlinear(seed, size, at):
    """A flight whose channels bend with one parameter: a fifth more of it counts double."""
    plain = flight(seed, noise=0.005, response=())
    bent = size * (1.0 + 5.0 * size) * plain.slopes[at]
    return dataclasses.replace(plain, measured=plain.measured + bent)


def test_a_large_change_is_found_in_its_right_size_where_the_flights_can_be_flown_again():
    at, size = column("attitude_gain", "g"), 0.2
    twin = make_twin([flight(i, noise=0.005, response=()) for i in range(8)], LIBRARY, EVERY)
    targets = [nonlinear(100 + i, size, at) for i in range(8)]

    def fly(vector, along):
        assert list(along) == [at]
        x = vector[at] - LIBRARY.neutral[at]
        made = []
        for one in targets:
            slopes = one.slopes[list(along)] * (1.0 + 10.0 * x)
            moved = one.simulated + x * (1.0 + 5.0 * x) * one.slopes[at]
            made.append(dataclasses.replace(one, simulated=moved, slopes=slopes))
        return tuple(made)

    linear, _ = answer_change(twin, targets)
    found, _ = answer_change(twin, targets, fly=fly)
    assert linear.parameters[0].value == pytest.approx(0.4, rel=0.1)
    assert found.effects == ("attitude_gain",)
    assert found.parameters[0].low < size < found.parameters[0].high
    assert found.misfit[1] < 0.1 * linear.misfit[0]


def test_effects_that_fit_the_flights_but_not_each_other_are_not_named():
    """Every flight wants another size and sign: the scatter between flights is the yardstick."""
    at = column("attitude_gain", "g")
    twin = plain_twin()
    sizes = (0.3, -0.3, 0.25, -0.25, 0.28, -0.28, 0.31, -0.31)
    found, _ = answer_change(twin, [flight(100 + i, [(at, x)]) for i, x in enumerate(sizes)])
    assert "attitude_gain" not in found.effects


def test_few_flights_name_a_family_of_effects_that_look_alike():
    """Each alone misses the level that is shared out; together they do not."""
    at, size = column("attitude_gain", "g"), 0.05
    twin = make_twin([flight(i) for i in range(5)], LIBRARY, EVERY)
    found, _ = answer_change(twin, [flight(100 + i, [(at, size)]) for i in range(3)])
    (first,) = found.effects
    assert "attitude_gain" in (first, *found.aliases[first])
    assert all(p >= 0.5 for p in found.probabilities.values())


def test_two_large_changes_at_once_are_both_named():
    """Either leaves much where it is alone, which does not hide what speaks for it."""
    sizes = {"attitude_gain": ("g", 0.2), "trim": ("roll", 0.03), "thrust_gain": ("e", -0.2)}
    changes = {name: (column(name, p), size) for name, (p, size) in sizes.items()}
    twin = plain_twin()
    for pair in itertools.combinations(sizes, 2):
        change = [changes[name] for name in pair]
        found, _ = answer_change(twin, [flight(100 + i, change) for i in range(8)])
        assert not {*found.effects} & {x for alike in found.aliases.values() for x in alike}
        assert {found.effects[0], *found.beside} == {*found.effects}
        shares = {c.effect: c.share for c in found.candidates}
        assert all(shares[e] > 0.5 for e in found.effects), "true effects do not compete"
        for name in pair:
            assert any(name in (e, *alike) for e, alike in found.aliases.items()), (pair, found)
            true = [p for p in found.parameters if p.parameter == sizes[name][0]]
            assert all(p.low < sizes[name][1] < p.high for p in true if p.effect == name)


def test_no_effect_is_judged_beside_one_that_can_do_its_work():
    """What happened is nearly the first effect; a second one is like it, and fits the rest."""
    at, like = column("attitude_gain", "g"), column("thrust_gain", "e")
    way = np.random.default_rng(7).normal(size=(6, 6))

    def alike(one, size=0.0):
        slopes = one.slopes.copy()
        aside = one.simulated @ way
        aside *= np.linalg.norm(slopes[at]) / np.linalg.norm(aside)
        slopes[like] = slopes[at] + 0.5 * aside
        measured = one.measured + size * (slopes[at] + 0.15 * aside)
        return dataclasses.replace(one, slopes=slopes, measured=measured)

    twin = make_twin([alike(flight(i, response=())) for i in range(8)], LIBRARY, EVERY)
    flights = [alike(flight(100 + i, response=()), 0.2) for i in range(8)]
    found, _ = answer_change(twin, flights)
    assert found.effects[0] == "attitude_gain"
    assert found.beside == ()


def test_an_effect_that_looks_alike_is_named_where_the_first_does_not_explain_flights(monkeypatch):
    at, like = column("attitude_gain", "g"), column("thrust_gain", "e")

    def alike(one):
        """The flight with two effects that move it in the same way."""
        slopes = one.slopes.copy()
        slopes[like] = slopes[at]
        return dataclasses.replace(one, slopes=slopes)

    twin = make_twin([alike(flight(i)) for i in range(5)], LIBRARY, EVERY)
    flights = [alike(flight(100 + i, [(at, 0.05)])) for i in range(5)]
    found, _ = answer_change(twin, flights)
    (first,) = found.effects
    assert {first, *found.aliases[first]} == {"attitude_gain", "thrust_gain"}
    answers = iter([False, True])
    monkeypatch.setattr(diagnose_change, "helps", lambda *_: next(answers))
    other, _ = answer_change(twin, flights)
    assert other.effects == found.aliases[first][:1]
    assert other.aliases == {other.effects[0]: (first,)}
    assert {p.effect for p in other.parameters} == {*other.effects}
    monkeypatch.setattr(diagnose_change, "helps", lambda *_: False)
    assert answer_change(twin, flights)[0].change == "unexplained"


@pytest.mark.parametrize(
    ("others", "far", "expected"),
    [(1.2, 3.0, False), (0.99, 5.4, False), (0.9, 3.0, True)],
    ids=["most fit worse", "most of the gap is left", "it explains them"],
)
def test_effects_must_explain_flights_that_they_were_not_fitted_to(others, far, expected):
    """One flight that fits far better makes up for none that fit worse."""
    twin, rng = plain_twin(), np.random.default_rng(3)

    def scored(name, before, after):
        """A flight whose errors in attitude are the twin's, scaled, and whose drift stays."""
        errors = twin.error * rng.normal(size=(300, 6))
        scale = lambda x: errors * np.asarray([x, x, x, 1.0, 1.0, 1.0])  # noqa: E731
        without = scale(before)
        return Scored(name, np.ones(300, bool), without, scale(after), without, np.ones(6))

    flights = [scored(f"{i}", 1.0, others) for i in range(7)] + [scored("far", 6.0, far)]
    whole = lambda when: np.mean([np.mean(getattr(f, when) ** 2) for f in flights])  # noqa: E731
    assert whole("after") < whole("before")
    assert helps(twin, flights, Decision()) is expected


def test_what_the_twin_misses_in_every_flight_does_not_count_against_a_change():
    """The reference flights look as if they had less of an effect than the twin.

    The changed flights happen to be as the twin is, and so differ from the reference.
    """
    at, size = column("attitude_gain", "g"), 0.02
    plain = plain_twin()
    scores = tuple(plain.score(flight(i, [(at, -size)])) for i in range(8))
    twin = dataclasses.replace(plain, scores=scores)
    found, scored = answer_change(twin, [flight(100 + i) for i in range(8)])
    assert found.effects == ("attitude_gain",)
    named = found.parameters[0]
    assert named.low < size < named.high
    assert helps(twin, scored, Decision())
    swapped = [dataclasses.replace(f, usual=f.after, after=f.usual) for f in scored]
    assert not helps(twin, swapped, Decision())
