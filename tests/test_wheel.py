"""The wheel, in an environment of its own: what it holds, and that what it holds works."""

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"bench", "blind", "diagnosis", "methods", "simulators", "tasks"}

pytestmark = pytest.mark.exhaustive


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel of a copy of the committed and the new files; nothing is fetched."""
    source, place = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"]
    names = subprocess.run(listed, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, names.split("\0")):
        if (ROOT / name).is_file() and not name.startswith(("results/", "reports/")):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check"]
    options = ["--no-index", "--no-deps", "--no-build-isolation", "--wheel-dir", str(place)]
    subprocess.run([*pip, *options, str(source)], check=True, timeout=600)
    (built,) = place.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def python(wheel, tmp_path_factory):
    """The interpreter of a new environment with the wheel, and with what it needs from ours."""
    place = tmp_path_factory.mktemp("environment")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(place)], check=True)
    own = next(place.glob("lib/python*/site-packages"))
    # A folder named here is searched after the environment's own, and its .pth files, among them
    # the one of our editable installation, are not read.
    (own / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", str(place), "install", "--quiet"]
    options = ["--no-index", "--no-deps", "--disable-pip-version-check", "--ignore-installed"]
    subprocess.run([*pip, *options, str(wheel)], check=True, timeout=600)
    return place / "bin" / "python"


def run(*command, cwd):
    """Stdout of a command that succeeds, outside of the repository."""
    variables = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=cwd, env=variables, timeout=600
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_wheel_holds_the_packages_with_their_types_and_data_and_nothing_else(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0] for name in names if ".dist-info" not in name} == PACKAGES
    assert {f"{package}/py.typed" for package in PACKAGES} <= {*names}
    tracked = subprocess.run(
        ["git", "ls-files", *sorted(PACKAGES)], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()
    assert {*tracked} <= {*names}


def test_the_installed_wheel_answers_and_is_not_the_checkout(python, tmp_path):
    place = run(python, "-c", "import bench; print(bench.__file__)", cwd=tmp_path)
    assert place.startswith(str(python.parents[1]))
    bench = python.with_name("bench")
    assert run(bench, "--version", cwd=tmp_path).startswith("fidelity-bench ")
    assert "trainer.epochs" in run(bench, "list", "methods", "--settings", cwd=tmp_path)
    assert "17 runs, 0 finished" in run(bench, "plan", "quick", cwd=tmp_path)


def test_the_installed_wheel_writes_documents_and_reads_tables(python, tmp_path):
    paper, bench = ROOT / "results" / "paper", python.with_name("bench")
    run(bench, "leaderboard", paper, "--out", tmp_path, cwd=tmp_path)
    assert (tmp_path / "leaderboard.md").is_file()
    script = "import bench, sys; print(len(bench.load(sys.argv[1]).to_pandas()))"
    assert int(run(python, "-c", script, paper, cwd=tmp_path)) > 100
