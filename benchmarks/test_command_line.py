"""What a user waits for before anything happens."""

import resource
import subprocess
import sys
from pathlib import Path

import pytest

LIBRARIES = "import cyclopts, rich.console, rich.markdown"
"""What no help on a command line can do without."""
HELP_LIMIT = 2.0
"""Processor time that help may take, relative to importing these libraries alone."""


def processor_time(*arguments):
    """Processor time of a Python process [s], the least of three."""
    times = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        times.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return min(times)


def test_help_appears(benchmark):
    done = benchmark.pedantic(
        lambda: subprocess.run(
            [sys.executable, "-m", "bench", "--help"], capture_output=True, text=True, check=True
        ),
        rounds=3,
    )
    assert "leaderboard" in done.stdout
    ratio = processor_time("-m", "bench", "--help") / processor_time("-c", LIBRARIES)
    benchmark.extra_info["over_libraries"] = ratio
    assert ratio < HELP_LIMIT


@pytest.fixture
def plugins_loaded():
    """Plug-ins are imported once a process, whatever is planned: not what is measured here."""
    from bench.plan.expansion import expand
    from bench.plan.suite import load_suite

    expand(load_suite("quick"))


def test_paper_suite_is_planned(benchmark, plugins_loaded):
    from bench.plan.expansion import expand
    from bench.plan.suite import load_suite

    plan = benchmark.pedantic(
        lambda: [run.key for run in expand(load_suite("paper")).runs], rounds=3
    )
    assert len(set(plan)) == 4 * 6 * 6 * 5


def test_paper_suite_is_forecast(benchmark, plugins_loaded, tmp_path):
    from rich.console import Console

    from bench.execution.outlook import show_plan
    from bench.plan.expansion import expand
    from bench.plan.suite import load_suite

    plan = expand(load_suite("paper"))
    with Path("/dev/null").open("w") as nowhere:
        status = benchmark.pedantic(
            lambda: show_plan("paper", plan, tmp_path, 2, False, Console(file=nowhere)), rounds=3
        )
    assert status == 0
