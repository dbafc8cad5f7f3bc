"""Records of a `Diagnosis` (`result.py`): flights, gaps, shrinkage, and data of pictures."""

import dataclasses
from typing import Literal

from diagnosis.logs.airframes import Airframe
from diagnosis.logs.columns import LeftOut

AtBound = Literal["no", "low", "high"]
"""Whether a size lies at an end of its allowed range."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FlightUsed:
    """One flight that counted."""

    name: str
    """Name of its file without the ending."""
    seconds: float | None
    """Length of the log [s]."""
    use: Literal["fit", "held out", "fit, and held out in turn", "reference", "checked only"]
    """What it was used for."""
    digest: str | None
    """SHA-256 of its columns."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flights:
    """Flights of one vehicle, as they were read."""

    name: str | None
    """Name of their folder."""
    drone: str
    """Name of the airframe."""
    mass: float | None
    """Mass that the operator believes [kg]."""
    driven_by: str
    """What drives their replay: commands, or what was measured in their place."""
    used: tuple[FlightUsed, ...]
    """Flights that counted."""
    left_out: tuple[LeftOut, ...]
    """Files and flights that did not."""
    airframe: Airframe | None = None
    """Numbers of the airframe's data sheet; null where a file of ours has them."""

    @property
    def seconds(self) -> float:
        """Time flown [s]."""
        return float(sum(flight.seconds or 0.0 for flight in self.used))

    @property
    def held_out(self) -> list[str]:
        """Flights on which the shrinkage was scored, all together or each in turn."""
        return [flight.name for flight in self.used if "held out" in flight.use]


@dataclasses.dataclass(frozen=True, kw_only=True)
class RegimeGap:
    """The gap of one channel against a condition of the flight."""

    variable: str
    """The condition, such as speed."""
    unit: str
    """Its unit."""
    edges: tuple[float, ...]
    """Edges of the bins, one more than bins."""
    gap: tuple[float | None, ...]
    """RMS gap of each bin, in the channel's unit; null for too few windows."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChannelGap:
    """The gap of one channel."""

    channel: str
    """Name."""
    unit: str
    """Unit of the gap."""
    gap_rms: float
    """Root mean square of measured minus predicted."""
    noise_floor: float
    """What noise alone would give."""
    share: float
    """Its part of the whole gap beyond noise [-]."""
    low: float | None
    """Lower end of the 95 % interval of `gap_rms` over flights."""
    high: float | None
    """Upper end."""
    regimes: tuple[RegimeGap, ...]
    """The gap against conditions of the flight."""
    onset_s: float | None
    """When the gap sets in, since the start [s]; null if it does not clearly."""
    beyond_noise: bool
    """Whether it stands out of its noise floor, by its interval where there is one."""
    main: bool
    """Whether it is one of the few channels that hold most of the gap."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChannelShrink:
    """How far the gap of one channel shrinks on flights that were left out."""

    channel: str
    """Name."""
    before: float
    """RMS gap under the nominal simulator."""
    after: float
    """RMS gap with the likeliest set."""
    percent: float | None
    """100 (1 - after / before) [%]."""
    unit: str
    """Unit of the gap."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Shrink:
    """How far the drift shrinks on flights that were left out of the fit."""

    horizon_s: float
    """Length of the windows at whose end the drift is measured [s]."""
    n: int
    """Flights."""
    before: float | None
    """RMS position drift under the nominal simulator [m]."""
    after: float | None
    """RMS position drift with the likeliest set [m]."""
    percent: float | None
    """100 (1 - after / before) [%]; null where it is not known (`reason`)."""
    low: float | None
    """Lower end of its 95 % interval."""
    high: float | None
    """Upper end."""
    by_channel: tuple[ChannelShrink, ...]
    """The same for every channel."""
    how: Literal["leave one flight out", "flights held out"] | None
    """Which flights scored."""
    reason: str | None
    """Why it is not known."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class DriftAlong:
    """Position drift along one flight that scored."""

    flight: str
    """Name."""
    t: tuple[float, ...]
    """Start of each window since the flight's first row [s]."""
    before: tuple[float | None, ...]
    """Drift under the nominal simulator [m]."""
    after: tuple[float | None, ...]
    """Drift with the likeliest set [m]."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class GapInTime:
    """The gap of one channel against time since the start."""

    channel: str
    """Name."""
    unit: str
    """Unit of the gap."""
    t: tuple[float, ...]
    """Time since the start [s]."""
    gap: tuple[float | None, ...]
    """RMS over flights."""
    low: tuple[float | None, ...]
    """Smallest window."""
    high: tuple[float | None, ...]
    """Largest window."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Limit:
    """The smallest size of a parameter that these flights would have shown."""

    effect: str
    """Registered name of the effect."""
    parameter: str
    """Name."""
    unit: str
    """Unit."""
    smallest: float | None
    """Five standard deviations by the Cramer-Rao bound; beside a twin, what is named with a
    probability of 95 %, as far as flights differ from each other."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SharedParameter:
    """What separates the simulator from both sets of flights."""

    effect: str
    """Registered name of the effect."""
    parameter: str
    """Name."""
    value: float
    """Value in the reference flights."""
    unit: str
    """Unit."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Followed:
    """How well a twin of the reference follows flights of the reference that it has not seen."""

    channel: str
    """Name."""
    unit: str
    """Unit."""
    simulator: float
    """Root mean square of measured minus nominal simulator."""
    twin: float
    """The same of measured minus twin."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChannelNoise:
    """Noise of one channel, as the logs show it."""

    channel: str
    """Name."""
    sigma: float | None
    """One standard deviation; null where the channel does not count."""
    unit: str
    """Unit."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class NotObservable:
    """An effect that is no candidate."""

    effect: str
    """Registered name."""
    why: str
    """Why not."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class SetAside:
    """A window that stands out and did not count."""

    flight: str
    """Flight."""
    t: float
    """Its start since the flight's first row [s]."""
    misfit: float
    """Its chi-square per number."""
    after_gap: bool
    """Whether it lies soon after an unknown command."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Windows:
    """How many half seconds there are."""

    n: int
    """All."""
    aside: int
    """Those that count nowhere."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Misfit:
    """Chi-square per number; 1 is noise."""

    before: float | None = None
    """Under the nominal simulator."""
    after: float | None = None
    """With the likeliest set."""
