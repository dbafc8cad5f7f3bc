"""docs/pilot_crazyflie.md as its reader follows it, with flights in simulation."""

from pathlib import Path

import pytest
from flights_for_tests import fly
from log_writers import write_usd

from simulators import registry
from simulators.contract import with_effects
from simulators.effects.mass import Mass
from simulators.effects.thrust_gain import ThrustGain
from tests.docs.blocks import every_block, run

PAGE = Path(__file__).parents[2] / "docs" / "pilot_crazyflie.md"
ALWAYS = ThrustGain(e=-0.08)
"""What the simulator misses of the vehicle, before and after."""
CHANGE = Mass(e=0.12)
INSTEAD = {"point_mass": {"more mass than before": "less thrust over mass than before"}}
"""What is said otherwise than on the page: a point mass takes weaker rotors for nearly the same."""


def write_logs(name):
    """The cards of both days: six flights, and five with the change."""
    simulator = registry.load("simulator", name)()
    for folder, n, effects in (("before", 6, [ALWAYS]), ("after", 5, [ALWAYS, CHANGE])):
        Path(folder).mkdir()
        flights = fly(with_effects(simulator, effects), n, seconds=6.0, seed=n, rows=2)
        for flight in flights:
            write_usd(Path(folder) / flight.name, flight.drones[0], simulator.spec.thrust_max)


@pytest.mark.parametrize(
    "simulator", ["point_mass", pytest.param("crazyflow", marks=pytest.mark.exhaustive)]
)
def test_the_page_leads_from_two_cards_to_what_changed(simulator, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_logs(simulator)
    said, remedy = "", Path("reports/diagnosis/after/remedy-crazyflie/remedy.md")
    for language, content in every_block(PAGE):
        for line in content.splitlines():
            if language == "text":
                expected = INSTEAD.get(simulator, {}).get(line, line)
                assert " ".join(expected.split()) in said
                continue
            said = run(line, capsys, ["--simulator", simulator])
            if remedy.exists():
                said += " ".join(remedy.read_text(encoding="utf-8").split())
