"""Likelihood, search and verdict on flights of known truth."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import (
    SIGMA,
    all_but,
    edited,
    few_or_all,
    flight_set,
    fly,
    point_mass_set,
    thinned,
)

from diagnosis.decide.attribution import attribute
from diagnosis.decide.prepared import make_likelihood
from diagnosis.decide.reference import beside, fit_reference
from diagnosis.decide.verdict import (
    Floor,
    intervals,
    judge,
    limits,
    sizes,
    structure,
)
from diagnosis.decision import Decision
from diagnosis.engine import diagnose
from diagnosis.fit.equations import dispersion
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.outliers import beyond
from diagnosis.fit.search import Fits, refit
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.replay import make_replay
from simulators.contract import with_effects
from simulators.effects.attitude_gain import AttitudeGain
from simulators.effects.contract import WrenchEffect
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
from simulators.effects.gust import Gust
from simulators.effects.mass import Mass
from simulators.effects.quadratic_drag import QuadraticDrag
from simulators.effects.trim import Trim
from simulators.effects.wind import Wind
from simulators.point_mass import PointMass


def likelihood_of(replay, *effects, **settings):
    flights = point_mass_set(*effects, **settings).flights
    return make_likelihood(replay, flights, SIGMA)


def judged(replay, *effects, n_flights=4, **settings):
    likelihood = likelihood_of(replay, *effects, n_flights=n_flights, **settings)
    fits = attribute(Evidence.of(likelihood), n_flights)
    return fits, judge(fits)


def reference_with(replay, *effects, **settings):
    """What flights of a vehicle say before anything changed."""
    return fit_reference(likelihood_of(replay, *effects, seed=1, **settings))


@pytest.fixture(scope="module")
def dragged(replay):
    """What reference flights with drag say; in four of 9 s, no one kind of drag stands out."""
    return reference_with(replay, Drag(c=0.5), n_flights=6, seconds=6.0)


def beside_reference(replay, base, *effects):
    """The fits of new flights beside what a reference says."""
    new = point_mass_set(*effects, seed=2).flights
    evidence = beside(make_likelihood(replay, new, base.enlarged * SIGMA), base)
    return attribute(evidence, len(new), base.phi)


def vector_of(replay, **values):
    vector = replay.library.neutral.copy()
    for i, slot in enumerate(replay.library.slots):
        vector[i] = values.get(f"{slot.effect}_{slot.parameter}", vector[i])
    return vector


def test_the_truth_leaves_only_noise(replay):
    likelihood = likelihood_of(replay, Wind(x=0.5))
    normal = likelihood.normal(vector_of(replay, wind_x=0.5))
    dof = normal.dof.sum()
    assert normal.chi2 / dof == pytest.approx(1.0, abs=5 * np.sqrt(2 / dof))


def test_slopes_agree_with_finite_differences(replay):
    likelihood = likelihood_of(replay, n_flights=1)
    at = vector_of(replay, wind_x=0.2, mass_e=0.05, attitude_lag_tau=0.02, drag_c=0.3)
    gradient = -2 * likelihood.normal(at).g.sum(axis=0)
    for name, step in (("wind_x", 1e-2), ("mass_e", 1e-3), ("drag_c", 1e-2)):
        i = int(np.flatnonzero(vector_of(replay, **{name: 9.0}) == 9.0)[0])
        ends = [likelihood.normal(at + s * step * np.eye(len(at))[i]).chi2 for s in (-1, 1)]
        assert (ends[1] - ends[0]) / (2 * step) == pytest.approx(gradient[i], rel=0.02)


def test_an_error_of_the_start_costs_nothing(replay):
    likelihood = likelihood_of(replay, n_flights=2)
    before = likelihood.normal(replay.library.neutral).chi2
    for group in likelihood.groups:
        group.pos[:] += 0.02
        group.vel[:] -= 0.05
    likelihood.cache.replays.clear()
    assert likelihood.normal(replay.library.neutral).chi2 == pytest.approx(before, rel=1e-3)


# `make test` has a force, a property of the plant, an onset and a command.
@pytest.mark.parametrize(
    ("effect", "name"),
    [
        (Wind(x=0.3, y=-0.2), "wind"),
        (Mass(e=0.1), "mass"),
        pytest.param(Drag(c=0.4), "drag", marks=pytest.mark.exhaustive),
        pytest.param(QuadraticDrag(k=0.5), "quadratic_drag", marks=pytest.mark.exhaustive),
        (Gust(x=0.8, y=0.3, onset=3.2), "gust"),
        pytest.param(AttitudeGain(g=-0.1), "attitude_gain", marks=pytest.mark.exhaustive),
        pytest.param(Trim(roll=0.02, pitch=-0.01), "trim", marks=pytest.mark.exhaustive),
        (Delay(seconds=0.03), "delay"),
    ],
)
def test_a_withheld_effect_is_named_with_its_size(replay, effect, name):
    fits, verdict = judged(replay, effect, seed=3)
    assert verdict.kind == "effect"
    assert len(verdict.chosen.effects) == 1
    (chosen,) = verdict.chosen.effects
    assert name in {chosen, *verdict.aliases[chosen]}
    free, low, high = intervals(fits.evidence, fits[frozenset({name})])
    for i, a, b in zip(free, low, high, strict=True):
        truth = float(getattr(effect, replay.library.slots[i].parameter))
        slack = 0.5 * (b - a) + 1e-3  # four sigmas, for sixteen intervals at once
        assert a - slack < truth < b + slack


def test_two_withheld_effects_are_both_named(replay):
    _, verdict = judged(replay, Wind(x=0.4), AttitudeGain(g=-0.15), seed=5)
    assert verdict.kind == "effect"
    assert verdict.chosen.effects == {"wind", "attitude_gain"}
    assert min(verdict.probability.values()) > 0.9
    assert max(verdict.probability.values()) <= Decision().true_share


@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.exhaustive) for seed in (2, 3))]
)
def test_clean_flights_show_no_effect(replay, seed):
    _, verdict = judged(replay, seed=seed)
    assert verdict.kind == "none"
    assert verdict.chosen.probability > 0.5


class Shaking(WrenchEffect):
    """A force that no candidate has: it swings with time."""

    parameters = {}  # noqa: RUF012
    door = "wrench"
    needs = ()
    order = 5
    version = "1"
    size = 1.0

    def init(self, n_drones, dt):
        return None

    def wrench(self, memory, flight, vehicle, dt):
        import jax.numpy as jnp

        swing = self.size * jnp.sin(5.0 * flight.t)
        force = vehicle.mass * swing * jnp.asarray([1.0, 0.5, 0.0])
        return None, jnp.broadcast_to(force, flight.pos.shape), jnp.zeros_like(flight.pos)


def test_a_force_that_no_candidate_has_stays_unexplained(replay):
    fits, verdict = judged(replay, Shaking())
    assert verdict.kind == "unexplained"
    assert verdict.unexplained_share > 0.5
    assert verdict.structure.value > 5.0
    assert structure(replay.library, fits.nominal.normal).value > 5.0


class Trembling(Shaking):
    """The same, hardly above noise."""

    size = 0.1


def test_what_leaves_structure_is_doubted_also_where_the_reference_leaves_as_much(replay):
    fits, verdict = judged(replay, Wind(x=1.5), Trembling(), seed=5)
    left = verdict.structure
    assert left.exceeds(Decision().slight_structure, Floor())
    beside = judge(fits, Floor(left.value))
    assert not left.exceeds(Decision().slight_structure, Floor(left.value))
    assert beside.kind == "effect"
    assert beside.chosen.effects == {"wind"}
    assert 0.9 * Decision().doubted_share < beside.probability["wind"] <= Decision().doubted_share


def test_an_excluded_effect_and_its_aliases_are_no_candidates():
    assert with_aliases(["mass"]) == {"mass", "thrust_gain"}
    library = make_library(PointMass(), with_aliases(["wind"]))
    assert not {"wind", "gust"} & set(library.candidates)
    assert "wind" in library.effects  # its slopes still measure what is left over


@pytest.mark.exhaustive  # twenty sets; make test asks each withheld effect's interval for its truth
def test_intervals_cover_the_truth_as_often_as_they_say(replay):
    inside = []
    for seed in range(20):
        likelihood = likelihood_of(replay, Wind(x=0.3), n_flights=3, seconds=4.0, seed=seed)
        fits, wind = Fits.of(Evidence.of(likelihood)), frozenset({"wind"})
        fit = refit(fits, wind, fits.nominal)[wind]
        _, low, high = intervals(fits.evidence, fit)
        inside += list((low < [0.3, 0, 0]) & (high > [0.3, 0, 0]))
    assert np.mean(inside) > 0.86  # 60 intervals of 95 %: below this by chance in 1 of 200


def test_what_the_fit_leaves_widens_intervals_as_much_as_it_should(replay):
    """Noise that is believed to be half of what it is leaves a structure of about four."""
    widths = []
    for believed in (1.0, 0.5):
        likelihood = likelihood_of(replay, Wind(x=0.3), seconds=20.0).noisier(believed)
        fits, wind = Fits.of(Evidence.of(likelihood)), frozenset({"wind"})
        fit = refit(fits, wind, fits.nominal)[wind]
        _, low, high = intervals(fits.evidence, fit)
        widths.append(high - low)
    np.testing.assert_allclose(widths[1], widths[0], rtol=0.15)


def test_dispersion_of_independent_noise_is_one_and_of_moody_flights_is_not(replay):
    calm = likelihood_of(replay, n_flights=8)
    assert dispersion(calm.normal(replay.library.neutral), 8) < 1.6
    moody = [
        fly(with_effects(PointMass(dt=0.005), [Wind(x=0.1 * (-1) ** i)]), n_flights=1, seed=i)[0]
        for i in range(8)
    ]
    likelihood = make_likelihood(replay, moody, SIGMA)
    assert dispersion(likelihood.normal(replay.library.neutral), 8) > 2.0


def test_the_smallest_visible_size_falls_with_the_root_of_flight_time(replay):
    visible = []
    for n_flights in (2, 8):
        evidence = Evidence.of(likelihood_of(replay, n_flights=n_flights))
        fits = attribute(evidence, n_flights).weighed(1.0)
        found = {replay.library.slots[i]: x for i, x in limits(fits.evidence, fits.nominal)}
        visible.append(next(x for slot, x in found.items() if slot.effect == "drag"))
    assert visible[0] / visible[1] == pytest.approx(2.0, rel=0.35)


def test_a_reference_takes_out_what_both_sets_share(replay, dragged):
    fits = beside_reference(replay, dragged, Drag(c=0.5), Wind(x=0.4))
    verdict = judge(fits, dragged.floor)
    assert verdict.chosen.effects == {"wind"}
    free, low, high = intervals(fits.evidence, verdict.chosen.fit)
    assert replay.library.slots[free[0]].parameter == "x"
    assert low[0] - 0.02 < 0.4 < high[0] + 0.02
    assert any(shared.effect == "drag" for shared in dragged.shared(replay.library))


def test_an_interval_holds_both_where_a_reference_stands_at_its_bound(replay):
    """The vehicle answers 14 ms sooner than its simulator, and a delay cannot be negative."""
    sooner, late = PointMass(dt=0.005, attitude_tau=0.09), frozenset({"delay"})
    base = fit_reference(make_likelihood(replay, fly(sooner, seed=1), SIGMA))
    late_flights = fly(with_effects(sooner, [Delay(seconds=0.03)]), n_flights=4, seed=11)
    evidence = beside(make_likelihood(replay, late_flights, base.enlarged * SIGMA), base)
    fits = Fits.of(evidence)
    fit = refit(fits, late, fits.nominal)[late]
    (at,), low, high = intervals(evidence, fit)
    assert base.vector[at] == evidence.low[at] == 0.0
    assert base.pull[at] < 0.0
    (found,), (error,) = sizes(evidence, fit)
    assert found + 4.0 * error < 0.03
    assert low[0] < found < 0.03 < high[0]


def test_a_gust_is_found_beside_a_reference(replay, dragged):
    fits = beside_reference(replay, dragged, Drag(c=0.5), Gust(x=0.3, y=0.8, onset=4.42))
    assert judge(fits, dragged.floor).chosen.effects == {"gust"}


def test_what_a_reference_does_not_show_is_not_shared_with_it():
    """Drones that flew alone say nothing of downwash, which is therefore a change if it is seen."""
    library = make_library(PointMass(dt=0.005), all_but("wind", "downwash"), several_drones=True)
    base = reference_with(make_replay(library, 0.005), Wind(x=0.5))
    error = np.sqrt(base.phi / np.diag(base.precision)) / (library.high - library.low)
    assert library.indices["downwash"]
    assert (error[library.indices["downwash"]] < 1e-6).all()
    assert (error[library.indices["wind"]] > 1e-6).all()


def test_an_excluded_effect_describes_the_reference_but_no_change():
    library = make_library(PointMass(dt=0.005), with_aliases({"drag"}), referenced=True)
    replay, at = make_replay(library, 0.005), library.indices["drag"]
    level = [*at, library.indices["rotor_drag"][1]]
    base = reference_with(replay, Drag(c=0.5))
    fits = beside_reference(replay, base, Drag(c=0.9))
    assert base.vector[level].sum() == pytest.approx(0.5, abs=0.02)
    for fit in fits.ranked():
        assert not fit.effects & {"drag", "quadratic_drag", "rotor_drag"}
        assert fit.total[at] == pytest.approx(base.vector[at], abs=1e-3)
    assert judge(fits, base.floor).kind == "unexplained"


def test_a_start_fades_with_the_drag_of_the_vector(replay):
    """v' = -(c + lateral, axial) v - k |v| v, linearised at v = (3, 0, 4)."""
    library, vector = replay.library, replay.library.neutral.copy()
    for effect, value in (("drag", [0.4]), ("rotor_drag", [0.3, 0.2]), ("quadratic_drag", [0.1])):
        vector[library.indices[effect]] = value
    found = library.braking(vector, np.asarray([[3.0, 0.0, 4.0]]))
    np.testing.assert_allclose(
        found, [[0.6 + 0.1 * (5.0 + 1.8), 0.6 + 0.1 * 5.0, 0.7 + 0.1 * (5.0 + 3.2)]]
    )
    assert not library.braking(library.neutral, np.ones((1, 3))).any()


def test_beside_a_reference_that_is_not_followed_a_second_effect_must_be_worth_its_name(replay):
    """A wind that explains a thousandth of the gap counts beside the simulator alone."""
    flights = point_mass_set(Drag(c=1.0), Wind(x=0.02), seed=3).flights
    evidence = Evidence.of(make_likelihood(replay, flights, SIGMA))
    fits = attribute(evidence, len(flights))
    by_set = {fit.effects: fit.objective for fit in fits.ranked()}
    both, one = by_set[frozenset({"drag", "wind"})], by_set[frozenset({"drag"})]
    assert (one - both) / (fits.nominal.objective - both) < Decision().worthy_share
    assert judge(fits).chosen.effects == {"drag", "wind"}
    assert judge(fits, Floor(1.3)).chosen.effects == {"drag"}
    assert [Floor(x).unlike() for x in (1.0, 1.3)] == [0.0, 1.0]


def test_windows_after_gaps_that_all_fit_badly_are_a_finding(replay):
    """A wind that nothing explains is not left out with windows that are doubted."""
    keep = np.setdiff1d(np.arange(300), [*range(90, 100), *range(190, 200)])
    flights = point_mass_set(Wind(x=0.5), n_flights=6, seconds=6.0, seed=4).flights
    flown = tuple(thinned(flight, keep) for flight in flights)
    likelihood = make_likelihood(replay, flown, SIGMA)
    normal = likelihood.normal(replay.library.neutral)
    assert (normal.doubtful & (normal.c > 2.0 * normal.dof)).sum() > 0.5 * normal.doubtful.sum() > 4
    likelihood = likelihood.settled(replay.library.neutral, beyond(2.5))
    assert not len(likelihood.aside.c)
    assert likelihood.normal(replay.library.neutral).dof.sum() == normal.dof.sum()


def test_flights_with_bad_windows_after_a_gap_distrust_only_those(replay):
    flights = point_mass_set(n_flights=3, seconds=6.0).flights
    assert len(flights[0].drones[0].t) == 300
    (lost,) = thinned(flights[0], np.setdiff1d(np.arange(300), np.arange(150, 160))).drones
    pos = lost.pos.copy()
    pos[(lost.t > 3.75) & (lost.t < 3.9)] += 0.05  # within the doubtful time
    pos[(lost.t > 1.75) & (lost.t < 1.9)] += 0.05  # outside of it
    spoiled = dataclasses.replace(lost, pos=pos)
    flown = (dataclasses.replace(flights[0], drones=(spoiled,)), bumped(flights[1]), flights[2])
    likelihood = make_likelihood(replay, flown, SIGMA)
    likelihood = likelihood.settled(replay.library.neutral, beyond(4.0))
    assert likelihood.aside.t.tolist() == [3.5]
    assert likelihood.aside.flight.tolist() == [0]


def bumped(flight):
    """The flight with 5 cm on its position for a moment, in one window."""

    def bump(log):
        return {"pos": log.pos + 0.05 * ((log.t > 2.25) & (log.t < 2.4))[:, None]}

    return edited(flight, bump)


@few_or_all()
def test_a_bump_in_one_flight_does_not_count_and_is_told(exclude):
    """A wind is measured as well as without it; bumps in two flights are a finding."""
    flights = point_mass_set(Wind(x=0.3), n_flights=4).flights
    sets = [flight_set([*map(bumped, flights[:n]), *flights[n:]]) for n in (1, 2)]
    once, twice = (diagnose(s, simulator="point_mass", exclude=exclude) for s in sets)
    (line,) = once.details.set_aside
    assert (line.flight, line.t) == ("flight_0", 2.0)
    assert line.misfit > 4.0
    (wind,) = once.effects
    assert wind.parameter("x").value == pytest.approx(0.3, abs=0.01)
    assert once.remainder.structure < 1.2
    assert twice.details.set_aside == ()
