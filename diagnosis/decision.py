"""Every threshold of a diagnosis: value, unit and the evidence for it, in one frozen record."""

import dataclasses
from typing import Any


def _decided(value: float | int, unit: str, evidence: str) -> Any:
    """A field of `Decision`."""
    return dataclasses.field(default=value, metadata={"unit": unit, "evidence": evidence})


UNDERIVED = "not derived"
"""Evidence of a threshold that nobody has measured."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Decision:
    """What decides, from the fits to the words of an answer."""

    noteworthy_share: float = _decided(0.05, "-", UNDERIVED)
    """Unexplained share of the gap from which the verdict mentions it."""
    mostly_share: float = _decided(0.2, "-", UNDERIVED)
    """Unexplained share below which most of the gap counts as explained."""
    main_share: float = _decided(0.5, "-", UNDERIVED)
    """Share of the gap that its main channels hold between them."""
    main_channels: int = _decided(3, "channels", UNDERIVED)
    """Most main channels."""

    def values(self) -> dict[str, float]:
        """Every threshold by name."""
        return {field.name: float(getattr(self, field.name)) for field in dataclasses.fields(self)}


DECISION = Decision()
"""What decides unless another is given."""
