"""What one run of a suite is: a policy to train and evaluate, its key and its names."""

import dataclasses
import functools
import hashlib
from collections.abc import Mapping

import rfc8785

from bench.plan.keys import Setting
from bench.plan.provenance import digest
from bench.plan.realities import shortened
from bench.text.pages import file_name

REALITY = "crazyflow"
"""Name of the high-fidelity simulator of a suite that names none."""


@dataclasses.dataclass(frozen=True)
class Run:
    """One policy to train and evaluate."""

    method: str
    """Registered name."""
    residual: str
    """Registered name, empty for methods that take none."""
    variant: str
    """What differs from default settings, as canonical text; empty for nothing."""
    task: str
    """Registered name."""
    team_size: int
    """Number of drones."""
    seed: int
    """Seed of training and of the evaluation's initial states."""
    overrides: Mapping[str, Setting]
    """Fields of the method that are not as by default."""
    task_overrides: Mapping[str, Setting]
    """Fields of the task that are not as by default."""
    nominal_overrides: Mapping[str, Setting]
    """Fields of the low-fidelity simulator that are not as by default."""
    parents: Mapping[str, str]
    """Folder of each parent's run, by method."""
    resolved: Mapping[str, Setting]
    """Everything that determines the result, as JSON; the key is its hash."""
    sources: Mapping[str, str]
    """Hash of the source of each plug-in, and of what it imports, to notice changes that no version
    tells."""
    cost: float
    """Rough training time, in units of an LF run per drone; orders the work."""
    reality: str = REALITY
    """Where it is deployed, as text; if it trains, it trains for that."""
    deploys: bool = False
    """Whether it trains nothing and deploys the policy of its one parent, a run of its method."""
    tracked: bool = False
    """Whether a PD controller flies that policy's paths."""

    @functools.cached_property
    def key(self) -> str:
        """Hash of `resolved`."""
        return hashlib.sha256(rfc8785.dumps(dict(self.resolved))).hexdigest()[:16]

    @functools.cached_property
    def program(self) -> str:
        """Hash of all code that its plug-ins run."""
        return digest(self.sources)

    @property
    def identity(self) -> tuple[str, str, str, str, int, int]:
        """What it is, whatever program trains it: the table's `IDENTITY` columns."""
        return (*self.kind, self.seed)

    @property
    def kind(self) -> tuple[str, str, str, str, int]:
        """What runs that differ only in their seed have in common."""
        return self.method, self.residual, self.variant, self.task, self.team_size

    @property
    def label(self) -> str:
        """Short text for people, e.g. "hybrid-mlp circle n3 s0"."""
        method = f"{self.method}-{self.residual}" if self.residual else self.method
        label = f"{method} {self.task} n{self.team_size} s{self.seed}"
        return f"{label} ({shortened(self.variant)})" if self.variant else label

    @functools.cached_property
    def name(self) -> str:
        """Name of its folder."""
        method = f"{self.method}-{self.residual}" if self.residual else self.method
        return (
            file_name(f"{method}-{self.task}-n{self.team_size}-s{self.seed}") + f"-{self.key[:10]}"
        )
