"""The tables of several suites, sorted by the world in which policies were deployed.

In the view of a world that world is home: its rows name no world, so that scores, claims and
boards read them like rows of undisturbed crazyflow. Two suites may call the same world by two
names: RotorPy is home in `paper_rotorpy` and `reality=rotorpy` in `worlds`.
"""

from collections.abc import Sequence
from typing import NamedTuple

import pandas as pd

from bench.plan.realities import shortened
from bench.stats.statistics import records, without_world
from bench.store.tables import LARGE, Tables, table

AS_IS = "as it is"
"""Variant of a policy that was trained or calibrated in another world than the one in which it is
deployed. A policy that was never flown in high fidelity is no such variant."""


class World(NamedTuple):
    """A simulator and its effects."""

    simulator: str
    effects: str = ""

    @property
    def text(self) -> str:
        """As rows write it."""
        return f"{self.simulator}+{self.effects}".rstrip("+")

    @property
    def name(self) -> str:
        """A short name: that of a named world, else its text."""
        return shortened(self.text)


def views(suites: Sequence[Tables]) -> dict[World, Tables]:
    """The tables of each world, that without effects first; a run of two suites counts once."""
    flying = {
        row["method"]
        for tables in suites
        for row in records(tables.results)
        if row["metric"] == "fleet_minutes" and row["value"] > 0.0
    }
    found: dict[World, Tables] = {}
    for tables in suites:
        flown = tables.results[["simulator", "deployed_effects"]].drop_duplicates()
        for row in records(pd.DataFrame(flown)):
            world = World(row["simulator"], row["deployed_effects"])
            view = _view(tables, world, flying)
            found[world] = found[world].merged(view) if world in found else view
    return dict(sorted(found.items(), key=lambda item: (item[0].effects != "", item[0])))


def _view(tables: Tables, world: World, flying: set[str]) -> Tables:
    """The rows of one world, as if it were home."""
    flown = (tables.results["simulator"].eq(world.simulator)
             & tables.results["deployed_effects"].eq(world.effects))  # fmt: skip
    rows = pd.DataFrame(tables.results.loc[flown])
    runs = pd.DataFrame(tables.runs.loc[tables.runs["run"].isin(list(rows["run"]))])

    def home(frame: pd.DataFrame) -> pd.DataFrame:
        named = [_variant(row["variant"], row["method"] in flying) for row in records(frame)]
        return frame.assign(variant=named)

    return Tables(
        results=home(rows).assign(deployed_effects=""),
        runs=home(runs),
        **{name: table(name, []) for name in LARGE},
    )


def _variant(variant: str, flies: bool) -> str:
    rest, deployed = without_world(variant)
    return ", ".join(filter(None, [AS_IS if deployed and flies else "", rest]))
