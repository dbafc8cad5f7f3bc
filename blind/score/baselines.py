r"""Three simple ways to name a cause, on the same logs: what a careful engineer tries first.

Each regresses residuals r of a static model (`dictionary.py`), in units of their noise, on one
signature per effect. What the static model leaves in undisturbed flights (of the nominal simulator,
or of the vehicle before the change) is fitted with the whole dictionary and subtracted first.

- correlation: the effect whose signature alone explains most of r, 1 - |r - X b|^2 / |r|^2
- stlsq: sequentially thresholded least squares with the whole dictionary; every survivor is named,
  the strongest first. Source: Brunton, Proctor and Kutz (2016), PNAS 113 (15), 3932-3937
- everything: least squares with the whole dictionary; the effect with the largest z-score wins

Below a strength that the caller calibrates on undisturbed flights they answer `none`; they have no
way to say `unexplained`, and none to state a probability.
"""

import dataclasses
import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pysindy
from jaxtyping import Float

from blind.score.dictionary import ONSETS, SIGNATURES, gust_from, regression
from diagnosis.logs.flights import FlightSet

Array = np.ndarray

_ALL = range(len(SIGNATURES))

SPARSITY = 0.1
"""RMS below which a signature's part is dropped from a sparse fit, in units of noise."""

EFFECTS = tuple(dict.fromkeys(s.effect for s in SIGNATURES))
"""What a baseline can name."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """What a baseline finds, before it is compared with its threshold."""

    strengths: tuple[tuple[str, float], ...]
    """Effects that it would name, the strongest first, each with its strength."""
    coefficients: Float[Array, " signatures"]
    """Estimated parameters."""
    errors: Float[Array, " signatures"]
    """Their standard errors, as if every row were independent."""
    onset: float
    """Onset of the gust that fitted best, over the duration of a flight [-]."""

    @property
    def strength(self) -> float:
        """Strength of the strongest."""
        return self.strengths[0][1] if self.strengths else 0.0


@dataclasses.dataclass(frozen=True)
class _Problem:
    """Residuals and dictionary in units of noise."""

    residual: Array
    columns: Array

    def fit(self, which: Sequence[int]) -> tuple[Array, Array, float]:
        """Coefficients, their covariance and the squared residual, with some of the columns."""
        x = self.columns[:, list(which)]
        used = np.linalg.norm(x, axis=0) > 1e-9
        b, cov = np.zeros(len(which)), np.full((len(which), len(which)), 0.0)
        inverse = np.linalg.pinv(x[:, used].T @ x[:, used])
        b[used] = inverse @ (x[:, used].T @ self.residual)
        cov[np.ix_(used, used)] = inverse
        rest = float(np.sum((self.residual - x @ b) ** 2))
        return b, cov * rest / max(len(x) - len(which), 1), rest


def correlation(flights: FlightSet, reference: FlightSet) -> Finding:
    """The effect whose signature alone explains most; strength is the share that it explains."""
    onset, problem = _problem(flights, reference)
    total = float(np.sum(problem.residual**2))
    coefficients, errors = np.zeros(len(SIGNATURES)), np.zeros(len(SIGNATURES))
    strengths = []
    for effect in EFFECTS:
        which = _columns(effect)
        b, cov, rest = problem.fit(which)
        coefficients[which], errors[which] = b, np.sqrt(np.diag(cov))
        strengths.append((effect, 1.0 - rest / total))
    best = max(strengths, key=lambda s: s[1])
    return Finding((best,), coefficients, errors, onset)


def stlsq(flights: FlightSet, reference: FlightSet) -> Finding:
    """The effects that survive; strength is the RMS of an effect's part, in units of noise."""
    onset, problem = _problem(flights, reference)
    scale = np.sqrt(np.mean(problem.columns**2, axis=0))
    used = scale > 1e-9
    optimizer = pysindy.STLSQ(threshold=SPARSITY, alpha=1e-6)
    with warnings.catch_warnings():
        # pysindy warns where nothing survives, which is an answer here.
        warnings.filterwarnings("ignore", message="Sparsity parameter is too big")
        optimizer.fit(problem.columns[:, used] / scale[used], problem.residual[:, None])
    scaled = np.zeros(len(SIGNATURES))
    scaled[used] = np.ravel(optimizer.coef_)
    _, cov, _ = problem.fit(_ALL)
    coefficients = np.divide(scaled, scale, out=np.zeros_like(scaled), where=used)
    found = [(e, float(np.linalg.norm(scaled[_columns(e)]))) for e in EFFECTS]
    found = sorted((f for f in found if f[1] > 0), key=lambda f: -f[1])
    return Finding(tuple(found), coefficients, np.sqrt(np.diag(cov)), onset)


def everything(flights: FlightSet, reference: FlightSet) -> Finding:
    """The effect with the largest z-score in a fit of the whole dictionary."""
    onset, problem = _problem(flights, reference)
    b, cov, _ = problem.fit(_ALL)
    errors = np.sqrt(np.diag(cov))
    z = np.divide(np.abs(b), errors, out=np.zeros_like(b), where=errors > 0)
    best = max(((e, float(np.max(z[_columns(e)]))) for e in EFFECTS), key=lambda s: s[1])
    return Finding((best,), b, errors, onset)


BASELINES: dict[str, Callable[[FlightSet, FlightSet], Finding]] = {
    "correlation": correlation,
    "stlsq": stlsq,
    "everything": everything,
}
"""Every baseline by name."""


def threshold(strengths: Sequence[float], alarms: float = 0.02) -> float:
    """The strength that at most a share `alarms` of undisturbed flight sets exceeds.

    Raises:
        ValueError: `strengths` is empty.
    """
    if not strengths:
        raise ValueError("`strengths` must hold at least one undisturbed flight set, got none.")
    return float(np.quantile(strengths, 1.0 - alarms, method="higher"))


def answer(finding: Finding, threshold: float, seconds: float) -> dict[str, Any]:
    """What a finding says, in the form that scores read; `seconds` is a flight's duration."""
    named = [name for name, strength in finding.strengths if strength > threshold]
    effects = [
        {
            "name": name,
            "probability": None,
            "aliases": list(SIGNATURES[_columns(name)[0]].aliases),
            "parameters": _parameters(finding, name, seconds),
        }
        for name in named
    ]
    return {"verdict": "effect" if effects else "none", "effects": effects}


def _parameters(finding: Finding, effect: str, seconds: float) -> dict[str, Any]:
    given = {}
    for i in _columns(effect):
        value, error = float(finding.coefficients[i]), 1.96 * float(finding.errors[i])
        given[SIGNATURES[i].parameter] = _interval(SIGNATURES[i].unit, value, error)
    if effect == "gust":
        half = 0.5 * seconds * float(ONSETS[1] - ONSETS[0])
        given["onset"] = _interval("s", finding.onset * seconds, half)
    return given


def _interval(unit: str, value: float, error: float) -> dict[str, Any]:
    return {"value": value, "low": value - error, "high": value + error, "unit": unit}


def _columns(effect: str) -> list[int]:
    return [i for i, s in enumerate(SIGNATURES) if s.effect == effect]


def _problem(flights: FlightSet, reference: FlightSet) -> tuple[float, _Problem]:
    """The best onset of a gust, and the whitened problem with that onset."""
    flown, nominal = regression(flights), regression(reference)
    usual, _, _ = _Problem(nominal.residual, gust_from(nominal, math.inf)).fit(_ALL)
    left = nominal.residual - nominal.columns @ usual
    scatter = [math.sqrt(float(np.mean(left[nominal.attitude == a] ** 2))) for a in (False, True)]
    unit = np.where(flown.attitude, scatter[1], scatter[0])
    residual = (flown.residual - flown.columns @ usual) / unit
    tried = [_Problem(residual, gust_from(flown, o) / unit[:, None]) for o in ONSETS]
    rests = [problem.fit(_ALL)[2] for problem in tried]
    best = int(np.argmin(rests))
    return float(ONSETS[best]), tried[best]
