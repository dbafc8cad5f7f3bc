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
