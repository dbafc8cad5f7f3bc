"""Whole sweeps on worker processes, with methods that train in no time, fail or die."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time

import at_once
import fake_slurm
import numpy as np
import pandas as pd
import pytest

from bench.cli.app import main
from bench.execution import slurm
from bench.execution.execute import _Schedule
from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.tables import UNITS, Tables

WAIT = 120.0
"""Longest time for which a test waits for a process [s]."""


def runs_of(directory):
    """Status and cause of each run, by method and seed."""
    runs = pd.read_parquet(directory / "runs.parquet").set_index(["method", "seed"])
    return runs[["status", "cause"]].apply(tuple, axis=1).to_dict()


def wait_until(condition):
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < WAIT
        time.sleep(0.05)


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_failures_and_deaths_cost_only_their_runs_and_are_retried(
    plugins, write_suite, tmp_path, capsys
):
    log = tmp_path / "trainings"
    suite = write_suite(
        f'method = "child"\nsettings.log = "{log}"',
        *("failing", "heir", "dying", "shattered"),
        simulator="calm",
    )
    out = tmp_path / "out"
    arguments = ["run", str(suite), "--out", str(out), "--jobs", "2"]
    assert main(arguments) == 1
    captured = capsys.readouterr()

    runs = runs_of(out)
    failed = next((out / "runs").glob("failing-*"))
    assert runs["instant", 0] == runs["child", 0] == ("ok", "")
    assert runs["failing", 0] == ("failed", "RuntimeError: the propellers fell off")
    assert runs["heir", 0] == ("failed", f"interrupted: parent {failed.name} failed")
    assert runs["dying", 0][0] == "failed"
    assert "ended by SIGKILL" in runs["dying", 0][1]
    assert "the propellers fell off" in (failed / "traceback.txt").read_text()
    assert "3 of 5 runs failed" in captured.err
    assert f"Traceback: {failed / 'traceback.txt'}\n" in captured.err
    assert "Left out: The method 'shattered'" in captured.err
    assert captured.out.count("spread n2 s0 (horizon=5") >= 5
    assert (out / "leaderboard.md").is_file()
    assert (out / "report.html").is_file()
    assert log.read_text().count("\n") == 1
    check_tables(out)

    (tmp_path / "cure").touch()
    os.truncate(next((out / "runs").glob("child-*")) / "policy.npz", 100)
    assert main([*arguments[:-1], "1"]) == 1  # one failed, one still dies, one is still broken
    captured = capsys.readouterr()
    again = runs_of(out)
    assert {run: again[run] for run in again if run != ("dying", 0)} == {
        run: runs[run] for run in runs if run != ("dying", 0)
    }
    assert "To do: 2, on 1 worker. Failed earlier: 1; --retry-failed" in captured.out
    assert "policy.npz has changed since it was written. It is now runs/.quarantine" in captured.err
    assert log.read_text().count("\n") == 1  # the row of what is damaged is there
    check_tables(out)

    assert main([*arguments[:-1], "1", "--retry-failed"]) == 1
    captured = capsys.readouterr()
    runs = runs_of(out)
    assert runs["failing", 0] == runs["heir", 0] == ("ok", "")
    assert runs["dying", 0][0] == "failed"
    assert runs["child", 0] == ("ok", "")
    assert "Runs finished already: 2 of 5. To do: 3, on 1 worker." in captured.out
    assert log.read_text().count("\n") == 1


def check_tables(out):
    """The tables hold what the fake methods reported."""
    tables = Tables.load(out)
    child = tables.results[tables.results["method"] == "child"].set_index("metric")
    assert {*UNITS, "leaves"} == set(child.index)
    assert child.loc["fleet_minutes", "value"] == 2.0
    assert child.loc["epochs", "value"] == 1
    assert child["variant"].iloc[0].startswith("horizon=5, log=")
    parent = tables.results[tables.results["method"] == "instant"].set_index("metric")
    # The child deploys its parent's policy with the same initial states.
    assert child.loc["reward", "value"] == parent.loc["reward", "value"]
    assert set(tables.results["method"]) == {"child", "instant"}
    assert (tables.curves.groupby("run").size().sort_values() == [1, 3]).all()
    assert set(tables.trajectories["drone"]) == {0, 1}
    settings = json.loads(tables.runs.set_index("method").loc["instant", "settings"])
    assert settings["method"]["inner"] == {"epochs": 3, "lr": 0.5}
    assert settings["task"]["horizon"] == 5


@pytest.mark.parametrize(
    "end", [(os.killpg, signal.SIGINT), (os.kill, signal.SIGTERM)], ids=["Ctrl-C", "SIGTERM"]
)
def test_an_interruption_keeps_finished_runs_and_running_again_resumes(
    plugins, write_suite, tmp_path, capsys, monkeypatch, end
):
    log, gate, out = tmp_path / "trainings", tmp_path / "gate", tmp_path / "out"
    suite = write_suite(
        f'method = "instant"\nsettings.log = "{log}"',
        f'method = "instant"\nsettings.log = "{log}"\nsettings.wait_for = "{gate}"',
        simulator="calm",
    )
    # Tests run in the background ignore Ctrl-C, and so would what they start.
    attentive = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    code = f"{attentive}; import sys; from bench.cli.app import main; sys.exit(main())"
    command = [sys.executable, "-c", code]
    arguments = ["run", str(suite), "--out", str(out), "--jobs", "1"]
    with subprocess.Popen(
        [*command, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        wait_until(lambda: log.exists() and log.read_text().count("\n") == 2)
        listing = subprocess.run(
            ["ps", "--no-headers", "-o", "pid", "--sid", str(process.pid)],
            capture_output=True,
            text=True,
            check=True,
        )
        pids = [int(pid) for pid in listing.stdout.split()]
        send, interruption = end
        send(process.pid, interruption)
        _, errors = process.communicate(timeout=WAIT)
    assert process.returncode == 130
    assert "Interrupted: 1 of 2 runs are finished and kept." in errors
    assert "Traceback" not in errors
    assert len(pids) >= 2
    wait_until(lambda: not any(alive(pid) for pid in pids))
    assert len(list((out / "runs").glob("instant-*"))) == 1

    if interruption == signal.SIGTERM:  # the store is the same after either
        return
    at_once.do_really(monkeypatch)
    gate.touch()
    assert main(arguments) == 0
    assert log.read_text().count("\n") == 3
    assert "Runs finished already: 1 of 2. To do: 1, on 1 worker." in capsys.readouterr().out

    first = Tables.load(out)
    assert main(arguments) == 0
    assert log.read_text().count("\n") == 3
    assert "Runs finished already: 2 of 2. To do: nothing." in capsys.readouterr().out
    pd.testing.assert_frame_equal(Tables.load(out).results, first.results)


def test_the_first_failure_ends_a_sweep_that_fails_fast(
    plugins, write_suite, tmp_path, capsys, monkeypatch
):
    gate, out = tmp_path / "gate", tmp_path / "out"
    row = f'method = "instant"\nsettings.wait_for = "{gate}"'
    suite = write_suite("failing", row, simulator="calm")
    arguments = ["run", str(suite), "--out", str(out), "--jobs", "2"]
    assert main([*arguments, "--fail-fast"]) == 1  # it would wait for ever
    captured = capsys.readouterr()
    assert runs_of(out).keys() == {("failing", 0)}
    assert "1 of 2 runs failed; the first: failing spread" in captured.err
    assert "Stopped at the first failure: 1 runs are still to do." in captured.err
    at_once.do_really(monkeypatch)
    gate.touch()
    assert main([*arguments, "--fail-fast"]) == 1  # the failure is not a new one
    assert runs_of(out)["instant", 0] == ("ok", "")


def test_two_sweeps_on_one_store_do_every_run_once(plugins, write_suite, tmp_path):
    log, gate, out = tmp_path / "trainings", tmp_path / "gate", tmp_path / "out"
    settings = f'settings.log = "{log}"\nsettings.wait_for = "{gate}"'
    suite = write_suite(f'method = "instant"\n{settings}', seeds=3, simulator="calm")
    command = [sys.executable, "-m", "bench", "run", str(suite), "--out", str(out), "--jobs", "1"]
    quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **quiet) as first:
        wait_until(log.exists)
        with subprocess.Popen(command, **quiet) as second:
            assert second.stderr.readline().startswith("Waiting: another run is working in")
            gate.touch()
            printed = [process.communicate(timeout=WAIT)[0] for process in (first, second)]
    assert [first.returncode, second.returncode] == [0, 0]
    assert log.read_text().count("\n") == 3
    assert "Runs finished already: 0 of 3. To do: 3" in printed[0]
    assert "Runs finished already: 3 of 3. To do: nothing." in printed[1]


def test_a_run_that_is_killed_goes_on_inside_and_bills_every_flight_once(
    plugins, write_suite, tmp_path
):
    """Killed by SIGKILL after 4 of 8 epochs; the other never is."""
    grave = tmp_path / "grave"
    tables = {}
    for name, die_at in (("whole", 0), ("killed", 4)):
        row = f'method = "flown"\nsettings.die_at = {die_at}\nsettings.grave = "{grave}-{name}"'
        out = tmp_path / name
        suite = write_suite(row, simulator="calm")
        arguments = ["run", str(suite), "--out", str(out), "--jobs", "1"]
        if die_at:
            assert main(arguments) == 1
            assert "ended by SIGKILL" in runs_of(out)["flown", 0][1]
            assert list((out / "runs" / ".checkpoints").glob("flown-*/flown.npz"))
        assert main(arguments) == 0
        assert not list((out / "runs" / ".checkpoints").iterdir())
        tables[name] = Tables.load(out)
    assert (tmp_path / "grave-killed").read_text().split() == [str(i) for i in range(1, 9)]
    whole, killed = tables["whole"], tables["killed"]
    columns = ["metric", "value", "unit", "status"]
    rows = [t.results.loc[t.results["metric"] != "train_seconds", columns] for t in (whole, killed)]
    pd.testing.assert_frame_equal(*rows, check_exact=True)
    pd.testing.assert_frame_equal(*(t.curves.drop(columns="run") for t in (whole, killed)))
    rows = rows[0].set_index("metric")["value"]
    assert rows["fleet_minutes"] == pytest.approx(8 * 5 * 0.02 * 2 / 60)
    policies = [next((tmp_path / n / "runs").glob("flown-*/policy.npz")) for n in tables]
    with np.load(policies[0]) as one, np.load(policies[1]) as other:
        assert one.files == other.files
        for name in one.files:
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.skipif(
    importlib.util.find_spec("ray") is None,
    reason="Ray is not installed; pip install 'fidelity-bench[ray]'",
)
def test_a_sweep_on_ray_leaves_the_same_store(plugins, write_suite, tmp_path):
    log, out = tmp_path / "trainings", tmp_path / "out"
    row = f'method = "child"\nsettings.log = "{log}"'
    suite = write_suite(row, "failing", simulator="calm")
    command = [sys.executable, "-m", "bench", "run", str(suite), "--out", str(out)]
    done = subprocess.run(
        [*command, "--executor", "ray", "--jobs", "2"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    runs = runs_of(out)
    assert runs["instant", 0] == runs["child", 0] == ("ok", "")
    assert runs["failing", 0] == ("failed", "RuntimeError: the propellers fell off")
    check_tables(out)


@pytest.mark.skipif(
    importlib.util.find_spec("submitit") is None,
    reason="submitit is not installed; pip install 'fidelity-bench[slurm]'",
)
def test_a_sweep_on_slurm_leaves_the_same_store_and_loses_only_a_job_that_is_killed(
    plugins, write_suite, tmp_path, monkeypatch
):
    place, out = tmp_path / "slurm", tmp_path / "out"
    fake_slurm.install(monkeypatch, place)
    log = tmp_path / "trainings"
    row = f'method = "child"\nsettings.log = "{log}"'
    suite = write_suite(row, "failing", "dying", simulator="calm")
    for name in ("POLL_S", "STATE_EVERY"):
        monkeypatch.setattr(slurm, name, 0.3)
    assert main(["run", str(suite), "--out", str(out), "--executor", "slurm"]) == 1
    runs = runs_of(out)
    assert runs["instant", 0] == runs["child", 0] == ("ok", "")
    assert runs["failing", 0] == ("failed", "RuntimeError: the propellers fell off")
    status, cause = runs["dying", 0]
    assert (status, "its worker process is gone (job" in cause) == ("failed", True)
    check_tables(out)
    # The three that wait for nobody, up to the limit of the cluster, and the child of one.
    assert (place / "arrays").read_text().split() == ["3", "1"]


@pytest.mark.parametrize("seeds", [1, 3])
def test_long_chains_start_first_and_parents_before_children(plugins, seeds):
    rows = (Row("instant"), Row("child"), Row("failing"))
    suite = Suite("test", "", ("spread",), (2, 4), seeds, rows)
    schedule = _Schedule(expand(suite).runs, done=())
    order = []
    while runs := schedule.next():
        (run,) = runs
        order.append((run.method, run.team_size))
        assert schedule.end(run.name, "ok") == []
    assert order == [
        (method, size)
        for method, size in [
            ("failing", 4),
            ("instant", 4),
            ("failing", 2),
            ("child", 4),
            ("instant", 2),
            ("child", 2),
        ]
        for _ in range(seeds)
    ]
    assert set(schedule.status.values()) == {"ok"}


def test_runs_that_differ_in_their_seed_are_given_together(plugins):
    suite = Suite("test", "", ("spread",), (2, 4), 3, (Row("instant"), Row("child")))
    schedule = _Schedule(expand(suite).runs, done=())
    given = []
    while runs := schedule.next(2):
        given.append([(run.method, run.team_size, run.seed) for run in runs])
        for run in runs:
            assert schedule.end(run.name, "ok") == []
    assert sorted(map(len, given)) == [1] * 4 + [2] * 4
    for group in given:
        assert len({(method, size) for method, size, _ in group}) == 1
    assert len({run for group in given for run in group}) == 12


def test_a_group_costs_nothing_but_its_own_runs(
    plugins, write_suite, tmp_path, capsys, monkeypatch
):
    """Seeds at once in one process: what fails is told apart, what dies takes its group along."""
    log = tmp_path / "trainings"
    suite = write_suite(
        f'method = "child"\nsettings.log = "{log}"', "failing", "dying", seeds=3, simulator="calm"
    )
    out = tmp_path / "out"
    arguments = ["run", str(suite), "--out", str(out), "--jobs", "1", "--together", "3"]
    assert main(arguments) == 1
    runs = runs_of(out)
    for seed in range(3):
        assert runs["instant", seed] == runs["child", seed] == ("ok", "")
        assert runs["failing", seed] == ("failed", "RuntimeError: the propellers fell off")
        assert "ended by SIGKILL" in runs["dying", seed][1]
    assert log.read_text().count("\n") == 3
    alone = tmp_path / "alone"
    at_once.do_really(monkeypatch)
    assert main([*arguments[:3], str(alone), *arguments[4:6], "--method", "child"]) == 0
    columns = ["method", "seed", "metric", "value"]
    one, other = (Tables.load(place).results for place in (out, alone))
    timed = one["metric"] == "train_seconds"
    pd.testing.assert_frame_equal(one.loc[~timed, columns], other.loc[~timed, columns])
    capsys.readouterr()
    assert main([*arguments[:-1], "0"]) == 2
    assert "`--together` must be at least 1, got 0." in capsys.readouterr().err


def test_rows_in_other_realities_are_deployed_there_and_train_nothing_anew(
    in_process, write_suite, tmp_path
):
    """What only deploys has its parent's policy, the wind of that reality, and no bill."""
    log, world = tmp_path / "trainings", "crazyflow+wind(x=2)"
    row = f'method = "instant"\nsettings.log = "{log}"'
    suite = write_suite(
        row,
        f'{row}\ndeployed_in = "{world}"',
        f'{row}\ndeployed_in = "{world}"\ntracked = true',
        f'{row}\nreality = "{world}"',
    )
    out = tmp_path / "out"
    assert main(["run", str(suite), "--out", str(out), "--jobs", "1"]) == 0
    assert log.read_text().count("\n") == 2  # the plain one, and the one for that reality
    results = Tables.load(out).results
    assert set(results.deployed_effects) == {"", "Wind(x=2, y=0, z=0)"}
    found = results[results.metric == "reward"].set_index("variant").value.to_dict()
    (loaded,) = [v for k, v in found.items() if "deployed_in" in k and "tracked" not in k]
    (plain,) = [v for k, v in found.items() if "Wind" not in k]
    (adapted,) = [v for k, v in found.items() if "reality=" in k]
    assert plain != loaded
    assert loaded == adapted  # the same fresh policy: `instant` learns nothing
    assert len(found) == 4
    epochs = results[results.metric == "epochs"].set_index("variant").value
    assert (epochs > 0).to_dict() == {v: "deployed_in" not in v for v in epochs.index}
    assert "Wind(x=2, y=0, z=0)" in (out / "leaderboard.md").read_text()
