"""What a twin says of changed flights, as frozen records; renderers decide nothing."""

import dataclasses
from collections.abc import Mapping

from diagnosis.result import VerdictKind
from diagnosis.result_parts import AtBound, Followed


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
    beyond: AtBound
    """The end of the effect's allowed range beyond which the estimate lies."""
    possible: bool
    """Whether logs can be flown with the estimate: commands may also act earlier than they say."""

    @property
    def clear(self) -> bool:
        """Whether the interval does not hold zero."""
        return self.low > 0.0 or self.high < 0.0


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

    @property
    def possible(self) -> bool:
        """Whether each size is possible."""
        return all(one.possible for one in self.parameters)


@dataclasses.dataclass(frozen=True)
class Naming:
    """What was named of what changed between reference and target flights."""

    change: VerdictKind
    """The verdict."""
    effects: tuple[str, ...]
    """Named effects; empty unless the change is `effect` or `partly`."""
    aliases: Mapping[str, tuple[str, ...]]
    """Effects that these flights cannot tell from each of them."""
    probabilities: Mapping[str, float]
    """Probability, among candidates, that each named effect or one of its aliases is true."""
    parameters: tuple[ChangedParameter, ...]
    """Parameters of the named effects, estimated together."""
    candidates: tuple[Candidate, ...]
    """Every candidate that these flights show, the most probable first."""
    beside: tuple[str, ...]
    """Effects that the flights show beside the best; all others were tried with them."""
    unseen: tuple[str, ...]
    """Effects of which these flights say too little to be candidates."""


@dataclasses.dataclass(frozen=True)
class TwinAnswer(Naming):
    """What changed between reference and target flights."""

    followed: tuple[Followed, ...]
    """How well the twin follows."""
    misfit: tuple[float, float]
    """Chi-square per number of the changed flights, without and with the named effects."""
    set_aside: tuple[str, ...]
    """Changed flights that do not count: the others differ from the twin far less."""
