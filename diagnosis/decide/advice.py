"""The flight to fly next: what would separate effects that these flights cannot tell apart.

Each advice names a manoeuvre in which the two effects act differently, by their equations.
"""

from collections.abc import Mapping, Sequence

MANOEUVRES: Mapping[frozenset[str], str] = {
    frozenset(pair): text
    for pair, text in (
        (
            ("mass", "thrust_gain"),
            "fast straight lines at 2 m/s or more: drag slows a heavier drone less, while a "
            "weaker rotor leaves that unchanged",
        ),
        (
            ("drag", "quadratic_drag"),
            "straight lines at two very different speeds, 0.5 and 3 m/s, each held for 2 s",
        ),
        (
            ("rotor_drag", "quadratic_drag"),
            "straight lines at two very different speeds, 0.5 and 3 m/s, each held for 2 s",
        ),
        (
            ("rotor_drag", "drag"),
            "climbs and descents at 1 m/s with hard turns: rotors brake more the faster they turn, "
            "and more along their axis",
        ),
        (
            ("wind", "gust"),
            "10 s of hover that begin well before the disturbance does",
        ),
        (
            ("attitude_lag", "delay"),
            "attitude steps of 0.3 rad every 0.4 s: a delay shifts the response, a lag rounds it",
        ),
        (
            ("delay", "inertia"),
            "attitude steps of 0.3 rad every 0.4 s: a delay shifts the response, inertia rounds it",
        ),
        (
            ("attitude_lag", "motor_lag"),
            "attitude steps and thrust steps in turn: slow rotors delay thrust as well",
        ),
        (
            ("delay", "motor_lag"),
            "attitude steps and thrust steps in turn: slow rotors round the thrust's response",
        ),
        (
            ("inertia", "motor_lag"),
            "attitude steps and thrust steps in turn: inertia rounds the first alone, slow rotors "
            "round both",
        ),
        (
            ("attitude_lag", "inertia"),
            "attitude steps of 0.3 rad every 0.4 s, as sharp as the controller allows",
        ),
        (
            ("trim", "center_of_mass"),
            "up and down by 25 cm every 1.4 s, so that the thrust swings by half of the weight: "
            "the tilt that an offset of the centre of mass causes grows with thrust, a trim does "
            "not",
        ),
        (
            ("trim", "wind"),
            "hover with the yaw turned by 90 degrees every 3 s: a trim turns with the drone",
        ),
        (
            ("battery", "thrust_gain"),
            "one flight of a minute or more: a weak battery grows with time",
        ),
        (
            ("battery", "mass"),
            "one flight of a minute or more: a weak battery grows with time",
        ),
        (
            ("ground_effect", "thrust_gain"),
            "hover at 0.05, 0.1, 0.3 and 1 m: ground effect vanishes with height",
        ),
        (
            ("ground_effect", "mass"),
            "hover at 0.05, 0.1, 0.3 and 1 m: ground effect vanishes with height",
        ),
        (
            ("thrust_gain", "wind"),
            "climbs and descents at 1 m/s with hard turns: a thrust error grows with thrust and "
            "tilts with the drone, a vertical wind does neither",
        ),
        (
            ("mass", "wind"),
            "climbs and descents at 1 m/s with hard turns: a mass error grows with thrust and "
            "tilts with the drone, a vertical wind does neither",
        ),
    )
}
"""What separates two effects."""

REGIMES: Mapping[str, str] = {
    "ground_effect": "hover below 0.1 m",
    "downwash": "two drones, one passing 0.5 m below the other",
    "battery": "one flight of several minutes",
    "voltage_sag": "two flights of a minute, one from a full and one from a half-empty battery",
    "motor_lag": "thrust steps of 30 % every 0.4 s",
    "gyro_compensation": "circles at 2 m/s under yaw sweeps of 1 rad/s",
    "rotor_arm": "attitude steps of 0.3 rad every 0.4 s",
    "rotor_torque": "yaw steps of 0.5 rad every second",
    "rotor_response": "thrust steps of 30 % every 0.4 s",
    "inertia": "attitude steps of 0.3 rad every 0.4 s",
    "quadratic_drag": "straight lines at 3 m/s",
    "drag": "straight lines at 1 to 2 m/s",
    "rotor_drag": "climbs and descents at 1 m/s",
    "translational_lift": "level straight lines at 2 m/s",
    "roll_pitch_gains": "attitude steps of 0.3 rad every 0.4 s",
    "yaw_gains": "yaw steps of 0.5 rad every second",
    "rotor_inertia": "yaw steps of 0.5 rad every second",
}
"""Where an effect shows best."""


def next_flight(
    kind: str, aliases: Mapping[str, Sequence[str]], where: str | None, blind_to: Sequence[str]
) -> str:
    """One sentence: what to fly next, and what for.

    `where` names the regime of the largest remaining gap, `blind_to` effects that these flights
    would hardly have shown.
    """
    pairs = [(name, other) for name, others in aliases.items() for other in others]
    # One whose manoeuvre was tried comes first.
    for one, other in sorted(pairs, key=lambda pair: frozenset(pair) not in MANOEUVRES)[:1]:
        if text := MANOEUVRES.get(frozenset({one, other})):
            return f"To separate {one} from {other}: {text}."
        return (
            f"To separate {one} from {other}: fly {_of(one)}, then {_of(other)}, "
            "each in flights of their own."
        )
    if kind == "unexplained":
        place = f" where most is left ({where})" if where else ""
        return f"Fly again{place} and change one thing at a time; no candidate has this shape."
    for name in blind_to:
        if name in REGIMES:
            return f"To be able to see {name.replace('_', ' ')} as well: {REGIMES[name]}."
    return "Nothing: these flights separate all candidates that they can show."


def _of(name: str) -> str:
    return REGIMES.get(name, f"whatever shows {name.replace('_', ' ')} most")
