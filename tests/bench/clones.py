"""What a clone of the repository holds, and what a sweep there leaves: for tests of sweeps.

A clone has the tables that were committed and no `runs/`.
"""

import shutil

import bench.plan.expansion
from bench.plan.expansion import expand
from bench.plan.suite import load_suite
from bench.store.tables import IDENTITY, Tables


def planned(write_suite, *rows, **changes):
    return expand(load_suite(str(write_suite(*rows, **changes)))).runs


def forget(out):
    """Makes a clone."""
    shutil.rmtree(out / "runs")


def files(out):
    """Content of every file of tables and runs; what a lock leaves is no content."""
    return {
        path: path.read_bytes()
        for path in sorted(out.rglob("*"))
        if path.is_file() and path.name != ".lock"
    }


def lines(out):
    """Rows of both tables that are the record, as text that tells any two values apart."""
    tables = Tables.load(out)
    names = ("results", "runs")
    return {name: getattr(tables, name).to_csv(index=False).splitlines() for name in names}


def assert_kept(before, after):
    """All rows of `before` stand in `after`, to the last digit and in their order."""
    for name, rows in before.items():
        assert [line for line in after[name] if line in {*rows}] == rows


def rows(out):
    """Program and status of each run, by method and seed."""
    runs = Tables.load(out).runs
    assert not runs.duplicated([*IDENTITY]).any()
    return runs.set_index(["method", "seed"])[["run", "program", "status", "cause"]].T.to_dict()


def trained_methods(trainer):
    return sorted(name.split("-")[0] for name in trainer.trained)


def bump(monkeypatch, *methods, version="2"):
    """Another version of some fake methods, so another key."""
    import fakes

    for method in methods:
        monkeypatch.setattr(getattr(fakes, method), "version", version)


def edit(monkeypatch):
    """Another source under the same versions."""
    monkeypatch.setattr(bench.plan.expansion, "own_source", lambda cls: f"new {cls.__name__}")
