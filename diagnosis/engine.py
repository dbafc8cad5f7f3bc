"""`diagnose(flights)`: where the gap lies, which effect causes it, how far it shrinks.

Flights beside a reference take one of two ways. Where effects of the library describe how the
reference flies, its fit is the vehicle that changed (`decide/reference.py`). Real flights seldom
are described so; then a twin is learned from the reference (`twin/`). So are two sets whose
vehicles were weighed anew: each is flown with its own mass.

Logs whose columns are swapped, flipped or in another frame are not explained by physics: where a
column that the replay reads has such a fault, nothing is simulated until it is mended (`misread`).
A path whose frame is turned against the reference's is turned back first, and flights below the
floor are raised.

Without a reference, a vehicle whose attitude loop nobody gave is flown with its measured attitude:
what its loop does is no effect. A quadrotor of 1.65 kg, believed to have 1.5 kg, is so found to
have 10.7 % more mass; with a loop that is not its own, nothing was sure but that loop.
"""

import dataclasses
from collections.abc import Collection
from pathlib import Path

from diagnosis.answer import answer
from diagnosis.decide.prepared import Progress, Question, prepare, silent
from diagnosis.decide.study import study
from diagnosis.decision import Decision
from diagnosis.interface.fault import MOTOR_CLOCK, of_reference
from diagnosis.interface.faults import checks, interface_faults
from diagnosis.interface.mended import in_time, lifted, mended
from diagnosis.interface.untold import untold
from diagnosis.logs.flights import FlightSet, check_comparable, load_flights
from diagnosis.misread import misleads, misread
from diagnosis.replay.believed import default_simulator, loop_is_known
from diagnosis.result import Diagnosis
from diagnosis.twin.as_diagnosis import alone, beside_twin, weighed_anew


def diagnose(
    flights: FlightSet | Path | str,
    *,
    simulator: str | None = None,
    reference: FlightSet | Path | str | None = None,
    exclude: Collection[str] = (),
    decision: Decision = Decision(),
    progress: Progress = silent,
) -> Diagnosis:
    """The diagnosis of `flights` against a registered simulator.

    Args:
        flights: The flights that may have a gap, or the path of their folder.
        simulator: Registered name of the simulator that they are compared with; if None, crazyflow,
            or the point mass for an airframe that crazyflow has no file of.
        reference: Flights of the same vehicle before something changed, or the path of their
            folder; the diagnosis then says what changed.
        exclude: Effects that may not be blamed; with each, those that look like it.
        decision: What decides.
        progress: Called with each stage's name and the share of the work that is done.

    Raises:
        LogError: A folder holds no usable flight, no flight has an input that can be replayed, or
            the reference flew another vehicle, holds one of the flights, too, or logged another
            input.
    """
    compared = None if reference is None else _loaded(reference)
    flown = _loaded(flights)
    if compared is not None:
        check_comparable(flown, compared)
    against = simulator or default_simulator(flown)
    made = checks(flown)
    faults = interface_faults(flown, compared, made)
    beside = None
    if compared is not None:
        beside = lifted(in_time(compared, faults, of_reference(MOTOR_CLOCK)))
    question = Question(lifted(mended(flown, faults)), against, beside, exclude, decision)
    if misleads(faults, made):
        found = misread(question)
    elif weighed_anew(question):
        found = beside_twin(question, progress)
    else:
        or_twin = alone(question)
        measured = beside is None and not loop_is_known(against, flown.vehicle)
        prepared = prepare(question, measured, progress, or_twin)
        if or_twin and prepared.base is not None and prepared.base.unfollowed(decision):
            found = beside_twin(question, progress)
        else:
            found = answer(question, study(question, prepared, progress))
    progress("done", 1.0)
    return dataclasses.replace(found, interface=faults, untold=untold(flown, made))


def _loaded(flights: FlightSet | Path | str) -> FlightSet:
    return flights if isinstance(flights, FlightSet) else load_flights(Path(flights))
