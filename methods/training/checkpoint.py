"""Where a training in progress is kept, so that one that was killed goes on where it was.

The harness opens a keeper around the `train` of any method, and every trainer inside it asks for
places of its own, in the order of the calls. No method has to know. Outside of a keeper nothing is
kept. A method is called again from its start: what it does before its trainer, such as calibration
flights, is done again with the same key and billed once, by the call that ends; what its trainings
spent before the kill, each of them remembers itself.
"""

import abc
import contextlib
import contextvars
import hashlib
from collections.abc import Iterator, Mapping
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import PRNGKeyArray


class AbstractKeeper(abc.ABC):
    """Keeps the state of one run's trainings, numbered in the order in which they began."""

    @abc.abstractmethod
    def load(self, index: int, fingerprint: str) -> dict[str, np.ndarray] | None:
        """What was last saved of a training; None if nothing of this very one is there."""

    @abc.abstractmethod
    def save(self, index: int, fingerprint: str, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps `arrays` instead of what was saved before; whole or not at all."""

    @abc.abstractmethod
    def due(self) -> bool:
        """Whether the last save is long enough ago."""


class Place:
    """The place of one training in a keeper; without a keeper it is always empty."""

    def __init__(self, keeper: AbstractKeeper | None, index: int, fingerprint: str) -> None:
        self._keeper = keeper
        self._index = index
        self._fingerprint = fingerprint

    def load(self) -> dict[str, np.ndarray] | None:
        """What was last saved, None if nothing was."""
        if self._keeper is None:
            return None
        return self._keeper.load(self._index, self._fingerprint)

    def due(self) -> bool:
        """Whether it is time to save."""
        return self._keeper is not None and self._keeper.due()

    def save(self, arrays: Mapping[str, np.ndarray]) -> None:
        """Keeps `arrays` instead of what was saved before."""
        if self._keeper is not None:
            self._keeper.save(self._index, self._fingerprint, arrays)


_OPEN: contextvars.ContextVar[list | None] = contextvars.ContextVar("keeper", default=None)
"""The open keeper and the number of places that were asked for."""


@contextlib.contextmanager
def kept_by(keeper: AbstractKeeper) -> Iterator[None]:
    """Inside, trainings are kept by `keeper`."""
    token = _OPEN.set([keeper, 0])
    try:
        yield
    finally:
        _OPEN.reset(token)


def next_place(settings: str, key: PRNGKeyArray, *trees: Any) -> Place:
    """The place of the training that begins now.

    Args:
        settings: Text that says how it trains.
        key: Its JAX key.
        trees: Pytrees that it begins from; what is saved of one with other numbers is not used.
    """
    if (opened := _OPEN.get()) is None:
        return Place(None, 0, "")
    keeper, index = opened
    opened[1] += 1
    digest = hashlib.sha256(settings.encode())
    digest.update(np.asarray(jax.random.key_data(key)).tobytes())
    for leaf in jax.tree.leaves(eqx.filter(trees, eqx.is_inexact_array)):
        digest.update(f"{leaf.dtype}{leaf.shape}".encode())
        digest.update(np.asarray(leaf).tobytes())
    return Place(keeper, index, digest.hexdigest())
