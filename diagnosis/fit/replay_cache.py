"""What a likelihood remembers of its replays, so that the same one is not flown twice."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from diagnosis.replay.whitening import Turns

KEPT = 2**29
"""Bytes of replays that are kept, so that scoring a fit does not fly it again; two at least."""
SLOPES = 2**28
"""Most bytes of slopes that are kept for replays along few parameters."""

Flown = tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
"""A replay: the fields of its `Normal` and of its `Tracks`."""
Place = tuple[int, int]
"""A batch of windows: the group, and the first segment in it."""


@dataclasses.dataclass(frozen=True)
class ReplayCache:
    """Replays of one likelihood, which alone writes here.

    A replay found here is the one that would be flown. The slopes are another matter: a replay
    along few parameters takes those of the others from the last replay along all.
    """

    replays: dict[tuple, Flown] = dataclasses.field(default_factory=dict)
    """The last few replays, by what was flown."""
    turns: dict[Place, Turns] = dataclasses.field(default_factory=dict)
    """What errors of fresh starts take from each batch."""
    slopes: dict[Place, np.ndarray] = dataclasses.field(default_factory=dict)
    """Slopes of each batch in the last replay along all parameters; none if they were too many."""

    def keep(self, key: tuple, flown: Flown) -> None:
        """Remembers a replay; the oldest are dropped until there is room for it."""
        sizes, room = {k: _bytes(found) for k, found in self.replays.items()}, _bytes(flown)
        for oldest in list(sizes):
            if len(self.replays) < 2 or sum(sizes.values()) + room <= KEPT:
                break
            del self.replays[oldest], sizes[oldest]
        self.replays[key] = flown

    def keep_slopes(self, at: Place, slopes: Float[np.ndarray, "params ..."]) -> None:
        """Remembers the slopes of a batch; none at all if they are too many or not finite."""
        slopes = slopes.astype(np.float32)
        kept = sum(x.nbytes for x in self.slopes.values()) + slopes.nbytes
        first = at == (0, 0)
        if (first or self.slopes) and kept <= SLOPES and np.isfinite(slopes).all():
            self.slopes[at] = slopes
        else:
            self.slopes.clear()

    def merged_slopes(
        self, at: Place, along: Sequence[int], slopes: Float[np.ndarray, "narrow ..."]
    ) -> Float[np.ndarray, "params ..."]:
        """Slopes of a batch along all parameters: those at `along` are new, the others as kept."""
        places: Int[np.ndarray, " params"] = len(along) + np.arange(len(self.slopes[at]))
        places[list(along)] = np.arange(len(along))
        return np.concatenate([slopes[: len(along)], self.slopes[at]])[places]


def _bytes(found: Flown) -> int:
    return sum(array.nbytes for part in found for array in part.values())
