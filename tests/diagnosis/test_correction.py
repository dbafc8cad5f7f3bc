"""The simulator that a diagnosis makes; `test_diagnose.py` flies one beside the truth."""

import dataclasses

import diagnoses_for_tests as made
import pytest
from flights_for_tests import sizes

import diagnosis
from bench.diagnosis_report.sentences import remarks
from diagnosis.result_parts import SharedParameter
from simulators.crazyflow import Crazyflow
from simulators.effects.mass import Mass


def effect():
    """A diagnosis of a heavier drone in crazyflow."""
    return made.load(made.effect())


def test_the_simulator_airframe_and_mass_are_those_of_the_flights():
    found = effect()
    simulator = diagnosis.corrected(found)
    assert isinstance(simulator, Crazyflow)
    assert simulator.spec.name == found.flights.drone
    assert simulator.spec.mass == found.flights.mass
    e = found.effects[0].parameter("e").value
    assert sizes(simulator)["Mass"]["e"] == pytest.approx(e)


def test_sizes_act_on_top_of_what_reference_flights_show():
    """A mass factor multiplies: 10 % on top of 20 % are 32 %; a wind adds."""
    found, (mass, *_) = effect(), effect().effects
    mass = dataclasses.replace(
        mass, parameters=(dataclasses.replace(mass.parameter("e"), value=0.1),)
    )
    shared = tuple(
        SharedParameter(effect=name, parameter=parameter, value=value, unit="")
        for name, parameter, value in (("mass", "e", 0.2), ("wind", "x", 0.3))
    )
    details = dataclasses.replace(found.details, shared=shared)
    simulator = diagnosis.corrected(dataclasses.replace(found, effects=(mass,), details=details))
    assert Mass.parameters["e"].factor
    assert sizes(simulator)["Mass"]["e"] == pytest.approx(0.32)
    assert sizes(simulator)["Wind"]["x"] == pytest.approx(0.3)


def test_a_size_beyond_its_range_acts_as_far_as_it_may():
    """A twin finds commands earlier than before; no simulator acts before it is told."""
    found, (mass, *_) = effect(), effect().effects
    early = dataclasses.replace(mass.parameter("e"), name="seconds", value=-0.02, at_bound="low")
    delay = dataclasses.replace(mass, name="delay", parameters=(early,))
    simulator = diagnosis.corrected(dataclasses.replace(found, effects=(delay,)))
    assert sizes(simulator)["Delay"]["seconds"] == 0.0
    said = remarks(dataclasses.replace(found, effects=(delay,)))
    assert any(line.startswith("Beyond its allowed range") and "-20 ms" in line for line in said)


def test_without_a_cause_the_simulator_stays_as_it_was():
    assert diagnosis.corrected(made.load(made.none())).effects == ()


def test_an_unexplained_gap_is_corrected_only_on_request():
    found = made.load(made.unexplained())
    with pytest.raises(ValueError, match="'unexplained': no effect is confirmed"):
        diagnosis.corrected(found)
    assert len(diagnosis.corrected(found, likeliest=True).effects) == len(found.effects)


def test_a_size_or_mass_that_the_file_does_not_hold_is_named():
    found = effect()
    bare = dataclasses.replace(found.effects[0], parameters=())
    with pytest.raises(ValueError, match="has no size of 'mass'"):
        diagnosis.corrected(dataclasses.replace(found, effects=(bare,)))
    flights = dataclasses.replace(found.flights, mass=None)
    with pytest.raises(ValueError, match="does not say the vehicle's mass"):
        diagnosis.corrected(dataclasses.replace(found, flights=flights))
