"""What trainings in the high-fidelity simulator share: BPTT in one world, and the crashes."""

from jaxtyping import PRNGKeyArray

from methods.contract import Ledger, Setup, Trained
from methods.training.bptt import BPTT, Training
from methods.training.policy import AbstractPolicy


def train_in_reality(
    trainer: BPTT, setup: Setup, policy: AbstractPolicy, key: PRNGKeyArray, stage: str
) -> Trained:
    """`policy` trained in `setup.reality`, with its crashes; the trainer bills the flight."""
    task = setup.task
    training = trainer.train(task, setup.reality, policy, key, setup.context, stage)
    return trained_in_reality(
        training, training.epochs * trainer.worlds(task.n_drones) * task.horizon
    )


def trained_in_reality(training: Training, steps: int) -> Trained:
    """Result of a training that took `steps` steps in reality, summed over worlds."""
    status = "budget" if training.out_of_budget else "ok"
    return Trained(
        policy=training.policy,
        ledger=Ledger(
            training_crashes=training.crashes,
            training_crash_step_rate=training.contact_steps / steps,
            epochs=training.epochs,
            skipped_updates=training.skipped,
            train_seconds=training.seconds,
        ),
        curves=training.curves,
        status="diverged" if training.diverged else status,
        notes={"training_reward": training.final_reward},
    )
