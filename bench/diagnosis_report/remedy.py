"""What to change after a diagnosis: the corrected simulator, and what must be known first."""

from bench.diagnosis_report.numbers import clean
from bench.diagnosis_report.sentences import join
from diagnosis.correction import parameters_of
from diagnosis.result import Diagnosis
from simulators.effects.card import load_card

PYTHON = 'diagnosis.corrected("diagnosis.json")'
"""How the corrected simulator is had in Python."""
LIKELIEST = 'diagnosis.corrected("diagnosis.json", likeliest=True)'
"""How the one with the likeliest set is had, where no cause is confirmed."""
COMMAND = "bench diagnose diagnosis.json --remedy px4"
"""How the files for a vehicle are had."""
CODE = (PYTHON, LIKELIEST, COMMAND)
"""What a page shows as code."""
FILES = (
    f"To write an autopilot's parameters and the next flight to files, run: {COMMAND} (or "
    "crazyflie, or crazyflow)."
)
"""Where the numbers for a vehicle are."""


def remedy(diagnosis: Diagnosis) -> list[str]:
    """What to change, a sentence or two each; empty where the logs themselves are wrong."""
    if any(fault.readings for fault in diagnosis.interface) and not diagnosis.blamed:
        advice = [clean(fault.advice) for fault in diagnosis.interface]
        return [*advice, "Then diagnose the flights again; nothing else can be said before."]
    if diagnosis.shows_nothing:
        return ["Nothing: these flights show no change that stands out of noise."]
    if not diagnosis.blamed:
        return [
            f"Nothing yet: no cause is confirmed. In Python, {LIKELIEST} is the simulator with the "
            "likeliest set, to look at and not to rely on."
        ]
    said = [_simulator(diagnosis)]
    if diagnosis.verdict == "partly":
        said.append(
            "Something else acts, too, and may bias the numbers: they say what to look at, not yet "
            "what to write into a parameter file."
        )
    said += [_alike(diagnosis)] if any(e.aliases for e in diagnosis.blamed) else []
    names = [name for e in diagnosis.blamed for name in (e.name, *e.aliases)]
    checks = [load_card(clean(name)).check for name in names]
    if first := [check for check in dict.fromkeys(checks) if check]:
        said.append(f"On the vehicle, first {'; also '.join(first)}.")
    return [*said, FILES]


def _simulator(diagnosis: Diagnosis) -> str:
    text = " + ".join(
        f"{clean(name)}({', '.join(f'{clean(key)}={value:.4g}' for key, value in own.items())})"
        for name, own in parameters_of(diagnosis).items()
    )
    beside = " (those of the reference flights are among them)" if diagnosis.details.shared else ""
    return (
        f"In {clean(diagnosis.settings.simulator)}, with the airframe and mass of these flights: "
        f"{text}{beside}. In Python, {PYTHON} is that simulator."
    )


def _alike(diagnosis: Diagnosis) -> str:
    """That the simulator may be corrected, but not yet the vehicle."""
    pairs = join(
        f"{load_card(clean(e.name)).label} from "
        f"{' or '.join(load_card(clean(a)).label for a in e.aliases)}"
        for e in diagnosis.blamed
        if e.aliases
    )
    return (
        f"These flights cannot tell {pairs}. In the simulator either makes up for the gap. On the "
        "vehicle only one is the cause: change a parameter there only if its new value is the same "
        "for both, and otherwise fly what tells them apart first."
    )
