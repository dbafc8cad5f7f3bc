"""What a user waits for before anything happens."""

import subprocess
import sys


def test_help_appears(benchmark):
    done = benchmark.pedantic(
        lambda: subprocess.run(
            [sys.executable, "-m", "bench", "--help"], capture_output=True, text=True, check=True
        ),
        rounds=3,
    )
    assert "leaderboard" in done.stdout


def test_paper_suite_is_planned(benchmark):
    from bench.plan import expand
    from bench.suite import load_suite

    plan = benchmark.pedantic(lambda: expand(load_suite("paper")), rounds=1)
    assert len(plan.runs) == 4 * 6 * 6 * 5
