"""What is known of the airframe that flew: by its name, or from a data sheet in vehicle.toml.

| key of `[airframe]` | unit | |
|---|---|---|
| `thrust_max` | N | largest collective thrust; required |
| `thrust_curve` | N | of one rotor, [c0, c1, c2] over its speed in rev/min; for rotor speeds |
| `attitude_lag` | s | time constant with which commanded roll and pitch are followed |
| `rotor_lag` | s | time constant of the rotors in hover |
| `inertia` | kg m^2 | moments about the body axes |
| `arm` | m | distance of a rotor from the roll and from the pitch axis |
| `drag` | N s/m | linear drag along the body axes |

What is left out is unknown. Without `attitude_lag` the measured attitude drives the simulator,
unless reference flights show how commands are followed; of the other numbers `ASSUMED` stands in.
Airframes beside those of `simulators.vehicle.VEHICLES` fly as point masses: crazyflow has no file
of them, or no attitude loop that is theirs.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from diagnosis.logs.vehicle_file import MASSES
from simulators.vehicle import VEHICLES, VehicleSpec

RPM = 60.0 / (2.0 * math.pi)
"""Revolutions a minute in a radian a second."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Airframe:
    """Numbers of a data sheet, SI; None where the sheet does not say."""

    thrust_max: float
    """Largest collective thrust [N]."""
    thrust_curve: tuple[float, float, float] | None = None
    """Thrust of one rotor [N] as a polynomial of its speed in rev/min, constant term first."""
    attitude_lag: float | None = None
    """Time constant with which commanded roll and pitch are followed [s]."""
    rotor_lag: float | None = None
    """Time constant of the rotors in hover [s]."""
    inertia: tuple[float, float, float] | None = None
    """Moments of inertia about the body axes [kg m^2]."""
    arm: float | None = None
    """Distance of each rotor from the roll and from the pitch axis [m]."""
    drag: tuple[float, float, float] | None = None
    """Linear drag along the body axes [N s/m]."""

    def spec(self, name: str, mass: float) -> VehicleSpec:
        """The airframe as a simulator takes it, with `ASSUMED` where the sheet says nothing."""
        known = {k: v for k, v in vars(self).items() if v is not None}
        given = {key: known.get(key, ASSUMED[key]) for key in ASSUMED}
        return VehicleSpec(
            name=name,
            mass=mass,
            thrust_min=0.0,
            thrust_max=self.thrust_max,
            rpm2thrust=self.thrust_curve or (0.0, 0.0, 0.0),
            **given,
        )


ASSUMED: Mapping[str, Any] = {
    "inertia": VEHICLES["cf21B_500"].inertia,
    "drag": (0.0, 0.0, 0.0),
    "arm": VEHICLES["cf21B_500"].arm,
    "rotor_lag": VEHICLES["cf21B_500"].rotor_lag,
}
"""What an airframe has whose sheet does not say. A point mass flies alike with any of them but the
drag, which a diagnosis may find."""


def _named(
    name: str, thrust_max: float, curve: tuple[float, float, float], **more: Any
) -> VehicleSpec:
    return Airframe(thrust_max=thrust_max, thrust_curve=curve, **more).spec(name, MASSES[name])


def _rotorpy(name: str, k_eta: float, fastest: float, arm: float, **more: Any) -> VehicleSpec:
    """RotorPy gives thrust over squared speed [N s^2/rad^2] and the largest speed [rad/s]."""
    curve = (0.0, 0.0, k_eta / RPM**2)
    return _named(name, 4.0 * k_eta * fastest**2, curve, arm=arm, **more)


POINT_MASSES = {
    spec.name: spec
    for spec in (
        _named(
            "cf2x_P250",
            0.48,
            (0.0, -3.6200226530383495e-7, 1.6060924304100328e-10),
            inertia=(16.8e-6, 16.8e-6, 29.8e-6),
            arm=0.03253,
            drag=(0.01351483, 0.01351483, 0.01677452),
        ),
        _named(
            "cf2x_T350",
            0.72,
            (0.0, -7.167227176573658e-7, 2.9401303690194613e-10),
            inertia=(15.7e-6, 17.1e-6, 30.0e-6),
            arm=0.03253,
            drag=(0.015203241038199845, 0.015203241038199845, 0.02204579179094129),
        ),
        _rotorpy(
            "crazyflie",
            2.3e-08,
            2500.0,
            0.043 * math.sqrt(0.5),
            inertia=(1.43e-5, 1.43e-5, 2.89e-5),
            rotor_lag=0.072,
        ),
        _rotorpy(
            "crazyfliebrushless",
            4.052e-08,
            3100.0,
            0.043 * math.sqrt(0.5),
            inertia=(3.3e-5, 3.6e-5, 5.9e-5),
            rotor_lag=0.05,
        ),
        _rotorpy(
            "hummingbird",
            5.57e-06,
            1500.0,
            0.17 * math.sqrt(0.5),
            inertia=(3.65e-3, 3.68e-3, 7.03e-3),
            rotor_lag=0.005,
        ),
        _rotorpy(
            "px4_sihsim_quadx",
            5e-6,
            1000.0,
            0.17,
            inertia=(0.025, 0.025, 0.030),
            rotor_lag=0.05,
        ),
    )
}
"""Airframes that other simulators have files of. Sources: crazyflow 0.4.0,
``dynamics/first_principles/params.toml``; RotorPy 3.0.0, ``vehicles/*_params.py``."""

AIRFRAMES: Mapping[str, VehicleSpec] = {**VEHICLES, **POINT_MASSES}
"""Every airframe that vehicle.toml may name."""

CRAZYFLIES = frozenset({*VEHICLES, "cf2x_P250", "cf2x_T350", "crazyflie"})
"""Airframes whose motors the map from duty to thrust was measured on."""


def as_toml(airframe: Airframe) -> str:
    """The table `[airframe]` as vehicle.toml holds it."""
    lines = [
        f"{key} = {list(value) if isinstance(value, tuple) else float(value)!r}\n"
        for key, value in vars(airframe).items()
        if value is not None
    ]
    return "".join(["\n[airframe]\n", *lines])
