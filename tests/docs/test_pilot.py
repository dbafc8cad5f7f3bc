"""docs/pilot.md as a pilot follows it: its commands, its outputs, and flights in simulation."""

from pathlib import Path

import pytest
from flights_for_tests import point_mass_set
from log_writers import write_ulog

from bench.diagnosis_report.mending.px4_params import read_params
from simulators.effects.mass import Mass
from simulators.effects.thrust_gain import ThrustGain
from simulators.vehicle import GRAVITY
from tests.docs.blocks import every_block, run

PAGE = Path(__file__).parents[2] / "docs" / "pilot.md"
BELIEVED = 0.5
"""PX4's hover thrust on Monday [-]."""
WEIGHT = 0.0434 * GRAVITY
"""Believed weight [N]."""
HEAVIER = Mass(e=0.1)
"""What is wrong with the vehicle."""


def fly(folder, hover, seed):
    """Logs of a vehicle that is heavier than believed, whose PX4 holds `hover`.

    A share of `hover` gives the believed weight in the logs. The rotors give as much as on Monday
    for the same share, so that a larger `hover` makes more thrust of the same command.
    """
    folder.mkdir()
    stronger = ThrustGain(e=hover / BELIEVED - 1.0)
    flights = point_mass_set(HEAVIER, stronger, n_flights=5, seconds=5.0, seed=seed).flights
    for flight in flights:
        hover_thrust = WEIGHT * BELIEVED / hover  # the writer's shares are for BELIEVED
        rates = {"pos": 1, "quat": 1, "cmd": 1}
        log = flight.drones[0]
        write_ulog(folder / f"{flight.name}.ulg", log, hover_thrust, rates, hover)


@pytest.fixture(scope="module")
def monday(tmp_path_factory):
    """The folder in which the pilot works, with Monday's flights and parameters."""
    folder = tmp_path_factory.mktemp("pilot")
    fly(folder / "monday", BELIEVED, 1)
    (folder / "now.params").write_text(f"1\t1\tMPC_THR_HOVER\t{BELIEVED}\t9\n")
    return folder


def test_the_page_leads_from_a_log_to_a_changed_parameter_and_none(monday, monkeypatch, capsys):
    monkeypatch.chdir(monday)
    remedy = Path("reports/diagnosis/monday/remedy-px4")
    said = ""
    for language, content in every_block(PAGE):
        for line in content.splitlines():
            if language == "text":
                assert " ".join(line.split()) in said
            elif "tuesday/" in line:
                new = read_params(remedy / "changed.params")["MPC_THR_HOVER"]
                assert new == pytest.approx(1.1 * BELIEVED, rel=0.01)
                fly(Path("tuesday"), new, 2)
                said = run(line, capsys)
            else:
                said = run(line, capsys)
                if (remedy / "remedy.md").exists():
                    said += " ".join((remedy / "remedy.md").read_text().split())
    assert "Nothing separates" in said
