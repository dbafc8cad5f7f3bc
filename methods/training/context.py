"""What the harness gives a training besides its task: seeds together, checkpoints, progress.

Nothing is ambient: whoever makes no `Context` trains alone, in silence, and keeps nothing.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

from jaxtyping import PRNGKeyArray

from methods.training.checkpoint import AbstractKeeper, Place, fingerprint
from methods.training.together import Team

Progress = Callable[[str, int, int, float], None]
"""Called with (stage, epoch, epochs, training return) after every epoch."""


def silent(stage: str, epoch: int, epochs: int, reward: float) -> None:
    """A `Progress` that shows nothing."""


@dataclasses.dataclass(frozen=True)
class Context:
    """What one run is given by the harness."""

    progress: Progress = silent
    """Where to report epochs."""
    team: Team | None = None
    """Runs whose epochs are flown in one program; None: this run trains alone."""
    keeper: AbstractKeeper | None = None
    """Keeps trainings in progress; None: a training that is killed starts again."""
    _begun: set[str] = dataclasses.field(default_factory=set, init=False, repr=False)

    @contextlib.contextmanager
    def in_turn(self) -> Iterator[None]:
        """A context in which no other member of the team works, so that its time is this run's."""
        with self.team.turn if self.team else contextlib.nullcontext():
            yield

    def place(self, stage: str, settings: str, key: PRNGKeyArray, *trees: Any) -> Place:
        """The place in which the training called `stage` is kept.

        Args:
            stage: Name of the training, which no other training of this run has.
            settings: Text that says how it trains.
            key: Its JAX key.
            trees: Pytrees that it begins from; what is saved of one with other numbers is not used.

        Raises:
            ValueError: Another training of this run has the same name.
        """
        if self.keeper is None:
            return Place(None, stage, "")
        if stage in self._begun:
            raise ValueError(
                f"Two trainings of one run are called {stage!r}, so that one would be resumed as "
                "the other. Give each a stage of its own, e.g. 'restart 1' and 'restart 2'."
            )
        self._begun.add(stage)
        return Place(self.keeper, stage, fingerprint(f"{stage} {settings}", key, *trees))
