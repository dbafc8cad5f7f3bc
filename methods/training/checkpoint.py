"""Keeps trainings in progress, so that a training that was killed resumes where it was.

The harness puts a keeper into the `Context` of a run, and every trainer asks it for a place under
the name of its stage. Without a keeper nothing is kept. A method is called again from its start:
what it does before its trainer, such as calibration flights, is done again with the same key and
billed once, by the call that ends; each training remembers what it spent before the kill.
"""

import abc
import hashlib
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PRNGKeyArray

T = TypeVar("T")


class AbstractKeeper(abc.ABC):
    """Keeps the state of one run's trainings, each under the name of its stage."""

    @abc.abstractmethod
    def load(self, stage: str, fingerprint: str) -> dict[str, np.ndarray] | None:
        """What was last saved of a training; None if nothing of this very one is there."""

    @abc.abstractmethod
    def save(self, stage: str, fingerprint: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps `arrays` instead of what was saved before; whole or not at all."""

    @abc.abstractmethod
    def due(self) -> bool:
        """Whether the last save is long enough ago."""


class Place:
    """The place of one training in a keeper; without a keeper it is always empty."""

    def __init__(self, keeper: AbstractKeeper | None, stage: str, fingerprint: str) -> None:
        self._keeper = keeper
        self._stage = stage
        self._fingerprint = fingerprint

    def load(self) -> dict[str, np.ndarray] | None:
        """The state that was saved last, or None."""
        if self._keeper is None:
            return None
        return self._keeper.load(self._stage, self._fingerprint)

    def due(self) -> bool:
        """Whether it is time to save."""
        return self._keeper is not None and self._keeper.due()

    def save(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps `arrays` instead of what was saved before."""
        if self._keeper is not None:
            self._keeper.save(self._stage, self._fingerprint, arrays)


def pack(
    trees: Any, history: Sequence[Mapping[str, float]], seconds: float
) -> dict[str, np.ndarray]:
    """A training in progress as arrays by name: pytrees, a row an epoch, wall time [s]."""
    leaves = jax.tree.leaves(eqx.filter(trees, eqx.is_array))
    columns = list(history[0])
    return {
        "columns": np.asarray(columns),
        "history": np.asarray([[row[name] for name in columns] for row in history]),
        "seconds": np.asarray(seconds),
    } | {f"{index:03d}": np.asarray(leaf) for index, leaf in enumerate(leaves)}


def unpack(trees: T, arrays: Mapping[str, np.ndarray]) -> tuple[T, list[dict[str, float]], float]:
    """Inverse of `pack`; `trees` give the structure."""
    columns = arrays["columns"].tolist()
    history = [dict(zip(columns, row, strict=True)) for row in arrays["history"].tolist()]
    found, rest = eqx.partition(trees, eqx.is_array)
    leaves, structure = jax.tree.flatten(found)
    stored = [arrays[f"{index:03d}"] for index in range(len(leaves))]
    loaded = [jnp.asarray(new, old.dtype) for new, old in zip(stored, leaves, strict=True)]
    restored = eqx.combine(jax.tree.unflatten(structure, loaded), rest)
    return restored, history, float(arrays["seconds"])


def fingerprint(settings: str, key: PRNGKeyArray, *trees: Any) -> str:
    """Digest of how a training trains and of what it begins from.

    Args:
        settings: Text that says how it trains.
        key: Its JAX key.
        trees: Pytrees that it begins from; only their numbers count.
    """
    digest = hashlib.sha256(settings.encode())
    digest.update(np.asarray(jax.random.key_data(key)).tobytes())
    for leaf in jax.tree.leaves(eqx.filter(trees, eqx.is_inexact_array)):
        digest.update(f"{leaf.dtype}{leaf.shape}".encode())
        digest.update(np.asarray(leaf).tobytes())
    return digest.hexdigest()
