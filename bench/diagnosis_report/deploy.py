"""What a diagnosis is worth to a team: policies trained in the corrected simulator, deployed.

In a simulated reality (`crazyflow+mass(e=0.2)+wind(x=1)`) the same task is trained four ways: in
the nominal point mass, in the point mass with the effects that the diagnosis identified from three
flights there, with a black-box residual, and in the reality itself from a hot start. All four are
deployed in that reality from the same initial states. The gap that counts is the one between the
settled rewards of the nominal policy and the hot start.
"""

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from bench.diagnosis_report.documents import check_place
from bench.plan.realities import NOMINAL, parse_reality, written
from bench.stats.scores import PRIMARY
from bench.stats.statistics import COUNTED, FAILURES, Entry
from bench.text.errors import UsageError
from bench.text.markdown import text_table
from bench.text.numbers import MISSING
from bench.text.say import say
from methods.contract import Setup, Trained
from methods.running.metered import train_metered
from methods.training.context import Context
from methods.training.evaluate import evaluate
from methods.training.policy import PolicyController
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.effects.chain import canonical

WAYS = (Entry("lf_baseline"), Entry("grey_box"), Entry("hybrid", "mlp"), Entry("hf_hotstart"))
"""Methods and residuals that are compared; the first is the parent of the others."""


def deploy(
    task_name: str, reality_text: str, team_size: int, seeds: int, out: Path, console: Console
) -> int:
    """Trains and deploys all ways, writes deploy.json and deploy.md, shows the table.

    Both are written after every seed, with what there is by then.

    Raises:
        UsageError: The reality is not understood, a number is out of range, or `out` cannot be
            written to.
    """
    if seeds < 1 or team_size < 2:
        raise UsageError(
            f"`--seeds` must be 1 or more and `--team-size` 2 or more, got {seeds} and {team_size}."
        )
    reality = parse_reality(reality_text)
    task = registry.load("task", task_name)(n_drones=team_size)
    names = ("deploy.json", "deploy.md")
    check_place(out, names)
    content: dict[str, Any] = {
        "task": task_name,
        "team_size": team_size,
        "reality": written(reality),
        "runs": [],
    }
    for seed in range(seeds):
        content["runs"] += _seed(task, reality, seed, console)
        content["ways"] = _summary(content["runs"])
        out.mkdir(parents=True, exist_ok=True)
        texts = json.dumps(content, indent=1, allow_nan=False) + "\n", _markdown(content)
        for name, text in zip(names, texts, strict=True):
            (out / name).write_text(text, encoding="utf-8")
    _show(content, console)
    say(console, f"Written: {out / 'deploy.md'}")
    return 0


def _seed(
    task: Any, reality: AbstractSimulator, seed: int, console: Console
) -> list[dict[str, Any]]:
    """One row a way, all from the same initial states."""
    nominal = registry.load("simulator", NOMINAL)()
    parents: dict[str, Trained] = {}
    rows = []
    with console.status("training") as status:
        for entry in WAYS:
            way = entry.label

            def shown(stage: str, epoch: int, epochs: int, reward: float, way: str = way) -> None:
                status.update(f"seed {seed}, {way}: {stage} {epoch} of {epochs}")

            given = {"residual": entry.residual} if entry.residual else {}
            method = registry.load("method", entry.method)(**given)
            setup = Setup(task, nominal, reality, parents, Context(shown))
            key = jax.random.fold_in(jax.random.key(seed), 0)
            trained = train_metered(method, setup, key)
            parents.setdefault(entry.method, trained)
            deployed = evaluate(task, reality, PolicyController(task, trained.policy), seed)
            rows.append(
                {
                    "way": way,
                    "seed": seed,
                    PRIMARY: _finite(deployed.settled_reward),
                    "reward": _finite(deployed.reward),
                    "crashes": _finite(deployed.crashes),
                    "fleet_minutes": trained.ledger.hf_fleet_seconds / 60.0,
                    "train_seconds": trained.ledger.train_seconds,
                    "status": trained.status,
                    "effects": canonical(trained.effects, digits=4),
                }
            )
            said = f" ({trained.status})" if trained.status in FAILURES else ""
            say(console, f"seed {seed}, {way}: settled reward {deployed.settled_reward:.1f}{said}")
    return rows


def _summary(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Mean over seeds, and the share of the gap from nominal to hot start that is closed.

    Without a share where the hot start is no better than the nominal policy.

    A diverged training counts with the policy that it left; the number of diverged trainings
    stands beside the mean. The gap uses the seeds in which all three ways have a return.
    """
    ok = {(r["way"], r["seed"]): r for r in rows if _counts(r)}
    low, high = WAYS[0].label, WAYS[-1].label
    found = []
    for way in dict.fromkeys(row["way"] for row in rows):
        seeds = [row["seed"] for row in rows if row["way"] == way]
        mine = [ok[way, seed] for seed in seeds if (way, seed) in ok]
        numbers = (PRIMARY, "reward", "crashes", "fleet_minutes", "train_seconds")
        means = {key: float(np.mean([r[key] for r in mine])) if mine else None for key in numbers}
        common = [s for s in seeds if all((name, s) in ok for name in (way, low, high))]
        reward = lambda name, common=common: sum(ok[name, s][PRIMARY] for s in common)  # noqa: E731
        gap = reward(high) - reward(low)
        closed = (reward(way) - reward(low)) / gap if gap > 1e-9 else None
        ended = [row["status"] for row in rows if row["way"] == way]
        diverged = sum(status in FAILURES for status in ended)
        found.append({"way": way, **means, "closed": closed, "diverged": diverged})
    return found


def _counts(row: dict[str, Any]) -> bool:
    return row["status"] in COUNTED and row[PRIMARY] is not None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


_HEADINGS = (
    *("trained by", "settled reward", "gap closed", "reward", "crashes"),
    *("HF fleet-minutes", "training time"),
)


def _cells(line: dict[str, Any]) -> list[str]:
    closed = "" if line["closed"] is None else f"{100 * line['closed']:.0f} %"
    diverged = f", {line['diverged']} diverged" if line["diverged"] else ""
    if line[PRIMARY] is None:
        return [line["way"] + diverged, *[MISSING] * (len(_HEADINGS) - 1)]
    return [
        line["way"] + diverged,
        f"{line[PRIMARY]:.1f}",
        closed,
        f"{line['reward']:.1f}",
        f"{line['crashes']:.2f}",
        f"{line['fleet_minutes']:.1f}",
        f"{line['train_seconds']:.0f} s",
    ]


def _markdown(content: dict[str, Any]) -> str:
    seeds = len({row["seed"] for row in content["runs"]})
    found = {row["effects"] for row in content["runs"] if row["way"] == "grey_box"}
    return (
        "\n\n".join(
            [
                f"# {content['task']}, N = {content['team_size']}, in `{content['reality']}`",
                f"Mean over {seeds} seed{'s' if seeds > 1 else ''}; gap closed: 0 % is the nominal "
                "policy, 100 % the hot start; where that is no better there is no gap.",
                text_table(_HEADINGS, map(_cells, content["ways"])),
                "Effects that were identified: " + "; ".join(f"`{text}`" for text in sorted(found)),
            ]
        )
        + "\n"
    )


def _show(content: dict[str, Any], console: Console) -> None:
    table = Table(title=f"{content['task']}, N = {content['team_size']}, {content['reality']}")
    for i, heading in enumerate(_HEADINGS):
        table.add_column(heading, justify="left" if i == 0 else "right")
    for line in content["ways"]:
        table.add_row(*_cells(line))
    console.print(table)
