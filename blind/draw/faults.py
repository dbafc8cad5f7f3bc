"""Which faults are injected into logs: how large they are drawn, and what a right answer names.

Sizes are those around the aims of a diagnosis of real flights: half of what is to be named, that,
and twice that. A fault whose answers are empty is outside of the library: an answer is right if it
says that something is there and names no effect.
"""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from blind.draw.catalogue import SIZES, Draw, Parameters, directed, fixed, signed
from blind.fly import log_faults as made
from diagnosis.logs.flights import DroneLog, FlightSet, VehicleFile
from diagnosis.logs.units import FOOT
from simulators.vehicle import GRAVITY

ONE_SIZE = ("whole",)
"""Size of a fault that is there or not."""

Change = Callable[[DroneLog, Parameters, VehicleFile], DroneLog]
Truths = Mapping[str, Parameters]


def _nothing(p: Parameters) -> Truths:
    return {}


@dataclasses.dataclass(frozen=True)
class Fault:
    """One fault of logs."""

    draw: Draw
    """Its numbers at a size (index into `sizes`), signs and directions at random."""
    change: Change
    """What one drone's log becomes."""
    needs: tuple[str, ...] = ("cmd",)
    """Columns of which a log must hold at least one; none stands for any log."""
    answers: Callable[[Parameters], Truths] = _nothing
    """Effects that describe it, each with its true numbers."""
    parts: tuple[str, ...] = ()
    """Parts of the interface (`diagnosis.interface.fault.PARTS`) whose fault is its true name."""
    sizes: tuple[str, ...] = SIZES
    """Names of the sizes."""
    believed_mass: Callable[[float, Parameters], float] | None = None
    """What the operator then believes the drone to weigh [kg]; None where that stays."""

    def fits(self, flights: FlightSet) -> bool:
        """Whether every flight has a column that the fault changes."""
        drones = [drone for flight in flights.flights for drone in flight.drones]
        return not self.needs or all(
            any(getattr(drone, name) is not None for name in self.needs) for drone in drones
        )

    def apply(self, flights: FlightSet, parameters: Parameters) -> FlightSet:
        """The flights as they would have been logged."""
        vehicle = flights.vehicle
        changed = flights.each(lambda drone: self.change(drone, parameters, vehicle))
        if self.believed_mass is not None:
            mass = self.believed_mass(vehicle.mass, parameters)
            vehicle = dataclasses.replace(vehicle, mass=mass)
        return dataclasses.replace(changed, vehicle=vehicle)


def _tilted(*degrees: float) -> Draw:
    return directed(("roll", "pitch"), *np.radians(degrees).tolist())


def _angle(*degrees: float) -> Draw:
    return signed("angle", *np.radians(degrees).tolist())


def _thrust(p: Parameters) -> Truths:
    """More thrust, or less mass: commands and paths tell the quotient alone."""
    return {"thrust_gain": {"e": p["e"]}, "mass": {"e": 1.0 / (1.0 + p["e"]) - 1.0}}


def _mass(p: Parameters) -> Truths:
    return {"mass": {"e": p["e"]}, "thrust_gain": {"e": 1.0 / (1.0 + p["e"]) - 1.0}}


def _unsized(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
    """The numbers of a fault that is there or not: none."""
    return {}


def _whole(
    part: str, needs: tuple[str, ...] = (), **columns: Callable[[np.ndarray], np.ndarray]
) -> Fault:
    """A fault without a size that makes something else of some columns of a log."""

    def change(log: DroneLog, p: Parameters, v: VehicleFile) -> DroneLog:
        there = {n: x for n in columns if (x := getattr(log, n)) is not None}
        return dataclasses.replace(log, **{n: columns[n](x) for n, x in there.items()})

    return Fault(_unsized, change, needs, parts=(part,), sizes=ONE_SIZE)


ALL: Mapping[str, Fault] = {
    "thrust_gain": Fault(
        signed("e", 0.025, 0.05, 0.1),
        lambda log, p, v: made.more_thrust(log, p["e"], v.spec),
        ("cmd", "rotor_vel", "pwm"),
        _thrust,
    ),
    "believed_mass": Fault(
        signed("e", 0.025, 0.05, 0.1),
        lambda log, p, v: log,
        (),
        _mass,
        believed_mass=lambda mass, p: mass / (1.0 + p["e"]),
    ),
    "delay": Fault(
        fixed("seconds", 0.01, 0.02, 0.04),
        lambda log, p, v: made.shifted(log, p["seconds"]),
        made.INPUTS,
        lambda p: {"delay": {"seconds": p["seconds"]}},
        parts=("motor clock since the reference",),
    ),
    "trim": Fault(
        _tilted(0.75, 1.5, 3.0),
        lambda log, p, v: made.off_trim(log, p["roll"], p["pitch"]),
        answers=lambda p: {"trim": {"roll": p["roll"], "pitch": p["pitch"]}},
    ),
    "attitude_gain": Fault(
        signed("g", 0.05, 0.1, 0.2),
        lambda log, p, v: made.more_tilt(log, p["g"]),
        answers=lambda p: {"attitude_gain": {"g": p["g"]}},
    ),
    "yaw_misalignment": Fault(
        _angle(2.5, 5.0, 10.0),
        lambda log, p, v: made.off_trim(log, 0.0, 0.0, p["angle"]),
        answers=lambda p: {"yaw_misalignment": {"angle": p["angle"]}},
    ),
    "tilt_turned_in_yaw": Fault(
        _angle(2.5, 5.0, 10.0),
        lambda log, p, v: made.turned_tilt(log, p["angle"]),
        answers=lambda p: {"frame_misalignment": {"angle": p["angle"]}},
        parts=("frame of the commands",),
    ),
    "path_turned_in_yaw": Fault(
        _angle(2.5, 5.0, 10.0),
        lambda log, p, v: made.turned_path(log, p["angle"]),
        (),
        parts=("frame of the path", "frame of the path since the reference"),
    ),
    "clock_offset": Fault(
        fixed("seconds", 0.02, 0.04, 0.08),
        lambda log, p, v: made.shifted(log, -p["seconds"]),
        made.INPUTS,
        # Nothing in a log tells a clock from commands that act earlier.
        lambda p: {"delay": {"seconds": -p["seconds"]}},
        parts=("command clock", "motor clock since the reference"),
    ),
    "clock_drift": Fault(
        signed("rate", 0.005, 0.01, 0.02),
        lambda log, p, v: made.shifted(log, 0.0, p["rate"]),
        made.INPUTS,
        lambda p: {"clock_drift": {"rate": p["rate"]}},
        parts=("command clock", "motor clock", "motor clock since the reference"),
    ),
    "pwm_scale": Fault(
        fixed("scale", 0.05, 0.1, 0.2),
        lambda log, p, v: made.more_duty(log, p["scale"]),
        ("pwm",),
        # Thrust is nearly a square of the duty, so that the effects have no single true number.
        lambda p: {"thrust_gain": {}, "mass": {}},
    ),
    "body_velocity": Fault(
        _unsized, lambda log, p, v: made.body_velocity(log), (), parts=("velocity",), sizes=ONE_SIZE
    ),
    "degrees": _whole("attitude command", ("cmd",), cmd=lambda x: x * [*[180.0 / np.pi] * 3, 1.0]),
    "grams": _whole("thrust", ("cmd",), cmd=lambda x: x * [1.0, 1.0, 1.0, 1000.0 / GRAVITY]),
    "feet": _whole("position", pos=lambda x: x / FOOT, vel=lambda x: x / FOOT),
    "feet_per_second": _whole("velocity", vel=lambda x: x / FOOT),
    "swapped_tilt": _whole("attitude command", ("cmd",), cmd=lambda x: x[:, [1, 0, 2, 3]]),
    # The opposite sign of pitch is the Crazyflie's own convention.
    "flipped_pitch": _whole("attitude command", ("cmd",), cmd=lambda x: x * [1.0, -1.0, 1.0, 1.0]),
    # In these two the path is changed, beside which the attitude then looks wrong: y points to the
    # right; x and y are exchanged.
    "flipped_axis": _whole(
        "attitude", pos=lambda x: x * [1.0, -1.0, 1.0], vel=lambda x: x * [1.0, -1.0, 1.0]
    ),
    "swapped_axes": _whole(
        "attitude", pos=lambda x: x[:, [1, 0, 2]], vel=lambda x: x[:, [1, 0, 2]]
    ),
    # From world to body; w, x, y, z; motors 1 and 4, 2 and 3 exchanged.
    "inverse_attitude": _whole("attitude", quat=lambda x: x * [-1.0, -1.0, -1.0, 1.0]),
    "scalar_first": _whole("attitude", quat=lambda x: np.roll(x, 1, axis=1)),
    "mirrored_motors": _whole(
        "motor order",
        ("pwm", "rotor_vel"),
        pwm=lambda x: x[:, [3, 2, 1, 0]],
        rotor_vel=lambda x: x[:, [3, 2, 1, 0]],
    ),
}
"""Every fault by name. A log holds what a fault changes, or the fault is not drawn for it."""


def able(flights: FlightSet) -> list[str]:
    """Faults that the columns of these flights can have."""
    return [name for name, fault in ALL.items() if fault.fits(flights)]
