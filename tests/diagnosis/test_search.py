"""Steps within bounds, starts of windows, gates and what acts on top of a reference."""

import dataclasses

import numpy as np
import pytest
from flights_for_tests import SIGMA, point_mass_set
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from diagnosis.decide.attribution import attribute
from diagnosis.decide.prepared import make_likelihood
from diagnosis.decide.reference import pinned
from diagnosis.decide.verdict import Floor, Structure, intervals, judge, structure
from diagnosis.decision import Decision
from diagnosis.fit import search
from diagnosis.fit.descent import polished
from diagnosis.fit.equations import bounded_step
from diagnosis.fit.evidence import Evidence, bounds
from diagnosis.fit.likelihood import NARROW, Likelihood
from diagnosis.fit.outliers import beyond
from diagnosis.fit.search import Fits, polish, refit
from diagnosis.logs.segments import REPLAY_WINDOW_S, cut
from diagnosis.replay.library import Slot, make_library
from diagnosis.replay.replay import TURNS, Replay
from diagnosis.replay.whitening import shown
from simulators.crazyflow import Crazyflow
from simulators.effects.drag import Drag
from simulators.effects.gust import Gust
from simulators.effects.wind import Wind


@pytest.mark.parametrize("seed", range(8))
def test_a_bounded_step_is_the_best_within_its_bounds(seed):
    """Against a general minimiser, with correlations that make clipping alone wrong."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 4)) + 2.0 * rng.normal(size=(6, 1))
    H, g = root.T @ root, root.T @ rng.normal(size=6) * 3.0
    low, high = -rng.uniform(0.0, 0.4, 4), rng.uniform(0.0, 0.4, 4)
    step = bounded_step(H, g, low, high)

    def cost(x):
        return x @ H @ x - 2 * g @ x

    best = minimize(
        cost, np.zeros(4), jac=lambda x: 2 * (H @ x - g), bounds=list(zip(low, high, strict=True))
    )
    assert ((step >= low - 1e-9) & (step <= high + 1e-9)).all()
    assert cost(step) <= best.fun + 1e-6 * abs(best.fun)


def test_a_step_of_nothing_observed_is_zero():
    H = np.diag([2.0, 0.0])
    np.testing.assert_allclose(
        bounded_step(H, np.asarray([1.0, 0.0]), -np.ones(2), np.ones(2)), [0.5, 0.0], atol=1e-9
    )
    assert not bounded_step(np.zeros((2, 2)), np.zeros(2), -np.ones(2), np.ones(2)).any()


def test_a_step_along_what_is_hardly_observed_stays_within_its_bounds():
    H, g, high = np.diag([2.0, 1e-50]), np.asarray([1.0, 1e-20]), np.asarray([1.0, 3.0])
    step = bounded_step(H, g, -np.ones(2), high)
    assert (step <= high).all()
    assert step[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("neutral", "factor", "base", "value", "vector"),
    [
        (0.0, True, 0.25, 0.6, 1.0),  # 1.25 x 1.6 = 1 + 1.0
        (1.0, True, 1.5, 2.0, 3.0),
        (0.0, False, 0.25, 0.6, 0.85),
        (0.0, True, -1.0, 0.6, -0.4),  # of nothing there is no ratio
        (1.0, True, 0.0, 1.6, 0.6),
    ],
)
def test_what_acts_on_top_of_a_reference(neutral, factor, base, value, vector):
    slot = Slot("inertia", "e", "-", neutral, -9.0, 9.0, factor)
    assert slot.on_top(value, base) == pytest.approx(vector)
    found, slope = slot.beyond(vector, base)
    assert found == pytest.approx(value)
    ahead, _ = slot.beyond(vector + 1e-6, base)
    assert slope == pytest.approx((ahead - found) / 1e-6, rel=1e-4)


def test_bounds_of_factors_go_with_the_reference_and_none_is_narrowed(replay):
    library = replay.library
    place = {(slot.effect, slot.parameter): i for i, slot in enumerate(library.slots)}
    mass, wind = place["mass", "e"], place["wind", "x"]
    base = library.neutral.copy()
    base[mass], base[wind] = 0.5, 1.0
    low, high = bounds(library.slots, base)
    slot = library.slots[mass]
    assert high[mass] == pytest.approx(1.5 * (1.0 + slot.high) - 1.0)
    assert low[mass] == slot.low
    assert (low[wind], high[wind]) == (library.low[wind], library.high[wind])
    base[mass] = -1.0  # nothing to multiply
    low, high = bounds(library.slots, base)
    assert (low[mass], high[mass]) == (library.low[mass], library.high[mass])
    kept = bounds(library.slots, library.neutral)
    np.testing.assert_allclose(kept, (library.low, library.high), rtol=1e-12)


def test_a_fresh_start_shows_in_three_windows():
    fresh = np.zeros((1, 7, 1), bool)
    fresh[0, [0, 4], 0] = True  # the first window is not scored
    assert shown(fresh)[0, :, 0].tolist() == [True, True, False, True, True, True]


def test_structure_counts_only_beyond_what_so_few_numbers_show_by_chance():
    long, short = Structure(1.3, 800, 16), Structure(1.3, 100, 2)
    assert long.exceeds(Decision().slight_structure, Floor())
    assert not short.exceeds(Decision().slight_structure, Floor())
    assert not long.exceeds(Decision().slight_structure, Floor(1.2))
    assert long.exceeds(Decision().slight_structure, Floor(1.05, 0.2))
    assert not long.exceeds(Decision().slight_structure, Floor(1.05, 0.4))


def test_short_clean_logs_raise_no_alarm(replay):
    """Single flights of 6 s: the threshold for long logs would be passed by some of them."""
    settings = {"n_flights": 1, "seconds": 6.0}
    flights = [point_mass_set(**settings, seed=100 + seed).flights[0] for seed in range(16)]
    normal = make_likelihood(replay, flights, SIGMA).normal(replay.library.neutral)
    found = [structure(replay.library, one) for one in normal.by_flight()]
    assert len(found) == 16
    assert any(one.value > Decision().slight_structure for one in found)
    assert sum(one.exceeds(Decision().slight_structure, Floor()) for one in found) <= 1


def test_a_start_that_is_turned_costs_little_and_one_that_is_not_measured_would(replay):
    """Attitudes at fresh starts are nuisances: an error of 0.03 rad there is taken out."""
    flights = point_mass_set(n_flights=2).flights
    likelihood = Likelihood(replay, cut(flights, replay.dt), SIGMA)
    before = likelihood.normal(replay.library.neutral).chi2
    turn = Rotation.from_euler("xyz", [0.03, -0.03, 0.03])
    for group in likelihood.groups:
        fresh = group.fresh.astype(bool)
        group.quat[fresh] = (Rotation.from_quat(group.quat[fresh]) * turn).as_quat()
    likelihood.cache.replays.clear()
    turned = likelihood.normal(replay.library.neutral).chi2
    for key, turns in likelihood.cache.turns.items():
        likelihood.cache.turns[key] = dataclasses.replace(turns, less=np.zeros_like(turns.less))
    likelihood.cache.replays.clear()
    believed = likelihood.normal(replay.library.neutral).chi2
    # Most of it is forgotten when scoring begins; of the rest the nuisances take four fifths.
    assert believed - before > 30.0
    assert turned - before < 0.3 * (believed - before)


class SpoiledReplay(Replay):
    """The first window of a segment has no numbers where there is any drag."""

    def __call__(self, group, vectors, along, turns=True):
        (at,) = self.library.indices["drag"]
        for chosen, prediction in super().__call__(group, vectors, along, turns):
            value, slope, turn = (
                np.array(x, float) for x in (prediction.value, prediction.slope, prediction.turn)
            )
            if vectors[0, at] != self.library.neutral[at]:
                value[0], slope[:, 0], turn[:, 0] = np.nan, np.nan, np.nan
            yield chosen, dataclasses.replace(prediction, value=value, slope=slope, turn=turn)


def test_a_vector_that_cannot_be_flown_spoils_no_other(replay):
    """A window without numbers where a parameter is wild: it counts elsewhere, and is no rival."""
    flights = point_mass_set(n_flights=1).flights
    likelihood = make_likelihood(replay, flights, SIGMA)
    before = likelihood.normal(replay.library.neutral)

    (at,) = replay.library.indices["drag"]
    wild = replay.library.neutral.copy()
    wild[at] = 2.0
    spoiled = SpoiledReplay(library=replay.library, dt=replay.dt)
    likelihood = Likelihood(spoiled, likelihood.groups, SIGMA).settled(wild, beyond(6.0))
    assert not np.isfinite(likelihood.normal(wild).chi2)
    after = likelihood.normal(replay.library.neutral)
    assert np.isfinite(after.chi2)
    assert after.chi2 == pytest.approx(before.chi2, rel=0.2)
    evidence = Evidence.of(likelihood, None, np.eye(len(wild)))
    spoiled = evidence.made(frozenset({"drag"}), wild)
    assert evidence.log_evidence(spoiled) == -np.inf
    found = polish(Fits(evidence, {spoiled.effects: spoiled}), spoiled.effects)
    np.testing.assert_array_equal(found[spoiled.effects].vector, wild)


def test_a_shared_shift_to_first_order_stays_within_the_bounds(replay):
    """A drag that pushes by 1 1/s takes the shift to its lower bound and no further."""
    flights = point_mass_set(Drag(c=-1.0), n_flights=1).flights
    likelihood = make_likelihood(replay, flights, SIGMA)
    library, weak = replay.library, 1e-3 * np.eye(len(replay.library.slots))
    fit = Evidence.of(likelihood, None, weak).made(frozenset(), library.neutral)
    finite = library.neutral <= library.high
    assert (fit.total >= library.low - 1e-9)[finite].all()
    assert (fit.total <= library.high + 1e-9)[finite].all()
    (at,) = library.indices["drag"]
    assert fit.total[at] == pytest.approx(library.low[at], abs=1e-9)


def test_nothing_moves_before_the_first_row(replay):
    """What was commanded before a flight began is not known and changes no prediction."""
    flights = point_mass_set(n_flights=1).flights
    likelihood = make_likelihood(replay, flights, SIGMA)
    (group,) = likelihood.groups
    vector = replay.library.neutral[None]
    along = np.eye(len(replay.library.slots))
    (_, before), *_ = list(replay(group, vector, along))
    unknown = group.start < 0
    assert unknown.any()
    steps = round(REPLAY_WINDOW_S / replay.dt)
    # The first command of the window is where the drone starts; the others must not act.
    group.cmd[unknown, 1:steps] += np.asarray([0.3, -0.3, 0.5, 0.2])
    (_, after), *_ = list(replay(group, vector, along))
    np.testing.assert_array_equal(after.value, before.value)
    np.testing.assert_array_equal(after.slope, before.slope)


def test_a_replay_along_some_parameters_is_that_part_of_the_whole(replay):
    flights = point_mass_set(n_flights=1).flights
    vector = replay.library.neutral.copy()
    (at,) = replay.library.indices["drag"][:1]
    vector[at] += 0.2
    along = [at, *replay.library.indices["mass"], *replay.library.indices["wind"]]
    assert len(along) <= NARROW < len(vector)
    narrow = make_likelihood(replay, flights, SIGMA).normal(vector, along)
    whole = make_likelihood(replay, flights, SIGMA).normal(vector)
    np.testing.assert_allclose(narrow.c, whole.c, rtol=1e-5)
    np.testing.assert_array_equal(narrow.dof, whole.dof)
    part = np.ix_(range(len(whole.c)), along, along)
    for found, expected in (
        (narrow.g[:, along], whole.g[:, along]),
        (narrow.H[part], whole.H[part]),
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-5 * np.abs(expected).max())
    others = [i for i in range(len(vector)) if i not in along]
    assert np.abs(whole.g[:, others]).max() > 0.0
    assert not narrow.g[:, others].any()


@pytest.mark.parametrize("onset", [2.97, 3.03])
def test_an_onset_beside_the_edge_of_a_window_is_found(replay, onset):
    """Shortly before and shortly behind an edge look alike to the windows there."""
    flights = point_mass_set(Gust(x=0.8, y=0.3, onset=onset), seed=4).flights
    evidence = Evidence.of(make_likelihood(replay, flights, SIGMA))
    fits = attribute(evidence, len(flights))
    verdict = judge(fits)
    assert verdict.chosen.effects == {"gust"}
    free, low, high = intervals(fits.evidence, verdict.chosen.fit)
    found = {
        replay.library.slots[i].parameter: (a + b) / 2
        for i, a, b in zip(free, low, high, strict=True)
    }
    assert found["onset"] == pytest.approx(onset, abs=0.02)


def test_what_a_start_may_err_is_flown_only_where_it_is_asked_for(replay):
    flights = point_mass_set(n_flights=1).flights
    (group,) = make_likelihood(replay, flights, SIGMA).groups
    vector, every = replay.library.neutral[None], np.eye(len(replay.library.slots))
    (_, whole), *_ = list(replay(group, vector, every))
    (_, less), *_ = list(replay(group, vector, every[:NARROW], turns=False))
    assert len(whole.turn) == TURNS
    assert np.abs(whole.turn).max() > 0.0
    assert len(less.turn) == 0
    np.testing.assert_allclose(less.value, whole.value, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(less.slope, whole.slope[:NARROW], rtol=1e-3, atol=1e-4)


def test_larger_sets_are_tried_from_the_polished_one_not_from_where_they_were(replay, monkeypatch):
    flights = point_mass_set(Drag(c=0.4), n_flights=3).flights
    fits = Fits.of(Evidence.of(make_likelihood(replay, flights, SIGMA)))
    drag, both = frozenset({"drag"}), frozenset({"drag", "wind"})
    fits = refit(fits, drag, fits.nominal)
    fits = refit(fits, both, fits[drag])
    fits = fits.settled(fits[drag].total)
    fits = refit(fits, drag, fits.nominal)
    fits = refit(fits, both, fits[drag])
    begun = []
    monkeypatch.setattr(
        search, "fitted", lambda evidence, effects, near, goal: begun.append(near) or fits[both]
    )
    monkeypatch.setattr(
        search, "_grow", lambda fits, front: (refit(fits, both, front[0]), [fits[drag]])
    )
    grown = search.outgrow(fits, fits[drag])
    assert both in fits.known
    assert [near is fits[drag] for near in begun] == [True]
    assert grown[both] is fits[both]


def test_no_step_of_a_search_changes_the_fits_that_it_was_given(replay):
    flights = point_mass_set(Drag(c=0.4), n_flights=2).flights
    fits = Fits.of(Evidence.of(make_likelihood(replay, flights, SIGMA)))
    found = search.search(fits, largest=1)
    assert frozenset({"drag"}) in found.by_set
    assert set(fits.by_set) == {frozenset()}
    assert found.settled(found.best.total).by_set.keys() == {frozenset()}
    for record, name in ((fits, "evidence"), (fits.evidence, "phi"), (found.best, "vector")):
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(record, name, None)
    with pytest.raises(dataclasses.FrozenInstanceError):
        fits.evidence.likelihood.sigma = SIGMA


def test_a_polished_set_is_worth_what_it_flies_with_its_shared_shift(replay):
    """Drag that the reference did not quite tell beside a wind: the shift follows by flying."""
    flights = point_mass_set(Drag(c=0.8), Wind(x=0.6), n_flights=3).flights
    likelihood = make_likelihood(replay, flights, SIGMA)
    library = replay.library
    (drag,) = library.indices["drag"]
    precision = np.diag(np.full(len(library.slots), 1e9))
    precision[drag, drag] = 1.0
    fits = Fits.of(Evidence.of(likelihood, library.neutral, precision))
    wind = frozenset({"wind"})
    fits = polish(refit(fits, wind, fits.nominal), wind)
    polished = fits[wind]
    assert not polished.ahead.any()
    assert polished.total[drag] == pytest.approx(0.8, abs=0.05)
    shared = polished.shared
    flown = likelihood.normal(polished.vector).chi2 + float(shared @ precision @ shared)
    assert polished.objective == pytest.approx(flown, rel=1e-6)
    again = polish(fits, wind)[wind]
    assert again.objective == pytest.approx(polished.objective, abs=0.1)


def test_a_damped_step_is_shorter_and_an_undamped_one_solves_both(replay, monkeypatch):
    likelihood = make_likelihood(replay, point_mass_set(Drag(c=0.4), n_flights=2).flights, SIGMA)
    library = replay.library
    precision = np.diag(np.full(len(library.slots), 1e3))
    evidence = Evidence.of(likelihood, library.neutral, precision)
    drag = frozenset({"drag"})
    fit, (at,) = evidence.as_flown(evidence.made(drag, library.neutral)), library.indices["drag"]
    vector, shared, promise = evidence.joint_step(fit, 0.0)
    H, g = fit.normal.H.sum(axis=0), fit.normal.g.sum(axis=0)
    assert abs((g - H @ (vector - library.neutral))[at]) < 1e-2 * abs(g[at])
    size = np.sqrt(np.diag(H))

    def length(vector, shared):
        step = (vector - library.neutral - shared)[at]
        return np.linalg.norm([size[at] * step, *(size * shared)])

    *damped, less = evidence.joint_step(fit, 1.0)
    assert length(*damped) < 0.9 * length(vector, shared)
    gain = fit.objective - evidence.as_flown(evidence.made(drag, vector, shared)).objective
    assert 0.0 < less < promise == pytest.approx(gain, rel=0.3)
    settled, flights = polished(evidence, fit, -np.inf), []
    counted = lambda *a, f=Evidence.as_flown: flights.append(a) or f(*a)  # noqa: E731
    monkeypatch.setattr(Evidence, "as_flown", counted)
    polished(evidence, settled, -np.inf)
    assert len(flights) == 1  # no more is promised than what ends a fit
    broken = dataclasses.replace(fit.normal, H=np.full_like(fit.normal.H, np.nan))
    stays = [*fit.vector, *fit.shared, 0.0]
    np.testing.assert_array_equal(np.hstack(evidence.joint_step(fit, others=broken)), stays)


@pytest.mark.parametrize("neutral", [0.0, 1.0])
def test_factors_walk_along_what_holds_their_ratio(neutral):
    factor = Slot("inertia", "e", "-", neutral, -9.0, 9.0, True)
    one = 1.0 - neutral
    for value in (-0.4, 0.0, 1.2):
        x = value + neutral
        slope = (factor.walked(x, 1e-6) - x) / 1e-6
        assert slope == pytest.approx(1.0, rel=1e-4)
        assert factor.walked(x, 0.3 * (x + one)) + one == pytest.approx(np.exp(0.3) * (x + one))
    assert factor.walked(neutral, -5.0) == neutral - 5.0  # too far for a factor
    assert factor.walked(-one, 0.0) == -one  # nothing is left of it
    assert factor.walked(-one, 0.2) == pytest.approx(0.2 - one)
    assert Slot("drag", "c", "1/s", 0.0, -1.0, 1.0).walked(0.2, 0.3) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("excluded", "shifts"), [((), True), (("battery",), True), (("inertia",), False)]
)
def test_what_only_references_show_shifts_unless_it_acts_like_what_is_excluded(excluded, shifts):
    library = make_library(Crazyflow(), excluded, referenced=True)
    firm = np.diag(pinned(library, np.eye(len(library.slots))))
    (arm,) = library.indices["rotor_arm"]
    assert (firm[arm] == 1.0) == shifts
    for name in excluded:
        assert (firm[library.indices[name]] > 1.0).all()
    assert (firm[library.indices["gyro_compensation"]] == 1.0).all()


def test_the_variance_of_a_factor_counts_with_what_the_reference_leaves_open(replay):
    """Against the inverse of the joint curvature of free parameters and shared shift."""
    likelihood = make_likelihood(replay, point_mass_set(Drag(c=0.4), n_flights=2).flights, SIGMA)
    library, rng = replay.library, np.random.default_rng(0)
    n = len(library.slots)
    precision = np.diag(rng.uniform(10.0, 1e3, n))
    evidence = Evidence.of(likelihood, library.neutral, precision)
    both = frozenset({"drag", "wind"})
    fit, free = evidence.made(both, library.neutral), evidence.free(both)
    H = fit.normal.H.sum(axis=0)
    joint = np.block([[H[np.ix_(free, free)], H[free]], [H[:, free], H + precision]])
    following = rng.normal(size=len(free))
    along = np.zeros((len(free), len(joint)))
    along[np.arange(len(free)), np.arange(len(free))] = 1.0
    along[np.arange(len(free)), len(free) + np.asarray(free)] = following
    expected = np.diag(along @ np.linalg.pinv(joint, hermitian=True) @ along.T)
    np.testing.assert_allclose(evidence.variance(fit, free, following), expected, rtol=1e-5)
