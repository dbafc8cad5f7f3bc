"""Blind cases: drawn, flown and written, with labels kept apart from what the diagnosis sees."""

import dataclasses
import hashlib
import json
import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from blind.draw import catalogue
from blind.draw.catalogue import SIZES, UNKNOWN, Withheld
from blind.fly import flying, references
from blind.fly.realities import DRONE, DT, MASS
from diagnosis.logs.flights import FlightSet, load_flights
from simulators.effects.card import Input, load_card

C = TypeVar("C")

KINDS = ("single", "pair", "clean", "unknown", "excluded")
"""What a case can be: one effect, two, none, one outside the library, one withheld from it."""

OWN = "crazyflow"
"""The reality whose equations are those of the simulator that the diagnosis is asked about."""

TWO_DRONES = 0.1
"""Share of the cases in which two drones fly though no effect needs them."""

REFERENCE_SETS = 8
"""Undisturbed flight sets beside which cases are diagnosed, where they need a reference."""

VEHICLE = f"""\
name = "Crazyflie, blind case"
drone = "{DRONE}"    # crazyflow parameter set
mass = {MASS}    # [kg] what the operator believes
"""
"""The same `vehicle.toml` in every case."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A vehicle whose difference from the nominal one is withheld."""

    id: str
    """Random name of the folder."""
    kind: str
    """One of `KINDS`."""
    effects: tuple[Withheld, ...]
    """What is different, at most two."""
    size: str
    """One of `SIZES`, joined by "+" for two effects; empty for a clean case."""
    seed: int
    """Seed of flights, noise and dropouts."""
    reality: str = OWN
    """Where it is flown."""
    drones: int = 1
    """Drones in each flight."""
    n_flights: int = 8
    """Number of flights."""
    seconds: float = 10.0
    """Duration of each flight [s]."""
    noise: float = 1.0
    """Measurement noise over the usual one."""
    reference: int | None = None
    """Which of the undisturbed flight sets it is diagnosed beside."""

    @classmethod
    def of(cls, label: Mapping[str, Any]) -> "Case":
        """The case of a label that `write_labels` wrote."""
        fields: dict[str, Any] = {name: value for name, value in label.items() if name != "exclude"}
        fields["effects"] = tuple(Withheld(**effect) for effect in label["effects"])
        return cls(**fields)

    @property
    def exclude(self) -> tuple[str, ...]:
        """Effects that the diagnosis must do without."""
        return tuple(e.name for e in self.effects) if self.kind == "excluded" else ()


def draw_cases(
    counts: Mapping[str, int], reality: str = "crazyflow", entropy: int | None = None
) -> list[Case]:
    """Cases in random order, balanced over effects and sizes.

    Args:
        counts: Number of cases by kind.
        reality: Where they are flown, one of `realities.REALITIES`.
        entropy: Seed of everything that is drawn; from the operating system if None.

    Raises:
        ValueError: A kind is not known, or a count is negative.
    """
    for kind, count in counts.items():
        if kind not in KINDS or count < 0:
            raise ValueError(
                f"`counts` must give numbers from 0 for kinds among {', '.join(KINDS)}, "
                f"got {kind!r}: {count}."
            )
    names = catalogue.known(reality)
    rng = np.random.default_rng(secrets.randbits(128) if entropy is None else entropy)
    plans: list[tuple[str, list[tuple[str, int]]]] = []
    for kind in KINDS:
        plans += [(kind, plan) for plan in _plans(kind, counts.get(kind, 0), names, rng)]
    order = [plans[i] for i in rng.permutation(len(plans))]
    n = reference_sets_in(reality)
    return [
        make_case(kind, plan, rng, reality=reality, reference=i % n if n else None)
        for i, (kind, plan) in enumerate(order)
    ]


def reference_sets_in(reality: str) -> int:
    """How many undisturbed flight sets a reality has, beside which its cases are diagnosed in turn.

    The reality `OWN` has none. The error of a reference is in every answer beside it, so that one
    reference tells little of how often intervals hold the truth.
    """
    return 0 if reality == OWN else REFERENCE_SETS


def make_case(
    kind: str, plan: Sequence[tuple[str, int]], rng: np.random.Generator, **settings: Any
) -> Case:
    """A case with the effects of `plan` (name, index of the size) and random details.

    `settings` are fields of `Case` such as `n_flights`, `seconds` and `noise`.
    """
    seconds = settings.get("seconds", Case.seconds)
    effects = tuple(catalogue.draw_effect(name, size, rng, seconds) for name, size in plan)
    two = any(Input.NEIGHBOUR in load_card(n).inputs for n, _ in plan) or rng.random() < TWO_DRONES
    return Case(
        id=rng.bytes(8).hex(),
        kind=kind,
        effects=effects,
        size="+".join(SIZES[size] for _, size in plan),
        seed=int(rng.integers(2**62)),
        drones=2 if two else 1,
        **settings,
    )


def _plans(
    kind: str, count: int, names: Sequence[str], rng: np.random.Generator
) -> list[list[tuple[str, int]]]:
    """Effects and sizes of `count` cases: whole rounds over all of them, then a random rest."""
    if kind == "clean":
        return [[] for _ in range(count)]
    if kind == "pair":
        singles = [(a, b) for a in names for b in names if a < b and not catalogue.alike(a, b)]
        chosen = _rounds(singles, count, rng)
        return [[(a, int(rng.integers(1, 3))), (b, int(rng.integers(1, 3)))] for a, b in chosen]
    pool = UNKNOWN if kind == "unknown" else names
    return [[plan] for plan in _rounds([(n, s) for n in pool for s in range(3)], count, rng)]


def _rounds(pool: list, count: int, rng: np.random.Generator) -> list:
    order: list = []
    while len(order) < count:
        order += [pool[i] for i in rng.permutation(len(pool))]
    return order[:count]


def fly_case(case: Case) -> list[flying.Flown]:
    """The flights of a case, rows dropped.

    Raises:
        ValueError: The flights are too short, there are none, or there is no such reality.
    """
    if case.seconds < 2.0 or case.n_flights < 1:
        raise ValueError(
            f"A case needs `n_flights` of at least 1 and `seconds` of at least 2, got "
            f"{case.n_flights} and {case.seconds:g}."
        )
    rng = np.random.default_rng(case.seed)
    t = np.arange(round(case.seconds / DT)) * DT
    lift = max((catalogue.LIFTED.get(e.name, 0.0) for e in case.effects), default=0.0)
    refs = []
    for kind in range(case.n_flights):
        drones = [references.make_reference(kind, t, rng, lift)]
        if case.drones == 2:
            drones.append(references.above(drones[0], t, rng))
        refs.append(drones)
    disturbance = catalogue.make_disturbance(case.effects, case.n_flights, rng)
    noise = flying.Noise().scaled(case.noise)
    flown = flying.fly(case.reality, disturbance, refs, noise, rng)
    return [flying.drop_rows(one, rng) for one in flown]


def write_flights(folder: Path, tables: Sequence[Any]) -> None:
    """A flight set in the log format: the vehicle that is believed, and one table a flight.

    The folder is there whole or not at all.
    """
    part = folder.with_name(f"{folder.name}.part")
    shutil.rmtree(part, ignore_errors=True)
    (part / "flights").mkdir(parents=True)
    (part / "vehicle.toml").write_text(VEHICLE)
    for i, table in enumerate(tables):
        table.to_parquet(part / "flights" / f"flight{i}.parquet", index=False)
    os.replace(part, folder)


def read_back(tables: Sequence[Any]) -> FlightSet:
    """The flights that a diagnosis reads where `write_flights` has written `tables`."""
    with tempfile.TemporaryDirectory() as folder:
        write_flights(Path(folder) / "flown", tables)
        return load_flights(Path(folder) / "flown")


def write_case(directory: Path, labels_directory: Path, case: Case) -> None:
    """Flies `case` into `directory`/ID, and into `labels_directory`/true/ID without noise.

    A case that is there already is left alone.
    """
    seen, true = directory / case.id, labels_directory / "true" / case.id
    if seen.is_dir() and true.is_dir():
        return
    flown = fly_case(case)
    for folder, tables in ((true, [f.true for f in flown]), (seen, [f.logged for f in flown])):
        shutil.rmtree(folder, ignore_errors=True)
        write_flights(folder, tables)


def undisturbed_case(reality: str, rng: np.random.Generator) -> Case:
    """One drone on which nothing acts."""
    return dataclasses.replace(make_case("clean", (), rng, reality=reality), drones=1)


def write_undisturbed(folder: Path, case: Case) -> None:
    """Flies a case, as it is logged, into a folder, unless the folder is there."""
    if not folder.is_dir():
        write_flights(folder, [one.logged for one in fly_case(case)])


def write_labels(path: Path, cases: Sequence[Case]) -> str:
    """SHA-256 of a file with what `cases` are; see `seal`."""
    return seal(
        path, {case.id: {**dataclasses.asdict(case), "exclude": case.exclude} for case in cases}
    )


def seal(path: Path, labels: Mapping[str, Mapping[str, Any]]) -> str:
    """SHA-256 of a file with labels by case and 32 random bytes, so that it cannot be guessed."""
    content = {"salt": secrets.token_hex(32), "cases": labels}
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1), encoding="utf-8")
    return digest(path)


def read_labels(
    path: Path, make: Callable[[Mapping[str, Any]], C], sha256: str | None = None
) -> dict[str, C]:
    """Cases by their folders' names, each made of its label.

    Raises:
        ValueError: The file is not the one whose `sha256` was printed.
    """
    if sha256 is not None and (found := digest(path)) != sha256:
        raise ValueError(f"`{path}` has changed: its SHA-256 is {found}, not {sha256}.")
    labels = json.loads(path.read_text(encoding="utf-8"))["cases"]
    return {name: make(label) for name, label in labels.items()}


def digest(path: Path) -> str:
    """SHA-256 of a file."""
    return hashlib.sha256(path.read_bytes()).hexdigest()
