"""Options that several commands share."""

import dataclasses
from typing import TYPE_CHECKING, Annotated

import cyclopts

if TYPE_CHECKING:
    from bench.plan.suite import Suite

Repeatable = cyclopts.Parameter(negative=(), show_default=False)
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
    """Only methods with this residual; those that take none are kept if --method names them; may be
    repeated."""
    quick: Annotated[bool, Repeatable] = False
    """Only the suite's quick part, which shows in minutes what the whole is about."""
    seeds: int | None = None
    """Only this many seeds, counted from the suite's first; rows with fewer seeds keep theirs."""
    setting: Annotated[list[str] | None, Repeatable] = None
    """Another value for a setting of the methods, such as trainer.epochs=50, of the tasks, such as
    task_settings.horizon=100, or of the point mass, such as nominal.attitude_tau=0.05; may be
    repeated. `bench list methods --settings` shows what there is."""

    def of(self, suite: str) -> "Suite":
        """The chosen part of the suite called `suite`."""
        from bench.plan.keys import parse_settings
        from bench.plan.override import overridden
        from bench.plan.suite import load_suite

        settings = parse_settings(self.setting or ())
        whole = load_suite(suite)
        chosen = (whole.quickly() if self.quick else whole).select(
            self.task or (),
            self.team_size or (),
            self.method or (),
            self.residual or (),
            self.seeds,
        )
        return overridden(chosen, settings)
