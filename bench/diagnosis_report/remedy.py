"""What to change after a diagnosis: the corrected simulator, and what must be known first."""

from collections.abc import Sequence

from bench.diagnosis_report.sentences import logs_first, set_label
from bench.text.words import clean, join
from diagnosis.correction import parameters_of
from diagnosis.result import Diagnosis, Effect
from simulators.effects.card import load_card

PYTHON = 'diagnosis.corrected("diagnosis.json")'
"""How the corrected simulator is had in Python."""
LIKELIEST = 'diagnosis.corrected("diagnosis.json", likeliest=True)'
"""How the one with the likeliest set is had, where no cause is confirmed."""
COMMAND = "bench diagnose diagnosis.json --remedy crazyflie"
"""How the files for a vehicle are had."""
CODE = (PYTHON, LIKELIEST, COMMAND)
"""What a page shows as code."""
FILES = (
    "For an autopilot's parameters and the next flight as files, run this beside the page: "
    f"{COMMAND} (or px4, or crazyflow)."
)
"""Where the numbers for a vehicle are."""


def remedy(diagnosis: Diagnosis, files: bool = True) -> list[str]:
    """What to change, a sentence or two each; with `files`, also how they are had."""
    advice = [clean(fault.advice) for fault in diagnosis.interface]
    if advice and logs_first(diagnosis):
        return [*advice, "Then diagnose the flights again; nothing else can be said before."]
    if diagnosis.verdict == "too_few":
        few = "there are too few flights to tell whether anything changed."
        return [*advice, f"{'In the vehicle n' if advice else 'N'}othing yet: {few}"]
    if diagnosis.shows_nothing:
        no_change = "these flights show no change beyond noise."
        return [*advice, f"{'In the vehicle n' if advice else 'N'}othing: {no_change}"]
    if not diagnosis.blamed:
        return [
            f"Nothing yet: no cause is confirmed. In Python, {LIKELIEST} is the simulator with the "
            "likeliest set, to look at and not to rely on."
        ]
    said = []
    if first := look_first(diagnosis.blamed):
        said.append(f"On the vehicle, first {first}")
    if diagnosis.verdict == "partly":
        said.append(
            "Something else acts, too, and may bias the numbers: they say what to look at, not yet "
            "what to write into a parameter file."
        )
    said += [_alike(diagnosis)] if any(e.aliases for e in diagnosis.blamed) else []
    said.append(_simulator(diagnosis))
    return [*said, FILES] if files else said


def look_first(effects: Sequence[Effect]) -> str:
    """What to look at on the vehicle before a number is changed; a sentence's end after "first".

    What looks like an effect has its turn, too: the look tells which of them it is.
    """
    names = [name for effect in effects for name in (effect.name, *effect.aliases)]
    checks = dict.fromkeys(load_card(clean(name)).check for name in names)
    text = ". Also ".join(filter(None, checks))
    return f"{text}." if text else ""


def _simulator(diagnosis: Diagnosis) -> str:
    text = " + ".join(
        f"{clean(name)}({', '.join(f'{clean(key)}={value:.4g}' for key, value in own.items())})"
        for name, own in parameters_of(diagnosis).items()
    )
    beside = " (those of the reference flights are among them)" if diagnosis.details.shared else ""
    alone = " It has the change alone." if diagnosis.details.followed else ""
    return (
        f"In {clean(diagnosis.settings.simulator)}, with the airframe and mass of these flights: "
        f"{text}{beside}. In Python, {PYTHON} is that simulator.{alone}"
    )


def _alike(diagnosis: Diagnosis) -> str:
    """That the simulator may be corrected, but not yet the vehicle."""
    pairs = join(
        f"{set_label([e.name])} from {' or '.join(set_label([a]) for a in e.aliases)}"
        for e in diagnosis.blamed
        if e.aliases
    )
    what = "change" if diagnosis.details.followed else "gap"
    return (
        f"These flights cannot tell {pairs}. In the simulator either makes up for the {what}. On "
        "the vehicle only one is the cause: change a parameter there only if its new value is the "
        "same for both, and otherwise fly what tells them apart first."
    )
