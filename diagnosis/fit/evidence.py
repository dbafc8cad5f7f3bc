r"""Normal equations of candidate sets, with what the reference flights share eliminated.

With a reference, what the nominal simulator lacks on both sets is a shared vector s with a
Gaussian precision S from the reference flights. It is eliminated from every solve to first order,
so that only effects are searched for in the simulator.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decision import Decision
from diagnosis.fit.equations import (
    Switched,
    bounded_step,
    loosened,
    moved,
    muted,
    scale_of,
    scaled,
)
from diagnosis.fit.fit import Fit, Set
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.windows import Normal
from diagnosis.logs.segments import REPLAY_WINDOW_S
from diagnosis.replay.library import Library, Slot


@dataclasses.dataclass(frozen=True)
class Evidence:
    """What flights hold against the nominal (or reference) vector, and what is known of it."""

    likelihood: Likelihood
    """The target flights."""
    base: Float[np.ndarray, " params"]
    """The vector without any effect: the nominal simulator's, or the reference flights'."""
    precision: Float[np.ndarray, "params params"] | None
    """How well the reference flights tell that vector; None without them."""
    spread: Float[np.ndarray, " params"]
    """Variance of what flights have of their own, in units of the dispersion."""
    pull: Float[np.ndarray, " params"]
    """Gradient of the reference flights at their vector: not zero where that stands at a bound."""
    phi: float = 1.0
    """Dispersion between flights."""
    decision: Decision = Decision()
    """What decides of it."""

    @classmethod
    def of(
        cls,
        likelihood: Likelihood,
        base: Float[np.ndarray, " params"] | None = None,
        precision: Float[np.ndarray, "params params"] | None = None,
        spread: Float[np.ndarray, " params"] | None = None,
        pull: Float[np.ndarray, " params"] | None = None,
        decision: Decision = Decision(),
    ) -> "Evidence":
        """That of flights, as far as nothing else is known beside the nominal simulator."""
        base = likelihood.library.neutral if base is None else base
        spread, pull = (np.zeros(len(base)) if x is None else x for x in (spread, pull))
        return cls(likelihood, base, precision, spread, pull, decision=decision)

    @property
    def library(self) -> Library:
        """The effects and the simulator."""
        return self.likelihood.library

    @functools.cached_property
    def ends(self) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, " params"]]:
        """Lower and upper bounds of the vector (`bounds`)."""
        return bounds(self.library.slots, self.base)

    @property
    def low(self) -> Float[np.ndarray, " params"]:
        """Lower bounds."""
        return self.ends[0]

    @property
    def high(self) -> Float[np.ndarray, " params"]:
        """Upper bounds."""
        return self.ends[1]

    @functools.cached_property
    def earliest(self) -> float:
        """The earliest onset that is tried [s]."""
        return (
            min(group.start.min() for group in self.likelihood.groups)
            + self.decision.quiet_windows * REPLAY_WINDOW_S
        )

    def free(self, effects: Iterable[str]) -> list[int]:
        """Entries of the vector that a set sets free."""
        places = self.library.indices
        return [i for name in sorted(effects) for i in places[name]]

    def made(
        self,
        effects: Set,
        vector: np.ndarray,
        shared: np.ndarray | None = None,
        whole: bool = True,
    ) -> Fit:
        """The fit of a set at `vector`, the rest of the shared shift taken to first order.

        Unless `whole`, the normal equations need not be along more than the set's parameters; what
        a reference shares has the slopes of the last fit that was whole.
        """
        shared, ahead = np.zeros(len(vector)) if shared is None else shared, np.zeros(len(vector))
        along = None if whole else self.free(effects)
        normal = self.likelihood.normal(vector, along, others=self.precision is not None)
        if self.precision is None:
            return Fit(effects, vector, normal, shared, ahead, 0.0)
        normal = loosened(normal, self.spread)
        H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
        if np.isfinite(H).all():
            ahead = self._ahead(H + self.precision, g - self.precision @ shared, vector)
        shift = shared + ahead
        penalty = float(shift @ self.precision @ shift)
        return Fit(effects, vector, moved(normal, ahead), shared, ahead, penalty)

    def as_flown(self, fit: Fit) -> Fit:
        """`fit` without what first order promises of the shared shift."""
        if self.precision is None:
            return fit
        back, penalty = -fit.ahead, float(fit.shared @ self.precision @ fit.shared)
        normal, nothing = moved(fit.normal, back), np.zeros(len(back))
        return dataclasses.replace(fit, normal=normal, ahead=nothing, penalty=penalty)

    def _ahead(self, H: np.ndarray, g: np.ndarray, vector: np.ndarray) -> np.ndarray:
        """Solution of H x = g that keeps `vector` + x within the bounds of all parameters."""
        low, high = self.low - vector, self.high - vector
        try:
            free = np.linalg.solve(H, g)
        except np.linalg.LinAlgError:  # so far from its flights that first order says nothing
            return np.zeros(len(g))
        inside = bool(np.all((free >= low) & (free <= high)))
        return free if inside else bounded_step(H, g, low, high)

    def place(self, effect: str, parameter: str) -> int:
        """Where a parameter of an effect stands in the vector."""
        slots = self.library.slots
        return next(i for i in self.library.indices[effect] if slots[i].parameter == parameter)

    def within(self, vector: np.ndarray, free: list[int]) -> np.ndarray:
        """`vector` with some entries taken to the nearest end of what a fit may try."""
        vector = vector.copy()
        vector[free] = np.clip(vector[free], *self.bounds_of(free))
        return vector

    def bounds_of(self, free: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ends of what a fit may try of some entries."""
        low, high = self.low.copy(), self.high
        low[list(self.library.onsets.values())] = self.earliest
        return low[free], high[free]

    def bounded(
        self, normal: Normal, fit: Fit, free: list[int]
    ) -> tuple[Float[np.ndarray, " free"], float]:
        """Linear step within the bounds, and the fall in chi-square that it promises."""
        H, g = self.reduced(normal, fit, free)
        if not free or not np.isfinite(H).all():
            return np.zeros(len(free)), 0.0
        low, high = self.bounds_of(free)
        step = bounded_step(H, g, low - fit.vector[free], high - fit.vector[free])
        return step, float(2 * g @ step - step @ H @ step)

    def following(
        self, fit: Fit, free: list[int], step: Float[np.ndarray, " free"]
    ) -> Float[np.ndarray, " params"]:
        """How the shared shift follows a step of the free parameters, to first order.

        An offset of the centre of mass and the stiffness of the loop, say, can only grow together.
        """
        if self.precision is None:
            return np.zeros(len(fit.vector))
        H = fit.normal.H.sum(axis=0)
        return -np.linalg.solve(H + self.precision, H[:, free] @ step)

    def joint_step(
        self, fit: Fit, damping: float = 0.0, others: Normal | None = None
    ) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, " params"], float]:
        """Beside a reference, the vector and the shared shift one step from `fit`, as flown.

        The last number is the fall of the objective that first order promises.

        Levenberg and Marquardt's step of the free parameters and of the shift at once: the
        curvature of each is raised by a share `damping` of its own. With `others`, normal
        equations at the fit, it is the step that those ask for; where their slopes are not finite,
        as beside a simulation that blows up, first order says nothing and the fit stays.
        """
        free, n, normal = self.free(fit.effects), len(fit.vector), others or fit.normal
        H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
        if not np.isfinite(H).all() or not np.isfinite(g).all():
            return fit.vector, fit.shared, 0.0
        every = [*free, *range(n)]
        joint, right = H[np.ix_(every, every)], g[every]
        joint[-n:, -n:] += self.precision
        damped = joint + damping * np.diag(np.diag(H)[every])
        right[-n:] -= self.precision @ fit.shared
        bounds = zip(self.bounds_of(free), (self.low, self.high), strict=True)
        low, high = (np.concatenate(ends) for ends in bounds)
        step = bounded_step(damped, right, low - fit.vector[every], high - fit.vector[every])
        promise = float(2.0 * right @ step - step @ joint @ step)
        shift = step[-n:].copy()
        shared = self._walked(self.base + fit.shared, shift) - self.base
        shift[free] += step[:-n]
        return self._walked(fit.vector, shift), shared, promise

    def _walked(
        self, vector: Float[np.ndarray, " params"], by: Float[np.ndarray, " params"]
    ) -> Float[np.ndarray, " params"]:
        """`vector` a step further (`Slot.walked`), and within the bounds that it was within."""
        slots = self.library.slots
        new = [slot.walked(x, step) for slot, x, step in zip(slots, vector, by, strict=True)]
        return np.clip(new, np.minimum(self.low, vector), np.maximum(self.high, vector))

    def inwards(
        self, vector: Float[np.ndarray, " params"], by: Float[np.ndarray, " params"]
    ) -> Float[np.ndarray, " params"]:
        """As much of the step `by` as leaves no bound behind."""
        low = np.minimum(self.low, vector)
        return np.clip(vector + by, low, np.maximum(self.high, vector)) - vector

    def solve(
        self, normal: Normal, fit: Fit, free: list[int]
    ) -> tuple[Float[np.ndarray, " free"], float]:
        """Linear step of the free parameters, and the fall in chi-square that it promises."""
        H, g = self.reduced(normal, fit, free)
        if not free:
            return np.zeros(0), 0.0
        step = np.linalg.lstsq(*scaled(H, g), rcond=1e-9)[0] / scale_of(H)
        return step, float(2 * g @ step - step @ H @ step)

    def reduced(
        self, normal: Normal, fit: Fit, free: list[int]
    ) -> tuple[Float[np.ndarray, "free free"], Float[np.ndarray, " free"]]:
        """Normal equations of the free parameters, the shared shift eliminated."""
        H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
        inner, right = H[np.ix_(free, free)], g[free]
        if self.precision is None:
            return inner, right
        known = H + self.precision
        pull = np.linalg.solve(known, np.column_stack([H[:, free], g - self.precision @ fit.shift]))
        return inner - H[free] @ pull[:, :-1], right - H[free] @ pull[:, -1]

    def silent(self, effects: Set, near: Fit) -> dict[str, int]:
        """Where the onsets stand of effects that are in `effects`, but not in `near` yet."""
        return {n: i for n, i in self.library.onsets.items() if n in effects - near.effects}

    def felt(self, effects: Set, near: Fit) -> list[int]:
        """Entries that a linear step from `near` may move: the onset of nothing has no slope.

        Rounding leaves one that is next to nothing, of which a linear step would make any time.
        """
        silent = self.silent(effects, near).values()
        return [i for i in self.free(effects) if i not in silent]

    def set_in(self, effects: Set, near: Fit) -> tuple[Normal, dict[str, float]]:
        """Normal equations at `near`, and when the effects that it has not yet set in [s].

        Each sets in when it explains most beside those before it, by name.
        """
        normal, found = near.normal, {}
        for name in sorted(self.silent(effects, near)):
            switched = self._switched(near.normal, name, found)
            later = self.silent(effects, near).keys() - found.keys() - {name}
            free = self.felt(effects - later, near)
            times = np.unique(near.normal.t)[self.decision.quiet_windows :]
            gains = [self.solve(switched(t), near, free)[1] for t in times[:-1]]
            found[name] = float(times[int(np.argmax(gains))]) if gains else 0.0
            normal = switched(found[name])
        return normal, found

    def _switched(
        self, normal: Normal, name: str, before: Mapping[str, float]
    ) -> Callable[[float], Normal]:
        """Normal equations by an effect's onset [s], those `before` set; what is loose, is so."""
        normal = normal.of(normal.dof > 0)
        for other, onset in before.items():
            normal = muted(normal, self.library.indices[other], onset)
        switched = Switched(normal, self.library.indices[name])
        return lambda onset: loosened(switched.at(onset), self.spread)

    def promised(self, near: Fit, effects: Set) -> float:
        """Log evidence that the linear screening at `near` promises a set [nats]."""
        normal, gain = self._screened(near, effects)
        free = self.free(effects)
        H, _ = self.reduced(normal, near, free)
        return -0.5 * (near.objective - gain) / self.phi - self.occam(H, free)

    def gain(self, near: Fit, effects: Set) -> float:
        """Fall of chi-square that the linear screening at `near` promises a set."""
        return self._screened(near, effects)[1]

    def _screened(self, near: Fit, effects: Set) -> tuple[Normal, float]:
        """Normal equations at `near`, of what sets in from where it does, and the promised fall."""
        normal, _ = self.set_in(effects, near)
        return normal, self.solve(normal, near, self.felt(effects, near))[1]

    def worth(self, fit: Fit, name: str) -> float:
        """What leaving out an effect of `fit` would cost in log evidence [nats], to first order."""
        gone, kept = self.library.indices[name], self.free(fit.effects - {name})
        (H, _), n = self.reduced(fit.normal, fit, [*gone, *kept]), len(gone)
        own = H[:n, :n] - H[:n, n:] @ np.linalg.pinv(H[n:, n:], hermitian=True) @ H[n:, :n]
        back: Float[np.ndarray, " gone"] = (self.base + fit.shared - fit.vector)[gone]
        return float(0.5 * back @ own @ back / self.phi)

    def variance(
        self, fit: Fit, free: list[int], following: Float[np.ndarray, " free"]
    ) -> Float[np.ndarray, " free"]:
        """Variance over `phi` of free parameters plus `following` times their shared shifts.

        Infinite where flights say nothing of a parameter.
        """
        own, _ = self.reduced(fit.normal, fit, free)
        told, along, n = np.diag(own) > 0.0, np.eye(len(free)), len(fit.vector)
        scale = scale_of(own)
        inverse = np.linalg.pinv(own / np.outer(scale, scale)) / np.outer(scale, scale)
        if self.precision is None:
            found = np.diag(inverse)
            return np.where(told & (found > 0.0), found, np.inf)
        H, shift = fit.normal.H.sum(axis=0), np.zeros((len(free), n))
        shift[np.arange(len(free)), free] = following
        pull = np.linalg.solve(H + self.precision, np.column_stack([H[:, free], shift.T]))
        along = along - shift @ pull[:, : len(free)]
        loose = np.sum(shift * pull[:, len(free) :].T, axis=1)
        found = np.einsum("ij,jk,ik->i", along, inverse, along) + loose
        return np.where(told & (found > 0.0), found, np.inf)

    def past_bounds(
        self, fit: Fit, free: list[int], following: Float[np.ndarray, " free"]
    ) -> Float[np.ndarray, " free"]:
        """How far bounds hold back free parameters plus `following` times their shared shifts.

        A vehicle that answers sooner than the simulator asks for a delay below zero, which no
        simulator has. To first order, this is the step from the fit to where the flights and
        their reference would be if their shared shift had no bounds.
        """
        nothing = np.zeros(len(free))
        if self.precision is None:
            return nothing
        H, at = fit.normal.H.sum(axis=0), self.base + fit.shift
        pull = fit.normal.g.sum(axis=0) + self.pull - self.precision @ fit.shift
        low, high = at <= self.low + 1e-9, at >= self.high - 1e-9
        held = np.where(low & (pull < 0.0) | high & (pull > 0.0), pull, 0.0)
        if not held.any() or not np.isfinite(H).all():
            return nothing
        own, _ = self.reduced(fit.normal, fit, free)
        shift = np.linalg.solve(H + self.precision, held)
        step = np.linalg.lstsq(*scaled(own, -H[free] @ shift), rcond=1e-9)[0] / scale_of(own)
        shift += self.following(fit, free, step)
        return step + following * shift[free]

    def log_evidence(self, fit: Fit) -> float:
        """Laplace's log evidence [nats]; of parameters that cannot be flown minus infinity."""
        free = self.free(fit.effects)
        H, _ = self.reduced(fit.normal, fit, free)
        if not np.isfinite(H).all():
            return -np.inf
        return -0.5 * fit.objective / self.phi - self.occam(H, free)

    def occam(self, H: Float[np.ndarray, "free free"], free: list[int]) -> float:
        """What the parameters cost: ln of prior range over posterior width [nats]."""
        if not free:
            return 0.0
        width = (self.library.high - self.library.low)[free]
        sizes = np.linalg.slogdet(H / self.phi + np.diag(2 * np.pi / width**2))[1]
        return float(np.sum(np.log(width / np.sqrt(2 * np.pi))) + 0.5 * sizes)


def bounds(
    slots: Sequence[Slot], base: Float[np.ndarray, " params"]
) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, " params"]]:
    """Bounds of a vector whose effects act on top of `base`: those of factors go with it."""
    within = np.asarray([(slot.low, slot.high) for slot in slots])
    on_top = [
        (slot.on_top(slot.low, at), slot.on_top(slot.high, at)) if slot.multiplies(at) else ends
        for slot, at, ends in zip(slots, base, within, strict=True)
    ]
    low, high = np.asarray(on_top).T
    return np.minimum(within[:, 0], low), np.maximum(within[:, 1], high)
