import contextlib
import fcntl
import json
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from importlib.metadata import version
from pathlib import Path
from shutil import which

import pytest

from bench.cli.app import main
from bench.plan import listing
from bench.plan.expansion import Plan, PlanError
from bench.text.pages import documents_of
from simulators import registry


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


def test_a_terminal_of_unknown_width_shows_as_much_as_any(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "0")
    assert main(["list", "methods"]) == 0
    assert "hybrid" in capsys.readouterr().out


MISSPELT = {
    "run quik": "Did you mean 'quick'?",
    "run --setting trainer": "must be KEY=VALUE",
    "plan quick --method hybird": "Did you mean 'hybrid'?",
    "leaderboard TABLE": "Did you mean 'tables'?",
    "report TABLE": "Did you mean 'tables'?",
    "claims TABLE": "Did you mean 'tables'?",
    "keep TABLE": "Did you mean 'tables'?",
    "export TABLE --to croissant --out new": "Did you mean 'tables'?",
    "choose TABLE --team-size 3 --budget 5": "Did you mean 'tables'?",
    "submit TABLE --method hybrid --out new": "Did you mean 'tables'?",
    "submit tables --method hybird --out new": "Did you mean 'hybrid'?",
    "verify TABLE": "Did you mean 'tables'?",
    "verify tables --task cirle": "Did you mean 'circle'?",
    "compare a b --results TABLE": "Did you mean 'tables'?",
    "replay run --tables TABLE": "Did you mean 'tables'?",
    "deploy tables cirle 3": "Did you mean 'circle'?",
    "deploy tables circle 3 --reality crazyflow+mas(e=0.2)": "Did you mean 'mass'?",
    "diagnose fligths": "Did you mean 'flights'?",
    "diagnose flights --simulator crazyflo": "Did you mean 'crazyflow'?",
    "diagnose flights --exclude wnd": "Did you mean 'wind'?",
    "diagnose flights --reference fligths": "Did you mean 'flights'?",
    "diagnose --deploy cirle --reality crazyflow": "Did you mean 'circle'?",
    "import log.ulog --out new --drone cf21B_500 --mass 0.04": "Did you mean 'log.ulg'?",
    "check drg": "Did you mean 'drag'?",
    "check drag --simulator crazyflo": "Did you mean 'crazyflow'?",
    "profile hybird circle": "Did you mean 'hybrid'?",
    "blind --reality crazyflo": 'Did you mean "crazyflow"?',
    "blind --inject fligths": "Did you mean 'flights'?",
    "list method": 'Did you mean "methods"?',
}
"""Requests with a misspelt name or path, and what is said of it."""


def test_a_misspelt_name_or_path_is_named_before_anything_heavy_is_imported(tmp_path):
    (tmp_path / "tables").mkdir()
    (tmp_path / "tables" / "results.parquet").touch()
    (tmp_path / "flights").mkdir()
    (tmp_path / "log.ulg").touch()
    script = (
        "import json, sys\nfrom bench.cli.app import main\n"
        "for request in json.loads(sys.argv[1]):\n"
        "    status = main(request.split())\n"
        "    heavy = {'jax', 'pandas', 'equinox', 'numpy', 'jinja2'} & set(sys.modules)\n"
        "    assert (status, heavy) == (2, set()), (request, status, heavy)\n"
    )
    requests = json.dumps([request.replace("TABLE", "table") for request in MISSPELT])
    done = subprocess.run(
        [sys.executable, "-c", script, requests],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    said = done.stderr.splitlines()
    for line, (request, message) in zip(said, MISSPELT.items(), strict=True):
        assert message in line, request


def test_the_version_is_that_of_the_package(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"fidelity-bench {version('fidelity-bench')}\n"


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_written_for_a_shell(shell, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HOME", str(tmp_path))
    place = tmp_path / "completion"
    assert main(["--install-completion", "--shell", shell, "--output", str(place)]) == 0
    script = place.read_text()
    assert all(word in script for word in ("diagnose", "leaderboard", "retry-failed"))
    if which(shell):
        subprocess.run([shell, "-n", str(place)], check=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0"], "`seeds` must be at least 1, got 0."),
        (["--jobs", "0"], "`--jobs` must be at least 1, got 0."),
        (["--team-size", "three"], "three"),
        (["--sedes", "3"], "Did you mean --seeds?"),
        (["--setting", "nominal.attitude_tua=0.1"], "Did you mean 'attitude_tau'?"),
        (["--setting", "nominal=3"], "Setting 'nominal' needs a field"),
        (["--setting", "trainer=3", "--setting", "trainer.lr=1"], "both a value and fields"),
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


def listed(capsys, *arguments):
    """Lines of `bench list`, by their first word."""
    assert main(["list", *arguments]) == 0
    lines = capsys.readouterr().out.splitlines()
    return {line.split()[0]: line for line in reversed(lines) if line.strip()}


def test_the_list_shows_plugins_of_others_with_their_package_and_broken_ones_with_the_reason(
    plugins, capsys, monkeypatch
):
    monkeypatch.setenv("COLUMNS", "200")
    lines = listed(capsys)
    assert "(fakes 1.0)" in lines["instant"]
    assert "broken: " in lines["shattered"]
    assert "No module named 'fakes_that_do_not_exist'" in lines["shattered"]
    assert "fidelity-bench" not in lines["hybrid"]
    assert "broken" not in lines["hybrid"]
    assert "17 runs" in lines["quick"]
    assert "1042 runs" in lines["paper"]


def test_the_list_of_one_kind_shows_settings_with_default_and_meaning(plugins, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    lines = listed(capsys, "methods", "--settings")
    assert "circle" not in lines
    assert re.search(r" 3 +Calibration flights; with more", lines["flights"])
    assert re.search(r" 0\.003 +Adam's learning rate at the start", lines["trainer.lr"])
    assert re.search(r" 3$", lines["inner.epochs"].rstrip())  # of a class without docstrings
    assert "Fitted between -0.5 and 3." in listed(capsys, "effects", "--settings")["c"]


def test_no_name_is_broken_in_80_columns(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setattr(listing, "expand", lambda suite: Plan([None] * 9999, []))
    lines = listed(capsys, "--settings")
    names = {name for kind in registry.GROUPS for name in registry.names(kind)}
    assert {*names, "paper_rotorpy", "trainer.min_improvement"} <= {*lines}
    assert max(map(len, lines.values())) <= 80


def test_the_leaderboard_loses_no_column_at_the_edge_of_80(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("COLUMNS", "80")
    paper = Path(__file__).parents[2] / "results" / "paper"
    assert main(["leaderboard", str(paper), "--out", str(tmp_path)]) == 0
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    rows = [line for line in lines if {"grey_box", "domain_randomization"} & {*line.split()}]
    assert len(rows) >= 8
    assert all(line.endswith("5 ok") for line in rows)
    assert f"Leaderboard: {tmp_path / 'leaderboard.md'}" in lines


def shown_on_a_terminal(command, columns):
    """What a command writes to a terminal of that width, and its exit status."""
    ours, its = pty.openpty()
    fcntl.ioctl(its, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    variables = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES")}
    variables |= {"TERM": "xterm-256color"}
    child = subprocess.Popen(command, stdin=its, stdout=its, stderr=its, env=variables)
    os.close(its)
    parts = []
    with contextlib.suppress(OSError):  # Linux ends a terminal that nobody writes to in this way
        while part := os.read(ours, 65536):
            parts.append(part)
    os.close(ours)
    return b"".join(parts).decode(), child.wait()


def test_a_run_on_a_terminal_of_80_columns_breaks_no_name(plugins, write_suite, tmp_path):
    out = tmp_path / ("a_folder_with_a_name_that_is_far_too_long_for_one_line_" + 40 * "x")
    suite = write_suite("instant", "failing", simulator="calm")
    command = ["run", str(suite), "--out", str(out), "--jobs", "1"]
    script = "import sys; from bench.cli.app import main; sys.exit(main())"
    text, status = shown_on_a_terminal([sys.executable, "-c", script, *command], 80)
    assert status == 1
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text).replace("\r\n", "\n")
    (traceback,) = out.glob("runs/failing-*/traceback.txt")
    assert f"Traceback: {traceback}\n" in text
    assert f"Leaderboard: {out / 'leaderboard.md'}\n" in text
    for method, end in (("instant", "ok"), ("failing", "failed")):
        assert re.search(rf"\[\d/2\] {method} spread n2 s0 \(horizon=5\): {end}, ", text)
    assert re.search(r"^instant, .* 1 ok *$", text, re.MULTILINE)


def test_a_suite_of_broken_plugins_alone_is_listed_with_the_reason(capsys, monkeypatch):
    def broken(suite):
        raise PlanError(f"Suite '{suite.name}' has nothing to run: no simulator imports.")

    monkeypatch.setenv("COLUMNS", "200")
    monkeypatch.setattr(listing, "expand", broken)
    assert main(["list"]) == 0
    assert "Suite 'quick' has nothing to run: no simulator imports." in capsys.readouterr().out
