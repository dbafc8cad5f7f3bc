"""Distributions that stand where a number would: `mass(e~normal(0, 0.05))`.

    uniform(a, b)    every value from a to b is equally likely
    normal(m, s)     mean m, standard deviation s, truncated to the parameter's bounds [low, high]:
                     a value outside is drawn again, so that no probability piles up at a bound

A value is the quantile of a share that is uniform in [0, 1). For a normal distribution truncated to
[low, high], with Phi the standard normal distribution and u the share,

    x = m + s Phi^-1(p + u (q - p)),   p = Phi((low - m) / s),   q = Phi((high - m) / s).
"""

import math

import equinox as eqx
import jax.numpy as jnp
from jax.scipy.special import ndtr, ndtri
from jaxtyping import Array, Float

KINDS = {"uniform": "(LEAST, LARGEST)", "normal": "(MEAN, STANDARD_DEVIATION)"}
"""What there is, and what its two numbers are."""


class Distribution(eqx.Module):
    """How one parameter of an effect is drawn."""

    kind: str = eqx.field(static=True)
    """One of `KINDS`."""
    first: float = eqx.field(static=True)
    """Least value, or mean, in the parameter's unit."""
    second: float = eqx.field(static=True)
    """Largest value, or standard deviation, in the parameter's unit."""
    low: float = eqx.field(static=True)
    """Smallest value that the parameter may have."""
    high: float = eqx.field(static=True)
    """Largest value that the parameter may have."""

    def __check_init__(self) -> None:
        where = f"{self.text()} in [{self.low:g}, {self.high:g}]"
        if self.kind not in KINDS:
            known = " or ".join(name + numbers for name, numbers in KINDS.items())
            raise ValueError(f"a distribution must be {known}, got '{self.kind}'")
        if not (math.isfinite(self.first) and math.isfinite(self.second)):
            raise ValueError(f"a distribution must have finite numbers, got {where}")
        if self.kind == "uniform" and not self.low <= self.first < self.second <= self.high:
            raise ValueError(
                f"uniform(LEAST, LARGEST) must rise and lie within the parameter's bounds, got "
                f"{where}"
            )
        if self.kind == "normal" and not self.second > 0.0:
            raise ValueError(f"the standard deviation of a normal must be above 0, got {where}")
        if self.kind == "normal" and not self.low <= self.first <= self.high:
            raise ValueError(
                f"the mean of a normal must lie within the parameter's bounds, got {where}"
            )

    def text(self, digits: int = 12) -> str:
        """As it is written in a reality, with so many digits."""
        return f"{self.kind}({self.first:.{digits}g}, {self.second:.{digits}g})"

    def quantile(self, share: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The values below which `share` of all draws lie."""
        if self.kind == "uniform":
            return self.first + share * (self.second - self.first)
        p, q = (ndtr((bound - self.first) / self.second) for bound in (self.low, self.high))
        drawn = self.first + self.second * ndtri(p + share * (q - p))
        return jnp.clip(drawn, self.low, self.high)  # ndtri(0) is minus infinity
