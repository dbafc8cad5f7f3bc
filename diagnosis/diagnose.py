"""`diagnose(flights)`: where the gap lies, which effect causes it, how far it shrinks."""

from collections.abc import Collection

from diagnosis.answer import answer
from diagnosis.decide.prepared import Progress, Question, silent
from diagnosis.decide.study import study
from diagnosis.decision import Decision
from diagnosis.logs.flights import FlightSet
from diagnosis.result import Diagnosis


def diagnose(
    flights: FlightSet,
    *,
    simulator: str = "crazyflow",
    reference: FlightSet | None = None,
    exclude: Collection[str] = (),
    decision: Decision = Decision(),
    progress: Progress = silent,
) -> Diagnosis:
    """The diagnosis of `flights` against a registered simulator.

    `decision` holds every threshold. `progress` is told each stage's name and the share of the
    work that is done.

    Raises:
        LogError: No flight has an input that can be replayed, or the reference flew another
            vehicle or logged another input.
    """
    question = Question(flights, simulator, reference, exclude, decision)
    found = answer(question, study(question, progress))
    progress("done", 1.0)
    return found
