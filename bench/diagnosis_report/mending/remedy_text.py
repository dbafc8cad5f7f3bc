"""What to change after a diagnosis, as Markdown for one autopilot or for the simulator."""

from collections.abc import Mapping, Sequence

import numpy as np

from bench.diagnosis_report import tables
from bench.diagnosis_report.gap_text import expected
from bench.diagnosis_report.remedy import look_first, remedy
from bench.diagnosis_report.sentences import logs_first, next_flight, verdict
from bench.text import markdown
from bench.text.numbers import MISSING, estimate, rounded, with_unit
from bench.text.words import clean, join
from diagnosis.remedies.changes import FirmwareChange, firmware_changes, without_parameter
from diagnosis.remedies.trajectory import Geofence, Trajectory
from diagnosis.result import Diagnosis
from simulators.effects.card import load_card, manoeuvre

TARGETS = {
    "crazyflow": "crazyflow",
    "crazyflie": "the Crazyflie's firmware",
    "px4": "PX4",
}
"""What a remedy may be for, as `--remedy` is given it, with its name."""
DESCRIPTIVE = (
    "Descriptive only: something else acts, too, or nothing is confirmed, and the numbers may be "
    "biased by it. They say what to look at; do not write them into a vehicle."
)


def remedy_text(
    diagnosis: Diagnosis,
    target: str,
    values: Mapping[str, float],
    flight: Sequence[str],
    unwritten: str = "",
) -> str:
    """The document.

    `values` are the autopilot's parameters now, `flight` says what to fly next, and `unwritten` why
    there is no file of changed parameters.
    """
    parts = [f"# What to change in {TARGETS[target]}: {markdown.escape(tables.title(diagnosis))}"]
    parts.append(f"**{markdown.escape(verdict(diagnosis))}**")
    if target == "crazyflow":
        parts += [markdown.escape(line) for line in remedy(diagnosis, files=False)]
        parts += ["The numbers are in params.toml."] if diagnosis.effects else []
    else:
        parts += [*_autopilot(diagnosis, target, values), *filter(None, [unwritten])]
    parts += ["## Fly next", *map(markdown.escape, flight)]
    return "\n\n".join(parts) + "\n"


def flight_lines(
    diagnosis: Diagnosis,
    trajectory: Trajectory,
    geofence: Geofence,
    pair: tuple[str, str] | None,
) -> list[str]:
    """What is in the files of the next flight, which tells `pair` apart; None: no such flight."""
    said = [advice] if (advice := next_flight(diagnosis)) else []
    if pair is None:
        said.append(
            "The files hold no such flight: targets of position cannot say it, or nothing is to be "
            "separated. They hold climbs and hard turns, which show whether the change has helped."
        )
    else:
        one, other = _labels(pair)
        said.append(f"The files hold the flight that tells {one} from {other}, and no other.")
    _, values = trajectory.sampled(0.01)
    values = np.round(values[:, :3], 1) + 0.0  # no -0.0
    start, low, high = values[0], values.min(axis=0), values.max(axis=0)
    size = f"{100 * trajectory.scale:.0f} % of its" if trajectory.scale < 1.0 else "its full"
    spans = join(
        f"{axis} from {a:.1f} to {b:.1f}" for axis, a, b in zip("xyz", low, high, strict=True)
    )
    said.append(
        f"The path '{trajectory.path}' fits into the geofence ({geofence.length:g} x "
        f"{geofence.width:g} x {geofence.height:g} m, with the origin on the floor, in its middle) "
        f"at {size} size. It starts at ({start[0]:.1f}, {start[1]:.1f}, {start[2]:.1f}) m and runs "
        f"over {spans} m, with z up, at up to {rounded(trajectory.top_speed, 2)} m/s, in "
        f"{trajectory.durations.sum():.1f} s. Hover at its start before, land after it; its "
        "coordinates are absolute, not relative to where the drone is."
    )
    thrust = trajectory.top_thrust
    said.append(
        f"The path asks for up to {thrust:.2f} times the thrust of hover. A drone that needs "
        f"{100.0 / thrust:.0f} % of its full thrust to hover cannot follow it. Stay well "
        "below, and look at propellers, battery and weight before."
    )
    if trajectory.scale < 1.0:
        said.append(
            "A smaller path is slower: what shows by speed shows less. With more room, give it as "
            "--geofence."
        )
    return said


def _autopilot(diagnosis: Diagnosis, target: str, values: Mapping[str, float]) -> list[str]:
    if diagnosis.shows_nothing or not diagnosis.effects or logs_first(diagnosis):
        return [markdown.escape(line) for line in remedy(diagnosis, files=False)]
    changes = firmware_changes(diagnosis, target)
    now = [change for change in changes if not change.waits_for]
    wait = [change for change in changes if change.waits_for]
    parts = [DESCRIPTIVE] if any(change.descriptive for change in changes) else []
    if first := look_first(diagnosis.effects):
        parts += [f"First {first}"]
    if now:
        heading = "## What it would change" if any(c.descriptive for c in now) else "## Change"
        parts += [heading, _table(now, values), *filter(None, [expected(diagnosis)])]
    if wait:
        parts += ["## Do not change yet", *_waiting(diagnosis, wait), _table(wait, values)]
    if idle := without_parameter(diagnosis, target):
        parts.append("## No parameter for it")
        alike: dict[str, list[str]] = {}
        for name in idle:
            alike.setdefault(load_card(clean(name)).instead, []).append(name)
        parts += [
            f"No parameter of {TARGETS[target]} makes up for: {join(_labels(names))}. {instead} "
            "(`--remedy crazyflow`)."
            for instead, names in alike.items()
        ]
    return parts


def _table(changes: Sequence[FirmwareChange], values: Mapping[str, float]) -> str:
    headings = ("parameter", "change", "95 %", "now", "would be", "where", "makes up for")
    rows = [_row(change, name, values) for change in changes for name in change.parameters]
    return markdown.text_table(headings, rows, (0, 5, 6))


def _row(change: FirmwareChange, name: str, values: Mapping[str, float]) -> list[str]:
    amount, interval = estimate(change.amount, change.low, change.high)
    unit = change.unit if change.how == "plus" else ""
    old = values.get(name, change.was)
    new = change.amount if change.how == "value" else old if old is None else change.of(old)
    return [
        name,
        "set" if change.how == "value" else f"{change.how} {with_unit(amount, unit)}",
        with_unit(interval, unit) if interval else MISSING,
        MISSING if old is None else with_unit(rounded(old, 4), change.unit),
        MISSING if new is None else with_unit(rounded(new, 4), change.unit),
        change.where,
        " or ".join([join(_labels(change.effects)), *_labels(change.alike)]),
    ]


def _labels(effects: Sequence[str]) -> list[str]:
    return [load_card(clean(name)).label for name in effects]


def _waiting(diagnosis: Diagnosis, changes: Sequence[FirmwareChange]) -> list[str]:
    """One line for each pair of effects that must be told apart, with the flight that does it."""
    alike = {(effect.name, alias) for effect in diagnosis.effects for alias in effect.aliases}
    waiting = ((e, alias) for c in changes for e in c.effects for alias in c.waits_for)
    said = []
    for one, other in dict.fromkeys(pair for pair in waiting if pair in alike):
        labels = _labels((one, other))
        flight = manoeuvre(one, other) or "fly what shows each of them most, in flights of its own"
        said.append(f"To tell {labels[0]} from {labels[1]}, fly this: {flight}.")
    return [markdown.escape(line) for line in said]
