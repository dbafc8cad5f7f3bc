"""Flights left out in turn confirm what acted, and nothing else."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import SIGMA, few_or_all, flight_set, misled, point_mass_set

from diagnosis.decide.blame import blame
from diagnosis.decide.prepared import Prepared, make_likelihood
from diagnosis.decide.reference import Reference
from diagnosis.decide.study import Study
from diagnosis.decide.support import judge_supported, support
from diagnosis.decide.verdict import Floor, intervals
from diagnosis.decision import Decision
from diagnosis.engine import diagnose
from diagnosis.fit import shrinkage
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.gap import rms_interval
from diagnosis.fit.search import Fits, polish, refit, without
from diagnosis.fit.shrinkage import Drift, flown_without, left_out, shrink, unknown_shrink
from diagnosis.result import Support
from simulators.effects.drag import Drag
from simulators.effects.wind import Wind


def fitted(replay, flights, effects):
    fits, effects = (
        Fits.of(Evidence.of(make_likelihood(replay, flights, SIGMA))),
        frozenset(effects),
    )
    fits = refit(fits, effects, fits.nominal)
    return fits, fits[effects]


def made(kind, **fields):
    """A record with some of its fields, those that matter."""
    one = object.__new__(kind)
    vars(one).update(fields)
    return one


def made_study(fits, verdict, lines=(), base=None):
    prepared = made(Prepared, base=base, decision=Decision())
    return made(Study, prepared=prepared, fits=fits, verdict=verdict, support=lines)


@pytest.fixture(scope="module")
def too_many(replay):
    """The fit of a wind and a drag to flights in a wind."""
    return fitted(replay, point_mass_set(Wind(x=0.3)).flights, {"wind", "drag"})


@pytest.fixture(scope="module")
def windy(replay):
    """The fits of a wind to flights in it, and the verdict on them."""
    fits, fit = fitted(replay, point_mass_set(Wind(x=0.3)).flights, {"wind"})
    return fits, fit, judge_supported(fits, Floor())[1]


def test_left_out_flights_confirm_what_acted_and_nothing_else(too_many):
    _, (wind, drag) = support(*too_many)
    assert (wind.effect, drag.effect) == ("wind", "drag")
    assert wind.confirmed
    assert wind.low < wind.percent < wind.high
    assert wind.n == 4
    assert drag.confirmed is False
    assert drag.percent == pytest.approx(0.0, abs=2.0)


def test_the_others_are_fitted_again_without_it(replay):
    """What a rival takes over as well is no support, however bad the fit was on the way."""
    flights = point_mass_set(Drag(c=0.4), n_flights=4).flights
    fits, fit = fitted(replay, flights, {"wind", "drag"})
    alone = without(fits, fit, "wind", hopeless=np.inf)[frozenset({"drag"})]
    assert frozenset({"drag"}) not in fits.by_set
    assert alone.objective - fit.objective < 25.0
    (at,) = replay.library.indices["drag"]
    assert alone.vector[at] == pytest.approx(0.4, abs=0.05)


def test_what_left_out_flights_deny_is_told_and_not_blamed(too_many):
    """Its evidence alone would not name the drag, nor would the nominal simulator be better."""
    fits, both = too_many
    alone = dataclasses.replace(fits, by_set={both.effects: both, frozenset(): fits.nominal})
    fits, verdict, lines = judge_supported(alone, Floor(2.0))
    assert verdict.kind == "effect"
    assert verdict.chosen.effects == {"wind", "drag"}
    assert [(one.effect, one.confirmed) for one in lines] == [
        ("wind", True),
        ("drag", False),
    ]
    likely = dataclasses.replace(verdict.ranked[0], probability=0.9)
    judged = dataclasses.replace(verdict, ranked=(likely,))
    study = made_study(fits, judged, lines, made(Reference, structure=2.0, scatter=0.0))
    said = blame(study, unknown_shrink(4, ""))
    assert (said.verdict, said.named, said.blamed) == ("partly", None, {"wind"})


@pytest.mark.parametrize(("floor", "verdict"), [(2.0, "unexplained"), (1.2, "effect")])
def test_a_clear_effect_that_they_deny_stands_where_references_are_followed(windy, floor, verdict):
    fits, fit, judged = windy
    _, (line,) = support(fits, fit)
    denied = dataclasses.replace(line, confirmed=False)
    base = made(Reference, structure=floor, scatter=0.0)
    study = made_study(fits, judged, (denied,), base)
    assert blame(study, unknown_shrink(4, "")).verdict == verdict


@pytest.mark.parametrize(("percent", "verdict"), [(-1.0, "unexplained"), (1.0, "effect")])
def test_a_drift_that_grows_where_more_than_noise_is_left_blames_nothing(windy, percent, verdict):
    fits, _, judged = windy
    judged = dataclasses.replace(judged, doubted=True)
    helps = Support(effect="wind", percent=9.0, low=5.0, high=12.0, n=4, confirmed=True)
    study = made_study(fits, judged, (helps,))
    shrink = dataclasses.replace(unknown_shrink(4, ""), percent=percent)
    found = blame(study, shrink)
    assert found.verdict == verdict
    assert set(found.blamed) == ({"wind"} if verdict == "effect" else set())


@pytest.mark.parametrize(("left", "verdict"), [(0.4, "partly"), (0.6, "unexplained")])
def test_what_leaves_most_of_the_gap_is_blamed_for_none_of_it(windy, left, verdict):
    fits, _, judged = windy
    judged = dataclasses.replace(judged, kind="unexplained", unexplained_share=left)
    helps = Support(effect="wind", percent=9.0, low=5.0, high=12.0, n=4, confirmed=True)
    said = blame(made_study(fits, judged, (helps,)), unknown_shrink(4, ""))
    assert (said.verdict, said.named) == (verdict, None)
    assert set(said.blamed) == ({"wind"} if verdict == "partly" else set())


@pytest.mark.parametrize(("share", "verdict"), [(0.4, "unexplained"), (0.9, "effect")])
def test_an_effect_less_likely_than_not_is_not_named(windy, share, verdict):
    fits, _, judged = windy
    ranked = tuple(dataclasses.replace(one, probability=share) for one in judged.ranked[:1])
    judged = dataclasses.replace(judged, ranked=ranked, aliases={"wind": []})
    study = made_study(fits, judged)
    assert blame(study, unknown_shrink(4, "")).verdict == verdict


def test_two_flights_say_nothing(replay):
    flights = point_mass_set(Wind(x=0.3), n_flights=2).flights
    _, (wind,) = support(*fitted(replay, flights, {"wind"}))
    assert (wind.percent, wind.low, wind.high, wind.n) == (None, None, None, 2)
    assert wind.confirmed is None


def test_what_is_shared_with_a_reference_is_estimated_without_the_flight_too(replay):
    """Within the bounds, the normal equations of the other flights ask for no further step."""
    flights = point_mass_set(Wind(x=0.3), n_flights=4).flights
    n = len(replay.library.neutral)
    likelihood, wind = make_likelihood(replay, flights, SIGMA), frozenset({"wind"})
    evidence = Evidence.of(likelihood, precision=1e3 * np.eye(n))
    fits = Fits.of(evidence)
    fit = polish(refit(fits, wind, fits.nominal), wind)[wind]
    found, rest = left_out(evidence, fit, 1), fit.normal.of(fit.normal.flight != 1)
    inside = (found > evidence.low + 1e-6) & (found < evidence.high - 1e-6)
    inside[evidence.free(fit.effects)] = False
    H, g = rest.H.sum(axis=0), rest.g.sum(axis=0)
    left = [g - H @ step - 1e3 * (fit.shift + step) for step in (0.0 * found, found - fit.total)]
    assert inside.any()
    assert np.abs(left[0][inside]).max() > 1.0
    assert np.abs(left[1][inside]).max() < 0.02 * np.abs(left[0][inside]).max()


def test_the_interval_of_the_shrinkage_is_that_of_its_percentage(replay, monkeypatch):
    """One flight in nine has most of the gap, and shrinks by more than the others."""
    flights = point_mass_set(n_flights=9, seconds=3.0).flights
    tracks = make_likelihood(replay, flights, SIGMA).tracks(replay.library.neutral)

    def shrunk(first, others):
        sizes = iter([np.where(tracks.flight == 0, *x) for x in zip(first, others, strict=True)])
        lines = np.zeros((len(tracks.flight), 5))
        monkeypatch.setattr(shrinkage, "drifts", lambda _: np.column_stack([next(sizes), lines]))
        return shrink(Drift(tracks, tracks), SIGMA, lofo=True)

    found = shrunk((0.1, 0.02), (0.01, 0.009))
    assert found.percent == pytest.approx(68.8, abs=0.1)
    assert found.low < 40.0 < found.percent < found.high
    alike = shrunk((0.1, 0.05), (0.01, 0.005))
    assert (alike.low, alike.percent, alike.high) == pytest.approx((50.0, 50.0, 50.0))
    lost = shrunk((0.1, np.nan), (0.01, 0.005))
    assert lost.percent is None
    assert "cannot be flown in 6 windows" in lost.reason


@pytest.mark.parametrize("n", [3, 5, 9])
def test_the_interval_of_a_gap_over_flights_covers_what_it_says(n):
    """Flights differ: their sums of squares scatter like chi-square with three degrees."""
    rng = np.random.default_rng(n)
    ends = (rms_interval(100.0 * rng.chisquare(3, n), np.full(n, 100)) for _ in range(2000))
    assert np.mean([low < np.sqrt(3.0) < high for low, high in ends]) == pytest.approx(
        0.95, abs=0.02
    )


def test_two_flights_tell_no_interval_of_a_gap():
    assert rms_interval(np.asarray([1.0, 2.0]), np.asarray([10, 10])) == (None, None)


def test_parameters_of_which_flights_say_nothing_have_no_interval(replay):
    flights = point_mass_set(Wind(x=0.3), n_flights=3).flights
    fits, fit = fitted(replay, flights, {"wind"})
    (x, *_), low, high = intervals(fits.evidence, fit)
    assert low[0] < 0.3 < high[0]
    H = fit.normal.H.copy()
    H[:, x, :] = H[:, :, x] = 0.0
    blind = dataclasses.replace(fit, normal=dataclasses.replace(fit.normal, H=H))
    _, low, high = intervals(fits.evidence, blind)
    assert (low[0], high[0]) == (-np.inf, np.inf)
    assert np.isfinite(low[1:]).all()


@few_or_all()
def test_it_is_told_where_the_simulator_does_not_follow(exclude):
    """Commands with errors that no effect has: a wind is found, and something else is left."""
    rng = np.random.default_rng(0)
    calm = point_mass_set(Wind(x=1.5), n_flights=4)
    flights = flight_set([misled(f, rng, [3], 0.02) for f in calm.flights])
    found = diagnose(flights, simulator="point_mass", exclude=exclude)
    assert found.verdict == "partly"
    lines = {line.effect: line for line in found.support}
    assert set(lines) == {effect.name for effect in found.effects}
    assert lines["wind"].confirmed
    assert lines["wind"].n == 4
    (wind,) = [effect for effect in found.blamed if effect.name == "wind"]
    assert wind.parameter("x").use == "descriptive"
    assert wind.probability is None
    assert found.probability is None


@pytest.mark.parametrize("curvature", [1.0, 1e-4])
def test_a_flight_is_not_left_out_by_a_step_with_which_the_others_fly_worse(replay, curvature):
    """Slopes that promise far too much, as where a simulator is not linear."""
    fits, fit = fitted(replay, point_mass_set(Wind(x=0.3), n_flights=3).flights, {"wind"})
    normal = dataclasses.replace(fit.normal, H=fit.normal.H * curvature)
    fit = dataclasses.replace(fit, normal=normal)

    def misfit(vector):
        found = fits.evidence.likelihood.normal(vector)
        return found.c[found.flight != 1].sum()

    whole, found = (one(fits.evidence, fit, 1) for one in (left_out, flown_without))
    assert (misfit(whole) > 2.0 * misfit(fit.total)) == (curvature < 1.0)
    assert misfit(found) <= misfit(fit.total)
    assert np.array_equal(whole, found) == (curvature == 1.0)
