"""What of a diagnosis the scores compare: one form for all answers."""

from collections.abc import Iterable, Mapping
from typing import Any

from diagnosis.result import Diagnosis, Effect

REFUSED = "exit status 2"
"""How the cause of a diagnosis begins that refused its logs (`blind.run.one`)."""


def scored_form(content: Mapping[str, Any]) -> Mapping[str, Any]:
    """An answer as the scores read it.

    Its effects are those that it blames. `partly` abstains, as `unexplained` does, because it says
    that something else acts; what it blames counts all the same.

    Raises:
        ValueError: The content is of no known schema, or not what its schema says.
    """
    found = Diagnosis.of_json(content)
    remainder, shrink = found.remainder, found.shrink
    return {
        "verdict": found.verdict,
        "effects": [_effect(effect) for effect in found.blamed],
        "candidates": [
            {"effects": list(c.effects), "probability": c.posterior, "evidence": c.evidence}
            for c in found.candidates
        ],
        "unexplained_share": remainder.share,
        "shrink": {"percent": shrink.percent, "low": shrink.low, "high": shrink.high},
        "structure": remainder.structure,
        "dispersion": found.details.dispersion,
    }


def beside_truth(
    own: Mapping[str, Any],
    blamed: Iterable[Effect],
    truths: Mapping[str, Mapping[str, float]],
) -> list[dict[str, Any]]:
    """Numbers of blamed effects whose `truths` are known, beside them; a row begins with `own`."""
    rows = []
    for effect in blamed:
        truth = truths.get(effect.name, {})
        for given in effect.parameters:
            if given.name in truth:
                true, low, high = truth[given.name], given.low, given.high
                row = {**own, "effect": effect.name, "parameter": given.name, "true": true}
                row |= {key: getattr(given, key) for key in ("value", "low", "high", "use")}
                inside = low is not None and high is not None and low <= true <= high
                rows.append(row | {"inside": inside})
    return rows


def _effect(effect: Effect) -> dict[str, Any]:
    sizes = {
        p.name: {"value": p.value, "unit": p.unit}
        # An interval that is marked as descriptive is not meant to hold the truth.
        | {end: None if p.use == "descriptive" else getattr(p, end) for end in ("low", "high")}
        for p in effect.parameters
    }
    return {
        "name": effect.name,
        "probability": effect.probability,
        "aliases": list(effect.aliases),
        "parameters": sizes,
    }
