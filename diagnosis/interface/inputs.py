"""Thrust that a drone's inputs stand for, in newtons or in any unit."""

import numpy as np
from jaxtyping import Float

from diagnosis.logs.flights import DroneLog, VehicleFile
from diagnosis.logs.inputs import thrust_is_known, thrust_of_pwm, thrust_of_rotors


def thrust_given(drone: DroneLog, vehicle: VehicleFile) -> Float[np.ndarray, " rows"] | None:
    """Thrust that a drone's inputs stand for [N]: what is commanded, else what its motors tell."""
    if drone.cmd is not None:
        return drone.cmd[:, 3]
    if drone.thrust is not None:
        return drone.thrust
    turns, duty = thrust_is_known(vehicle)
    if drone.rotor_vel is not None and turns:
        return thrust_of_rotors(drone.rotor_vel, vehicle.spec)
    if drone.pwm is not None and drone.battery is not None and duty:
        return thrust_of_pwm(drone.pwm, drone.battery)
    return None


def lift_given(
    drone: DroneLog, thrust: Float[np.ndarray, " rows"] | None
) -> Float[np.ndarray, " rows"] | None:
    """The thrust, or squares of what the motors are given where it cannot be told."""
    if thrust is not None:
        return thrust
    given = drone.rotor_vel if drone.rotor_vel is not None else drone.pwm
    if given is None:
        return None
    volts = drone.battery if drone.rotor_vel is None and drone.battery is not None else 1.0
    return np.sum(given**2, axis=1) * volts**2
