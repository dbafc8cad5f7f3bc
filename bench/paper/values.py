"""What claims are about: the methods by name, and their values by cell, entry and seed."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from bench.plan.realities import joined
from bench.stats.scores import PRIMARY, UPPER, undisturbed
from bench.stats.statistics import Cell, Entry, Values, home_of, matched, seed_values
from bench.store.tables import Tables

LF = Entry("lf_baseline")
SCRATCH = Entry("hf_scratch")
HOTSTART = Entry("hf_hotstart")
AFFINE, SINDY, HYBRID = (Entry("hybrid", residual) for residual in ("affine", "sindy", "mlp"))
ONCE = Entry("hybrid_once")
GREY_BOX = Entry("grey_box")
RANDOMIZED = Entry("domain_randomization")
RECALIBRATED = Entry("recalibrated")
TRACKED = Entry("lf_baseline", variant="PD tracking")
CLEAN = Entry("hybrid", "mlp", "on the unchanged drone")
NAMES = {
    LF: "LF baseline",
    SCRATCH: "HF scratch",
    HOTSTART: "hot start",
    AFFINE: "Hybrid (affine)",
    SINDY: "Hybrid (SINDy)",
    HYBRID: "Hybrid",
    ONCE: "Hybrid once",
    GREY_BOX: "grey box",
    Entry("grey_box", "mlp"): "grey box with a residual (MLP)",
    RANDOMIZED: "domain randomization",
    RECALIBRATED: "recalibrated",
    TRACKED: "PD tracking",
    Entry("ppo"): "PPO",
    CLEAN: "Hybrid on the unchanged drone",
    Entry("hybrid", "history"): "Hybrid (history)",
}
"""How a page calls them."""
WORDS = (
    "*LF baseline* trains in a point mass (low fidelity, LF), *domain randomization* in one whose "
    "parameters are drawn anew each episode. *HF scratch* and *hot start* train "
    "in the high-fidelity simulator (HF), hot start from the LF baseline's policy. *Hybrid*, the "
    "paper's method, trains in a point mass that a learned force corrects; the force is fitted to "
    "calibration flights of one drone, by an ensemble of networks unless affine or SINDy stands in "
    "brackets. *Hybrid once* fits it once for every task and team. *Grey box*, ours, trains in a "
    "point mass with named effects, identified from three calibration flights of ten seconds. "
    "A *fleet-minute* is one drone in the air for one minute. The *settled reward* is the sum of "
    "the reward from 2 s on; 0 would be perfect. N is the number of drones."
)
"""The words of a page, for who begins with it."""

Source = Callable[[Tables, str], Values]
"""Values of a metric."""


def off_spec(tables: Tables, metric: str) -> Values:
    """Values in each world in which something was recalibrated, by what it is there."""
    nominal, home, found = undisturbed(tables, metric), home_of(tables), {}
    for cell, entries in seed_values(tables.results, metric).items():
        world = joined(cell.simulator, cell.deployed_effects)
        here = f"deployed_in={world}"
        named = {
            RECALIBRATED: entries.get(Entry("recalibrated", variant=f"reality={world}")),
            LF: entries.get(Entry("lf_baseline", variant=here)),
            TRACKED: entries.get(Entry("lf_baseline", variant=f"{here}, tracked=true")),
            HYBRID: entries.get(Entry("hybrid", "mlp", here)),
            GREY_BOX: entries.get(Entry("grey_box", variant=f"reality={world}")),
            HOTSTART: entries.get(Entry("hf_hotstart", variant=f"reality={world}")),
            CLEAN: nominal.get(cell._replace(simulator=home, deployed_effects=""), {}).get(HYBRID),
        }
        if named[RECALIBRATED]:
            found[cell] = {entry: values for entry, values in named.items() if values}
    return found


class Varied(NamedTuple):
    """A method with a setting that is not its default."""

    cell: Cell
    """Where it flew."""
    entry: Entry
    """The method and its setting."""
    other: Mapping[int, float]
    """Its settled reward by seed: of the seeds that the default has, too, where there are two."""
    base: Mapping[int, float]
    """That of the default."""


def varied(tables: Tables) -> list[Varied]:
    """Every method whose settings differ from its default, cell by cell."""
    found = []
    for cell, values in seed_values(tables.results, PRIMARY).items():
        for entry in sorted(e for e in values if e.variant and e.method != UPPER):
            default = values.get(entry._replace(variant=""), {})
            other, base = matched(values[entry], default)
            if default or not cell.deployed_effects:  # elsewhere nothing flies by default
                found.append(Varied(cell, entry, other or values[entry], base))
    return found


def name_of(entry: Entry) -> str:
    """What a page calls an entry."""
    return NAMES.get(entry, entry.label)


def name_of_method(entry: Entry) -> str:
    """What a page calls an entry's method, whatever its settings."""
    return name_of(entry._replace(variant=""))


def sizes(values: Values) -> list[int]:
    """Team sizes, ascending."""
    return sorted({cell.team_size for cell in values})


def of_size(values: Values, entry: Entry, team_size: int) -> list[float]:
    """Values of an entry in all tasks and seeds at a team size."""
    cells = (own for cell, own in values.items() if cell.team_size == team_size)
    return [x for own in cells for x in own.get(entry, {}).values()]
