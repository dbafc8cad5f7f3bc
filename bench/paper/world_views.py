"""Methods against worlds: the tables of several suites, sorted by the world flown in, and scores.

In the view of a world that world is home: its rows name no world, so that scores, claims and
boards read them like rows of undisturbed crazyflow. Two suites may call the same world by two
names: RotorPy is home in `paper_rotorpy` and `reality=rotorpy` in `worlds`.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from bench.plan.realities import joined, shortened
from bench.stats.scores import PRIMARY, recovered, scored
from bench.stats.statistics import (
    REALITY,
    Cell,
    Entry,
    Values,
    entry_of,
    estimate,
    records,
    seed_values,
    without_world,
)
from bench.stats.verdicts import over_cells
from bench.store.tables import LARGE, Tables, table

AS_IS = "as it is"
"""Variant of a policy that was trained or calibrated in another world than the one in which it is
deployed. A policy that was never flown in high fidelity is no such variant."""

RETURNS = ("reward", PRIMARY, "spawn_settled_reward")
"""Metrics that a deployed policy has of the world in which it is deployed, and that claims read."""
TO_UPPER = (
    "A score of 0 is the settled reward of a team that stays at its spawn, a score of 1 that of "
    "the upper reference of the same world"
)
TO_PERFECT = (
    "Not every world has an upper reference, so that scores here are raw: 0 is the settled reward "
    "of a team that stays at its spawn, 1 is a settled reward of 0, which is perfect and out of "
    "reach"
)
FEWEST_WORLDS = 2
"""Worlds without which there is nothing to compare."""


class World(NamedTuple):
    """A simulator and its effects."""

    simulator: str
    effects: str = ""

    @property
    def text(self) -> str:
        """As rows write it."""
        return joined(self.simulator, self.effects)

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


def ways(view: Tables) -> dict[str, Tables]:
    """What claims are judged by in the view of a world: `view`, and its policies *as they are*.

    In the second, a policy that was never flown there stands under its method's name, with its
    returns alone: what its training cost and how that went is no matter of this world.
    """
    as_is = _entries(view.results, AS_IS)
    if not as_is:
        return {"": view}

    def renamed(frame: pd.DataFrame) -> pd.DataFrame:
        trained = [entry_of(row) in as_is for row in records(frame)]
        kept = pd.DataFrame(frame.loc[~np.asarray(trained, bool)])
        return kept.assign(variant=kept["variant"].where(kept["variant"].ne(AS_IS), ""))

    returns = pd.DataFrame(view.results.loc[view.results["metric"].isin(RETURNS)])
    other = dataclasses.replace(view, results=renamed(returns), runs=renamed(view.runs))
    return {"": view, AS_IS: other} if as_is & _entries(view.results, "") else {AS_IS: other}


def _entries(rows: pd.DataFrame, variant: str) -> set[Entry]:
    """Methods with their residuals that have rows of a variant."""
    found = {entry_of(row) for row in records(rows)}
    return {entry._replace(variant="") for entry in found if entry.variant == variant}


class Standing(NamedTuple):
    """A method over all worlds."""

    entry: Entry
    scores: Mapping[World, tuple[float, float, float]]
    """Mean with the ends of its interval, NaN without one, by world that it flew in every cell."""
    deciles: Mapping[World, float]
    """Settled reward of the worst tenth of its drones, mean over cells and seeds, by world."""
    minutes: float
    """High-fidelity flight, mean over worlds, cells and seeds; of a policy that is deployed *as it
    is*, what its training flew [min]."""
    worst: World | None
    """The world of its lowest score; None unless it flew in all worlds."""

    @property
    def worst_score(self) -> float:
        """The lowest score; NaN unless it flew in all worlds."""
        return self.scores[self.worst][0] if self.worst is not None else math.nan


class Matrix(NamedTuple):
    """Methods against worlds."""

    worlds: tuple[World, ...]
    cells: tuple[Cell, ...]
    """Tasks and team sizes that are compared, named as if at home: those that every method flew in
    every world, of the methods that flew everywhere at all."""
    left_out: tuple[Cell, ...]
    """Others, which some of these methods flew in every world."""
    standings: list[Standing]
    """Highest worst-world score first, then who did not fly everywhere."""
    front: frozenset[Entry]
    """Methods that no other beats in worst-world score without flying more."""
    scale: str
    """What a score is."""
    best: Mapping[World, tuple[Entry, ...]]
    """By world, the method of the highest mean, then those that are not shown to score less: the
    paired 95 % interval of the difference holds 0. As named there (`flown_as`)."""
    level: Mapping[Entry, tuple[Entry, ...]]
    """By method of the front, those that fly less and above whose worst-world score its own is not
    shown to be, by the same interval, each in its own worst world."""


def matrix(found: Mapping[World, Tables]) -> Matrix:
    """The matrix of the views of worlds."""
    values = {world: seed_values(scored(t), "score") for world, t in found.items()}
    scale = TO_UPPER
    if not all(values.values()):
        values, scale = {w: recovered(t) for w, t in found.items()}, TO_PERFECT
    entries = sorted({e for own in values.values() for entries in own.values() for e in entries})
    shared, some = _shared([e for e in entries if settings_of(e) == ""], values)
    standings = [_standing(entry, values, found, shared) for entry in entries]
    standings = sorted(
        (s for s in standings if s.scores),
        key=lambda s: (s.worst is None, -s.worst_score if s.worst else 0.0, s.entry),
    )
    front = frozenset(s.entry for s in standings if _on_front(s, standings))
    cells, left_out = (tuple(Cell(*c) for c in sorted(x)) for x in (shared, some - shared))
    best = {w: _best(travelled(standings), w, own, shared) for w, own in values.items()}
    best = {world: entries for world, entries in best.items() if entries}
    level = _level([s for s in standings if s.entry in front], values, shared)
    return Matrix(tuple(found), cells, left_out, standings, front, scale, best, level)


def travelled(standings: Sequence[Standing]) -> Sequence[Standing]:
    """Who flew in `FEWEST_WORLDS` or more; all, if nobody did."""
    return [s for s in standings if len(s.scores) >= FEWEST_WORLDS] or standings


def _best(
    standings: Sequence[Standing], world: World, own: Values, shared: set[tuple[str, int]]
) -> tuple[Entry, ...]:
    """`Matrix.best` of a world."""
    here = [s for s in standings if world in s.scores]
    here = sorted(here, key=lambda s: -s.scores[world][0])
    ranked = list(dict.fromkeys(flown_as(s.entry, world) for s in here))
    flown = {entry: _of(own, entry, shared) for entry in ranked}

    def behind(entry: Entry) -> float:
        """How much less it scores at least; NaN where seeds are too few for an interval."""
        return over_cells(zip(flown[ranked[0]], flown[entry], strict=True)).low

    return (*ranked[:1], *(entry for entry in ranked[1:] if not behind(entry) > 0.0))


def _level(
    front: Sequence[Standing], values: Mapping[World, Values], shared: set[tuple[str, int]]
) -> dict[Entry, tuple[Entry, ...]]:
    """`Matrix.level` of the front."""

    def worst(standing: Standing) -> list[Mapping[int, float]]:
        assert standing.worst is not None
        here = flown_as(standing.entry, standing.worst)
        return _of(values[standing.worst], here, shared)

    def above(one: Standing, other: Standing) -> bool:
        return over_cells(zip(worst(one), worst(other), strict=True)).low > 0.0

    return {
        one.entry: tuple(s.entry for s in front if s.minutes < one.minutes and not above(one, s))
        for one in front
    }


def _shared(
    entries: Sequence[Entry], values: Mapping[World, Values]
) -> tuple[set[tuple[str, int]], set[tuple[str, int]]]:
    """Tasks and team sizes that everybody flew in all worlds, and those that somebody did.

    Of everybody who flew somewhere in all worlds; if nobody did, what was flown in each world.
    Other settings than the defaults do not count: they are shown where they flew all of these.
    """
    flown = []
    for entry in entries:
        places = [
            {(c.task, c.team_size) for c, e in own.items() if flown_as(entry, world) in e}
            for world, own in values.items()
        ]
        flown.append(set.intersection(*places))
    flown = [cells for cells in flown if cells]
    if not flown:
        every = [{(c.task, c.team_size) for c in own} for own in values.values()]
        flown = [set.intersection(*every)]
    return set.intersection(*flown), set.union(*flown)


def _standing(
    entry: Entry,
    values: Mapping[World, Values],
    found: Mapping[World, Tables],
    shared: set[tuple[str, int]],
) -> Standing:
    scores, deciles, minutes = {}, {}, []
    for world, own in values.items():
        here = flown_as(entry, world)
        flown = _of(own, here, shared)
        if len(flown) < len(shared) or not flown:
            continue
        scores[world] = _mean(flown)
        results = found[world].results
        if not is_as_it_is(entry) or world == World(REALITY):
            bills = _of(seed_values(results, "fleet_minutes"), here, shared)
            minutes += [x for seeds in bills for x in seeds.values()]
        tenths = _of(seed_values(results, "worst_decile_reward"), here, shared)
        if tenths:
            deciles[world] = float(np.mean([estimate(s.values()).mean for s in tenths]))
    complete = len(scores) == len(values)
    worst = min(scores, key=lambda world: scores[world][0]) if complete and scores else None
    return Standing(entry, scores, deciles, estimate(minutes).mean, worst)


def flown_as(entry: Entry, world: World) -> Entry:
    """What an entry is called in a world: where it was trained, a policy is not *as it is*.

    Suites that deploy elsewhere train in crazyflow.
    """
    if is_as_it_is(entry) and world == World(REALITY):
        return entry._replace(variant=settings_of(entry))
    return entry


def is_as_it_is(entry: Entry) -> bool:
    """Whether the policy was trained in one world and is deployed in another."""
    return entry.variant == AS_IS or entry.variant.startswith(f"{AS_IS}, ")


def settings_of(entry: Entry) -> str:
    """The settings of an entry that are not the defaults, as text."""
    return entry.variant.removeprefix(AS_IS).removeprefix(", ")


def _of(values: Values, entry: Entry, shared: set[tuple[str, int]]) -> list[Mapping[int, float]]:
    """Values by seed of a method, in each of the shared cells that it flew."""
    return [
        own[entry]
        for cell, own in values.items()
        if (cell.task, cell.team_size) in shared and entry in own
    ]


def _mean(flown: Sequence[Mapping[int, float]]) -> tuple[float, float, float]:
    """Mean over cells, with the interval of the mean over seeds where every cell has two."""
    mean = float(np.mean([estimate(seeds.values()).mean for seeds in flown]))
    if min(map(len, flown)) < 2:
        return mean, math.nan, math.nan
    test = over_cells((seeds, dict.fromkeys(seeds, 0.0)) for seeds in flown)
    return mean, test.low, test.high


def _on_front(one: Standing, all_: Sequence[Standing]) -> bool:
    """Whether everybody else flies more, scores less in the worst world, or equals it in both."""
    if one.worst is None:
        return False
    return not any(
        other.worst_score >= one.worst_score
        and other.minutes <= one.minutes
        and (other.worst_score > one.worst_score or other.minutes < one.minutes)
        for other in all_
        if other.worst is not None
    )
