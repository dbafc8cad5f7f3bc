"""Trainings of one shape, run as one program so that they fill an accelerator.

Trainings that differ in numbers only (seeds, a residual's weights, an effect's size) do the same
operations. The members of a `Team` train in threads of their own. Each finds the team in its
`Context`: a trainer's call waits for those of the others, and all calls of one shape become one
call over a leading axis. Nobody waits for a member that has ended its task; everybody waits for
one that does something else (calibration flights, deployment). Products over that axis round
differently, so that a training equals the one that is alone up to rounding, as on another machine.
"""

import contextlib
import threading
import time
from collections.abc import Callable, Hashable, Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

Function = Callable[[Any, Any], tuple]
"""Of (given, room) -> (*results, room): a pytree, and memory that calls hand on."""


class _Call:
    """One member's call and its result."""

    def __init__(self, function: Function, given: Any, make_room: Callable[[int], Any]) -> None:
        self.function, self.make_room = function, make_room
        self.numbers, self.rest = eqx.partition(given, _is_array)
        leaves, structure = jax.tree.flatten(self.numbers)
        fixed, other = jax.tree.flatten(self.rest)
        shapes = tuple((np.shape(x), str(x.dtype)) for x in leaves)
        self.shape: Hashable = (function, structure, shapes, other, tuple(fixed))
        self.results: tuple | None = None
        self.error: BaseException | None = None
        self.seconds = 0.0
        """This member's share of the time in which it was flown [s]."""

    @property
    def over(self) -> bool:
        """Whether it was flown."""
        return self.results is not None or self.error is not None


def _is_array(x: Any) -> bool:
    return eqx.is_array(x) or isinstance(x, np.ndarray | np.generic)


class Team:
    """A fixed number of members, each a thread that enters `member` once."""

    def __init__(self, members: int) -> None:
        self._size = self._left = members
        self._waiting: list[_Call] = []
        self._rooms: dict[tuple[Hashable, int], Any] = {}
        self._change = threading.Condition()
        self.turn = threading.Lock()
        """Held during work that members do one after another."""

    @contextlib.contextmanager
    def member(self) -> Iterator[None]:
        """A context in which the other members wait for this thread's calls."""
        try:
            yield
        finally:
            with self._change:
                self._left -= 1
                self._change.notify_all()

    def call(
        self, function: Function, given: Any, make_room: Callable[[int], Any]
    ) -> tuple[tuple, float]:
        """Results of `function` for `given`, and the time that was not this member's own [s].

        Own is its share of the common call; what others did until they called, too, is not.

        Args:
            function: Traced; it must be the same object in every thread.
            given: Its argument; arrays are what may differ between members of one call.
            make_room: Memory for so many members, with a leading axis; None for none.
        """
        begun = time.perf_counter()
        mine = _Call(function, given, make_room)
        with self._change:
            self._waiting.append(mine)
            self._change.notify_all()
            self._change.wait_for(lambda: mine.over or len(self._waiting) >= self._left)
            calls = []
            if not mine.over:  # the last to call flies for all
                calls, self._waiting = self._waiting, []
        if calls:
            self._fly(calls)
            with self._change:
                self._change.notify_all()
        if mine.error is not None:
            raise mine.error
        assert mine.results is not None
        return mine.results, time.perf_counter() - begun - mine.seconds

    def _fly(self, calls: Sequence[_Call]) -> None:
        groups: dict[Hashable, list[_Call]] = {}
        for call in calls:
            groups.setdefault(call.shape, []).append(call)
        for group in groups.values():
            try:
                self._fly_group(group)
            except BaseException as error:
                for call in group:
                    call.error = error

    def _fly_group(self, group: Sequence[_Call]) -> None:
        """One call for all; the program stays the same until half of its places are empty."""
        begun = time.perf_counter()
        first, size = group[0], self._size
        while (size + 1) // 2 >= len(group) and size > 1:
            size = (size + 1) // 2
        filled = [*group, *[group[-1]] * (size - len(group))]
        key = (first.shape, size)
        room = self._rooms.pop(key, None)
        if room is None:
            self._rooms = {k: x for k, x in self._rooms.items() if k[0] != first.shape}
            room = first.make_room(size)
        numbers = tuple(call.numbers for call in filled)
        every, self._rooms[key] = _together((first.function, first.rest, numbers), room)
        jax.block_until_ready(every)
        seconds = (time.perf_counter() - begun) / len(group)
        for call, results in zip(group, every, strict=False):
            call.results, call.seconds = results, seconds


@eqx.filter_jit(donate="all-except-first")
def _together(given: tuple[Function, Any, tuple], room: Any) -> tuple[list[tuple], Any]:
    """Results for every entry, and the room for the next call."""
    function, rest, numbers = given
    stacked = eqx.combine(jax.tree.map(lambda *x: jnp.stack(x), *numbers), rest)
    *results, room = eqx.filter_vmap(function)(stacked, room)
    one = lambda i: jax.tree.map(lambda x: x[i] if _is_array(x) else x, tuple(results))  # noqa: E731
    return [one(i) for i in range(len(numbers))], room
