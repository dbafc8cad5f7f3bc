"""Options that several commands share."""

import dataclasses
from typing import TYPE_CHECKING, Annotated

import cyclopts

from bench.text.errors import UsageError

if TYPE_CHECKING:
    from bench.plan.suite import Suite

Repeatable = cyclopts.Parameter(negative=())
"""For an option that has no opposite called `--no-...`."""


@cyclopts.Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Part:
    """The options of `bench run` and `bench plan` that choose a part of a suite."""

    task: Annotated[list[str] | None, Repeatable] = None
    """Only this task; may be repeated."""
    team_size: Annotated[list[int] | None, Repeatable] = None
    """Only this number of drones; may be repeated."""
    method: Annotated[list[str] | None, Repeatable] = None
    """Only this method; may be repeated."""
    residual: Annotated[list[str] | None, Repeatable] = None
    """Only methods with this residual, and methods without any that --method names; may be
    repeated."""
    seeds: int | None = None
    """Only so many seeds, from the suite's first on; rows with fewer seeds keep theirs."""

    def of(self, suite: str) -> "Suite":
        """The chosen part of the suite called `suite`."""
        from bench.plan.suite import load_suite

        return load_suite(suite).select(
            self.task or (),
            self.team_size or (),
            self.method or (),
            self.residual or (),
            self.seeds,
        )


def check_number(option: str, value: int | None) -> None:
    """Refuses a number below 1; None stands for an option that was not given.

    Raises:
        UsageError: It is smaller.
    """
    if value is not None and value < 1:
        raise UsageError(f"`--{option}` must be at least 1, got {value}.")
