"""Options that several commands share."""

import dataclasses
from typing import TYPE_CHECKING, Annotated

import cyclopts

from bench.text.errors import UsageError

if TYPE_CHECKING:
    from bench.plan.suite import Suite

Repeatable = cyclopts.Parameter(negative=())
"""An option without its `--no-` twin."""


@cyclopts.Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Part:
    """Which part of a suite, by options that `bench run` and `bench plan` share."""

    task: Annotated[list[str] | None, Repeatable] = None
    """Only this task."""
    team_size: Annotated[list[int] | None, Repeatable] = None
    """Only this number of drones."""
    method: Annotated[list[str] | None, Repeatable] = None
    """Only this method."""
    residual: Annotated[list[str] | None, Repeatable] = None
    """Only with this residual, and what --method names and takes none."""
    seeds: int | None = None
    """Number of seeds, from the suite's first; rows that have fewer keep their number."""

    def of(self, suite: str) -> "Suite":
        """That part of the suite."""
        from bench.plan.suite import load_suite

        return load_suite(suite).select(
            self.task or (),
            self.team_size or (),
            self.method or (),
            self.residual or (),
            self.seeds,
        )


def check_number(option: str, value: int | None) -> None:
    """Nothing, for a number from 1 on or none at all.

    Raises:
        UsageError: It is smaller.
    """
    if value is not None and value < 1:
        raise UsageError(f"`--{option}` must be at least 1, got {value}.")
