"""Keeps trainings in progress, so that a training that was killed resumes where it was.

The harness puts a keeper into the `Context` of a run, and every trainer asks it for a place under
the name of its stage. Without a keeper nothing is kept. A method is called again from its start:
what it does before its trainer, such as calibration flights, is done again with the same key and
billed once, by the call that ends; each training remembers what it spent before the kill.
"""

import abc
import hashlib
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PRNGKeyArray


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
        """What was last saved, None if nothing was."""
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


def fingerprint(settings: str, key: PRNGKeyArray, *trees: Any) -> str:
    """What tells a training from others: a digest of how it trains and what it begins from.

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
