"""What a twin says of changed flights, as frozen records; renderers decide nothing."""

import dataclasses
import enum

import numpy as np

from diagnosis.twin.channels import CHANNELS


class Change(enum.Enum):
    """What flights show beside their reference."""

    EFFECT = "effect"
    """Named effects, or one of a class that these flights cannot tell apart, explain the change."""
    PARTLY = "partly"
    """Named effects explain part of it; what they leave is more than flights differ by."""
    UNEXPLAINED = "unexplained"
    """Something changed that no candidate explains."""
    NONE = "none"
    """Nothing changed by more than flights differ."""
    TOO_FEW = "too few flights to tell"
    """Nothing is seen, and with so few flights little could be."""


@dataclasses.dataclass(frozen=True)
class ChangedParameter:
    """How far one parameter moved since the reference flights."""

    effect: str
    """Registered name of the effect."""
    parameter: str
    """Name of the parameter."""
    unit: str
    """Its SI unit."""
    value: float
    """Estimated change."""
    low: float
    """Lower end of the 95 % interval."""
    high: float
    """Upper end of the 95 % interval."""
    limit: float
    """Smallest change that flights like these show with 95 % probability."""
    at_bound: bool
    """Whether the estimate lies beyond what the effect may have."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One effect alone on top of the twin."""

    effect: str
    """Registered name."""
    p: float
    """Probability of such an estimate without any change, for this effect alone."""
    log_evidence: float
    """Log evidence against no change [nats]."""
    share: float
    """Probability among all single candidates and no change."""
    parameters: tuple[ChangedParameter, ...]
    """Its parameters."""


@dataclasses.dataclass(frozen=True)
class Followed:
    """How well the twin follows flights of the reference that it has not seen."""

    channel: str
    """One of `diagnosis.twin.channels.CHANNELS`."""
    unit: str
    """rad or m/s^2."""
    simulator: float
    """Root mean square of measured minus nominal simulator."""
    twin: float
    """The same of measured minus twin."""


@dataclasses.dataclass(frozen=True)
class Drift:
    """Position drift over one window, mean over flights, root mean square within each [m]."""

    before: float
    """Of the reference's twin."""
    after: float
    """Of the twin with the named effects, fitted to the other changed flights."""

    @property
    def shrinkage(self) -> float:
        """Share of the drift that the named effects take away."""
        return 1.0 - self.after / self.before if self.before > 0.0 else np.nan


@dataclasses.dataclass(frozen=True)
class TwinAnswer:
    """What changed between reference and target flights."""

    change: Change
    """The verdict."""
    effects: tuple[str, ...]
    """Named effects; empty unless the change is `EFFECT` or `PARTLY`."""
    aliases: tuple[str, ...]
    """Effects that these flights cannot tell from the first of them."""
    probability: float
    """Probability that the first named effect or one of its aliases is true, among candidates."""
    parameters: tuple[ChangedParameter, ...]
    """Parameters of the named effects, estimated together."""
    candidates: tuple[Candidate, ...]
    """Every candidate that these flights show, the most probable first."""
    unseen: tuple[str, ...]
    """Effects of which these flights say too little to be candidates."""
    p_none: float
    """Probability of such flights without any change, in all directions together."""
    p_left: float
    """The same after the named effects."""
    followed: tuple[Followed, ...]
    """How well the twin follows."""
    drift: Drift | None
    """How far the named effects shrink the drift; None without any."""
    set_aside: tuple[str, ...]
    """Flights of either set that do not count: no twin follows them."""
    reference_flights: int
    """Reference flights that count."""
    target_flights: int
    """Changed flights that count."""


def followed(
    simulator: np.ndarray, twin: np.ndarray, seen: tuple[int, ...]
) -> tuple[Followed, ...]:
    """The records of all channels that are seen."""
    return tuple(
        Followed(CHANNELS[c], "rad" if c < 3 else "m/s^2", float(simulator[c]), float(twin[c]))
        for c in seen
    )
