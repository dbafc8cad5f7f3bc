"""The typed answer of a diagnosis, as `diagnosis.json` holds it (schema 2).

Everything is decided before: a document that shows a `Diagnosis` chooses words and no facts. The
JSON Schema of `docs/diagnosis.schema.json` is generated from these records
by `python -m diagnosis.result`. All numbers are SI; null stands for a number that is not known.
"""

import dataclasses
import functools
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import pydantic

from diagnosis.interface.fault import InterfaceFault, Untold
from diagnosis.result_parts import (
    AtBound,
    ChannelGap,
    ChannelNoise,
    DriftAlong,
    Flights,
    Followed,
    GapInTime,
    Limit,
    Misfit,
    NotObservable,
    SetAside,
    SharedParameter,
    Shrink,
    Windows,
)

SCHEMA = 2
"""Version of `diagnosis.json`."""

VerdictKind = Literal["effect", "partly", "none", "too_few", "unexplained"]
"""`diagnosis.statements` says when each is given."""
Use = Literal["measured", "descriptive"]
"""What a size may be used for (`statements.use_of`)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Program:
    """Which program gave the answer."""

    version: str | None
    """Release of the package."""
    digest: str | None
    """SHA-256 of the source of `diagnosis` and `simulators`."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Settings:
    """What was asked."""

    simulator: str
    """Registered name of the nominal simulator."""
    exclude: tuple[str, ...]
    """Effects that were left out by request."""
    withheld: tuple[str, ...]
    """Those, and every effect that always looks like one of them."""
    decision: Mapping[str, float] | None
    """The fields of `diagnosis.decision.Decision`, in their units."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Parameter:
    """The size of one parameter of an effect."""

    name: str
    """Name."""
    value: float
    """Most likely value, on top of what the reference flights have."""
    low: float | None
    """Lower end of its 95 % interval; null where the flights say nothing of it."""
    high: float | None
    """Upper end."""
    unit: str
    """Unit."""
    at_bound: AtBound
    """Whether the value lies at an end of its allowed range."""
    use: Use
    """What the value may be used for: `measured` with its interval, or `descriptive` only."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """One effect of the likeliest set."""

    name: str
    """Registered name."""
    blamed: bool
    """Whether the verdict names it as a cause."""
    probability: float | None
    """Probability that it acts [-]; beside a twin, that it or one of its aliases does. Null where
    it is not blamed, which states nothing of it, and without a twin under `partly`: odds among
    candidates say little beside something that none of them describes."""
    aliases: tuple[str, ...]
    """Effects that these flights cannot tell from it, likeliest first."""
    parameters: tuple[Parameter, ...]
    """Its sizes."""

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name.

        Raises:
            KeyError: There is none.
        """
        by_name = {parameter.name: parameter for parameter in self.parameters}
        return by_name[name]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Candidate:
    """One set of effects that was fitted."""

    effects: tuple[str, ...]
    """Names, sorted; none for the nominal simulator."""
    posterior: float
    """Its share among all sets that were looked at [-]; no statement of truth."""
    evidence: float | None
    """Gain in log-likelihood over no effect on flights left out in turn [nats]."""
    shrink_percent: float | None
    """Fall of the drift of the fitted flights [%]."""
    named: bool
    """Whether it is the set that the verdict names."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Support:
    """What one effect does for flights that were left out of the fit in turn."""

    effect: str
    """Registered name."""
    percent: float | None
    """By how much it lowers their misfit [%]."""
    low: float | None
    """Lower end of its 95 % interval."""
    high: float | None
    """Upper end."""
    n: int
    """Flights."""
    confirmed: bool | None
    """Whether it helps by more than flights differ; null with too few flights to say."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Remainder:
    """What the likeliest set leaves of the gap."""

    share: float | None = None
    """Its part of the gap beyond noise [-]."""
    noteworthy: bool = False
    """Whether the share is large enough to be said beside an effect."""
    mostly_explained: bool = False
    """Whether the share is small enough for most of the gap to be explained."""
    structure_before: float | None = None
    """Structure that the nominal simulator leaves; 1 is noise."""
    structure: float | None = None
    """Structure that the likeliest set leaves; 1 is noise."""
    where: tuple[ChannelGap, ...] = ()
    """The gap that it leaves, by channel."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Doubt:
    """Why the effects of the verdict are less probable than their evidence says."""

    structure: float
    """Structure that is left; 1 is noise."""
    true_share: float
    """Part of the effects named in cases with known answers that were true with so much left."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Details:
    """Data of tables and pictures."""

    misfit: Misfit
    """How well the fitted flights are followed."""
    dispersion: float | None = None
    """Variance between flights over that of independent samples; at least 1."""
    noise: tuple[ChannelNoise, ...] = ()
    """Noise of the logs."""
    windows: Windows | None = None
    """Half seconds that counted."""
    set_aside: tuple[SetAside, ...] = ()
    """Half seconds that stand out and did not count."""
    limits: tuple[Limit, ...] = ()
    """What would have stayed unseen."""
    not_observable: tuple[NotObservable, ...] = ()
    """Effects that are no candidates."""
    shared: tuple[SharedParameter, ...] = ()
    """With reference flights: what they have already."""
    before_after: tuple[DriftAlong, ...] = ()
    """Drift along the flights that scored."""
    gap_in_time: tuple[GapInTime, ...] = ()
    """The gap against time."""
    followed: tuple[Followed, ...] = ()
    """How well a twin of the reference flies; none where the simulator follows the reference."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Diagnosis:
    """Why a simulator and flights differ."""

    __pydantic_config__ = pydantic.ConfigDict(extra="forbid", use_attribute_docstrings=True)

    schema: Literal[2] = SCHEMA
    """Version of this format."""
    verdict: VerdictKind
    """What the flights say."""
    probability: float | None
    """Probability that the verdict names the right set [-]; null where it names none."""
    effects: tuple[Effect, ...]
    """Effects of the likeliest set, blamed or not."""
    remainder: Remainder
    """What that set leaves."""
    doubt: Doubt | None
    """Why the effects are less probable than their evidence; null where nothing is doubted."""
    where: tuple[ChannelGap, ...]
    """Where the gap lies, by channel."""
    candidates: tuple[Candidate, ...]
    """The likeliest sets, most probable first."""
    support: tuple[Support, ...]
    """What flights left out in turn say of the effects, where the simulator does not follow."""
    shrink: Shrink
    """How far the gap shrinks."""
    next_flight: str | None
    """What to fly next, and what for."""
    flights: Flights
    """The flights."""
    reference: Flights | None
    """The reference flights."""
    settings: Settings
    """What was asked."""
    program: Program
    """Which program gave the answer."""
    details: Details
    """Data of tables and pictures."""
    interface: tuple[InterfaceFault, ...] = ()
    """Parts of the logs that do not say what the format asks for; none in older files."""
    untold: tuple[Untold, ...] = ()
    """Parts of the logs that these flights do not allow to check; none in older files."""

    @property
    def shows_nothing(self) -> bool:
        """Whether nothing stands out of noise, be it for want of flights."""
        return self.verdict in ("none", "too_few")

    @property
    def compared(self) -> bool:
        """Whether the flights were compared with a simulator; not where the logs mislead."""
        return bool(self.where)

    @property
    def blamed(self) -> tuple[Effect, ...]:
        """The effects that the verdict names as causes."""
        return tuple(effect for effect in self.effects if effect.blamed)

    def to_json(self) -> dict[str, Any]:
        """The object that `diagnosis.json` holds, null for every number that JSON lacks."""
        return json.loads(_adapter().dump_json(self))

    @classmethod
    def of_json(cls, content: Mapping[str, Any]) -> "Diagnosis":
        """The diagnosis in a JSON object.

        Raises:
            ValueError: It is of another schema, or a field is missing, unknown or of a wrong type.
        """
        schema = content.get("schema")
        if schema != SCHEMA:
            raise ValueError(f"`schema` must be {SCHEMA}, got {schema!r}.")
        return _adapter().validate_json(json.dumps(content))

    @classmethod
    def load(cls, path: Path) -> "Diagnosis":
        """The diagnosis in a file.

        Raises:
            ValueError: As `of_json`; or the file holds no JSON object.
        """
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            if not isinstance(content, dict):
                raise ValueError("it holds no JSON object")
            return cls.of_json(content)
        except ValueError as error:
            raise ValueError(f"{path} is no diagnosis: {error}") from None


@functools.cache
def _adapter() -> Any:
    """The types as pydantic reads and writes them."""
    return pydantic.TypeAdapter(Diagnosis)


def json_schema() -> str:
    """The text of the published JSON Schema."""
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema"} | _adapter().json_schema()
    return json.dumps(schema, indent=1) + "\n"


if __name__ == "__main__":
    sys.stdout.write(json_schema())
