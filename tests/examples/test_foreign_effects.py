"""Effects of another package take part everywhere, without a change to any file of ours."""

import copy
import shutil
from pathlib import Path

import diagnoses_for_tests
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flights_for_tests import SIGMA, fly
from installed import fresh_registry

from bench.diagnosis_report.documents import diagnosis_text
from bench.diagnosis_report.effect_words import effect_phrase
from bench.diagnosis_report.page import diagnosis_page
from blind.draw import cases, catalogue
from blind.fly.crazyflow_reality import CrazyflowReality
from blind.fly.rotorpy_reality import RotorpyReality
from diagnosis.decide.advice import next_flight
from diagnosis.decide.attribution import attribute
from diagnosis.decide.prepared import make_likelihood
from diagnosis.decide.reference import _prior
from diagnosis.decide.verdict import intervals, judge
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.search import Fits, refit
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.replay import make_replay
from simulators import registry
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects.gust import Gust
from simulators.point_mass import PointMass

SOURCE = Path(__file__).with_name("foreign_effects.py")
POINTS = """\
[bench.effects]
updraft = foreign_effects:Updraft
broken_blade = foreign_effects:BrokenBlade
"""
CANDIDATES = {"updraft", "broken_blade", "wind", "gust", "mass", "thrust_gain", "drag"}
"""The two foreign effects, the effects of ours that look like them, and a drag."""


@pytest.fixture(scope="module", autouse=True)
def _installed(tmp_path_factory):
    """A folder with the package is on the path of this process."""
    site = tmp_path_factory.mktemp("site")
    shutil.copy(SOURCE, site)
    info = site / "foreign_effects-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-effects\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(POINTS)
    with fresh_registry(site):
        yield


@pytest.fixture(scope="module")
def replay(_installed):
    """Of few candidates; `test_attribution.py` has all of ours."""
    exclude = [name for name in registry.names("effect") if name not in CANDIDATES]
    return make_replay(make_library(PointMass(dt=0.005), exclude), 0.005)


def kind(name):
    return registry.load("effect", name)


def found_in(replay, *effects, seed):
    flights = fly(with_effects(PointMass(dt=0.005), effects), seed=seed)
    fits = attribute(Evidence.of(make_likelihood(replay, flights, SIGMA)), len(flights))
    return fits.evidence, judge(fits)


def test_they_are_candidates_and_go_with_their_families():
    assert {"updraft", "broken_blade"} <= set(make_library(Crazyflow()).candidates)
    assert with_aliases(["updraft"]) == {"updraft", "wind", "gust"}
    assert "updraft" in with_aliases(["wind"])
    assert with_aliases(["broken_blade"]) == {"broken_blade"}
    assert "updraft" not in make_library(Crazyflow(), with_aliases(["wind"])).candidates


def test_a_foreign_effect_is_found_with_its_size(replay):
    evidence, verdict = found_in(replay, kind("updraft")(k=0.5), seed=3)
    assert verdict.kind == "effect"
    assert verdict.chosen.effects == {"updraft"}
    _, low, high = intervals(evidence, verdict.chosen.fit)
    assert low[0] - 0.05 < 0.5 < high[0] + 0.05


def test_what_sets_in_is_dated_though_it_is_no_gust(replay):
    _, verdict = found_in(replay, kind("broken_blade")(e=0.06, onset=3.2), seed=4)
    assert verdict.chosen.effects == {"broken_blade"}
    found = replay.library.named(verdict.chosen.fit.total, "broken_blade")
    assert found["onset"] == pytest.approx(3.2, abs=0.1)
    assert found["e"] == pytest.approx(0.06, rel=0.1)


def test_two_effects_that_set_in_are_dated_beside_each_other(replay):
    made = [Gust(x=0.8, y=0.3, onset=2.2), kind("broken_blade")(e=0.06, onset=4.2)]
    flights = fly(with_effects(PointMass(dt=0.005), made), seed=5)
    fits = Fits.of(Evidence.of(make_likelihood(replay, flights, SIGMA)))
    effects = frozenset({"gust", "broken_blade"})
    _, times = fits.evidence.set_in(effects, fits.nominal)
    assert times == pytest.approx({"gust": 2.2, "broken_blade": 4.2}, abs=0.6)
    fit = refit(fits, effects, fits.nominal)[effects]
    onsets = {n: replay.library.named(fit.vector, n)["onset"] for n in effects}
    assert onsets == pytest.approx({"gust": 2.2, "broken_blade": 4.2}, abs=0.1)


def test_what_has_no_slope_at_neutral_is_not_shared_with_a_reference(replay):
    library, precision = replay.library, _prior(replay.library)
    relative = precision * (library.high - library.low) ** 2
    own, others = library.indices["broken_blade"], library.indices["updraft"]
    assert (relative[own] > 1e6 * relative[others]).all()


def test_the_page_speaks_of_them_in_their_words():
    found = copy.deepcopy(diagnoses_for_tests.effect())
    rise = diagnoses_for_tests.parameter("k", 0.31, 0.3, 0.32, "1/s^2")
    found["effects"][0] |= {"name": "updraft", "parameters": [rise]}
    told = diagnoses_for_tests.load(found)
    phrase = effect_phrase(told.effects[0], "believed")
    assert phrase.startswith("air that rises by 31.0 cm/s² a metre with the distance (95 %: 30.0")
    for document in (diagnosis_text(told), diagnosis_page(told)):
        assert "Air rises the faster, the further forward the drone flies." in document
        assert "rising air" in document
    found["effects"][0]["name"] = "broken_blade"
    size = diagnoses_for_tests.parameter("e", 1.0, 1.0, 1.0, "-")
    found["effects"][0]["parameters"] = [size]
    (plain,) = diagnoses_for_tests.load(found).effects[:1]
    assert "the effect broken blade" in effect_phrase(plain, "believed")


def test_the_advice_knows_the_flights_that_show_and_separate_them():
    said = next_flight("effect", {"wind": ["updraft"]}, None, [], 8)
    assert said.startswith("To separate wind from rising air: hover on both sides of the room")
    assert "hover at x = -1, 0 and 1 m" in next_flight("none", {}, None, ["updraft"], 8)


def test_bench_blind_draws_and_excludes_them():
    assert "updraft" in catalogue.known("crazyflow")
    assert "broken_blade" not in catalogue.known("crazyflow"), "its card draws nothing"
    assert "updraft" not in catalogue.known("rotorpy")
    n = len(catalogue.known("crazyflow"))
    drawn = cases.draw_cases({"single": 3 * n, "excluded": 3 * n, "pair": 300}, entropy=7)
    single = [c for c in drawn if c.kind == "single" and c.effects[0].name == "updraft"]
    assert sorted(c.effects[0].parameters["k"] for c in single) == [0.1, 0.3, 0.8]
    assert {"updraft"} in [set(c.exclude) for c in drawn]
    partners = {frozenset(e.name for e in c.effects) for c in drawn if c.kind == "pair"}
    assert frozenset({"updraft", "mass"}) in partners
    assert not {frozenset({"updraft", "wind"}), frozenset({"updraft", "gust"})} & partners


def test_bench_blind_flies_them_by_their_own_class():
    effect = catalogue.draw_effect("updraft", 2, np.random.default_rng(0), 10.0)
    made = catalogue.make_disturbance((effect,), 2, np.random.default_rng(0))
    one = jax.tree.map(lambda x: x[1], made)
    pos, cmd = jnp.asarray([[1.5, 0.0, 1.0]]), jnp.asarray([[0.0, 0.0, 0.0, 0.0434 * 9.81]])
    climbs = []
    for disturbance in (one, one._replace(borrowed=())):
        reality, state = CrazyflowReality(), None
        state = reality.start(disturbance, pos)
        for _ in range(5):
            state = reality.step(disturbance, state, cmd)
        climbs.append(float(reality.truth(state)[0, 5]))
    # 0.8 1/s^2 at 1.5 m for 10 ms.
    assert climbs[0] - climbs[1] == pytest.approx(0.8 * 1.5 * 0.01, rel=0.02)
    with pytest.raises(ValueError, match="RotorPy has no doors for effects; fly Updraft"):
        RotorpyReality().start(one, pos)
