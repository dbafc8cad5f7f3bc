"""Faults that a log shows as if the vehicle had them: only the logged commands are changed."""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from diagnosis.logs.flights import DroneLog, FlightLog

Alteration = Callable[[DroneLog, float], DroneLog]
"""A log as it would be, had the vehicle a fault of some size."""


def _cmd(log: DroneLog) -> Float[np.ndarray, "rows 4"]:
    assert log.cmd is not None  # `applies` looked
    return log.cmd.copy()


def _thrust(log: DroneLog, size: float) -> DroneLog:
    """The vehicle makes (1 + size) times the thrust that is now logged."""
    if log.cmd is None:
        assert log.pwm is not None
        return dataclasses.replace(log, pwm=log.pwm / (1.0 + size))
    cmd = _cmd(log)
    cmd[:, 3] /= 1.0 + size
    return dataclasses.replace(log, cmd=cmd)


def _delay(log: DroneLog, size: float) -> DroneLog:
    """Commands act `size` [s] after they are now logged."""
    cmd, ahead = _cmd(log), log.t + size
    moved = [np.interp(ahead, log.t, cmd[:, i]) for i in range(4)]
    return dataclasses.replace(log, cmd=np.stack(moved, axis=1))


def _offset(axis: int) -> Alteration:
    """The vehicle leans by `size` [rad] more than is now logged."""

    def change(log: DroneLog, size: float) -> DroneLog:
        cmd = _cmd(log)
        cmd[:, axis] -= size
        return dataclasses.replace(log, cmd=cmd)

    return change


def _gain(log: DroneLog, size: float) -> DroneLog:
    """The vehicle leans (1 + size) times as far as is now logged."""
    cmd = _cmd(log)
    cmd[:, :2] /= 1.0 + size
    return dataclasses.replace(log, cmd=cmd)


def _frame(log: DroneLog, size: float) -> DroneLog:
    """The vehicle leans in a direction turned by `size` [rad] against what is now logged."""
    cmd = _cmd(log)
    cos, sin, roll, pitch = np.cos(size), np.sin(size), cmd[:, 0].copy(), cmd[:, 1].copy()
    cmd[:, 0], cmd[:, 1] = cos * roll + sin * pitch, cos * pitch - sin * roll
    return dataclasses.replace(log, cmd=cmd)


@dataclasses.dataclass(frozen=True)
class Fault:
    """A fault and how an answer names it."""

    change: Alteration
    """What it does to a log."""
    unit: str
    """SI unit of its size."""
    aim: float
    """Size that should be found with a probability of 95 %."""
    effect: str
    """Registered name of the effect that describes it."""
    parameter: str
    """The parameter that should have the fault's size."""


FAULTS: Mapping[str, Fault] = {
    "thrust": Fault(_thrust, "-", 0.05, "thrust_gain", "e"),
    "delay": Fault(_delay, "s", 0.02, "delay", "seconds"),
    "roll offset": Fault(_offset(0), "rad", np.deg2rad(1.5), "trim", "roll"),
    "pitch offset": Fault(_offset(1), "rad", np.deg2rad(1.5), "trim", "pitch"),
    "attitude gain": Fault(_gain, "-", 0.1, "attitude_gain", "g"),
    "frame": Fault(_frame, "rad", np.deg2rad(5.0), "frame_misalignment", "angle"),
}
"""Faults by name, with the sizes that issue 31 aims at."""


def applies(name: str, flight: FlightLog) -> bool:
    """Whether a flight logs what the fault changes."""
    commands = all(drone.cmd is not None for drone in flight.drones)
    return commands or name == "thrust"


def disturbed(flight: FlightLog, name: str, size: float) -> FlightLog:
    """The flight with a fault of some size."""
    drones = tuple(FAULTS[name].change(drone, size) for drone in flight.drones)
    return dataclasses.replace(flight, drones=drones)
