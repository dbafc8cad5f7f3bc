"""Shows a running sweep: live lines on a terminal, one line per finished run elsewhere."""

import dataclasses
import math
import time

from rich.console import Console, Group
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from bench.plan.planned_run import Run


@dataclasses.dataclass
class _Line:
    """What one worker is doing."""

    runs: list[Run]
    stage: str = "starting, compiling"
    epoch: int = 0
    epochs: int = 0
    reward: float = math.nan
    stage_start: float = dataclasses.field(default_factory=time.monotonic)
    furthest: float = 0.0
    """Largest share of any stage so far: what the runs count in the overall bar."""

    @property
    def label(self) -> str:
        """The first run, and how many go with it."""
        others = len(self.runs) - 1
        return self.runs[0].label + (f" and {others} like it" if others else "")

    @property
    def cost(self) -> float:
        """Cost of all its runs."""
        return sum(run.cost for run in self.runs)

    @property
    def fraction(self) -> float:
        """Share of the stage that is done, at most 1."""
        return min(1.0, self.epoch / self.epochs) if self.epochs else 0.0

    @property
    def left(self) -> float:
        """Expected time to the end of the stage, at its pace so far [s]; NaN if unknown."""
        if not 0.0 < self.fraction < 1.0:
            return math.nan
        return (time.monotonic() - self.stage_start) * (1.0 / self.fraction - 1.0)


class SweepProgress:
    """A context in which the progress of `runs` is shown on `console`."""

    def __init__(self, runs: list[Run], console: Console) -> None:
        self.console = console
        self.count = 0
        self._total = len(runs)
        self._cost = sum(run.cost for run in runs)
        self._cost_done = 0.0
        self._lines: dict[int, _Line] = {}
        self._start = time.monotonic()
        self._live = (
            Live(console=console, get_renderable=self._render, transient=True)
            if console.is_terminal and runs
            else None
        )

    def __enter__(self) -> "SweepProgress":
        if self._live is not None:
            self._live.start()
        return self

    def __exit__(self, *raised: object) -> None:
        if self._live is not None:
            self._live.stop()

    def started(self, worker: int, runs: list[Run]) -> None:
        """A worker began one run, or several at once."""
        self._lines[worker] = _Line(list(runs))

    def progress(self, worker: int, stage: str, epoch: int, epochs: int, reward: float) -> None:
        """A worker reports an epoch and the training return there."""
        line = self._lines[worker]
        if stage != line.stage:
            line.stage, line.stage_start = stage, time.monotonic()
        line.epoch, line.epochs, line.reward = epoch, epochs, reward
        line.furthest = max(line.furthest, line.fraction)

    def finished(self, run: Run, status: str, cause: str, seconds: float) -> None:
        """A run ended; it may never have started."""
        self.count += 1
        self._cost_done += run.cost
        for worker, line in list(self._lines.items()):
            line.runs = [other for other in line.runs if other.name != run.name]
            if not line.runs:
                del self._lines[worker]
        style = {"ok": "green", "budget": "green", "diverged": "yellow"}.get(status, "red")
        text = Text(f"[{self.count}/{self._total}] {run.label}: ")
        text.append(status, style)
        text.append(f", {_clock(seconds)}" + (f": {cause}" if cause else ""))
        self.console.print(text, soft_wrap=True)

    def _render(self) -> Group:
        elapsed = time.monotonic() - self._start
        done = self._cost_done + sum(l.furthest * l.cost for l in self._lines.values())
        left = elapsed * (self._cost - done) / done if done > 0.0 else math.nan
        overall = Table.grid(padding=(0, 1))
        overall.add_row(
            Text(f"{self.count}/{self._total} runs", "bold"),
            ProgressBar(total=self._cost, completed=done, width=20),
            Text(f"{_clock(elapsed)} elapsed, about {_clock(left)} left"),
        )
        lines = Table.grid(padding=(0, 2))
        for _, line in sorted(self._lines.items()):
            reward = "" if math.isnan(line.reward) else f"return {line.reward:.1f}"
            epochs = f"{line.epoch}/{line.epochs}" if line.epochs > 1 else ""
            left = "" if math.isnan(line.left) else f"{_clock(line.left)} left"
            lines.add_row(*map(Text, (line.label, line.stage, epochs, reward, left)))
        return Group(overall, lines)


def _clock(seconds: float) -> str:
    """A duration for people, e.g. "41 s", "3 min 07 s", "2 h 05 min"."""
    if math.isnan(seconds):
        return "?"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60:02d} s"
    return f"{whole // 3600} h {whole // 60 % 60:02d} min"
