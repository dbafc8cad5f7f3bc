"""Tables are the record: a row that is there stays as it is, and comes in once."""

import functools
from pathlib import Path

import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pandera.config import config_context
from tables_for_tests import Sheet

from bench.execution.sweep import recorded_tables
from bench.store.tables import SCHEMAS, TableError, Tables

RESULTS = Path(__file__).parents[2] / "results"


def made(*runs):
    """Tables of runs (method, seed, program, status), with the curve and the path of each."""
    sheet, names = Sheet(), {}
    for method, seed, program, status in runs:
        name = f"run{len(sheet.runs):03d}"
        reward = (-100.0 - seed - ord(program) / 7.0,)  # no round number
        drawn = {"status": status, "drawn": status != "failed"}
        sheet.add(method, rewards=reward, first_seed=seed, team_size=2, **drawn)
        sheet.runs[-1]["program"] = program
        names[name] = f"{method}-s{seed}-{program}"
    for rows in (sheet.results, sheet.runs, sheet.curves, sheet.trajectories):
        for row in rows:
            row["run"] = names[row["run"]]
    return sheet.tables()


def frames(tables):
    return {name: getattr(tables, name) for name in SCHEMAS}


def assert_equal(one, other):
    """All four tables, or what `of` left of them."""
    one, other = (frames(x) if isinstance(x, Tables) else x for x in (one, other))
    for name in SCHEMAS:
        pd.testing.assert_frame_equal(one[name], other[name], check_exact=True)


def of(tables, runs):
    """The rows of some runs, by table."""
    return {
        name: frame.loc[frame["run"].isin({*runs})].reset_index(drop=True)
        for name, frame in frames(tables).items()
    }


def names(tables):
    return set(tables.runs["run"])


def lines(tables, name):
    """Rows of a table as text that tells any two values apart."""
    return getattr(tables, name).to_csv(index=False).splitlines()


def test_rows_that_are_there_stay_to_the_last_digit(tmp_path):
    made(("a", 0, "x", "ok"), ("c", 0, "x", "diverged"), ("c", 1, "x", "failed")).save(tmp_path)
    recorded = Tables.load(tmp_path)
    before = {name: lines(recorded, name) for name in ("results", "runs")}
    recorded.merged(made(("a", 1, "x", "ok"), ("b", 0, "x", "ok"))).save(tmp_path)
    found = Tables.load(tmp_path)
    for name, rows in before.items():
        after = lines(found, name)
        assert [line for line in after if line in {*rows}] == rows
        assert len(after) > len(rows)
    assert_equal(of(found, names(recorded)), recorded)
    assert names(found) == {"a-s0-x", "a-s1-x", "b-s0-x", "c-s0-x", "c-s1-x"}


def test_rows_are_sorted_by_run_and_keep_their_order_within_one():
    new = made(("b", 0, "x", "ok"), ("a", 0, "x", "ok"))
    found = Tables.empty().merged(new)
    assert found.runs["run"].tolist() == ["a-s0-x", "b-s0-x"]
    for run, rows in new.results.groupby("run"):
        own = found.results.loc[found.results["run"] == run, "metric"]
        assert own.tolist() == rows["metric"].tolist()


def test_a_row_is_replaced_by_one_of_the_same_name():
    """Another program under the same key, because no version tells."""
    old, new = made(("a", 0, "x", "ok"), ("b", 0, "x", "ok")), made(("a", 0, "x", "ok"))
    new.results["value"] = new.results["value"] - 1.0
    assert_equal(old.merged(new), old)
    found = old.merged(new, {"a-s0-x"})
    assert_equal(of(found, {"a-s0-x"}), new)
    assert_equal(of(found, {"b-s0-x"}), of(old, {"b-s0-x"}))


def test_a_save_that_was_cut_off_before_the_runs_doubles_no_row(tmp_path):
    """Then `results` has rows of runs that `runs` does not list; the runs come again."""
    old, new = made(("a", 0, "x", "ok")), made(("b", 0, "x", "ok"))
    old.save(tmp_path)
    runs = (tmp_path / "runs.parquet").read_bytes()
    old.merged(new).save(tmp_path)
    (tmp_path / "runs.parquet").write_bytes(runs)
    cut_off = Tables.load(tmp_path)
    assert len(cut_off.results) > len(old.results)
    assert_equal(cut_off.merged(new), old.merged(new))


def test_results_that_lost_their_runs_are_no_empty_tables(tmp_path):
    made(("a", 0, "x", "ok")).save(tmp_path)
    (tmp_path / "runs.parquet").unlink()
    with pytest.raises(TableError, match=r"holds no runs\.parquet"):
        recorded_tables(tmp_path)
    (tmp_path / "runs").mkdir()  # as where the first save of a sweep was cut off
    assert recorded_tables(tmp_path).runs.empty


PROGRAMS = st.sampled_from("xy")
STATUSES = st.sampled_from(["ok", "failed", "diverged"])
EACH = functools.cache(made)
"""The tables of one run."""
RUNS = st.dictionaries(
    st.tuples(st.sampled_from("ab"), st.integers(0, 2)), st.tuples(PROGRAMS, STATUSES)
)
"""A run for some of the identities: (method, seed) -> (program, status)."""


def stacked(runs):
    """The tables of several runs, from what is made once of each."""
    each = [frames(EACH((*i, *run))) for i, run in sorted(runs.items())] or [frames(EACH())]
    with config_context(validation_enabled=False):
        return Tables(**{name: pd.concat([x[name] for x in each]) for name in SCHEMAS})


@settings(max_examples=25, deadline=None, derandomize=True)
@given(RUNS, RUNS, st.data())
def test_merging_agrees_with_a_dictionary_and_is_idempotent(here, there, data):
    old, new = (stacked(runs) for runs in (here, there))
    given_up = data.draw(st.sets(st.sampled_from(sorted(here)))) if here else set()
    expected = dict(here)
    for identity in given_up:
        del expected[identity]
    for identity, run in there.items():
        if identity not in expected or expected[identity][1] == "failed":
            expected[identity] = run
    replaced = {f"{method}-s{seed}-{here[method, seed][0]}" for method, seed in given_up}
    with config_context(validation_enabled=False):  # which takes longer than all the rest
        merged = old.merged(new, replaced)
        again, alone = merged.merged(new, replaced), merged.merged(Tables.empty())
    assert merged.column("status") == {
        f"{method}-s{seed}-{program}": status
        for (method, seed), (program, status) in expected.items()
    }
    kept = {i for i in expected if i in here and i not in given_up and here[i][1] != "failed"}
    stay = {f"{method}-s{seed}-{here[method, seed][0]}" for method, seed in kept}
    assert_equal(of(merged, stay), of(old, stay))
    assert_equal(of(merged, names(merged) - names(old)), of(new, names(merged) - names(old)))
    assert_equal(again, merged)
    assert_equal(alone, merged)


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        (lambda runs: runs.drop(columns="machine"), "machine"),
        (lambda runs: runs.assign(colour="red"), "colour"),
        (lambda runs: runs[runs.columns[::-1]], "order"),
        (lambda runs: pd.concat([runs, runs]), "duplicate"),
    ],
)
def test_tables_with_other_columns_or_a_run_twice_are_refused(tmp_path, edit, said):
    tables = made(("a", 0, "x", "ok"))
    tables.save(tmp_path)
    edit(tables.runs).to_parquet(tmp_path / "runs.parquet", index=False)
    with pytest.raises(TableError, match=rf"runs\.parquet cannot be used: .*{said}"):
        Tables.load(tmp_path)


@pytest.mark.parametrize(
    "folder", sorted(path.parent.name for path in RESULTS.glob("*/runs.parquet"))
)
def test_the_tables_of_this_repository_load_and_merge(folder):
    tables = Tables.load(RESULTS / folder)
    assert len(tables.identities()) == len(tables.runs) > 0
    assert set(tables.results["run"]) <= names(tables)
    merged = Tables.empty().merged(tables)
    assert names(merged) == names(tables)
    assert len(merged.results) == len(tables.results)
