"""A diagnosis on the terminal: progress while it works, then a short summary."""

from pathlib import Path

from rich.console import Console, Group
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.rule import Rule
from rich.table import Table
from rich.text import Text

from bench.diagnosis_report import tables
from bench.diagnosis_report.remedy import remedy
from bench.diagnosis_report.sentences import next_flight, remarks, set_label, verdict
from bench.text.numbers import probability, rounded
from bench.text.words import clean
from diagnosis.result import Diagnosis

STYLES = {
    "effect": "bold cyan",
    "partly": "bold yellow",
    "none": "bold green",
    "too_few": "bold yellow",
    "unexplained": "bold yellow",
}
"""Colour of each verdict."""
MOST_LINES = 4
"""Channels and candidates in the summary."""


class DiagnosisProgress:
    """A context whose `update` shows what the diagnosis is doing.

    A bar on a terminal; elsewhere one line as each stage begins.
    """

    def __init__(self, console: Console) -> None:
        self.console = console
        self._stage = ""
        self._bar = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=30),
            TextColumn("{task.percentage:>3.0f} %", markup=False),
            TimeElapsedColumn(),
            console=console,
            transient=True,
        )
        self._task = self._bar.add_task("loading flights", total=1.0)

    def __enter__(self) -> "DiagnosisProgress":
        if self.console.is_terminal:
            self._bar.start()
        return self

    def __exit__(self, *raised: object) -> None:
        if self.console.is_terminal:
            self._bar.stop()

    def update(self, stage: str, fraction: float) -> None:
        """The diagnosis is at `stage`, and `fraction` of all its work is done."""
        stage = clean(stage)
        self._bar.update(self._task, description=stage, completed=min(1.0, max(0.0, fraction)))
        if stage != self._stage and not self.console.is_terminal:
            self.console.print(Text(stage), soft_wrap=True)
        self._stage = stage


def show_summary(diagnosis: Diagnosis, out: Path, console: Console) -> None:
    """Prints the verdict, where the gap lies, the best candidates and what to fly next."""
    style = STYLES[diagnosis.verdict]
    console.print(Rule(Text(tables.title(diagnosis)), align="left", style=style))
    console.print(Text(verdict(diagnosis), style))
    for line in remarks(diagnosis):
        console.print(Text(line, "yellow"))
    if diagnosis.compared:  # otherwise the advice stands among the remarks
        console.print(Group(_where(diagnosis), _candidates(diagnosis)))
        console.print(Text.assemble(("Change: ", "bold"), " ".join(remedy(diagnosis, files=False))))
    if advice := next_flight(diagnosis):
        console.print(Text.assemble(("Fly next: ", "bold"), advice))
    place = Text.assemble("Page: ", (clean(out / "diagnosis.html"), "bold"))
    console.print(place, soft_wrap=True)


def _where(diagnosis: Diagnosis) -> Table:
    shown = tables.where_table(diagnosis)
    table = _grid("Where the gap lies")
    for texts in shown.rows[:MOST_LINES]:
        row = dict(zip(shown.headings, texts, strict=True))
        within = "" if row["95 %"] == tables.MISSING else f"(95 %: {row['95 %']})"
        table.add_row(
            row["channel"],
            Text(row.get("share", ""), "bold"),
            f"{row['gap']} {within}",
            Text(f"noise {row['noise floor']}", "dim"),
        )
    return table


def _candidates(diagnosis: Diagnosis) -> Table:
    candidates = diagnosis.candidates
    weighed = any(candidate.evidence is not None for candidate in candidates)
    heading = f"Candidates, probability{', evidence' * weighed}"
    table = _grid(heading if candidates else "")
    for candidate in candidates[:MOST_LINES]:
        style = "bold" if candidate.named else "dim"
        table.add_row(
            Text(set_label(candidate.effects), style),
            Text(probability(candidate.posterior), style),
            Text(f"{rounded(candidate.evidence, 2)} nats" if weighed else "", style),
        )
    return table


def _grid(title: str) -> Table:
    table = Table(title=title or None, title_justify="left", title_style="bold", box=None)
    table.show_header = False
    for _ in range(4):
        table.add_column(overflow="fold")
    return table
