"""Progress of a blind run: a bar with the time left on a terminal, lines elsewhere."""

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text


class CasesProgress:
    """A context that shows how many of `total` cases are done."""

    def __init__(self, what: str, total: int, console: Console, done: int = 0) -> None:
        self.console, self._total = console, total
        self._count, self._failed, self._what = done, 0, what
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            # Cases take a minute: the usual half a minute of history knows no speed.
            TimeRemainingColumn(elapsed_when_finished=True),
            console=console,
            transient=True,
            speed_estimate_period=3600.0,
        )
        self._task = self._bar.add_task(what, total=total, completed=done)

    def __enter__(self) -> "CasesProgress":
        if self.console.is_terminal:
            self._bar.start()
        elif self._count < self._total:
            self.console.print(Text(f"{self._what}: {self._total - self._count} cases"))
        return self

    def __exit__(self, *raised: object) -> None:
        if self.console.is_terminal:
            self._bar.stop()

    def at(self, count: int) -> None:
        """So many are done."""
        if count != self._count:
            self._count = count
            self._bar.update(self._task, completed=count)

    def finished(self, name: str, cause: str, seconds: float) -> None:
        """One more is done, or failed for a cause."""
        self._failed += bool(cause)
        self.at(self._count + 1)
        if self._failed:
            self._bar.update(self._task, description=f"{self._what}, {self._failed} failed")
        if cause or not self.console.is_terminal:
            text = Text(f"[{self._count}/{self._total}] {name}: ")
            text.append("failed" if cause else "ok", "red" if cause else "green")
            text.append(f", {seconds:.0f} s" + (f": {cause}" if cause else ""))
            self.console.print(text, soft_wrap=True)
