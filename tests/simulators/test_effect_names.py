"""No file names an effect but its own: what others need to know of it stands on its card.

The laboratory `blind` is excepted, whose physics is doubled on purpose, and so are tests, examples
and benchmarks, which set scenes. Docstrings may name effects.
"""

import ast
import dataclasses
import functools
import re
from pathlib import Path

import pytest

from simulators import registry
from simulators.vehicle import AutopilotGains, Vehicle, VehicleSpec

HOUSE = Path(__file__).parents[2]
PACKAGES = ("bench", "diagnosis", "methods", "simulators", "tasks")
OWN = HOUSE / "simulators" / "effects"

KINDS = registry.load_all("effect")
CONSTANTS = {
    f.name for kind in (AutopilotGains, Vehicle, VehicleSpec) for f in dataclasses.fields(kind)
}
"""Constants of the plant and of its controller, which are no effects."""
OTHER_MEANINGS = {
    "battery": "the column of the logs",
    "collision": "the penalty of a task, and the radius that it goes by",
    "floor": "the smallest value of anything; rounding down",
    "trim_blocks": "an option of jinja",
}
"""Identifiers with another meaning."""
PLAIN = {*CONSTANTS, *OTHER_MEANINGS}
"""Words that say something else in a text, too: only a text that is nothing but the word counts."""

LOG_COLUMN = {"battery": "a column of the logs"}
BELIEVED_MASS = {"mass": "a key of vehicle.toml"}
IMPORTING = ("ardupilot", "bags", "convert", "crazyflie", "reader", "resample", "tables", "ulog")
"""Readers of logs whose format has that column."""
ALLOWED = {
    "diagnosis/fit/gap.py": LOG_COLUMN,
    "diagnosis/fit/windows.py": LOG_COLUMN,
    **{f"diagnosis/importing/{name}.py": LOG_COLUMN for name in IMPORTING},
    "diagnosis/logs/airframes.py": dict.fromkeys(
        ("attitude_lag", "drag", "inertia"), "keys of the table [airframe] in vehicle.toml"
    ),
    "diagnosis/logs/columns.py": LOG_COLUMN,
    "diagnosis/logs/flights.py": LOG_COLUMN,
    "diagnosis/logs/units.py": LOG_COLUMN,
    "diagnosis/logs/vehicle_file.py": BELIEVED_MASS
    | dict.fromkeys(
        ("attitude_lag", "drag", "inertia"), "keys of the table [airframe] in vehicle.toml"
    ),
    "simulators/rotorpy_vehicle.py": {"mass": "a key of RotorPy's airframe file"},
    "methods/calibration/identification.py": {
        "delay": "half a step of it makes up for the integrator",
        "floor": "it is no candidate of a diagnosis; this method looks for it by itself",
        "rotor_drag": "a point mass cannot tell it from the thrust's response",
    },
    "diagnosis/decision.py": dict.fromkeys(
        ("downwash", "gust"), "the evidence of a threshold names the cases that it comes from"
    ),
    "bench/diagnosis_report/gap_text.py": dict.fromkeys(
        ("attitude_lag", "drag"), "keys of [airframe] in vehicle.toml"
    ),
    "diagnosis/replay/believed.py": {"attitude_lag": "a key of [airframe] in vehicle.toml"},
    "methods/domain_randomization.py": dict.fromkeys(
        ("delay", "drag", "thrust_gain", "thrust_lag"), "the method is to draw these four"
    ),
    "methods/grey_box.py": {"delay": "its setting draws a longer one than was identified"},
    "methods/training/varied.py": {
        "delay": "it is the one time that may be drawn from 0 on",
        "wind": "a steady push stands for all forces that nobody identified",
    },
}
"""Why a file may name effects."""


def snake(identifier):
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", identifier).lower()


@functools.cache
def parts_of(identifier):
    """Effects that an identifier names."""
    words = snake(identifier)
    if words in PLAIN:
        return set()
    return {n for n in KINDS if re.search(rf"(^|_){n}(_|$)", words)} - PLAIN


def names_in(source):
    """Effects that a module names: in identifiers, in texts, or by importing them."""
    tree = ast.parse(source)
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    modules = {kind.__module__: name for name, kind in KINDS.items()}
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            imported = [getattr(node, "module", None), *(alias.name for alias in node.names)]
            found |= {modules[name] for name in imported if name in modules}
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = "" if id(node) in docstrings else node.value
            said = KINDS.keys() & {*re.findall(r"\w+", text)}
            found |= {name for name in said if name not in PLAIN or name == text}
        for field in ("id", "attr", "arg", "name"):
            identifier = getattr(node, field, None)
            if isinstance(identifier, str):
                found |= parts_of(identifier)
    return found


@pytest.mark.parametrize("package", PACKAGES)
def test_no_file_names_an_effect_but_its_own(package):
    files = [path for path in (HOUSE / package).rglob("*.py") if OWN not in path.parents]
    assert files
    wrong = []
    for path in files:
        where = path.relative_to(HOUSE).as_posix()
        named = names_in(path.read_text(encoding="utf-8"))
        allowed = ALLOWED.get(where, {}).keys()
        wrong += [f"{where} names {name}" for name in sorted(named - allowed)]
        wrong += [f"{where} need not be allowed {name}" for name in sorted(allowed - named)]
    assert not wrong


def test_every_effect_stands_in_a_file_of_its_name():
    assert {path.stem for path in OWN.glob("*.py")} == {
        *KINDS,
        *("__init__", "card", "chain", "contract", "late"),
    }


def test_a_family_has_members():
    """A family of one is a word that was misspelt."""
    families = [family for kind in KINDS.values() for family in kind.card.families]
    assert families
    assert all(families.count(family) > 1 for family in families)


def test_every_door_of_a_simulator_can_be_proven_by_one_effect():
    probes = [kind.card.probe for kind in KINDS.values() if kind.card.probe]
    doors = {door for kind in registry.load_all("simulator").values() for door in kind.doors}
    assert sorted(probe.door for probe in probes) == sorted(doors)
