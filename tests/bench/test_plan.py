import dataclasses
import math
import re

import equinox as eqx
import jax
import numpy as np
import pytest
from outcomes import outcome

from bench.execution.worker import _parents, _trained_in
from bench.plan.expansion import PlanError, expand
from bench.plan.keys import SettingsError
from bench.plan.override import overridden
from bench.plan.realities import nominal_simulator, parse_reality
from bench.plan.settings import describe
from bench.plan.suite import Row, Suite, load_suite
from bench.store.store import Store
from bench.text.errors import UsageError
from methods.contract import AbstractMethod, Setup
from methods.hybrid import Hybrid
from methods.hybrid_once import HybridOnce
from methods.training.policy import make_policy
from simulators import registry
from simulators.effects.drag import Drag
from simulators.point_mass import PointMass
from tasks.circle import Circle
from tasks.figure8 import Figure8
from tasks.spread import Spread


def arrays(policy):
    return jax.tree.leaves(eqx.filter(policy, eqx.is_array))


def make_suite(*rows, tasks=("spread",), team_sizes=(2,), seeds=1):
    return Suite("test", "", tasks, team_sizes, seeds, rows)


def names(plan):
    return [run.name for run in plan.runs]


def only(*rows, **keys):
    """The last run of a suite: that of its last row."""
    return expand(make_suite(*rows, **keys)).runs[-1]


def test_a_suite_is_the_product_of_its_lists(plugins):
    suite = make_suite(Row("instant"), tasks=("spread", "circle"), team_sizes=(2, 4, 5), seeds=3)
    runs = expand(suite).runs
    cells = {(run.task, run.team_size, run.seed) for run in runs}
    assert len(runs) == len(cells) == 2 * 3 * 3


def test_seeds_count_from_the_first(plugins):
    suite = Suite("test", "", ("spread",), (2,), 2, (Row("child"),), first_seed=1000)
    seeds = [(run.method, run.seed) for run in expand(suite).runs]
    assert seeds == [("instant", 1000), ("child", 1000), ("instant", 1001), ("child", 1001)]


def test_a_row_can_be_restricted(plugins):
    rows = (
        Row("instant"),
        Row("failing", tasks=("circle",)),
        Row("dying", team_sizes=(4,)),
    )
    few = expand(make_suite(Row("instant"), Row("failing", seeds=1), seeds=3)).runs
    assert [run.seed for run in few if run.method == "failing"] == [0]
    assert [run.seed for run in few if run.method == "instant"] == [0, 1, 2]
    suite = make_suite(*rows, tasks=("spread", "circle"), team_sizes=(2, 4))
    cells = {(run.method, run.task, run.team_size) for run in expand(suite).runs}
    assert {c for c in cells if c[0] == "failing"} == {
        ("failing", "circle", 2),
        ("failing", "circle", 4),
    }
    assert {c for c in cells if c[0] == "dying"} == {("dying", "spread", 4), ("dying", "circle", 4)}
    assert len(cells) == 4 + 2 + 2


def test_a_parent_is_planned_once_before_its_child_in_the_same_cell(plugins):
    row = Row("child", task_settings={"horizon": 7})
    suite = make_suite(row, Row("child", settings={"log": "x"}, task_settings={"horizon": 7}))
    parent, child, other = expand(suite).runs
    assert (parent.method, child.method, other.method) == ("instant", "child", "child")
    assert child.parents == other.parents == {"instant": parent.name}
    assert parent.resolved["task_settings"] == child.resolved["task_settings"]
    assert parent.resolved["task_settings"]["horizon"] == 7
    assert (parent.task, parent.team_size, parent.seed) == (child.task, 2, 0)


ONCE = Row("hybrid_once", task_settings={"horizon": 7})
"""A method that fixes the cell of its parent: hybrid on figure8 with three drones."""


def test_a_parent_of_a_fixed_cell_is_planned_there_once_for_each_seed():
    suite = make_suite(ONCE, tasks=("spread", "circle"), team_sizes=(2, 5), seeds=2)
    plan = expand(suite)
    parents = {run.name: run for run in plan.runs if run.method == "hybrid"}
    children = [run for run in plan.runs if run.method == "hybrid_once"]
    assert {(run.task, run.team_size) for run in parents.values()} == {("figure8", 3)}
    assert sorted(run.seed for run in parents.values()) == [0, 1]
    assert len(children) == 2 * 2 * 2
    for run in children:
        (parent,) = run.parents.values()
        assert parents[parent].seed == run.seed
        assert run.resolved["parents"] == {"hybrid": parents[parent].key}
        assert plan.runs.index(parents[parent]) < plan.runs.index(run)
        assert run.resolved["task_settings"]["horizon"] == 7
    for parent in parents.values():  # the child's settings are of the child's task
        assert (parent.variant, parent.resolved["task_settings"]["horizon"]) == ("", 500)


def test_a_parent_of_a_fixed_cell_is_the_suites_own_run_there():
    suite = make_suite(Row("hybrid"), ONCE, tasks=("spread", "figure8"), team_sizes=(3, 5))
    runs = expand(suite).runs
    (own,) = [r for r in runs if (r.method, r.task, r.team_size) == ("hybrid", "figure8", 3)]
    children = [run for run in runs if run.method == "hybrid_once"]
    assert len(children) == 4
    assert all(run.parents == {"hybrid": own.name} for run in children)


@pytest.mark.parametrize("filters", [{"tasks": ["spread"]}, {"team_sizes": [5]}])
def test_filters_keep_a_parent_of_a_fixed_cell(filters):
    suite = make_suite(ONCE, tasks=("spread", "circle"), team_sizes=(2, 5))
    whole, part = expand(suite).runs, expand(suite.select(**filters)).runs
    assert [run for run in part if run.method == "hybrid"] == [
        run for run in whole if run.method == "hybrid"
    ]
    kept = [run for run in part if run.method == "hybrid_once"]
    assert len(kept) == 2
    assert {run.name for run in kept} < {run.name for run in whole}


def test_a_key_changes_with_a_parent_of_a_fixed_cell(monkeypatch):
    def key():
        return only(ONCE).key

    before = key()
    for target, name, value in (
        (Hybrid, "version", "changed"),
        (Figure8, "version", "changed"),
        (HybridOnce, "parent_cells", {"hybrid": ("figure8", 4)}),
        (HybridOnce, "parent_cells", {"hybrid": ("circle", 3)}),
        (HybridOnce, "parent_cells", {}),
    ):
        with monkeypatch.context() as changed:
            changed.setattr(target, name, value)
            assert key() != before, (target, name, value)
        assert key() == before
    monkeypatch.setattr(Circle, "version", "changed")  # in which neither of them is
    assert key() == before


def test_the_policy_of_a_parent_of_a_fixed_cell_is_loaded_as_that_of_its_own_task(
    plugins, tmp_path, monkeypatch
):
    import fakes

    monkeypatch.setattr(fakes.Child, "parent_cells", {"instant": ("circle", 4)})
    row = Row("child", task_settings={"n_neighbors": 1})
    parent, child = expand(make_suite(row)).runs
    assert (parent.task, parent.team_size) == ("circle", 4)
    store, nominal = Store(tmp_path), PointMass()
    there, here = Circle(n_drones=4), Spread(n_drones=2, n_neighbors=1)
    policy, other = (
        make_policy(task, nominal.spec, nominal.action_space, jax.random.key(1))
        for task in (there, here)
    )
    assert [leaf.shape for leaf in arrays(policy)] != [leaf.shape for leaf in arrays(other)]
    store.commit(parent, outcome(parent, policy=policy))
    found = _parents(child, store, here, nominal)["instant"]
    for one, same in zip(arrays(found.policy), arrays(policy), strict=True):
        np.testing.assert_array_equal(one, same)


def test_folder_names_say_what_a_run_is(plugins):
    assert re.fullmatch(r"instant-spread-n2-s0-[0-9a-f]{10}", only(Row("instant")).name)
    hybrid = only(Row("hybrid", "affine"))
    assert re.fullmatch(r"hybrid-affine-spread-n2-s0-[0-9a-f]{10}", hybrid.name)


@pytest.mark.parametrize(
    "changed",
    [
        {"row": Row("instant", settings={"inner": {"lr": 0.25}})},
        {"row": Row("instant", task_settings={"altitude": 1.5})},
        {"team_sizes": (3,)},
        {"tasks": ("circle",)},
    ],
)
def test_a_key_changes_with_each_setting(plugins, changed):
    keys = {"row": Row("instant")} | changed
    assert only(keys.pop("row"), **keys).key != only(Row("instant")).key


def test_a_key_changes_with_the_seed(plugins):
    first, second = expand(make_suite(Row("instant"), seeds=2)).runs
    assert first.key != second.key


def test_a_key_does_not_change_when_a_default_is_spelled_out(plugins):
    spelled = Row("instant", settings={"inner": {"epochs": 3}}, task_settings={"horizon": 500})
    assert only(spelled).key == only(Row("instant")).key
    assert only(spelled).variant == ""


def test_a_key_changes_with_a_declared_version_and_reaches_the_children(plugins, monkeypatch):
    before = names(expand(make_suite(Row("child"))))
    import fakes

    monkeypatch.setattr(fakes.Instant, "version", "2")
    after = names(expand(make_suite(Row("child"))))
    assert set(before).isdisjoint(after)
    assert [name[:-10] for name in before] == [name[:-10] for name in after]


def test_a_method_that_identifies_is_of_another_program_with_another_effect(plugins):
    """Whatever it finds in the end, every registered effect was a candidate."""
    grey, hot = (only(Row(name)).sources for name in ("grey_box", "hf_hotstart"))
    effects = {f"effect {cls.__name__}" for cls in registry.load_all("effect").values()}
    assert effects <= {*grey}
    assert not effects & {*hot}


def test_rows_that_tables_cannot_tell_apart_are_refused(plugins):
    with pytest.raises(PlanError, match="'instant' is planned twice on spread with 2 drones"):
        only(Row("instant"), Row("instant", simulator="rotorpy"))


def test_a_variant_names_what_differs_sorted(plugins):
    row = Row(
        "instant",
        settings={"inner": {"lr": 0.25}, "log": "x"},
        task_settings={"observe_attitude": True},
    )
    assert only(row).variant == "inner.lr=0.25, log=x, observe_attitude=true"


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (
            Row("instant", settings={"iner": {}}),
            "Method 'instant' has no key 'iner'. Did you mean 'inner'?",
        ),
        (Row("instant", settings={"inner": {"epoch": 2}}), "Did you mean 'epochs'?"),
        (Row("instant", settings={"inner": 2}), "must be a table of its settings, got 2"),
        (
            Row("instant", settings={"inner": {"epochs": 2.5}}),
            "inner, epochs must be a whole number (such as 3), got 2.5",
        ),
        (Row("instant", settings={"inner": {"lr": "fast"}}), "must be a number"),
        (Row("instant", settings={"log": 3}), "must be text"),
        (Row("hybrid", settings={"flights": 2.5}), "must be a whole number"),
        (Row("hybrid", settings={"trainer": {"patience": "long"}}), "must be a whole number"),
        (Row("hybrid", settings={"trainer": {"patience": -3}}), "must be at least 1 or None"),
        (Row("hybrid", settings={"flights": 2**60}), "must be at most 9007199254740991 in size"),
        (Row("hybrid", settings={"trainer": {"lr": math.nan}}), "must be a number (such as"),
        (Row("hybrid", settings={"excitation": -0.5}), "`excitation` must be at least 0, got -0.5"),
        (Row("hf_scratch", settings={"epochs_base": -9}), "`epochs_base` must be at least 1"),
        (Row("hybrid", settings={"trainer": {"lr": -1.0}}), "`lr` must be at least 0, got -1.0"),
        (Row("recalibrated", settings={"flights": -1}), "`flights` must be at least 0, got -1"),
        (Row("instant", task_settings={"altitude": -2.0}), "must be above 0, got -2.0"),
        (
            Row("instant", task_settings={"horizn": 3}),
            "Task 'spread' has no key 'horizn'. Did you mean 'horizon'?",
        ),
        (Row("instant", task_settings={"n_drones": 3}), "has no key 'n_drones'"),
        (
            Row("instant", task_settings={"horizon": 0}),
            "Task 'spread' does not accept these settings: `horizon` must be at least 1, got 0.",
        ),
    ],
)
def test_a_wrong_setting_is_named_in_one_line(plugins, row, message):
    with pytest.raises(SettingsError, match=re.escape(message)) as caught:
        only(row)
    assert "\n" not in str(caught.value)


def test_what_is_registered_as_a_method_and_is_none_is_named(plugins, monkeypatch):
    for wrong in (print, int, AbstractMethod):
        monkeypatch.setattr("simulators.registry.load", lambda kind, name, it=wrong: it)
        with pytest.raises(
            PlanError, match="'instant' must be a class that implements AbstractMethod"
        ):
            only(Row("instant"))


def test_a_residual_for_a_method_without_one_is_an_error(plugins):
    with pytest.raises(PlanError, match="'instant' takes no residual, got 'mlp'"):
        only(Row("instant", "mlp"))
    with pytest.raises(PlanError, match="give `residual` beside `method`"):
        only(Row("hybrid", settings={"residual": "mlp"}))


def test_methods_that_need_each_other_are_an_error(plugins):
    with pytest.raises(PlanError, match="ouroboros -> ouroboros"):
        only(Row("ouroboros"))


def test_a_broken_plugin_is_left_out_and_named(plugins):
    plan = expand(make_suite(Row("shattered"), Row("instant"), seeds=2))
    assert [run.method for run in plan.runs] == ["instant", "instant"]
    assert len(plan.broken) == 1
    assert "'shattered' of fakes 1.0 cannot be imported: ModuleNotFoundError" in plan.broken[0]
    with pytest.raises(PlanError, match="nothing to run: The method 'shattered'"):
        expand(make_suite(Row("shattered")))


def test_what_cannot_be_written_down_is_no_setting():
    assert describe({"a": (1, float("inf"))}, "here") == {"a": [1, "inf"]}
    with pytest.raises(SettingsError, match=r"here, a must be made of numbers, .* got a object"):
        describe({"a": object()}, "here")


WINDY = "crazyflow+wind(x=1.5)"


def test_a_row_that_only_deploys_has_what_it_would_train_as_its_one_parent(plugins):
    trained, deployed = expand(
        make_suite(Row("child"), Row("child", deployed_in=WINDY), seeds=1)
    ).runs[1:]
    assert deployed.parents == {"child": trained.name}
    assert (deployed.deploys, deployed.reality, deployed.tracked) == (True, WINDY, False)
    assert not trained.deploys
    assert deployed.variant == "deployed_in=crazyflow+Wind(x=1.5, y=0, z=0)"
    followed = only(Row("instant", deployed_in=WINDY, tracked=True))
    assert followed.tracked
    assert followed.variant.endswith("tracked=true")
    assert only(Row("instant", tracked=True)).parents


def test_a_reality_determines_the_key_of_its_runs_and_of_no_parent(plugins):
    plain, windy = only(Row("child")), only(Row("child", reality=WINDY))
    assert plain.parents == windy.parents
    keys = {run.key for run in (plain, windy, only(Row("child", reality=WINDY.replace("5", "6"))))}
    assert len(keys) == 3
    same = only(Row("child", reality=" crazyflow + wind( x = 1.50 )"))
    assert same.key == windy.key
    assert only(Row("child", reality="crazyflow")).key == plain.key
    assert "reality" not in plain.resolved
    assert windy.resolved["versions"]["effect Wind"]


def test_another_high_fidelity_simulator_is_a_reality_or_that_of_a_whole_suite(plugins):
    plain = only(Row("child"))
    here = only(Row("child", reality="rotorpy"))
    assert here.parents == plain.parents
    assert here.variant == "reality=rotorpy"
    assert {"simulator point_mass", "simulator rotorpy"} < {*here.resolved["versions"]}
    home = only(Row("child", simulator="rotorpy"))
    assert (home.variant, home.reality, home.resolved["simulator"]) == ("", "rotorpy", "rotorpy")
    assert home.parents != plain.parents, "its parent is evaluated in RotorPy, too"
    assert len({run.key for run in (plain, here, home)}) == 3
    assert only(Row("child", simulator="crazyflow")).key == plain.key


@pytest.mark.parametrize(
    ("row", "message"),
    [
        (Row("instant", simulator="point_mass"), "`simulator`: the simulator must be a high"),
        (Row("instant", reality="point_mass+wind(x=1)"), "`reality`: the simulator must be a high"),
        (Row("instant", deployed_in="crazyflow+wind(q=1)"), "'instant', `deployed_in`: 'q=1'"),
        (Row("instant", deployed_in="crazyflow"), "`deployed_in` must name an effect"),
        (Row("instant", reality="crazyflow+wind"), "`reality`: 'wind' is no effect"),
    ],
)
def test_a_reality_that_cannot_be_is_named(plugins, row, message):
    with pytest.raises(UsageError, match=message):
        only(row)


@pytest.mark.parametrize(
    ("method", "noted"),
    [
        ("hf_scratch", "Mass(e=0.2)"),
        ("grey_box", "Drag(c=0.5); Floor(height=0)"),
        ("lf_baseline", "Drag(c=0.5); Floor(height=0)"),
    ],
)
def test_effects_of_the_simulator_that_was_trained_in_are_noted(tmp_path, method, noted):
    """Those of the reality where it trained there, else the point mass's and the method's."""
    run = only(Row(method, reality="crazyflow+mass(e=0.2)"))
    trained = dataclasses.replace(outcome(run).trained, effects=(Drag(c=0.5),))
    nominal = nominal_simulator({"effects": "floor(height=0)"})
    setup = Setup(Circle(n_drones=3), nominal, parse_reality(run.reality))
    assert _trained_in(run, Store(tmp_path), trained, setup) == noted


def test_settings_of_the_command_line_replace_those_of_every_row(plugins, write_suite):
    suite = load_suite(str(write_suite('method = "instant"\nsettings.inner = { lr = 0.1 }')))
    given = {"inner.epochs": 7, "settings.log": "here", "task_settings.horizon": 6}
    (run,) = expand(overridden(suite, given | {"nominal.attitude_tau": 0.2})).runs
    assert run.overrides == {"inner": {"lr": 0.1, "epochs": 7}, "log": "here"}
    assert run.task_overrides == {"horizon": 6}
    assert run.nominal_overrides == {"attitude_tau": 0.2}
    assert "inner.epochs=7" in run.variant
    assert expand(overridden(suite, {})) == expand(suite)
