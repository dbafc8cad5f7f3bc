"""The simulator as the operator believes it: her airframe, her mass."""

import dataclasses
from typing import Any

from diagnosis.logs.airframes import AIRFRAMES, CRAZYFLIES, Airframe
from diagnosis.logs.flights import FlightSet, LogError, VehicleFile
from simulators.contract import AbstractSimulator, replayable_class
from simulators.vehicle import ActionSpace

MEASURED = 2.0
"""Largest thrust that rotors can be measured to give, over the largest that can be commanded."""
USUAL, ANY = "crazyflow", "point_mass"
"""What flights are compared with, and what flies any airframe, because it needs no more of it than
mass and thrust."""


def default_simulator(flights: FlightSet) -> str:
    """Name of the simulator that flights are compared with where none is asked for."""
    vehicle = flights.vehicle
    known = vehicle.airframe is None and vehicle.drone in replayable_class(USUAL).airframes
    return USUAL if known else ANY


def loop_is_known(simulator: str, vehicle: VehicleFile) -> bool:
    """Whether the simulator follows attitude commands as this vehicle is believed to.

    The lag of a point mass is that of a Crazyflie, unless a data sheet gives another.
    """
    if simulator != ANY:
        return True
    own = vehicle.airframe
    return vehicle.drone in CRAZYFLIES if own is None else own.attitude_lag is not None


def nominal_simulator(name: str, flights: FlightSet, limited: bool = True) -> AbstractSimulator:
    """The simulator as the operator believes it.

    A thrust that was measured is not `limited` to what the airframe can be commanded.

    Raises:
        LogError: The simulator does not know the airframe.
    """
    kind, vehicle = replayable_class(name), flights.vehicle
    known = vehicle.airframe is None and vehicle.drone in kind.airframes
    if not known and name != ANY:
        raise LogError(
            f"{flights.path}/vehicle.toml: drone must be an airframe that '{name}' knows "
            f"({', '.join(sorted(kind.airframes))}), got '{vehicle.drone}'. '{ANY}' flies any."
        )
    return believed_simulator(name, vehicle.drone, vehicle.mass, limited, vehicle.airframe)


def believed_simulator(
    name: str,
    drone: str,
    mass: float,
    limited: bool = True,
    airframe: Airframe | None = None,
) -> AbstractSimulator:
    """A registered simulator with an airframe that it knows, or a point mass with any.

    Args:
        name: Name of the simulator.
        drone: Name of the airframe.
        mass: Mass [kg].
        limited: Whether thrust is limited to what can be commanded; measured thrust is not.
        airframe: Data sheet of an airframe that no file of ours has.
    """
    kind = replayable_class(name)
    known = {**AIRFRAMES, **kind.airframes}
    spec = airframe.spec(drone, mass) if airframe else dataclasses.replace(known[drone], mass=mass)
    # The largest action asks for the largest thrust of this airframe.
    given: dict[str, Any] = {}
    if spec.thrust_max != ActionSpace().thrust_max:
        given["action_space"] = ActionSpace(thrust_max=spec.thrust_max)
    if not limited:
        spec = dataclasses.replace(spec, thrust_min=0.0, thrust_max=MEASURED * spec.thrust_max)
    # Buffers of effects are as fine as the simulator's own step, so that is the replay's.
    given["spec"] = spec
    fields = {field.name for field in dataclasses.fields(kind)}
    if "dt" in fields:
        given["dt"] = kind.replay_dt
    if "freq" in fields:
        given["freq"] = round(1.0 / kind.replay_dt)
    if airframe is not None and airframe.attitude_lag is not None:
        given["attitude_tau"] = airframe.attitude_lag
    return kind(**given)
