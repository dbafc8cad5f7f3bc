"""The answer where columns of the logs do not hold what they are taken for: mend the logs first.

A replay reads position, velocity, attitude and commands. If one of them is in another order,
sign, frame or unit, the simulator would be compared with wrong numbers. Then nothing is simulated.
A replay does not read the accelerometer, the angular velocity or the order of the motors. If only
these are wrong, the answer stays as it is.
"""

from collections.abc import Sequence

from diagnosis.decide.prepared import Question, driven
from diagnosis.fit.shrinkage import unknown_shrink
from diagnosis.interface.fault import ORDERED, InterfaceFault, of_reference
from diagnosis.interface.faults import Checks
from diagnosis.recorded import flights_used, settings_of, this_program
from diagnosis.result import Details, Diagnosis, Remainder
from diagnosis.result_parts import Misfit

REPLAYED = frozenset({*ORDERED, *map(of_reference, ORDERED), "frame of the path"})
"""Parts of the interface that a replay reads and no effect describes; effects describe a clock, a
thrust scale, a heading and turned commands."""
WITNESSES = frozenset({"angular velocity", "accelerometer"})
"""Parts that are seen from the attitude, which may be the wrong one of the two."""


def misleads(faults: Sequence[InterfaceFault], made: Checks) -> bool:
    """Whether a column that a replay reads is wrong, or may be.

    A witness that is at odds with the attitude casts doubt on it, unless the path confirms it.
    """
    parts = {fault.part for fault in faults}
    attitude = made.compared.get("attitude")
    confirmed = attitude is not None and not attitude.names
    return bool(parts & REPLAYED) or (bool(parts & WITNESSES) and not confirmed)


def misread(question: Question) -> Diagnosis:
    """The diagnosis of flights that were compared with nothing.

    Raises:
        LogError: As `prepare`.
    """
    inputs, compared = driven(question)
    return Diagnosis(
        verdict="unexplained",
        probability=None,
        effects=(),
        remainder=Remainder(),
        doubt=None,
        where=(),
        candidates=(),
        support=(),
        shrink=unknown_shrink(len(inputs.flights), "the logs must be mended first"),
        next_flight=None,
        flights=flights_used(question.flights, inputs, lambda _: "checked only"),
        reference=None
        if question.reference is None or compared is None
        else flights_used(question.reference, compared, lambda _: "checked only"),
        settings=settings_of(question),
        program=this_program(),
        details=Details(misfit=Misfit()),
    )
