import subprocess
import sys

import pytest

from bench.cli.app import main
from bench.execution.progress import _clock
from bench.plan import listing
from bench.plan.expansion import PlanError
from bench.text.pages import documents_of


def complaint(capsys, *arguments):
    """What `bench run` with these arguments says on stderr; it must be one line, status 2."""
    assert main([*arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_help_imports_neither_jax_nor_pandas():
    script = (
        "import sys; from bench.cli.app import main; status = main(['run', '--help']); "
        "heavy = {'jax', 'pandas', 'equinox', 'numpy'} & set(sys.modules); "
        "sys.exit(f'imports {heavy}' if heavy else status)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "--team-size" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["quik"], "Did you mean 'quick'?"),
        (["--task", "cirle"], "Did you mean 'circle'?"),
        (["--method", "hf_scrach"], "Did you mean 'hf_scratch'?"),
        (["--residual", "sindi"], "Did you mean 'sindy'?"),
        (["--team-size", "1"], "A team size must be at least 2, got 1."),
        (["--seeds", "0"], "`seeds` must be at least 1, got 0."),
        (["--jobs", "0"], "`--jobs` must be at least 1, got 0."),
        (["--team-size", "three"], "three"),
        (["--sedes", "3"], "Did you mean --seeds?"),
    ],
)
def test_a_wrong_request_gets_one_line_and_writes_nothing(
    tmp_path, monkeypatch, capsys, arguments, message
):
    monkeypatch.chdir(tmp_path)
    assert message in complaint(capsys, "run", *arguments)
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_setting_in_a_file_gets_one_line_and_writes_nothing(
    plugins, write_suite, tmp_path, capsys
):
    suite = write_suite('method = "instant"\nsettings.inner.epoch = 2')
    out = tmp_path / "out"
    assert "Did you mean 'epochs'?" in complaint(capsys, "run", str(suite), "--out", str(out))
    suite = write_suite("shattered")
    assert "cannot be imported" in complaint(capsys, "run", str(suite), "--out", str(out))
    assert not out.exists()
    out.write_text("a file")
    suite = write_suite("instant")
    assert "must be a folder, but it is a file" in complaint(
        capsys, "run", str(suite), "--out", str(out)
    )


def test_documents_need_tables(tmp_path, capsys):
    for command in ("leaderboard", "report"):
        assert "holds no results.parquet" in complaint(capsys, command, str(tmp_path))


def test_documents_of_results_are_among_the_reports(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    place = documents_of(tmp_path / "results" / "mine")
    assert place.resolve() == tmp_path / "reports" / "mine"
    assert documents_of(tmp_path / "elsewhere") == tmp_path / "elsewhere"


def test_the_list_shows_plugins_with_their_package_and_broken_ones_with_the_reason(
    plugins, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["list"]) == 0
    lines = capsys.readouterr().out.splitlines()

    def line(name):
        return next(line for line in lines if line.strip().startswith(f"{name} "))

    assert "fakes 1.0" in line("instant")
    assert "broken: " in line("shattered")
    assert "No module named 'fakes_that_do_not_exist'" in line("shattered")
    assert "fidelity-bench" in line("hybrid")
    assert "broken" not in line("hybrid")
    assert "16 runs" in line("quick")
    assert "884 runs" in line("paper")


def test_a_suite_of_broken_plugins_alone_is_listed_with_the_reason(capsys, monkeypatch):
    def broken(suite):
        raise PlanError(f"Suite '{suite.name}' has nothing to run: no simulator imports.")

    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(listing, "expand", broken)
    assert main(["list"]) == 0
    assert "Suite 'quick' has nothing to run: no simulator imports." in capsys.readouterr().out


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(41.4, "41 s"), (187, "3 min 07 s"), (7500, "2 h 05 min"), (float("nan"), "?")],
)
def test_times_read_as_people_write_them(seconds, text):
    assert _clock(seconds) == text
