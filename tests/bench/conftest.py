"""Fake plug-ins, installed for a test as any third party's would be."""

import os
import textwrap
from pathlib import Path

import at_once
import pytest

from bench.cli.app import main
from simulators import registry

METHODS = {
    "instant": "Instant",
    "child": "Child",
    "failing": "Failing",
    "heir": "Heir",
    "dying": "Dying",
    "flown": "Flown",
    "ouroboros": "Ouroboros",
}


@pytest.fixture
def plugins(tmp_path, monkeypatch, program_cache):
    """The methods of `fakes.py` and one broken one are registered, in child processes too."""
    site = tmp_path / "site"
    info = site / "fakes-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: fakes\nVersion: 1.0\n")
    points = "".join(f"{name} = fakes:{cls}\n" for name, cls in METHODS.items())
    points += "shattered = fakes_that_do_not_exist:Shattered\n"
    calm = "[bench.simulators]\ncalm = fakes:Calm\n"
    (info / "entry_points.txt").write_text(f"[bench.methods]\n{points}{calm}")
    here = str(Path(__file__).parent)
    monkeypatch.syspath_prepend(here)
    monkeypatch.syspath_prepend(str(site))
    root = str(Path(__file__).parents[2])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(site), here, root)))
    monkeypatch.setenv("FAKES_CURE", str(tmp_path / "cure"))
    monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", str(program_cache))
    registry._entry_points.cache_clear()
    registry.load.cache_clear()
    yield site
    monkeypatch.undo()
    registry._entry_points.cache_clear()
    registry.load.cache_clear()


@pytest.fixture
def write_suite(tmp_path):
    """A function that writes a suite of one small cell and returns its path."""

    def write(*rows, seeds=1, **changes):
        keys = {"tasks": ["spread"], "team_sizes": [2], "seeds": seeds} | changes
        lines = [f"{key} = {value!r}" for key, value in keys.items()]
        for row in rows:
            row = f'method = "{row}"' if "=" not in row else textwrap.dedent(row)
            lines += ["[[methods]]", row, "task_settings.horizon = 5"]
        path = tmp_path / "small.toml"
        path.write_text("\n".join(lines) + "\n")
        return path

    return write


@pytest.fixture
def in_process(plugins, monkeypatch):
    """Sweeps start no process."""
    at_once.do_really(monkeypatch)


@pytest.fixture
def trainer(plugins, monkeypatch):
    return at_once.install(monkeypatch, documents=False)


@pytest.fixture
def sweep(trainer, write_suite, tmp_path, capsys):
    """A function that runs a suite and returns exit status, stdout and stderr."""
    suite = write_suite("instant", "child", seeds=2)

    def run(*arguments, command="run", of=suite):
        trainer.trained.clear()
        jobs = ("--jobs", "1") if command == "run" else ()
        status = main([command, str(of), "--out", str(tmp_path / "out"), *jobs, *arguments])
        said = capsys.readouterr()
        return status, " ".join(said.out.split()), " ".join(said.err.split())

    return run


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"
