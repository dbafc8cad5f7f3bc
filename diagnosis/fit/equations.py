"""Linear algebra on normal equations: steps, shifts, onsets, what flights have of their own."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from scipy.optimize import lsq_linear
from scipy.stats import chi2

from diagnosis.decision import Decision
from diagnosis.fit.windows import Normal
from diagnosis.logs.segments import REPLAY_WINDOW_S

ROUNDS = 5
"""Rounds in which variances and dispersion settle together."""


def moved(normal: Normal, by: Float[np.ndarray, " params"]) -> Normal:
    """Normal equations `by` ahead, to first order in the prediction."""
    pushed = np.einsum("wij,j->wi", normal.H, by)
    c = normal.c - 2.0 * normal.g @ by + pushed @ by
    return dataclasses.replace(normal, g=normal.g - pushed, c=c)


def bounded_step(
    H: Float[np.ndarray, "free free"],
    g: Float[np.ndarray, " free"],
    low: Float[np.ndarray, " free"],
    high: Float[np.ndarray, " free"],
) -> Float[np.ndarray, " free"]:
    """The step that solves H step = g as well as `low` and `high` allow; zero is allowed."""
    least, most = np.minimum(low, 0.0), np.maximum(high, 0.0)
    scale = scale_of(H)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    kept = values > 1e-9 * max(values.max(), 1e-9)
    if not kept.any():
        return np.zeros(len(g))
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = vectors[:, kept].T @ (g / scale) / np.sqrt(values[kept])
    room = (scale * least - 1e-12, scale * most + 1e-12)
    with np.errstate(invalid="ignore"):  # scipy multiplies a step of zero by infinity and drops it
        found = lsq_linear(root, target, room).x
    return np.clip(np.asarray(found) / scale, least, most)


def scale_of(H: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal, one where it vanishes."""
    root = np.sqrt(np.clip(np.diag(H), 0.0, None))
    return np.where(root > 0, root, 1.0)


def scaled(H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations with a unit diagonal."""
    scale = scale_of(H)
    return H / np.outer(scale, scale), g / scale


def summed(normal: Normal) -> Normal:
    """Normal equations with one entry a flight, the sum of its windows."""
    each = [
        {name: getattr(mine, name).sum(axis=0) for name in ("H", "g", "c", "dof", "kind")}
        | {"flight": mine.flight[0], "t": mine.t.min(), "doubtful": mine.doubtful.any()}
        for mine in normal.by_flight()
    ]
    joined = {name: np.stack([one[name] for one in each]) for name in each[0]}
    return dataclasses.replace(normal, **joined)


class Switched:
    """Normal equations, one entry a flight, in which some parameters act only from an onset on.

    Sums over the windows that are left after each are made once, so that trying every onset costs
    as much as there are windows.
    """

    def __init__(self, normal: Normal, columns: list[int]) -> None:
        self._columns, self._whole, self._t, self._left = columns, summed(normal), [], []
        for mine in normal.by_flight():
            mine = mine.of(np.argsort(mine.t, kind="stable"))
            self._t.append(mine.t)
            self._left.append((_left_after(mine.H[:, columns]), _left_after(mine.g[:, columns])))

    def at(self, onset: float) -> Normal:
        """Those of an onset [s]; a window counts from half of its length before on."""
        H, g, columns = self._whole.H.copy(), self._whole.g.copy(), self._columns
        for i, (t, (rows, right)) in enumerate(zip(self._t, self._left, strict=True)):
            first = int(np.searchsorted(t, onset - REPLAY_WINDOW_S / 2))
            H[i, columns], g[i, columns] = rows[first], right[first]
            H[i][:, columns] = rows[first].T
        return dataclasses.replace(self._whole, H=H, g=g)


def muted(normal: Normal, columns: list[int], onset: float) -> Normal:
    """Normal equations in which some parameters act only from an `onset` [s] on, as `Switched`."""
    on = np.ones_like(normal.g)
    on[:, columns] = (normal.t >= onset - REPLAY_WINDOW_S / 2)[:, None]
    H, g = normal.H * on[:, :, None] * on[:, None, :], normal.g * on
    return dataclasses.replace(normal, H=H, g=g)


def _left_after(x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Sums over the first axis of each entry and all that follow, and zero after the last."""
    nothing = np.zeros_like(x[:1])
    return np.concatenate([np.cumsum(x[::-1], axis=0)[::-1], nothing])


def loosened(normal: Normal, spread: Float[np.ndarray, " params"]) -> Normal:
    """Normal equations of flights that each draw parameters of their own around the common ones.

    `spread` is the variance of such a draw in units of the dispersion. Every flight takes the draw
    d that is most likely, at a cost of d' diag(spread)^-1 d; what it takes away from H, g and c
    stands in one more entry a flight, which holds no number (dof 0).
    """
    loose = np.flatnonzero(spread)
    if not len(loose):
        return normal
    added: dict[str, list] = {name: [] for name in ("H", "g", "c", "flight", "t")}
    for mine in normal.by_flight():
        H, g = mine.H.sum(axis=0), mine.g.sum(axis=0)
        stiff = H[np.ix_(loose, loose)] + np.diag(1.0 / spread[loose])
        draw = np.linalg.solve(stiff, np.column_stack([H[loose], g[loose]]))
        added["H"].append(-H[:, loose] @ draw[:, :-1])
        added["g"].append(-H[:, loose] @ draw[:, -1])
        added["c"].append(-g[loose] @ draw[:, -1])
        added["flight"].append(mine.flight[0])
        added["t"].append(mine.t.min())
    n = len(added["c"])
    nothing = {"dof": np.zeros(n), "kind": np.zeros((n, 9)), "doubtful": np.zeros(n, bool)}
    more = {name: np.stack(values) for name, values in added.items()} | nothing
    joined = {name: np.concatenate([getattr(normal, name), x]) for name, x in more.items()}
    return dataclasses.replace(normal, **joined)


def spread_between(
    normal: Normal, allowed: Bool[np.ndarray, " params"], decision: Decision = Decision()
) -> Float[np.ndarray, " params"]:
    """Variance of the parameters that flights draw for themselves, in units of the dispersion.

    One after another, the allowed parameter whose scores differ most between flights is set loose,
    until none differs more than the dispersion of the others gives by chance (`loose_chance`).
    """
    variance, n_flights = np.zeros(normal.H.shape[1]), len(np.unique(normal.flight))
    if n_flights < decision.loose_flights:
        return variance
    limit = chi2.ppf(1.0 - decision.loose_chance, n_flights - 1) / (n_flights - 1)
    phi = dispersion(normal, n_flights)
    while True:
        differ, H = _scores(loosened(normal, variance / phi))
        ratio = np.where(allowed & (variance == 0.0), differ / H.sum(axis=0), 0.0)
        worst = int(np.argmax(ratio))
        gone = variance / phi
        gone[worst] = 1e6 / H[:, worst].mean()
        others = dispersion(loosened(normal, gone), n_flights)
        if ratio[worst] <= limit * others:
            return variance / phi
        phi, variance[worst] = others, (differ / np.sum(H**2, axis=0))[worst]
        for _ in range(ROUNDS):
            for i in np.flatnonzero(variance):
                rest = variance / phi
                rest[i] = 0.0
                differ, H = _scores(loosened(normal, rest))
                beyond = (differ - phi * H.sum(axis=0)) / np.sum(H**2, axis=0)
                variance[i] = max(beyond[i], 1e-3 * variance[i])
            phi = dispersion(loosened(normal, variance / phi), n_flights)


def _scores(normal: Normal) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, "..."]]:
    """Variance of the scores between flights, and H's diagonal in each [flights, params]."""
    each = normal.by_flight()
    H = np.maximum([np.diag(one.H.sum(axis=0)) for one in each], 1e-12)
    g = np.stack([one.g.sum(axis=0) for one in each])
    left = g - H * g.sum(axis=0) / H.sum(axis=0)
    return np.sum(left**2, axis=0) / (1.0 - 1.0 / len(each)), H


def dispersion(normal: Normal, n_flights: int) -> float:
    """Variance of the flights' scores over what independent samples would give, at least 1.

    Computed after the step that the whole library would take, so that an effect which is merely
    missing does not count as dispersion. With fewer than three flights, blocks of time stand in,
    and what flights draw for themselves (`loosened`) belongs to none of them.
    """
    if n_flights < 3:
        normal = normal.of(normal.dof > 0)
    groups = normal.flight if n_flights >= 3 else np.arange(len(normal.t)) * 8 // len(normal.t)
    H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
    seen = np.diag(H) > 1e-9 * np.max(np.diag(H))
    H, g = H[np.ix_(seen, seen)], g[seen]
    values, vectors = np.linalg.eigh(scaled(H, g)[0])
    kept = values > 1e-6
    whiten = (vectors[:, kept] / np.sqrt(values[kept])).T / scale_of(H)
    step = whiten.T @ (whiten @ g)
    scores = []
    for group in np.unique(groups):
        rows = groups == group
        left = (
            normal.g[rows][:, seen].sum(axis=0) - normal.H[rows][:, seen][:, :, seen].sum(0) @ step
        )
        scores.append(whiten @ left)
    n = len(scores)
    return max(1.0, float(np.sum(np.square(scores)) / kept.sum() / (1.0 - 1.0 / n)))
