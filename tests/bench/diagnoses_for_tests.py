"""Diagnoses as the engine reports them, of every kind that a user may meet."""

import copy
import math

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


def channel(name, unit, gap, floor, share):
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
    }


def parameter(value, low, high, unit):
    return {"value": value, "low": low, "high": high, "unit": unit}


def candidate(effects, probability, evidence, shrink):
    return {
        "effects": effects,
        "probability": probability,
        "evidence": evidence,
        "shrink_percent": shrink,
    }


def details():
    """Data for every picture, of flights that are called what a page must survive."""
    seconds = [0.1 * i for i in range(100) if not 40 < i < 60]
    return {
        "flights_seconds": {HOSTILE: 10.0, "figure8_02": 9.7},
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
        "chi2_per_dof": {"before": 21.3, "after": 1.08},
        "noise": {"position x": 0.00031, "velocity z": 0.012, "attitude roll": None},
        "set_aside": [
            {"flight": HOSTILE, "t": 4.5, "misfit": 80.0, "after_gap": False},
            {"flight": HOSTILE, "t": 7.0, "misfit": 6.0, "after_gap": True},
        ],
        "where_left": [channel("velocity drift z", "m/s", 0.02, 0.014, 0.7)],
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
    return {
        "schema": 1,
        "simulator": "crazyflow",
        "drone": "cf21B_500",
        "flights": {
            "n": 12,
            "seconds": 118.4,
            "fit": [f"circle_{i:02d}" for i in range(10)],
            "held_out": [HOSTILE, "figure8_02"],
            "left_out": [{"name": "bad|one", "reason": "column `pos_x`, row 12: NaN"}],
        },
        "where": [channel(*line) for line in CHANNELS],
        "verdict": "effect",
        "unexplained_share": 0.01,
        "effects": [
            {
                "name": "mass",
                "probability": 0.983,
                "aliases": [],
                "parameters": {"e": parameter(0.1203, 0.1121, 0.1274, "-")},
            }
        ],
        "candidates": [
            candidate(["mass"], 0.983, 212.4, 82.1),
            candidate(["mass", "drag"], 0.011, 211.0, 82.4),
            candidate(["thrust_gain"], 0.004, 171.9, 74.0),
            candidate([], 0.0, 0.0, 0.0),
            candidate(["attitude_lag"], 0.0, -3.2, None),
        ],
        "shrink": {
            "horizon_s": 0.5,
            "before": 0.0341,
            "after": 0.0061,
            "unit": "m",
            "percent": 82.1,
            "low": 78.9,
            "high": 84.6,
            "n": 12,
            "by_channel": {
                "position drift x": {"before": 0.0042, "after": 0.004, "percent": 4.8, "unit": "m"},
                "position drift z": {"before": 0.033, "after": 0.005, "percent": 84.8, "unit": "m"},
            },
        },
        "next_flight": "Nothing more is needed for this answer.",
        "details": details(),
    }


def pair():
    """Wind and a delay, with a share that stays unexplained and a hostile drone."""
    found = effect()
    found["drone"] = HOSTILE
    found["unexplained_share"] = 0.12
    wind = {
        "x": parameter(-0.771, -0.802, -0.741, "m/s^2"),
        "y": parameter(0.211, 0.188, 0.234, "m/s^2"),
    }
    found["effects"] = [
        {"name": "wind", "probability": 0.97, "aliases": [], "parameters": wind},
        {
            "name": "delay",
            "probability": 0.93,
            "aliases": [],
            "parameters": {"seconds": parameter(0.0481, 0.0455, 0.0508, "s")},
        },
    ]
    found["candidates"] = [
        candidate(["delay", "wind"], 0.91, 340.2, 71.0),
        candidate(["wind"], 0.06, 290.0, 55.0),
    ]
    return found


def none():
    """Nothing beyond noise."""
    found = effect()
    found["where"] = [channel(n, u, floor * 1.01, floor, 0.125) for n, u, _, floor, _ in CHANNELS]
    found |= {"verdict": "none", "unexplained_share": None, "effects": []}
    found["candidates"] = [candidate([], 0.94, 0.0, 0.0), candidate(["mass"], 0.02, 0.4, 1.0)]
    found["shrink"] = {"horizon_s": 0.5, "before": None, "after": None, "reason": "no effect"}
    found["next_flight"] = "Faster turns, to see drag."
    found["details"]["before_after"] = []
    return found


def unexplained():
    """A gap that nothing in the library explains, from a certain moment on."""
    found = effect()
    found["where"][2]["onset_s"] = 4.2
    found |= {"verdict": "unexplained", "unexplained_share": 0.83, "effects": []}
    found["candidates"] = [
        candidate(["gust"], 0.4, 80.0, 12.0),
        candidate(["wind"], 0.3, 75.0, 9.0),
    ]
    found["candidates"].append(candidate([], 0.1, 0.0, 0.0))
    found["shrink"] = {"horizon_s": 0.5, "before": None, "after": None, "reason": "no effect"}
    return found


def confirmed():
    """Unexplained, but one effect of the likeliest set helps on flights that were left out."""
    found = unexplained()
    found["candidates"] = [candidate(["mass", "wind"], 0.8, 90.0, 80.0)]
    found["shrink"] = effect()["shrink"]
    found["details"]["support"] = [
        {"effect": "mass", "percent": 91.2, "low": 89.7, "high": 92.4, "n": 12, "clear": True},
        {"effect": "wind", "percent": 0.8, "low": -1.1, "high": 2.6, "n": 12, "clear": False},
    ]
    return found


def reference():
    """Less thrust than before, given reference flights; too few flights for an interval."""
    found = effect()
    found["effects"] = [
        {
            "name": "thrust_gain",
            "probability": 0.999,
            "aliases": [],
            "parameters": {"e": parameter(-0.081, -0.09, -0.072, "-")},
        }
    ]
    found["candidates"] = [candidate(["thrust_gain"], 0.999, 99.0, None)]
    reason = "2 flights; an interval needs at least 3."
    found["shrink"] = {"horizon_s": 0.5, "before": None, "after": None, "percent": None}
    found["shrink"]["reason"] = reason
    none = dict.fromkeys(("percent", "low", "high"))
    found["details"]["support"] = [{"effect": "thrust_gain", **none, "n": 2, "clear": False}]
    found["details"]["shared"] = [
        {"name": "drag", "parameter": "c", "value": -0.11, "unit": "1/s"},
        {"name": "trim", "parameter": "roll", "value": 0.0145, "unit": "rad"},
    ]
    return found


def alias():
    """Mass or thrust gain: these flights cannot tell."""
    found = effect()
    found["effects"][0] |= {"aliases": ["thrust_gain", ["drag", "battery"]], "probability": 0.52}
    found["candidates"][0]["probability"] = 0.52
    found["next_flight"] = "Fly a vertical ramp at 3 m/s: mass and thrust gain part in drag."
    return found


def empty():
    """The least that schema 1 allows: no details, no candidates, nothing by regime."""
    found = copy.deepcopy(none())
    for line in found["where"]:
        line["regimes"] = []
        line["share"] = line["low"] = line["high"] = None
    found["flights"] = {"n": 1, "seconds": 5.8, "fit": ["one"], "held_out": [], "left_out": []}
    found["shrink"] = {"horizon_s": 0.5, "before": None, "after": None, "percent": None}
    found |= {"candidates": [], "next_flight": None}
    del found["details"]
    return found


ALL = {f.__name__: f for f in (effect, pair, none, unexplained, confirmed, reference, alias, empty)}
