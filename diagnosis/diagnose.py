"""`diagnose(flights)`: where the gap lies, which effect causes it, how far it shrinks.

Flights beside a reference take one of two ways. Where effects of the library describe how the
reference flies, its fit is the vehicle that changed (`decide/reference.py`). Real flights seldom
are described so; then a twin is learned from the reference (`twin/`). So are two sets whose
vehicles were weighed anew: each is flown with its own mass.
"""

from collections.abc import Collection

from diagnosis.answer import answer
from diagnosis.decide.prepared import Progress, Question, prepare, silent
from diagnosis.decide.study import study
from diagnosis.decision import Decision
from diagnosis.logs.flights import FlightSet
from diagnosis.result import Diagnosis
from diagnosis.twin.as_diagnosis import alone, beside_twin, weighed_anew


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
    if weighed_anew(question):
        found = beside_twin(question, progress)
    else:
        prepared = prepare(question, progress=progress)
        if prepared.base is not None and prepared.base.unfollowed(decision) and alone(question):
            found = beside_twin(question, progress)
        else:
            found = answer(question, study(question, prepared, progress))
    progress("done", 1.0)
    return found
