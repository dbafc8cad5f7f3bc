"""What a running sweep shows."""

import io

from rich.console import Console

from bench.execution.progress import SweepProgress
from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite


def test_what_a_plugin_says_is_shown_as_it_is(plugins):
    row = Row("instant", settings={"log": "[/home]"})
    suite = Suite("mine", "", ("spread",), (3,), 1, (row,))
    runs = expand(suite).runs
    out = io.StringIO()
    display = SweepProgress(runs, Console(file=out, force_terminal=True, width=200))
    with display:
        display.started(0, runs)
        display.progress(0, "[/] phase", 3, 9, -1.0)
    assert "[/] phase" in out.getvalue()
    assert "[/home]" in out.getvalue()


def test_the_display_of_a_terminal_shows_run_stage_epoch_return_and_time_left(plugins):
    runs = expand(Suite("test", "", ("spread",), (2,), 2, (Row("instant"),))).runs
    console = Console(file=io.StringIO(), width=120, force_terminal=True, color_system=None)
    display = SweepProgress(runs, console)
    display.started(0, [runs[1]])
    display.progress(0, "HF training", 30, 120, -41.25)
    display.finished(runs[0], "diverged", "", 61.0)
    console.print(display._live.renderable)
    lines = console.file.getvalue().splitlines()
    assert lines[0] == "[1/2] instant spread n2 s0: diverged, 61 s"
    assert lines[1].startswith("1/2 runs ")
    assert lines[1].rstrip().endswith(" left")
    words = " ".join(lines[2].split())
    assert words == "instant spread n2 s1 HF training 30/120, return -41.2 -:--:--"


def test_the_display_of_a_group_names_the_first_and_counts_the_others(plugins):
    runs = expand(Suite("test", "", ("spread",), (2,), 3, (Row("instant"),))).runs
    console = Console(file=io.StringIO(), width=120, force_terminal=True, color_system=None)
    display = SweepProgress(runs, console)
    display.started(0, runs)
    display.finished(runs[0], "ok", "", 2.0)
    display.progress(0, "HF training", 30, 120, -41.25)
    console.print(display._live.renderable)
    text = " ".join(console.file.getvalue().split())
    assert "instant spread n2 s1 and 1 like it HF training 30/120" in text
    display.finished(runs[1], "ok", "", 2.0)
    display.finished(runs[2], "ok", "", 2.0)
    assert not display._lines.tasks
