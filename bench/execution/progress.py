"""Shows a running sweep: live lines on a terminal, one line per finished run elsewhere."""

import dataclasses
import functools
import math

from rich.console import Console, Group
from rich.live import Live
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

from bench.plan.planned_run import Run
from bench.text.numbers import seconds as time_text


@dataclasses.dataclass
class _Work:
    """What one worker is doing."""

    line: TaskID
    runs: list[Run]
    stage: str = ""
    furthest: float = 0.0
    """Largest share of any stage so far: what the runs count in the overall bar."""


class SweepProgress:
    """A context in which the progress of `runs` is shown on `console`."""

    def __init__(self, runs: list[Run], console: Console) -> None:
        self.console = console
        self.count = 0
        self._total = len(runs)
        self._cost_done = 0.0
        self._work: dict[int, _Work] = {}
        label, doing = (
            TextColumn(text, markup=False, table_column=Column())
            for text in ("{task.description}", "{task.fields[doing]}")
        )
        # Runs take minutes: the usual half a minute of history knows no speed.
        progress = functools.partial(Progress, speed_estimate_period=3600.0)
        times = (TimeElapsedColumn(), "elapsed, about", TimeRemainingColumn(), "left")
        self._bar = progress(label, BarColumn(20), *times)
        self._lines = progress(label, doing, TimeRemainingColumn())
        self._all = self._bar.add_task("", total=sum(run.cost for run in runs))
        self._move_bar()
        shown = Group(self._bar, self._lines)
        live = console.is_terminal and runs
        self._live = Live(shown, console=console, transient=True) if live else None

    def __enter__(self) -> "SweepProgress":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *raised: object) -> None:
        if self._live is not None:
            self._live.stop()

    def started(self, worker: int, runs: list[Run]) -> None:
        """A worker began one run, or several at once."""
        line = self._lines.add_task(_label(runs), total=None, doing="starting, compiling")
        self._work[worker] = _Work(line, list(runs))

    def progress(self, worker: int, stage: str, epoch: int, epochs: int, reward: float) -> None:
        """A worker reports an epoch and the training return there."""
        work = self._work[worker]
        if stage != work.stage:
            work.stage = stage
            self._lines.reset(work.line)
        many = epochs > 1
        doing = [f"{stage} {epoch}/{epochs}" if many else stage]
        doing += [] if math.isnan(reward) else [f"return {reward:.1f}"]
        total = epochs if many else None
        self._lines.update(work.line, total=total, completed=epoch, doing=", ".join(doing))
        work.furthest = max(work.furthest, min(1.0, epoch / epochs) if epochs else 0.0)
        self._move_bar()

    def finished(self, run: Run, status: str, cause: str, seconds: float) -> None:
        """A run ended; it may never have started."""
        self.count += 1
        self._cost_done += run.cost
        for worker, work in list(self._work.items()):
            work.runs = [other for other in work.runs if other.name != run.name]
            if work.runs:
                self._lines.update(work.line, description=_label(work.runs))
            else:
                self._lines.remove_task(self._work.pop(worker).line)
        self._move_bar()
        style = {"ok": "green", "budget": "green", "diverged": "yellow"}.get(status, "red")
        text = Text(f"[{self.count}/{self._total}] {run.label}: ")
        text.append(status, style)
        text.append(f", {time_text(seconds)}" + (f": {cause}" if cause else ""))
        self.console.print(text, soft_wrap=True)

    def _move_bar(self) -> None:
        works = self._work.values()
        done = sum(work.furthest * sum(run.cost for run in work.runs) for work in works)
        text = f"{self.count}/{self._total} runs"
        self._bar.update(self._all, completed=self._cost_done + done, description=text)


def _label(runs: list[Run]) -> str:
    """The first run, and how many go with it."""
    others = len(runs) - 1
    return runs[0].label + (f" and {others} like it" if others else "")
