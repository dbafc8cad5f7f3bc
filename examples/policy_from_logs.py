"""Trains a policy for a team from what flights of one drone showed.

    bench diagnose FLIGHTS --simulator point_mass
    python examples/policy_from_logs.py reports/diagnosis/FLIGHTS/diagnosis.json --task circle

The policy is trained in the point mass with the effects of the diagnosis; no drone flies for it.
The file holds, as NumPy arrays, the weights of its network and the scales of its action:

    action = tanh(w2 tanh(w1 tanh(w0 observation + b0) + b1) + b2)
    roll, pitch = tilt_limit action[:2] [rad],  thrust = thrust_max (action[2] + 1) / 2 [N]
"""

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np

import diagnosis
from bench.plan.realities import parse_reality
from bench.text.errors import UsageError
from methods.contract import Setup
from methods.grey_box import GreyBox
from methods.lf_baseline import LFBaseline
from methods.training.context import Context
from methods.training.evaluate import evaluate
from methods.training.policy import AbstractPolicy, PolicyController, is_written_out
from simulators import registry
from simulators.contract import AbstractSimulator


def weights(policy: AbstractPolicy) -> dict[str, Any]:
    """Weights w0, w1, w2 and biases b0, b1, b2 of the layers, from the observation on."""
    assert is_written_out(policy)
    found = {}
    for i, layer in enumerate(policy.net.layers):
        found |= {f"w{i}": np.asarray(layer.weight), f"b{i}": np.asarray(layer.bias)}
    return found


def scales(model: AbstractSimulator) -> dict[str, Any]:
    """What an action of 1 commands: roll and pitch [rad], thrust [N]."""
    space = model.action_space
    return {"tilt_limit": space.tilt_limit, "thrust_max": space.thrust_max}


def main() -> None:
    """Trains, says what the policy is worth, and writes it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("diagnosis", type=Path, help="diagnosis.json, made with the point mass")
    parser.add_argument("--task", default="circle", choices=registry.names("task"))
    parser.add_argument("--team-size", type=int, default=3)
    parser.add_argument("--epochs", type=int, default=400, help="updates (default: 400)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--likeliest", action="store_true", help="also effects not confirmed")
    parser.add_argument("--reality", help='also flown there: such as "crazyflow+mass(e=0.2)"')
    parser.add_argument("--out", type=Path, default=Path("policy.npz"))
    given = parser.parse_args()
    place = given.out.with_suffix(".npz")
    if not place.absolute().parent.is_dir():
        parser.error(f"--out: there is no folder {place.absolute().parent}.")
    try:
        model = diagnosis.corrected(given.diagnosis, likeliest=given.likeliest)
        task = registry.load("task", given.task)(n_drones=given.team_size)
        method = LFBaseline(trainer=dataclasses.replace(GreyBox().trainer, epochs=given.epochs))
        worlds = {"the corrected point mass": model}
        if given.reality:
            worlds[given.reality] = parse_reality(given.reality)
    except (OSError, ValueError, UsageError, registry.UnknownPluginError) as error:
        parser.error(str(error))

    def shown(stage: str, epoch: int, epochs: int, reward: float) -> None:
        print(f"\r{stage} {epoch} of {epochs}", end="", flush=True)  # noqa: T201

    setup = Setup(task, nominal=model, reality=model, context=Context(shown))
    trained = method.train(setup, jax.random.key(given.seed))
    for name, world in worlds.items():
        flown = evaluate(task, world, PolicyController(task, trained.policy), given.seed)
        print(f"\nSettled reward in {name}: {flown.settled_reward:.1f}", end="")  # noqa: T201
    np.savez(place, **weights(trained.policy), **scales(model))
    print(f"\nWritten: {place} (training: {trained.status})")  # noqa: T201


if __name__ == "__main__":
    main()
