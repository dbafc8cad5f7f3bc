"""Random splits of undisturbed flights into a reference and a target, and the options of both."""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from rich.console import Console
from rich.progress import track

from diagnosis.logs.flights import FlightSet, load_flights

T = TypeVar("T")


def parser_of(program: str, said: str | None, splits: int, seed: int) -> argparse.ArgumentParser:
    """A command that splits a flight set; the last two are defaults."""
    parser = argparse.ArgumentParser(prog=program, description=said)
    parser.add_argument("flights", type=Path, help="folder of logs of one undisturbed vehicle")
    parser.add_argument("--splits", type=int, default=splits, help="random splits")
    parser.add_argument("--reference", type=int, default=9, help="reference flights of a split")
    parser.add_argument("--target", type=int, default=9, help="target flights of a split")
    parser.add_argument("--seed", type=int, default=seed, help="of the splits")
    return parser


def read(parser: argparse.ArgumentParser) -> tuple[argparse.Namespace, FlightSet, tuple[int, int]]:
    """What was given, the flights, and how many of them a reference and a target have.

    The program ends with a message if the set has fewer flights than that.
    """
    given = parser.parse_args()
    flights, sizes = load_flights(given.flights), (given.reference, given.target)
    if (n := len(flights.flights)) < sum(sizes):
        parser.error(f"--reference and --target need {sum(sizes)} flights, {given.flights} has {n}")
    return given, flights, sizes


def random_splits(
    flights: Sequence[T], splits: int, sizes: tuple[int, int], seed: int, doing: str
) -> Iterator[tuple[list[T], list[T]]]:
    """Reference and target of each split, with a progress bar that says what is being done."""
    rng = np.random.default_rng(seed)
    for _ in track(range(splits), doing, console=Console(stderr=True)):
        order = [flights[i] for i in rng.permutation(len(flights))]
        yield order[: sizes[0]], order[sizes[0] : sum(sizes)]
