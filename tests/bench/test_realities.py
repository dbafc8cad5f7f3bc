"""Realities as text: numbers, distributions, sensing, and worlds with a name."""

import pytest

from bench.cli.checks import check_reality
from bench.plan.expansion import PlanError, expand
from bench.plan.names import worlds
from bench.plan.realities import parse_reality, shortened, written
from bench.plan.suite import Row, Suite
from bench.stats.statistics import Entry, cells_meant, default_of
from bench.text.errors import UsageError
from simulators.drawn.drawn_team import Drawn
from simulators.effects.chain import canonical
from simulators.registry import UnknownPluginError

LAW = "crazyflow+mass(e~normal(0,0.05))+drag(c=1)"


def test_a_reality_is_written_canonically():
    assert written(parse_reality(LAW)) == "crazyflow+Drag(c=1); Mass(e~normal(0, 0.05))"
    spaced = "crazyflow + drag(c = 1) + mass( e ~ normal( 0 , 5e-2 ) )"
    assert written(parse_reality(spaced)) == written(parse_reality(LAW))
    plain = parse_reality("crazyflow+wind(x=1, y=-0.5)+mass(e=0.2)")
    assert written(plain) == "crazyflow+Mass(e=0.2); Wind(x=1, y=-0.5, z=0)"


def test_a_variant_that_names_a_drawn_world_is_understood():
    reality = parse_reality(LAW)
    entry = Entry("hybrid", "mlp", f"reality={written(reality)}, trainer.lr=0.01")
    assert default_of(entry).variant == f"reality={written(reality)}"
    (cell,) = cells_meant("circle", 3, entry.variant, ())
    assert cell.deployed_effects == canonical(reality.effects)


def test_a_reality_without_draws_is_the_simulator_itself():
    assert not isinstance(parse_reality("crazyflow+mass(e=0.1)"), Drawn)


@pytest.mark.parametrize("name", sorted(worlds()))
def test_a_world_with_a_name_is_what_its_text_says(name):
    check_reality(name)
    assert written(parse_reality(name)) == written(parse_reality(worlds()[name]))


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("mass(e~0.1)", "with a distribution such as ~normal"),
        ("mass(e~normal(0.1))", "with a distribution such as ~normal"),
        ("mass(e~gamma(1, 2))", r"must be uniform\(LEAST, LARGEST\) or normal"),
        ("mass(e~normal(0, 0))", "standard deviation of a normal must be above 0"),
        ("mass(e~normal(0.7, 0.1))", r"mean of a normal must lie .* in \[-0.3, 0.6\]"),
        ("mass(e~uniform(0.2, 0.1))", "must rise and lie within"),
        ("mass(e~uniform(0, 0.7))", "must rise and lie within"),
        ("mass(e~normal(x, 0.1))", "finite numbers"),
        ("mass(e=0.1, e~normal(0, 0.1))", "given twice"),
        ("mass(q=1)", "its parameters are e"),
        ("mass(e=lots)", "each with a number"),
        ("mass(e=nan)", "each with a number"),
        ("attitude_loop(damping=1)", "does not have"),
        ("sensing(latency=0.1)", r"latency of 'sensing' must lie in \[0, 0.06\]"),
        ("mass(e~normal(0, 0.1))+collision(radius=0.1)", "Collision acts between drones"),
    ],
)
def test_an_effect_that_makes_no_sense_is_refused(text, match):
    with pytest.raises(UsageError, match=match):
        parse_reality(f"crazyflow+{text}")


def test_an_unknown_effect_of_a_drawn_reality_is_named_at_once():
    with pytest.raises(UnknownPluginError, match="Did you mean"):
        check_reality("crazyflow+mas(e~normal(0, 0.1))+sensing(pos=0.1)")


def test_the_key_of_a_run_knows_how_its_team_was_drawn():
    rows = (Row("grey_box", reality=LAW), Row("grey_box", reality="crazyflow+drag(c=1)"))
    drawn, plain = expand(Suite("mine", "", ("circle",), (3,), 1, rows)).runs
    assert drawn.resolved["versions"]["drawn team"] == "1"
    assert "module simulators.drawn.sensing" in drawn.sources
    assert "drawn team" not in plain.resolved["versions"]
    assert "reality=crazyflow+Drag(c=1); Mass(e~normal(0, 0.05))" in drawn.variant


@pytest.mark.parametrize("name", sorted(worlds()))
def test_people_read_the_name_of_a_world_and_not_what_it_is_made_of(name):
    text = written(parse_reality(name))
    assert shortened(f"hf_scratch (reality={text})") == f"hf_scratch (reality={name})"
    longer = f"{text}; Wind(x=1, y=0)"
    assert shortened(longer) == longer  # another world
    assert shortened("crazyflow") == "crazyflow"


def test_whoever_takes_a_parents_calibration_takes_one_of_its_own_reality():
    """Hybrid once flies nothing: a residual from crazyflow is no calibration in RotorPy."""

    def parents(method, reality):
        row = Row(method, reality=reality)
        runs = expand(Suite("s", "", ("circle",), (3,), 1, (row,))).runs
        child = next(run for run in runs if run.method == method)
        return [run for run in runs if run.name in child.parents.values()]

    (calibrated,) = parents("hybrid_once", "rotorpy")
    assert (calibrated.method, calibrated.reality) == ("hybrid", "rotorpy")
    assert (calibrated.task, calibrated.team_size) == ("figure8", 3)
    (home,) = parents("hybrid_once", "")
    assert home.reality == "crazyflow"
    assert home.name != calibrated.name
    # What starts from a policy and flies itself starts from the policy of home.
    for method in ("hf_hotstart", "recalibrated", "online"):
        assert all(run.reality == "crazyflow" for run in parents(method, "rotorpy"))


def test_seeds_of_tuning_and_of_results_stand_in_no_suite_together():
    def suite(first, seeds):
        return Suite("s", "", ("circle",), (3,), seeds, (Row("lf_baseline"),), first_seed=first)

    with pytest.raises(PlanError, match=r"must lie below 1000 .* got 998 to 1001"):
        expand(suite(998, 4))
    for first in (998, 1000):
        assert len(expand(suite(first, 2)).runs) == 2
