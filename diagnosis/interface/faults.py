"""`interface_faults(flights)`: what a log says wrongly, found in seconds and before any physics.

Nothing is simulated. Columns that say the same thing are compared (`orders`, `commands`), and sizes
with what vehicles do by themselves (`scales`). Later checks read columns as earlier ones found them
to be meant where that matters: the lag is that of the order and sign that fit.

Beside a reference the question is what changed. A size that the reference has, too, is then no
fault. The path's frame and the time that motors take to turn the drone are compared with the
reference's: what both sets share falls out, so that small changes show.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from diagnosis.interface import commands, orders, position, scales
from diagnosis.interface.commands import Following
from diagnosis.interface.fault import (
    MOTOR_CLOCK,
    OWN,
    SIZED,
    Evidence,
    InterfaceFault,
    in_order,
    in_reference,
)
from diagnosis.interface.inputs import lift_given, thrust_given
from diagnosis.interface.mended import below_floor
from diagnosis.interface.motors import (
    Pieces,
    Turning,
    drifting,
    later_since,
    motor_order,
    pieces_of,
    turning,
)
from diagnosis.interface.readings import RIGHT, Chosen
from diagnosis.interface.scales import Size, sized
from diagnosis.interface.windows import Windows, make_windows
from diagnosis.logs.flights import DroneLog, FlightSet, VehicleFile
from diagnosis.logs.noise import measured

FEWEST_WINDOWS = 8
"""Fewest windows that say anything; two seconds and a half of flight."""
POUNDS = 2.2046
"""Pounds in a kilogram, the one unit in which a mass is within three times the airframe's."""


def interface_faults(
    flights: FlightSet,
    reference: FlightSet | None = None,
    made: "Checks | None" = None,
    then: "Checks | None" = None,
) -> tuple[InterfaceFault, ...]:
    """Every part of the interface that these flights show to be wrong, in the order of `PARTS`.

    Beside a `reference`, a size that it has, too, is left out, and what changed since then is
    found: a turn of the path's frame, and the time from the motors' inputs to the turning. Columns
    of the reference that are in another order, sign or frame, and its motors' clock, are named as
    well. `made` are the `checks` of these flights, `then` the reference's, if made already.
    """
    now = made or checks(flights)
    found = _faults(flights, now)
    if reference is None:
        return found
    before = then or checks(reference)
    there = _faults(reference, before)
    had = {fault.part for fault in there}
    shared = {x.part for x in there if x.part in SIZED and not _turned_more(x, found)}
    own = [fault for fault in found if fault.part not in shared]
    wrong = had | {fault.part for fault in own}  # each is read from columns of both sets
    turn = None
    if not {"attitude", "position"} & wrong:
        size, then_size = _path_turn(now), _path_turn(before)
        if size is not None and then_size is not None:  # what both share is no change
            own = [fault for fault in own if fault.part != "frame of the path"]
            turn = _turned_since(size.since(then_size))
    later = None
    if not {"angular velocity", "motor order", MOTOR_CLOCK} & wrong:
        commanded = any(drone.pwm is not None for drone in _drones(flights))
        later = later_since(now.turned, before.turned, commanded)
    beside = (in_reference(fault) for fault in there if fault.part in OWN)
    return in_order(fault for fault in (*own, turn, later, *beside) if fault is not None)


@dataclasses.dataclass(frozen=True)
class Checks:
    """What was compared, and what came out of it."""

    windows: Windows | None
    """Windows of all flights, in metres; None if they are too few."""
    units: InterfaceFault | None
    """What is in another unit than metres."""
    followed: list[Following]
    """How each piece of flight follows its commands."""
    turned: list[list[Turning]]
    """How the motors of each drone turn it."""
    timed: list[Pieces]
    """The same, in pieces for the motors' clock."""
    compared: dict[str, Chosen | None]
    """Every part that can be read in several ways; None where flights do not tell."""
    rise: Size | None
    """How the path rises with the thrust (`position.rise`)."""


def checks(flights: FlightSet) -> Checks:
    """Every comparison of columns of these flights."""
    drones, windows, units = _drones(flights), _windows(flights), None
    if windows is not None:
        units, windows = position.in_units(windows)
    turned = [turning(drone) for drone in drones]
    parts = scales.parts_of(len(drones))
    followed = [part for drone in drones for part in commands.following(drone, parts)]
    compared = _compared(windows, followed, [piece for drone in turned for piece in drone])
    tilt, rise = compared.get("attitude"), None
    if windows is not None and all(n in orders.PATHS for n in (tilt.names if tilt else ())):
        rise = position.rise(windows)  # it is read from the attitude
    timed = [pieces for drone in drones if (pieces := pieces_of(drone)) is not None]
    return Checks(windows, units, followed, turned, timed, compared, rise)


def _faults(flights: FlightSet, made: Checks) -> tuple[InterfaceFault, ...]:
    """Faults that flights show by themselves."""
    whole, compared = not _wrong(made.compared.get("attitude")), made.compared
    placed, explained = _placed(made)
    found = [
        _ordered(part, chosen, _columns(part, chosen, made))
        for part, chosen in compared.items()
        if part not in explained
    ]
    down = position.points_down(made.rise)
    found += [made.units, placed, None if down else below_floor(flights)]
    if made.windows is not None and whole and not down:  # these need the attitude and the ground
        found += [_thrust_scale(made.windows, flights.vehicle), _path_frame(made.windows, made)]
    if made.followed and whole:
        found += _followed(made.followed)
    if not any(_wrong(compared.get(part)) for part in ("angular velocity", "motor order")):
        found.append(drifting(made.timed))
    found.append(_heading(_drones(flights)))
    return in_order(fault for fault in found if fault is not None)


def _placed(made: Checks) -> tuple[InterfaceFault | None, set[str]]:
    """The fault of the position, and the parts that look wrong because of it."""
    velocity, tilt = (made.compared.get(part) for part in ("velocity", "attitude"))
    down = position.points_down(made.rise)
    risen = (position.risen(made.rise),) if down and made.rise is not None else ()
    words = position.misplaced(velocity, tilt, down)
    if words is None:
        return (position.upside_down(risen), {"accelerometer"}) if down else (None, set())
    shares = tuple(
        line
        for part, chosen in (("velocity", velocity), ("attitude", tilt))
        if chosen is not None and chosen.names
        for line in _shares(part, chosen)
    )
    return position.of_position(words, (*shares, *risen)), {"velocity", "attitude", "accelerometer"}


def _drones(flights: FlightSet) -> list[DroneLog]:
    return [drone for flight in flights.flights for drone in flight.drones]


def _windows(flights: FlightSet) -> Windows | None:
    """The windows of all drones; None if they are too few to say anything."""
    drones = _drones(flights)
    thrusts = [thrust_given(drone, flights.vehicle) for drone in drones]
    lifts = [lift_given(drone, thrust) for drone, thrust in zip(drones, thrusts, strict=True)]
    windows = make_windows(flights.flights, thrusts, lifts)
    return None if windows is None or len(windows) < FEWEST_WINDOWS else windows


def _compared(
    windows: Windows | None, followed: Sequence[Following], turned: Sequence[Turning]
) -> dict[str, Chosen | None]:
    """Every part that can be read in several ways, with the reading that fits."""
    found: dict[str, Chosen | None] = {"motor order": motor_order(turned)}
    if followed:
        found["attitude command"] = commands.order(commands.together(followed))[0]
    if windows is None:
        return found
    found |= orders.vectors(windows)
    if _wrong(found["angular velocity"]):
        found["motor order"] = None  # it is read from the angular velocity
    tilt, witnesses = orders.attitude(windows), ("angular velocity", "attitude command")
    if tilt is None or not tilt.names:
        return found | {"attitude": tilt}
    # A wrong attitude is at odds with whatever else is in the body's axes, a wrong path is not.
    heard = [found.get(part) for part in witnesses]
    against, beside = any(map(_wrong, heard)), any(h is not None and not h.names for h in heard)
    of_path = [name for name in tilt.names if name in orders.PATHS]
    kept = tilt.names
    if against or beside:
        kept = tuple(n for n in tilt.names if (n in of_path) != against) or tilt.names
    if against:
        found |= dict.fromkeys((*witnesses, "accelerometer"))
    return found | {"attitude": dataclasses.replace(tilt, names=kept)}


def _wrong(chosen: Chosen | None) -> bool:
    return chosen is not None and bool(chosen.names)


_CHECKED = {
    "velocity": ("columns vel_x to vel_z", "how the position moves"),
    "angular velocity": ("columns ang_vel_x to ang_vel_z", "how the attitude turns"),
    "accelerometer": ("columns acc_x to acc_z", "how the position accelerates"),
    "attitude": ("columns quat_x to quat_w and the path's axes", "the force that the path needs"),
    "attitude command": ("columns cmd_roll and cmd_pitch", "the attitude that is flown"),
    "motor order": ("the order of pwm_1 to pwm_4 or rotor_vel_1 to rotor_vel_4", "turning"),
}
"""What to check of each part, and what it must agree with."""


def _columns(part: str, chosen: Chosen | None, made: Checks) -> str:
    """Columns to check: those of the position, too, where nothing else agrees with the path."""
    columns = _CHECKED[part][0]
    if part != "velocity" or chosen is None or not any(n in position.ORDERS for n in chosen.names):
        return columns
    tilt, rise = made.compared.get("attitude"), made.rise
    upright = tilt is not None and not tilt.names
    if chosen.names == (position.Z_FLIPPED,):
        upright = rise is not None and rise.low > 0.0
    return columns if upright else f"{columns}, and pos_x to pos_z"


def _ordered(part: str, chosen: Chosen | None, columns: str) -> InterfaceFault | None:
    if chosen is None or not chosen.names:
        return None
    held = " or ".join(chosen.names)
    return InterfaceFault(
        part=part,
        readings=chosen.names,
        advice=f"The {part} looks like {held}: check {columns}.",
        evidence=_shares(part, chosen),
    )


def _shares(part: str, chosen: Chosen) -> tuple[Evidence, ...]:
    against = _CHECKED[part][1]
    return (
        _share(f"{against}, explained by the {part} as logged", chosen.asked),
        _share(f"the same, explained by {chosen.names[0]}", chosen.explained),
    )


def _share(quantity: str, value: float) -> Evidence:
    allowed = "no less than any other reading explains"
    return Evidence(quantity=quantity, value=value, low=None, high=None, unit="-", allowed=allowed)


def _thrust_scale(windows: Windows, vehicle: VehicleFile) -> InterfaceFault | None:
    size = scales.thrust_over_force(windows, vehicle.mass)
    if size is None or not size.beyond(*scales.THRUST):
        return None
    over = size.value > 1.0
    factor = size.value if over else 1.0 / size.value
    evidence = sized("thrust over the force that the path needs", size, "-", *scales.THRUST, 1.0)
    # A mass in another unit shows as a mass that is far from the airframe's by the same factor.
    apart = vehicle.mass / vehicle.spec.mass
    if not over and 0.75 < apart / POUNDS < 1.33 and 0.75 < factor / apart < 1.33:
        return InterfaceFault(
            part="thrust",
            readings=("a mass in pounds",),
            advice=f"The mass in vehicle.toml is {apart:.1f} times the airframe's, and thrust "
            f"carries {1.0 / size.value:.1f} times less: is the mass in pounds?",
            evidence=(evidence,),
        )
    more, less = "The simulator makes", "these flights show"
    if not over:
        more, less = "These flights show", "the simulator makes"
    advice = (
        f"{more} about {factor:.2g} times the thrust that {less}: "
        "check how commands, PWM or rotor speeds become thrust, and the mass."
    )
    reading = f"thrust off by a factor of {size.value:.2g}"
    return InterfaceFault(part="thrust", readings=(reading,), advice=advice, evidence=(evidence,))


def _path_frame(windows: Windows, made: Checks) -> InterfaceFault | None:
    """A turn of the path that is no order or sign of axes."""
    size = scales.path_turn(windows)
    if size is None or not size.beyond(-scales.TURN, scales.TURN):
        return None
    if made.compared.get("attitude") is None and abs(size.value) > RIGHT:
        return None  # the path follows the attitude in no frame
    return _turned(
        "frame of the path",
        "position and velocity are turned",
        "the attitude: check the yaw between the motion capture's frame and the drone's.",
        size,
    )


def _angle(evidence: Evidence) -> Size:
    """A turn [rad] that is shown in degrees."""
    value, low, high = evidence.value, evidence.low, evidence.high
    assert low is not None  # `sized` gives both ends
    assert high is not None
    return Size(math.radians(value), math.radians(low), math.radians(high))


def _turned_more(before: InterfaceFault, found: Sequence[InterfaceFault]) -> bool:
    """Whether an angle that was off before is off by as much again as would be a fault."""
    limit = {"heading": scales.HEADING, "frame of the commands": scales.TURN}.get(before.part)
    now = next((fault for fault in found if fault.part == before.part), None)
    if limit is None or now is None:
        return False
    size, then = (_angle(fault.evidence[0]) for fault in (now, before))
    size = size.since(then)
    turns = 2.0 * math.pi * round(size.value / (2.0 * math.pi))
    return Size(size.value - turns, size.low - turns, size.high - turns).beyond(-limit, limit)


def _path_turn(made: Checks) -> Size | None:
    return None if made.windows is None else scales.path_turn(made.windows)


def _turned_since(size: Size) -> InterfaceFault | None:
    """A turn of the path since the reference, which a new calibration of motion capture makes."""
    if not size.beyond(0.0, 0.0) or abs(size.value) < scales.TURN_SINCE:
        return None
    return _turned(
        "frame of the path since the reference",
        "position and velocity are turned",
        "the attitude, compared with the reference: was the motion capture calibrated anew, or the "
        "drone's body defined anew? All else is said of flights that are turned back.",
        size,
        scales.TURN_SINCE,
    )


def _turned(
    part: str, what: str, against: str, size: Size, limit: float = scales.TURN
) -> InterfaceFault:
    degrees = math.degrees(1.0)
    shown = f"{degrees * size.value:.0f} degrees in yaw"
    evidence = sized(f"turn of the {part}", size, "deg", -limit, limit, degrees)
    return InterfaceFault(
        part=part,
        readings=(f"turned by {shown}",),
        advice=f"In these flights {what} by {shown} against {against}",
        evidence=(evidence,),
    )


def _followed(followed: Sequence[Following]) -> list[InterfaceFault | None]:
    """Clock and turn of commanded roll and pitch."""
    chosen, matrix = commands.order(commands.together(followed))
    if chosen is None:
        return []  # what is flown is not what is commanded, so that nothing has a lag
    found, size = [], scales.lag(followed, matrix)
    if size is not None and size.beyond(*scales.LAG):
        early = size.value < 0.0
        word = "before" if early else "after"
        evidence = sized("attitude after its command", size, "s", *scales.LAG, 1.0)
        found.append(
            InterfaceFault(
                part="command clock",
                readings=(f"commands stamped {'late' if early else 'early'}",),
                advice=f"The attitude changes {abs(size.value):.2f} s {word} its command: check "
                "the clocks of commands and pose.",
                evidence=(evidence,),
            )
        )
    turn = None if chosen.names else scales.command_turn(followed)
    if turn is not None and turn.beyond(-scales.TURN, scales.TURN):
        against = "commanded roll and pitch: check whose yaw is used."
        part = "frame of the commands" if abs(turn.value) < RIGHT else "attitude command"
        found.append(_turned(part, "flown tilts are turned", against, turn))
    return found


def _heading(drones: Sequence[DroneLog]) -> InterfaceFault | None:
    off, parts = [], scales.parts_of(len(drones))
    for drone in drones:
        if drone.cmd is not None:
            apart = np.exp(1j * (measured(drone)[:, 8] - drone.cmd[:, 2]))
            pieces = np.array_split(apart, min(parts, len(apart)))
            off += [float(np.angle(piece.mean())) for piece in pieces]
    size = scales.heading(off)
    if size is None or not size.beyond(-scales.HEADING, scales.HEADING):
        return None
    degrees = math.degrees(1.0)
    shown = f"{degrees * size.value:.0f} degrees"
    limits = (-scales.HEADING, scales.HEADING)
    return InterfaceFault(
        part="heading",
        readings=(f"off its command by {shown}",),
        advice=f"The heading is {shown} off its command: check the unit, sign and zero of cmd_yaw "
        "and of the yaw that is measured.",
        evidence=(sized("heading less its command", size, "deg", *limits, degrees),),
    )
