"""A remedy is applied, and the vehicle flies again: the drift falls as said, and nothing is left.

What the mended vehicle still has of its fault is the true size less the one that was found.
"""

import numpy as np
import pytest
from flights_for_tests import COMMON, all_but, point_mass_set

from diagnosis.engine import diagnose
from simulators import registry
from simulators.effects.drag import Drag

FAULTS = {
    "trim": {"roll": 0.03, "pitch": -0.02},
    "mass": {"e": 0.1},
    "delay": {"seconds": 0.03},
    "attitude_gain": {"g": -0.1},
    "wind": {"x": 0.4, "y": -0.2, "z": 0.0},
}


def drift(found):
    """Root mean square of how far the simulator is from the drone after half a second [m]."""
    channels = [line for line in found.where if line.channel.startswith("position drift")]
    assert len(channels) == 3
    return float(np.sqrt(sum(line.gap_rms**2 for line in channels)))


def remaining(name, true, found):
    """The effect that is left of a fault after its remedy, both given by parameter."""
    kinds, left = registry.load("effect", name).parameters, {}
    for key, value in true.items():
        info = kinds[key]
        one = 1.0 - info.neutral
        if info.factor:
            left[key] = (value + one) / (found[key] + one) - one
        else:
            left[key] = float(np.clip(value - found[key], info.low, info.high))
    return registry.load("effect", name)(**left)


@pytest.mark.parametrize(
    "beside", [False, pytest.param(True, marks=pytest.mark.exhaustive)], ids=["alone", "beside"]
)
@pytest.mark.parametrize(
    ("name", "exclude"),
    [
        pytest.param("trim", all_but(*COMMON), id="trim-few candidates"),
        *(pytest.param(name, (), id=name, marks=pytest.mark.exhaustive) for name in FAULTS),
    ],
)
def test_after_the_remedy_the_drift_is_as_said_and_the_next_diagnosis_finds_nothing(
    name, exclude, beside
):
    """Beside a reference, drag that the simulator lacks acts before and after the change."""
    own, asked = (), {"simulator": "point_mass", "exclude": exclude, "reference": None}
    if beside:
        own = (Drag(c=0.3),)
        asked["reference"] = point_mass_set(*own, n_flights=8, seed=5)
    fault = registry.load("effect", name)(**FAULTS[name])
    found = diagnose(point_mass_set(fault, *own, n_flights=8 if beside else 4), **asked)
    assert found.verdict == "effect"
    blamed = {effect.name: effect for effect in found.blamed}
    assert set(blamed) == {name}

    sizes = {parameter.name: parameter.value for parameter in blamed[name].parameters}
    left = remaining(name, FAULTS[name], sizes)
    healed = diagnose(point_mass_set(left, *own, seed=2), **asked)
    assert healed.verdict == "none"
    assert drift(found) == pytest.approx(found.shrink.before, rel=0.3)
    assert drift(healed) == pytest.approx(found.shrink.after, rel=0.3)
    assert drift(healed) < 0.6 * drift(found)
