r"""What drives a replay: commands where they are logged, else measured attitude and rotors.

Without an attitude command the attitude is prescribed from measurement at every step, and only the
collective thrust is an input; effects on the attitude are then not observable.

- Commanded thrust alone: rotors lag behind it, as behind a whole command.
- Rotor speeds: thrust of the airframe's measured curve, f = c0 + c1 n + c2 n^2 per rotor, n in
  rev/min (crazyflow 0.4.0, ``rpm2thrust``). Rotors have these speeds at every step, joined by
  straight lines between rows; how they lag behind a command cannot be seen.
- PWM and battery voltage: the motor voltage is duty times battery voltage, and thrust follows from
  it as the Crazyflie's firmware believes, V = 0.088 F - 0.0006239 F^2, F in grams force of all
  four rotors (crazyflie-firmware, ``motors.c``, battery compensation). Beyond the parabola's top,
  at 3.10 V, the thrust is held there. Rotors lag behind their voltage, as behind a command.
"""

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.logs.airframes import CRAZYFLIES
from diagnosis.logs.flights import (
    DroneLog,
    FlightLog,
    FlightSet,
    LeftOut,
    LogError,
    VehicleFile,
    stretches,
)
from diagnosis.logs.noise import measured
from diagnosis.logs.upsets import before_upset
from simulators.vehicle import GRAVITY, VehicleSpec

VOLTS = (0.088, -0.0006239)
"""Motor voltage over thrust [V/gf] and over its square [V/gf^2]; crazyflie-firmware before 2025,
motors.c, of brushed motors. That of August 2026 has a cubic for each platform. For the brushless
Crazyflie in hover (0.426 N, 2.15 V) it says 1.4 times the thrust of this map."""
PRESCRIBED = "commanded thrust and measured attitude"
"""What drives a replay that does not trust how the attitude follows its command."""
PWM = "PWM and voltage"
"""What drives a replay where nothing else is logged."""
ON_GROUND = 0.3
"""Share of the weight below which a drone is taken to stand on the ground."""
STANDING = (0.15, 0.05)
"""Height [m] and speed [m/s] below which a drone stands before its flight and after it: rotors turn
on the ground, too, which carries what they do not."""
LANDED = 0.3
"""Time below that from which it is; a shorter dip in the air is none. A fall of 0.4 m [s]."""


@dataclasses.dataclass(frozen=True)
class Inputs:
    """Flights that a replay can take, all driven alike."""

    flights: tuple[FlightLog, ...]
    """Every drone with `cmd`: as logged, or measured attitude and thrust from the rotors."""
    prescribed: bool
    """Whether the attitude is prescribed from measurement."""
    kind: str
    """`commands`, `PRESCRIBED`, `rotor speeds` or `PWM`."""
    left_out: tuple[LeftOut, ...]
    """Flights without that input, and flights or parts of them that are an upset."""

    @property
    def produced(self) -> bool:
        """Whether thrust is what rotors of a known speed produce, which no lag delays."""
        return self.kind == "rotor speeds"

    @property
    def mapped(self) -> bool:
        """Whether thrust is known by a map from PWM and voltage alone."""
        return self.kind == PWM

    @property
    def measured(self) -> int:
        """Leading columns of `cmd` that were measured: none, the attitude, the thrust as well."""
        return 3 * self.prescribed + self.produced

    @property
    def follows_commands(self) -> bool:
        """Whether thrust is what was commanded, and not what the rotors are known to do."""
        return self.kind in ("commands", PRESCRIBED)

    def without(self, silent: Collection[int], why: str) -> "Inputs":
        """The flights but those whose indices are `silent`.

        Raises:
            LogError: None is left.
        """
        if not silent:
            return self
        names = [self.flights[i].name for i in sorted(silent)]
        gone = tuple(LeftOut(name, f"flights/{name}: {why}") for name in names)
        left = tuple(f for i, f in enumerate(self.flights) if i not in silent)
        if not left:
            raise LogError("\n".join(one.reason for one in gone))
        return dataclasses.replace(self, flights=left, left_out=(*self.left_out, *gone))


def choose_inputs(
    flights: FlightSet, prescribe: bool = False, beside: FlightSet | None = None
) -> Inputs:
    """Commands where any flight has them, else rotor speeds, else PWM; if it can be, as `beside`.

    With `prescribe` the attitude comes from measurement even where commands are logged.

    Raises:
        LogError: No flight has any of them.
    """
    flights, fallen = _controlled(flights)
    able, there = _able(flights), _able(beside) if beside is not None else {}
    possible = [kind for kind, found in able.items() if found]
    kind = next((k for k in possible if there.get(k)), possible[0] if possible else None)
    if kind is None:
        if not flights.flights:
            why = [f"{flights.path}, no flight is usable:", *(one.reason for one in fallen)]
            raise LogError("\n".join(why))
        raise LogError(
            f"{flights.path}: no flight has cmd_*, rotor_vel_*, or pwm_* with battery."
            + _of_no_use(flights.vehicle)
        )
    usable = able[kind]
    bare = tuple(
        LeftOut(f.name, f"flights/{f.name}: has no {kind}, which the other flights are replayed by")
        for f in flights.flights
        if f not in usable
    )
    left_out = (*bare, *fallen)
    if kind == "commands" and not prescribe:
        return Inputs(tuple(usable), False, kind, left_out)
    driven = [_prescribed(flight, flights.vehicle.spec, kind) for flight in usable]
    kind = PRESCRIBED if kind == "commands" else kind
    return Inputs(tuple(driven), True, kind, left_out)


def driven_alike(
    flights: FlightSet, reference: FlightSet, prescribe: bool = False
) -> tuple[Inputs, Inputs]:
    """Two sets, driven by one kind of input (`choose_inputs`).

    Raises:
        LogError: They are not, or one of them has none.
    """
    inputs = choose_inputs(flights, prescribe, reference)
    before = choose_inputs(reference, prescribe, flights)
    if inputs.kind != before.kind:
        raise LogError(
            f"{flights.path} is replayed by {inputs.kind}, the reference by {before.kind}; "
            "both must log the same kind of input."
        )
    return inputs, before


def _controlled(flights: FlightSet) -> tuple[FlightSet, tuple[LeftOut, ...]]:
    """Every flight until it loses control, and what that leaves out."""
    kept, fallen = [], []
    for flight in flights.flights:
        before, why = before_upset(flight)
        kept += [before] if before is not None else []
        fallen += [LeftOut(flight.name, why)] if why else []
    return dataclasses.replace(flights, flights=tuple(kept)), tuple(fallen)


def _able(flights: FlightSet) -> dict[str, list[FlightLog]]:
    """Flights that have each kind of input, the preferred kind first."""
    turns, duty = thrust_is_known(flights.vehicle)
    kinds = {
        "commands": lambda drone: drone.cmd is not None,
        "rotor speeds": lambda drone: drone.rotor_vel is not None and turns,
        PRESCRIBED: lambda drone: drone.cmd is not None or drone.thrust is not None,
        PWM: lambda drone: drone.pwm is not None and drone.battery is not None and duty,
    }
    return {k: [f for f in flights.flights if all(map(has, f.drones))] for k, has in kinds.items()}


def thrust_is_known(vehicle: VehicleFile) -> tuple[bool, bool]:
    """Whether rotor speeds, and whether duty commands, say what thrust this vehicle makes."""
    return any(vehicle.spec.rpm2thrust), vehicle.airframe is None and vehicle.drone in CRAZYFLIES


def _of_no_use(vehicle: VehicleFile) -> str:
    """What cannot be turned into thrust; empty if nothing is like that."""
    turns, duty = thrust_is_known(vehicle)
    if turns and duty:
        return ""
    speeds = "" if turns else " Rotor speeds need a thrust_curve in [airframe]."
    return f"{speeds} How duty becomes thrust is known of Crazyflies alone."


def _prescribed(flight: FlightLog, spec: VehicleSpec, kind: str) -> FlightLog:
    """The flight with measured attitude and produced thrust as commands."""
    drones = []
    for drone in flight.drones:
        if kind in ("commands", PRESCRIBED):
            thrust = _known(drone.cmd)[:, 3] if drone.thrust is None else drone.thrust
        elif kind == "rotor speeds":
            thrust = thrust_of_rotors(_known(drone.rotor_vel), spec)
        else:
            thrust = thrust_of_pwm(_known(drone.pwm), _known(drone.battery))
        cmd = np.concatenate([measured(drone)[:, 6:], thrust[:, None]], axis=1)
        drones.append(dataclasses.replace(drone, cmd=cmd))
    return dataclasses.replace(flight, drones=tuple(drones))


def _known(x: np.ndarray | None) -> np.ndarray:
    assert x is not None  # `choose_inputs` looked
    return x


def thrust_of_rotors(
    rotor_vel: Float[np.ndarray, "rows 4"], spec: VehicleSpec
) -> Float[np.ndarray, " rows"]:
    """Collective thrust [N] of rotor speeds [rad/s]."""
    n = rotor_vel * 60.0 / (2.0 * np.pi)
    c0, c1, c2 = spec.rpm2thrust
    return np.sum(c0 + c1 * n + c2 * n * n, axis=1)


def thrust_of_pwm(
    pwm: Float[np.ndarray, "rows 4"], battery: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " rows"]:
    """Collective thrust [N] of duty [0 to 1] and battery voltage [V], each rotor a quarter."""
    linear, square = VOLTS
    top = -(linear**2) / (4.0 * square)
    volts = np.minimum(pwm * battery[:, None], top)
    grams = (linear - np.sqrt(linear**2 + 4.0 * square * volts)) / (-2.0 * square)
    return np.mean(grams, axis=1) * 1e-3 * GRAVITY


def on_ground(log: DroneLog, mass: float, turning: bool) -> Sequence[tuple[float, float]]:
    """Stretches [s] in which the thrust is far from carrying the drone.

    They last, or the log begins or ends with them. With `turning` rotors the drone also stands
    until it first moves or rises, and from when it no longer does.
    """
    cmd = _known(log.cmd)
    low = cmd[:, 3] < ON_GROUND * mass * GRAVITY
    if turning:
        height, speed = STANDING
        still = low | (log.pos[:, 2] < height) & (np.linalg.norm(log.vel, axis=1) < speed)
        low |= np.logical_and.accumulate(still) | np.logical_and.accumulate(still[::-1])[::-1]
    last = float(log.t[-1] - log.t[0])
    return [
        (a, b)
        for a, b in stretches(log.t - log.t[0], low)
        if b - a >= LANDED or a == 0.0 or b == last
    ]
