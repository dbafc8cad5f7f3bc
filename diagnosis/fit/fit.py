"""A candidate set at its most likely parameters."""

import dataclasses

import numpy as np
from jaxtyping import Float

from diagnosis.fit.windows import Normal

Set = frozenset[str]
"""Names of effects."""


@dataclasses.dataclass(frozen=True)
class Fit:
    """A candidate set at its most likely parameters."""

    effects: Set
    """Names; empty for the nominal simulator."""
    vector: Float[np.ndarray, " params"]
    """All parameters of the library where the simulator was linearised."""
    normal: Normal
    """Normal equations of the target flights along every parameter, there and `ahead` of it."""
    shared: Float[np.ndarray, " params"]
    """Shift of the base that `vector` holds: what the reference flights did not quite tell."""
    ahead: Float[np.ndarray, " params"]
    """The rest of that shift, to first order only; zero without reference."""
    penalty: float
    """What the whole shift costs, in units of chi-square."""

    @property
    def shift(self) -> Float[np.ndarray, " params"]:
        """The whole shift of the base."""
        return self.shared + self.ahead

    @property
    def total(self) -> Float[np.ndarray, " params"]:
        """All parameters of the library at the fit."""
        return self.vector + self.ahead

    @property
    def objective(self) -> float:
        """Chi-square of the target flights, and of the shift; infinite for NaN."""
        value = self.normal.chi2 + self.penalty
        return value if np.isfinite(value) else np.inf
