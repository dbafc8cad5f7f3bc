import dataclasses
import re

import pytest

from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite, SuiteError, built_in, load_suite
from methods.training.evaluate import TUNING_SEEDS
from simulators.registry import UnknownPluginError

GOOD = """
name = "mine"
description = "One line."
tasks = ["spread"]
team_sizes = [3]
seeds = 2
[[methods]]
method = "hybrid"
residual = "mlp"
settings.trainer.epochs = 7
"""


@pytest.fixture
def load(tmp_path):
    def load(text):
        path = tmp_path / "file.toml"
        path.write_text(text)
        return load_suite(str(path))

    return load


def small():
    rows = (Row("lf_baseline"), Row("hybrid", "affine"), Row("hybrid", "mlp"))
    return Suite("small", "", ("spread", "circle"), (3, 12), 2, rows)


def methods_of(suite):
    return [(row.method, row.residual) for row in suite.methods]


def test_a_suite_is_read_as_it_is_written(load):
    suite = load(GOOD)
    assert dataclasses.astuple(suite)[:5] == ("mine", "One line.", ("spread",), (3,), 2)
    assert suite.methods == (Row("hybrid", "mlp", {"trainer": {"epochs": 7}}),)


def test_a_suite_without_a_name_is_called_as_its_file(load):
    assert load(GOOD.replace('name = "mine"', "")).name == "file"


def test_built_in_suites_are_what_the_documentation_promises():
    suites = {name: load_suite(name) for name in built_in()}
    rows = {
        name: [row for row in suite.methods if not row.settings and not row.task_settings]
        for name, suite in suites.items()
    }
    sizes = {
        name: (len(s.tasks), s.team_sizes, s.seeds, len(rows[name])) for name, s in suites.items()
    }
    assert sizes == {
        "quick": (2, (3,), 1, 10),
        "contact": (2, (3, 7, 12), 5, 10),
        "field": (4, (3, 12), 5, 11),
        "field_parts": (2, (3,), 5, 20),
        "floor": (1, (7, 18), 5, 6),
        "worlds": (1, (3,), 3, 44),
        "paper": (4, (3, 5, 7, 9, 12, 18), 5, 13),
        "paper_rotorpy": (4, (3, 12), 5, 10),
        "transfer": (4, (3, 12), 5, 30),
        "ablations": (2, (3, 12), 3, 15),
        "budget": (4, (3, 7, 12), 3, 6),
        "off_spec": (2, (3, 7, 12), 5, 20),
        "scale": (2, (100, 1000), 1, 2),
        "tuning": (4, (3,), 1, 0),
    }
    assert list(suites)[:2] == ["quick", "paper"]
    upper, steady = [row for row in suites["paper"].methods if row.method == "upper_reference"]
    assert upper == Row("upper_reference", seeds=1)  # in every cell
    assert steady.settings == {"trainer": {"decay": 0.99}}  # where that diverged
    assert (steady.tasks, steady.team_sizes, steady.seeds) == (("figure8",), (9, 12, 18), 1)
    for name, suite in suites.items():  # tuning has seeds that no result uses
        assert (suite.first_seed >= TUNING_SEEDS) == (name == "tuning")
        assert suite.first_seed + suite.seeds <= TUNING_SEEDS or name == "tuning"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("team_sizes", "team_size", "has no key 'team_size'. Did you mean 'team_sizes'? Allowed:"),
        ("residual", "residul", "method 1 has no key 'residul'. Did you mean 'residual'?"),
        ("seeds = 2", "", "lacks the key 'seeds'"),
        ("seeds = 2", "seeds = 0", "`seeds` must be at least 1, got 0"),
        ("seeds = 2", "seeds = 5000000000", "must be at most 4294967295, got 4999999999"),
        ("seeds = 2", "seeds = true", "`seeds` must be a whole number, got True"),
        ("[3]", "[1]", "team size must be at least 2, got 1"),
        ("[3]", '["3"]', "`team_sizes` must be a whole number, got '3'"),
        ("[3]", "[]", "`team_sizes` must not be empty"),
        ('"mine"', '"../mine"', "names a folder, got '../mine'"),
        ("[[methods]]", "[methods]", "`methods` must be a list"),
        ("[[methods]]", "methods = [3]\n[quick]", "Suite 'file', method 1 must be a table, got 3."),
        ("seeds = 2", "seeds = 2\nquick = 3", "Suite 'file', [quick] must be a table, got 3."),
        ("seeds = 2", "seeds = 2\nsimulator = 3", "Suite 'file': `simulator` must be text, got 3."),
        ("seeds = 2", "seeds = ", "cannot be read"),
        (
            'residual = "mlp"',
            "team_sizes = [12]",
            "`team_sizes` must be among the `team_sizes` of the suite",
        ),
        (
            'residual = "mlp"',
            'tasks = ["circle"]',
            "`tasks` must be among the `tasks` of the suite",
        ),
        ('residual = "mlp"', "seeds = 3", "`seeds` must be at most the suite's 2, got 3"),
    ],
)
def test_a_mistake_in_a_suite_is_named_in_one_line(load, old, new, message):
    with pytest.raises(SuiteError, match=re.escape(message)) as caught:
        load(GOOD.replace(old, new))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("spread", "spraed", "No task is registered as 'spraed'. Did you mean 'spread'?"),
        ("hybrid", "hybird", "No method is registered as 'hybird'. Did you mean 'hybrid'?"),
        ("mlp", "mpl", "No residual is registered as 'mpl'. Did you mean 'mlp'?"),
    ],
)
def test_an_unknown_plugin_is_named_with_the_nearest(load, old, new, message):
    with pytest.raises(UnknownPluginError, match=re.escape(message)):
        load(GOOD.replace(f'"{old}"', f'"{new}"'))


def test_a_row_says_where_it_is_deployed(load):
    row = 'residual = "mlp"'
    assert GOOD.count(row) == 1
    made = load(GOOD.replace(row, row + '\ndeployed_in = "crazyflow+drag(c=2)"\ntracked = true'))
    (deployed,) = [r for r in made.methods if r.deploys]
    assert (deployed.world, deployed.tracked) == ("crazyflow+drag(c=2)", True)
    with pytest.raises(SuiteError, match="`tracked` must be true or false, got 1"):
        load(GOOD.replace(row, row + "\ntracked = 1"))
    with pytest.raises(SuiteError, match="give `reality` to train for it, or"):
        load(GOOD.replace(row, row + '\nreality = "crazyflow"\ntracked = true'))


def test_a_list_of_worlds_makes_a_row_of_each(load):
    row = 'residual = "mlp"'
    made = load(GOOD.replace(row, row + '\nreality = ["rotorpy", "contact"]'))
    assert [r.reality for r in made.methods] == ["rotorpy", "contact"]
    with pytest.raises(SuiteError, match="`reality` must be text, got 3"):
        load(GOOD.replace(row, row + '\nreality = ["rotorpy", 3]'))
    after = row + '\nreality = ["rotorpy", "contact"]\n[[methods]]\nmethod = "hybrid"\nseeds = 3'
    with pytest.raises(SuiteError, match="method 2: `seeds` must be at most"):
        load(GOOD.replace(row, after))


QUICK = """
[quick]
tasks = ["spread"]
team_sizes = [3]
seeds = 1
methods = ["hybrid"]
residuals = ["mlp"]
"""


def test_the_quick_part_of_a_suite_is_a_part_of_its_runs(load):
    whole = load(GOOD + QUICK)
    quick = whole.quickly()
    assert (quick.tasks, quick.team_sizes, quick.seeds) == (("spread",), (3,), 1)
    assert {run.name for run in expand(quick).runs} < {run.name for run in expand(whole).runs}


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('tasks = ["spread"]', 'tasks = ["figure8"]', "[quick]: `tasks` must be among the `tasks`"),
        ("seeds = 1", "seeds = 9", "[quick]: `seeds` must be at most the suite's 2, got 9"),
        ('["hybrid"]', '["hf_scratch"]', "[quick]: `methods` must be among the suite's, got 'hf_"),
    ],
)
def test_a_quick_part_must_be_a_part(load, old, new, message):
    assert old in QUICK
    with pytest.raises(SuiteError, match=re.escape(message)):
        load(GOOD + QUICK.replace(old, new))


def test_what_only_deploys_is_a_part_of_a_suite():
    whole = load_suite("transfer")
    part = whole.deploying()
    assert len(part.methods) == 32
    assert all(row.deployed_in for row in part.methods)
    left_out = [row.method for row in whole.methods if row not in part.methods]
    trained = ["grey_box", "recalibrated", "grey_box", "hf_hotstart", "upper_reference"]
    assert left_out == trained
    with pytest.raises(SuiteError, match="Every row of suite 'scale' trains; --deployed takes"):
        load_suite("scale").deploying()


def test_the_quick_part_of_the_worlds_has_every_world():
    quick = load_suite("worlds").quickly()
    assert {row.world for row in quick.methods} >= {"", "rotorpy", "contact", "field"}
    per_world = {world: [row for row in quick.methods if row.world == world]
                 for world in ("rotorpy", "contact", "field")}  # fmt: skip
    assert [len(rows) for rows in per_world.values()] == [6, 6, 6]
    whole = {run.name for run in expand(load_suite("worlds")).runs}
    assert {run.name for run in expand(quick).runs} < whole  # it fills in no residual


def test_a_suite_without_a_quick_part_says_which_have_one(load):
    with pytest.raises(SuiteError, match=r"has no table \[quick\]. Suites that have one: worlds"):
        load(GOOD).quickly()
    with pytest.raises(SuiteError, match=r"\[quick\] has no key 'seed'. Did you mean 'seeds'"):
        load(GOOD + QUICK.replace("seeds", "seed"))


def test_an_unknown_suite_is_named_with_the_nearest():
    with pytest.raises(SuiteError, match=r"'quik'\. Did you mean 'quick'"):
        load_suite("quik")
    with pytest.raises(SuiteError, match=r"no suite file 'nowhere\.toml'"):
        load_suite("nowhere.toml")


def test_filters_replace_the_lists_of_the_suite():
    chosen = small().select(tasks=["figure8"], team_sizes=[5, 5], seeds=7)
    assert (chosen.tasks, chosen.team_sizes, chosen.seeds) == (("figure8",), (5,), 7)
    assert methods_of(chosen) == methods_of(small())


def test_a_method_outside_the_suite_gets_a_row_with_defaults():
    chosen = small().select(methods=["hf_scratch", "lf_baseline"])
    assert methods_of(chosen) == [("lf_baseline", ""), ("hf_scratch", "")]


def test_the_rows_of_a_suite_fly_in_its_simulator(load):
    rotorpy = load_suite("paper_rotorpy").select(methods=["lf_baseline", "recalibrated"])
    assert {row.simulator for row in rotorpy.methods} == {"rotorpy"}
    with pytest.raises(UnknownPluginError, match="Did you mean 'rotorpy'"):
        load(GOOD.replace("seeds = ", 'simulator = "rotorpi"\nseeds = '))


def test_a_residual_filter_keeps_rows_with_it():
    assert methods_of(small().select(residuals=["mlp"])) == [("hybrid", "mlp")]
    both = small().select(methods=["lf_baseline", "hybrid"], residuals=["mlp"])
    assert methods_of(both) == [("lf_baseline", ""), ("hybrid", "mlp")]
    assert methods_of(small().select(residuals=["sindy"])) == [("hybrid", "sindy")]


def test_a_residual_filter_fills_rows_that_name_none_but_could():
    off_spec = load_suite("off_spec").select(methods=["hybrid"], residuals=["affine"])
    assert {(row.method, row.residual) for row in off_spec.methods} == {("hybrid", "affine")}
    assert {row.deployed_in for row in off_spec.methods} > {"", "crazyflow+mass(e=0.2)"}
    new = small().select(methods=["grey_box", "lf_baseline"], residuals=["mlp"])
    assert methods_of(new) == [("lf_baseline", ""), ("grey_box", "mlp")]


def test_filters_are_checked_as_a_file_is():
    with pytest.raises(SuiteError, match="at least 2, got 1"):
        small().select(team_sizes=[1])
    with pytest.raises(SuiteError, match="at least 1, got 0"):
        small().select(seeds=0)
    with pytest.raises(UnknownPluginError, match="Did you mean 'circle'"):
        small().select(tasks=["cirle"])
    alone = dataclasses.replace(small(), methods=(Row("lf_baseline"),))
    with pytest.raises(SuiteError, match="leave no run of suite 'small'"):
        alone.select(residuals=["mlp"])
