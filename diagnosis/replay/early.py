"""Commands that act earlier than the log says.

No simulator acts before its command, so effects that delay commands begin at zero. But a log holds
the commands that come next: flown again, it may give each of them before its row.
"""

from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diagnosis.logs.segments import Early
from diagnosis.replay.library import Library
from simulators.effects.late import LateEffect


def lowest(library: Library) -> Float[np.ndarray, " params"]:
    """Smallest values at which logs can be flown: commands may be as early as late."""
    late = [issubclass(library.effects[slot.effect], LateEffect) for slot in library.slots]
    return np.where(late, 2.0 * library.neutral - library.high, library.low)


def split_early(
    library: Library, vector: Float[np.ndarray, " params"]
) -> tuple[Float[np.ndarray, " params"], Early | None]:
    """The vector without effects that would act before a command, and how early these act."""
    ahead = []
    vector, low = vector.copy(), library.low
    for name, kind in library.effects.items():
        places = library.indices[name]
        if issubclass(kind, LateEffect) and np.any(vector[places] < low[places]):
            ahead.append(_made(kind, library.named(vector, name)))
            vector[places] = library.neutral[places]

    def early(t: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        late = [np.asarray(effect.late(jnp.asarray(t))) for effect in ahead]
        return np.zeros_like(t) - sum(late)

    return vector, early if ahead else None


def _made(kind: Callable[..., LateEffect], values: Mapping[str, float]) -> LateEffect:
    return kind(**values)
