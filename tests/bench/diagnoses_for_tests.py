"""Diagnoses as the engine reports them, of every kind that a user may meet.

Each function gives the JSON object; `load` makes the `Diagnosis`.
"""

import math

from diagnosis.result import Diagnosis

HOSTILE = "<script>alert(1)</script>"
CHANNELS = [
    ("specific force x", "m/s^2", 0.21, 0.15, 0.04),
    ("specific force y", "m/s^2", 0.2, 0.15, 0.03),
    ("specific force z", "m/s^2", 1.32, 0.16, 0.61),
    ("attitude roll", "rad", 0.0034, 0.0031, 0.01),
    ("attitude pitch", "rad", 0.0029, 0.0031, 0.0),
    ("position drift x", "m", 0.0042, 0.0031, 0.02),
    ("position drift z", "m", 0.033, 0.003, 0.17),
    ("velocity drift z", "m/s", 0.13, 0.014, 0.12),
]
REGIMES = [
    ("speed", "m/s", [0.0, 0.3, 0.6, 0.9, 1.2], [1.2, 1.25, 1.31, 1.4]),
    ("tilt", "rad", [0.0, 0.05, 0.1, 0.2, 0.35], [1.3, 1.29, 1.31, None]),
    ("thrust", "N", [0.3, 0.38, 0.42, 0.46, 0.55], [1.1, 1.25, 1.33, 1.5]),
    ("battery", "V", [3.7, 3.9], [1.3]),
]


def load(content):
    """The diagnosis of a JSON object."""
    return Diagnosis.of_json(content)


def channel(name, unit, gap, floor, share, main=False):
    """One line of `where`, with the regimes in proportion to the gap."""
    return {
        "channel": name,
        "unit": unit,
        "gap_rms": gap,
        "noise_floor": floor,
        "share": share,
        "low": 0.9 * gap,
        "high": 1.12 * gap,
        "regimes": [
            {
                "variable": variable,
                "unit": regime_unit,
                "edges": edges,
                "gap": [g and g * gap / 1.32 for g in values],
            }
            for variable, regime_unit, edges, values in REGIMES
        ],
        "onset_s": None,
        "beyond_noise": 0.9 * gap > floor,
        "main": main,
    }


def parameter(name, value, low, high, unit, use="measured"):
    size = {"name": name, "value": value, "low": low, "high": high, "unit": unit}
    return size | {"at_bound": "no", "use": use}


def named(name, probability, *parameters, blamed=True):
    kept = {"name": name, "blamed": blamed, "probability": probability}
    return kept | {"aliases": [], "parameters": list(parameters)}


def candidate(effects, posterior, evidence, shrink, chosen=False):
    return {
        "effects": effects,
        "posterior": posterior,
        "evidence": evidence,
        "shrink_percent": shrink,
        "named": chosen,
    }


def support(effect, percent, low, high, n, confirmed):
    ends = {"percent": percent, "low": low, "high": high}
    return {"effect": effect, **ends, "n": n, "confirmed": confirmed}


def used(name, use, seconds=None):
    return {"name": name, "seconds": seconds, "use": use, "digest": None}


def unknown_shrink(reason):
    empty = dict.fromkeys(("before", "after", "percent", "low", "high", "how"))
    return {"horizon_s": 0.5, "n": 0, **empty, "by_channel": [], "reason": reason}


def details():
    """Data for every picture, of flights that are called what a page must survive."""
    seconds = [0.1 * i for i in range(100) if not 40 < i < 60]
    return {
        "before_after": [
            {
                "flight": name,
                "t": seconds,
                "before": [0.034 + 0.008 * math.sin(t + i) for t in seconds],
                "after": [0.006 + 0.002 * math.cos(3 * t + i) for t in seconds],
            }
            for i, name in enumerate([HOSTILE, "figure8_02"])
        ],
        "gap_in_time": [
            {
                "channel": "specific force z",
                "unit": "m/s^2",
                "t": list(range(10)),
                "gap": [0.2, 0.18, 0.21, 0.2, 0.9, 1.3, 1.32, 1.3, 1.28, None],
                "low": [0.15, 0.13, 0.16, 0.15, 0.6, 1.1, 1.1, 1.1, 1.1, None],
                "high": [0.25, 0.23, 0.26, 0.25, 1.2, 1.5, 1.5, 1.5, 1.5, None],
            }
        ],
        "followed": [],
        "misfit": {"before": 21.3, "after": 1.08},
        "dispersion": 1.2,
        "windows": None,
        "noise": [
            {"channel": "position x", "sigma": 0.00031, "unit": "m"},
            {"channel": "velocity z", "sigma": 0.012, "unit": "m/s"},
            {"channel": "attitude roll", "sigma": None, "unit": "rad"},
        ],
        "set_aside": [
            {"flight": HOSTILE, "t": 4.5, "misfit": 80.0, "after_gap": False},
            {"flight": HOSTILE, "t": 7.0, "misfit": 6.0, "after_gap": True},
        ],
        "not_observable": [{"effect": "downwash", "why": "one drone flew alone"}],
        "limits": [
            {"effect": "mass", "parameter": "e", "unit": "-", "smallest": 0.011},
            {"effect": "attitude_lag", "parameter": "tau", "unit": "s", "smallest": 0.0042},
            {"effect": "drag", "parameter": "c", "unit": "1/s", "smallest": None},
        ],
        "shared": [],
    }


def effect():
    """More mass, found with confidence."""
    fitted = [used(f"circle_{i:02d}", "fit", 9.87) for i in range(10)]
    held_out = [used(HOSTILE, "held out", 10.0), used("figure8_02", "held out", 9.7)]
    return {
        "schema": 2,
        "verdict": "effect",
        "probability": 0.983,
        "effects": [named("mass", 0.983, parameter("e", 0.1203, 0.1121, 0.1274, "-"))],
        "remainder": {
            "share": 0.01,
            "noteworthy": False,
            "mostly_explained": True,
            "structure_before": 5000.0,
            "structure": 1.02,
            "where": [channel("velocity drift z", "m/s", 0.02, 0.014, 0.7, main=True)],
        },
        "doubt": None,
        "where": [channel(*line, main=line[0] == "specific force z") for line in CHANNELS],
        "candidates": [
            candidate(["mass"], 0.983, 212.4, 82.1, chosen=True),
            candidate(["mass", "drag"], 0.011, 211.0, 82.4),
            candidate(["thrust_gain"], 0.004, 171.9, 74.0),
            candidate([], 0.0, 0.0, 0.0),
            candidate(["attitude_lag"], 0.0, -3.2, None),
        ],
        "support": [],
        "shrink": {
            "horizon_s": 0.5,
            "n": 12,
            "before": 0.0341,
            "after": 0.0061,
            "percent": 82.1,
            "low": 78.9,
            "high": 84.6,
            "by_channel": [
                {"channel": name, "before": before, "after": after, "percent": less, "unit": "m"}
                for name, before, after, less in (
                    ("position drift x", 0.0042, 0.004, 4.8),
                    ("position drift z", 0.033, 0.005, 84.8),
                )
            ],
            "how": "flights held out",
            "reason": None,
        },
        "next_flight": "Nothing more is needed for this answer.",
        "flights": {
            "name": HOSTILE,
            "drone": "cf21B_500",
            "airframe": None,
            "mass": 0.0434,
            "driven_by": "commands",
            "used": fitted + held_out,
            "left_out": [{"name": "bad|one", "reason": "column `pos_x`, row 12: NaN"}],
        },
        "reference": None,
        "settings": {"simulator": "crazyflow", "exclude": [], "withheld": [], "decision": None},
        "program": {"version": "0.1.0", "digest": "f" * 64},
        "details": details(),
        "interface": [],
    }


def pair():
    """Wind and a delay, with a share that stays unexplained and a hostile drone."""
    found = effect()
    found["flights"]["drone"] = HOSTILE
    found["remainder"] |= {"share": 0.12, "noteworthy": True}
    x = parameter("x", -0.771, -0.802, -0.741, "m/s^2")
    y = parameter("y", 0.211, 0.188, 0.234, "m/s^2")
    delay = parameter("seconds", 0.0481, 0.0455, 0.0508, "s")
    found["effects"] = [named("wind", 0.97, x, y), named("delay", 0.93, delay)]
    found["probability"] = 0.91
    found["candidates"] = [
        candidate(["delay", "wind"], 0.91, 340.2, 71.0, chosen=True),
        candidate(["wind"], 0.06, 290.0, 55.0),
    ]
    return found


def none():
    """Nothing beyond noise."""
    found = effect()
    found["where"] = [channel(n, u, floor * 1.01, floor, 0.125) for n, u, _, floor, _ in CHANNELS]
    found |= {"verdict": "none", "probability": 0.94, "effects": []}
    found["remainder"]["share"] = 0.0
    found["candidates"] = [
        candidate([], 0.94, 0.0, 0.0, chosen=True),
        candidate(["mass"], 0.02, 0.4, 1.0),
    ]
    found["shrink"] = unknown_shrink("no effect")
    found["next_flight"] = "Faster turns, to see drag."
    found["details"]["before_after"] = []
    return found


def unexplained():
    """A gap that nothing in the library explains, from a certain moment on."""
    found = effect()
    found["where"][2]["onset_s"] = 4.2
    onset = parameter("onset", 4.1, None, None, "s", "descriptive")
    gust = named("gust", None, onset, blamed=False)
    found |= {"verdict": "unexplained", "probability": None, "effects": [gust]}
    found["remainder"] |= {"share": 0.83, "noteworthy": True, "mostly_explained": False}
    found["candidates"] = [
        candidate(["gust"], 0.4, 80.0, 12.0),
        candidate(["wind"], 0.3, 75.0, 9.0),
        candidate([], 0.1, 0.0, 0.0),
    ]
    found["shrink"] = unknown_shrink("no effect")
    return found


def partly():
    """One effect of the likeliest set helps on flights that were left out; much is left."""
    found = unexplained() | {"verdict": "partly"}
    e = parameter("e", 0.1203, 0.1121, 0.1274, "-", "descriptive")
    x = parameter("x", 0.02, -0.1, 0.1, "m/s^2", "descriptive")
    found["effects"] = [named("mass", None, e), named("wind", None, x, blamed=False)]
    found["candidates"] = [candidate(["mass", "wind"], 0.8, 90.0, 80.0)]
    found["shrink"] = effect()["shrink"]
    found["support"] = [
        support("mass", 91.2, 89.7, 92.4, 12, True),
        support("wind", 0.8, -1.1, 2.6, 12, False),
    ]
    return found


def reference():
    """Less thrust than before, given reference flights; too few flights for an interval."""
    found = effect()
    less = parameter("e", -0.081, -0.09, -0.072, "-")
    found["effects"] = [named("thrust_gain", 0.999, less)]
    found["probability"] = 0.999
    found["candidates"] = [candidate(["thrust_gain"], 0.999, 99.0, None, chosen=True)]
    found["shrink"] = unknown_shrink("2 flights; an interval needs at least 3.")
    found["flights"]["name"] = "changed"
    found["reference"] = found["flights"] | {"name": "plain", "left_out": []}
    found["support"] = [support("thrust_gain", None, None, None, 2, None)]
    found["details"]["shared"] = [
        {"effect": "drag", "parameter": "c", "value": -0.11, "unit": "1/s"},
        {"effect": "trim", "parameter": "roll", "value": 0.0145, "unit": "rad"},
    ]
    return found


def alias():
    """Mass or thrust gain: these flights cannot tell."""
    found = effect()
    found["effects"][0] |= {"aliases": ["thrust_gain", "battery"], "probability": 0.52}
    found["probability"] = found["candidates"][0]["posterior"] = 0.52
    found["next_flight"] = "Fly a vertical ramp at 3 m/s: mass and thrust gain part in drag."
    return found


def empty():
    """The least that is allowed: no details, no candidates, nothing by regime."""
    found = none()
    unknown = dict.fromkeys(("share", "structure_before", "structure"))
    return found | {
        "probability": None,
        "remainder": {**unknown, "noteworthy": False, "mostly_explained": False, "where": []},
        "where": [line | {"regimes": [], "share": 0.0} for line in found["where"]],
        "candidates": [],
        "shrink": unknown_shrink(None),
        "next_flight": None,
        "flights": found["flights"]
        | {"name": None, "mass": None, "used": [used("one", "fit")], "left_out": []},
        "program": dict.fromkeys(("version", "digest")),
        "details": {key: [] for key, of in details().items() if isinstance(of, list)}
        | {"misfit": dict.fromkeys(("before", "after")), "dispersion": None, "windows": None},
    }


ALL = {f.__name__: f for f in (effect, pair, none, unexplained, partly, reference, alias, empty)}


def beside_twin(found):
    """The same diagnosis as a twin of the reference flights gives it."""
    lines = [{"channel": "roll", "unit": "rad", "simulator": 0.0333, "twin": 0.0078}]
    found["details"]["followed"] = lines
    found["shrink"] = effect()["shrink"]
    found["reference"] = found["flights"] | {"name": "plain", "left_out": []}
    return found
