"""A diagnosis of schema 1 as one of schema 2; what schema 1 lacked is null or `unknown`."""

from collections.abc import Mapping, Sequence
from typing import Any

from diagnosis.logs.noise import CHANNELS, UNITS
from diagnosis.statements import (
    answer_probability,
    beyond_noise,
    judged_of,
    main_channels,
    mostly_explained,
    noteworthy,
    verdict_of,
)

Json = Mapping[str, Any]


def upgraded(old: Json) -> dict[str, Any]:
    """The JSON object of schema 2 for one of schema 1.

    Effects that were not blamed had no sizes there, and are named without any.
    """
    details = old.get("details") or {}
    support = [_support(line) for line in details.get("support") or ()]
    confirmed = {line["effect"] for line in support if line["confirmed"]}
    verdict = verdict_of(old["verdict"], bool(confirmed))
    chosen = sorted(effect["name"] for effect in old["effects"])
    candidates = [_candidate(c, verdict, chosen) for c in old.get("candidates") or ()]
    structure, share = details.get("structure") or {}, old.get("unexplained_share")
    best = details.get("best_set") or sorted(line["effect"] for line in support)
    unnamed = [] if verdict == "effect" else [_unnamed(name, confirmed) for name in best]
    posterior = next((c["posterior"] for c in candidates if c["named"]), None)
    stated = [effect.get("probability") for effect in old["effects"]]
    named = judged_of(verdict) != "unexplained"
    return {
        "schema": 2,
        "verdict": verdict,
        "probability": answer_probability(posterior, stated) if named else None,
        "effects": [_effect(effect) for effect in old["effects"]] + unnamed,
        "remainder": {
            "share": share,
            "noteworthy": noteworthy(share),
            "mostly_explained": mostly_explained(share),
            "structure_before": structure.get("before"),
            "structure": structure.get("after"),
            "where": _where(details.get("where_left") or ()),
        },
        "doubt": None,
        "where": _where(old["where"]),
        "candidates": candidates,
        "support": support,
        "shrink": _shrink(old["shrink"]),
        "next_flight": old.get("next_flight"),
        "flights": _flights(old, details),
        "reference": _reference(details),
        "settings": {
            "simulator": old["simulator"],
            "exclude": details.get("excluded") or [],
            "withheld": details.get("excluded") or [],
            "decision": None,
        },
        "program": {"version": None, "digest": None},
        "details": _details(details),
    }


def _effect(old: Json) -> dict[str, Any]:
    unknown = {"at_bound": "unknown", "use": "unknown"}
    parameters = [{"name": n} | dict(p) | unknown for n, p in old["parameters"].items()]
    return dict(old) | {"blamed": True, "parameters": parameters}


def _unnamed(name: str, confirmed: set[str]) -> dict[str, Any]:
    """An effect of the likeliest set that schema 1 did not blame."""
    blamed = name in confirmed
    empty = {"probability": None, "aliases": [], "parameters": []}
    return {"name": name, "blamed": blamed, **empty}


def _candidate(old: Json, verdict: str, chosen: list[str]) -> dict[str, Any]:
    return {
        "effects": old["effects"],
        "posterior": old["probability"],
        "evidence": old.get("evidence"),
        "shrink_percent": old.get("shrink_percent"),
        "named": judged_of(verdict) != "unexplained" and sorted(old["effects"]) == chosen,
    }


def _support(old: Json) -> dict[str, Any]:
    kept = {key: old[key] for key in ("effect", "percent", "low", "high", "n")}
    return kept | {"confirmed": None if old["percent"] is None else old["clear"]}


def _where(lines: Sequence[Json]) -> list[dict[str, Any]]:
    main = main_channels([line["share"] for line in lines])
    return [
        dict(line)
        | {
            "beyond_noise": beyond_noise(line["gap_rms"], line["low"], line["noise_floor"]),
            "main": is_main,
        }
        for line, is_main in zip(lines, main, strict=True)
    ]


def _shrink(old: Json) -> dict[str, Any]:
    numbers = ("before", "after", "percent", "low", "high", "how", "reason")
    channels = old.get("by_channel") or {}
    return {key: old.get(key) for key in numbers} | {
        "horizon_s": old["horizon_s"],
        "n": old.get("n", 0),
        "by_channel": [{"channel": name} | dict(line) for name, line in channels.items()],
    }


def _flights(old: Json, details: Json) -> dict[str, Any]:
    flights, seconds = old["flights"], details.get("flights_seconds") or {}
    fit, held = flights["fit"], flights["held_out"]
    uses = {(True, True): "fit, and held out in turn", (True, False): "fit"}
    used = [
        {
            "name": name,
            "seconds": seconds.get(name),
            "use": uses.get((name in fit, name in held), "held out"),
            "digest": None,
        }
        for name in dict.fromkeys([*fit, *held])
    ]
    return {
        "name": None,
        "drone": old["drone"],
        "mass": None,
        "driven_by": flights.get("input", "unknown"),
        "used": used,
        "left_out": flights.get("left_out") or [],
    }


def _reference(details: Json) -> dict[str, Any] | None:
    if details.get("reference") is None:
        return None
    unknown = {"drone": "unknown", "mass": None, "driven_by": "unknown"}
    return {"name": details["reference"], **unknown, "used": [], "left_out": []}


def _details(old: Json) -> dict[str, Any]:
    units, noise = dict(zip(CHANNELS, UNITS, strict=True)), old.get("noise") or {}
    fit = old.get("chi2_per_dof") or {}
    shared = [
        {"effect": line["name"]} | {key: line[key] for key in ("parameter", "value", "unit")}
        for line in old.get("shared") or ()
    ]
    lists = ("set_aside", "limits", "not_observable", "before_after", "gap_in_time")
    return {key: old.get(key) or [] for key in lists} | {
        "misfit": {"before": fit.get("before"), "after": fit.get("after")},
        "dispersion": old.get("dispersion"),
        "noise": [{"channel": n, "sigma": x, "unit": units[n]} for n, x in noise.items()],
        "windows": old.get("windows"),
        "shared": shared,
    }
