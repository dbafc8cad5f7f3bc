"""README.md and docs/: numbers are those of the tables, commands and code are real, links lead."""

import inspect
import re
import shlex
from importlib.metadata import entry_points
from pathlib import Path

import diagnoses_for_tests
import jax
import numpy as np
import pytest

import bench
import diagnosis
from bench.cli.app import make_app
from bench.conformance.command import declarations
from bench.conformance.suite import execute
from bench.stats.choices import choose, on_task
from bench.stats.scores import PRIMARY, undisturbed
from bench.stats.statistics import Cell, Entry
from bench.text import markdown
from bench.text.numbers import mean_std, significant
from diagnosis.result import Diagnosis
from methods.contract import Setup
from methods.training.bptt import BPTT
from simulators import registry
from simulators.point_mass import PointMass
from tasks.circle import Circle
from tests.docs.blocks import blocks

HOUSE = Path(__file__).parents[2]
README = HOUSE / "README.md"
PAGES = [README, HOUSE / "CONTRIBUTING.md", *sorted((HOUSE / "docs").glob("*.md"))]
REPORTS = sorted((HOUSE / "reports").glob("*.md"))
IMPORTS = """
from typing import ClassVar
import equinox as eqx
import jax
from methods.contract import AbstractMethod
from methods.training.policy import make_policy
from methods.training.bptt import BPTT
from methods.running.low_fidelity import train_in_point_mass
from simulators.contract import with_effects
from simulators.effects.delay import Delay
from simulators.effects.drag import Drag
"""
"""What the README's method needs; the page leaves it out."""


def commands():
    """Every command of ours in a page, as a user would type it."""
    for page in PAGES:
        for line in "\n".join(blocks(page, "console")).splitlines():
            if line.startswith("$ bench"):
                yield page.name, line.removeprefix("$ bench ").split(" > ")[0]


def test_the_readme_fits_a_few_screens():
    assert len(README.read_text(encoding="utf-8").splitlines()) <= 120


def test_the_table_of_the_readme_is_that_of_the_tables():
    frame = bench.load(HOUSE / "results" / "paper").to_pandas()
    rows = frame.query("team_size == 3 and variant == ''")
    lines = [
        [cell.strip() for cell in line.strip("|\n").split("|")]
        for line in README.read_text(encoding="utf-8").splitlines()
        if line.count("|") == 8
    ]
    (_, *tasks, _, _), _, *shown = lines
    assert {"grey_box", "domain_randomization"} <= {row[0] for row in shown}
    for label, *cells, minutes, off in shown:
        mine = [
            Entry(*x).label == label for x in rows[["method", "residual", "variant"]].to_numpy()
        ]
        own = rows[mine]
        by_task = own.groupby("task")["settled_reward"]
        assert set(by_task.size()) == {5}
        assert cells == [mean_std(by_task.mean()[t], by_task.std()[t]) for t in tasks], label
        assert minutes == significant(own["fleet_minutes"].mean()), label
        assert off == f"{1e3 * own[own['task'] == 'circle']['position_error'].mean():.0f}", label
    best = {row[0]: [float(cell.split()[0]) for cell in row[1:-2]] for row in shown}
    others = [best[name] for name in best if name not in ("grey_box", "hf_scratch", "hf_hotstart")]
    assert all(g > max(o) for g, o in zip(best["grey_box"], zip(*others, strict=True), strict=True))


def or_of(entries):
    """Methods as the README names them; residuals of one method after its name."""
    residuals = " or ".join(f"`{entry.residual}`" for entry in entries if entry.residual)
    (method,) = {entry.method for entry in entries}
    return f"`{method}` with {residuals}" if residuals else f"`{method}`"


def test_the_readme_chooses_as_the_tables_do():
    tables = bench.load(HOUSE / "results" / "paper")
    rewards = undisturbed(tables, PRIMARY)
    shown = re.findall(r"^\| (\w+) \| (3|12) \| (`.+) \|$", README.read_text("utf-8"), re.M)
    tasks = ("circle", "figure8", "pitchandexpand", "spread")
    assert [(task, int(n)) for task, n, _ in shown] == [(t, n) for t in tasks for n in (3, 12)]
    for task, n, cells in shown:
        alone, size = on_task(tables, task), int(n)
        for budget, cell in zip((0, 0.5, 500, 5000), cells.split(" | "), strict=True):
            found = choose(alone, size, budget)
            seeds = rewards[Cell(task, size, "crazyflow", "")][found.best].values()
            near = [tie.entry for tie in found.tied if tie.near]
            others = f" (or {or_of(near)})" if near else ""
            said = f"`{found.best.label}` {sum(seeds) / len(seeds):.1f}{others}"
            assert cell == said, (task, size, budget)


def test_grey_box_has_the_highest_mean_of_all_that_needs_little_flight():
    assert "in all 24 cells" in README.read_text("utf-8")
    tables = bench.load(HOUSE / "results" / "paper")
    for task in sorted({*tables.runs["task"]}):
        alone = on_task(tables, task)
        for size in sorted({*alone.runs["team_size"]}):
            for budget in (0.5, 50.0):
                assert choose(alone, size, budget).best == Entry("grey_box"), (task, size)


@pytest.mark.parametrize("page", [*PAGES, *REPORTS], ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.M)
    for target in re.findall(r"\]\(([^)#]+)[^)]*\)", text):
        if not target.startswith("http"):
            assert (page.parent / target).exists(), target
    for target, place in re.findall(r"\]\(([^)#]*)#([^)]+)\)", text):
        if not target.startswith("http") and (not target or target.endswith(".md")):
            there = page.parent / target if target else page
            assert place in anchors(there), f"{target}#{place}"


def anchors(page):
    """Where links find the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.M)
    return {markdown.anchor(heading) for heading in headings}


@pytest.mark.parametrize(("page", "command"), list(commands()))
def test_every_command_is_one_that_the_program_takes(page, command):
    words = shlex.split(command, comments=True)
    make_app().parse_args(words, exit_on_error=False, print_error=False)


def test_every_command_is_on_a_page():
    shown = {command.split()[0] for _, command in commands()}
    assert {*registry.names("command")} - shown <= {"keep"}


def test_the_method_of_the_readme_keeps_its_contract_and_trains(key):
    (code,) = blocks(README, "python")
    assert len(code.splitlines()) <= 15
    names = {}
    exec(IMPORTS + code, names)
    method = names["GuessedDrag"]
    assert not [x.problem for x in execute(method, declarations("method", method, {})) if x.problem]
    short = method(trainer=BPTT(epochs=2, smoothing=1, n_worlds=1))
    trained = short.train(Setup(Circle(n_drones=2, horizon=5), PointMass(), PointMass()), key)
    assert trained.status == "ok"
    assert trained.ledger.epochs == 2
    assert trained.ledger.hf_fleet_seconds == 0
    assert all(np.isfinite(x).all() for x in jax.tree.leaves(trained.curves))


def test_the_python_of_the_pages_runs(monkeypatch, capsys):
    """Trainings and fits are left out, but what they are asked must fit their signatures."""
    found = diagnoses_for_tests.load(diagnoses_for_tests.effect())

    def asked(function, answer):
        signature = inspect.signature(function)

        def instead(*arguments, **options):
            signature.bind(*arguments, **options)
            return answer

        return instead

    tables = bench.load(HOUSE / "results" / "paper")
    monkeypatch.chdir(HOUSE)
    monkeypatch.setattr(bench, "run", asked(bench.run, tables))
    monkeypatch.setattr(diagnosis, "diagnose", asked(diagnosis.diagnose, found))
    monkeypatch.setattr(Diagnosis, "load", asked(Diagnosis.load, found))
    for page in ("running.md", "diagnosis.md"):
        (code,) = blocks(HOUSE / "docs" / page, "python")
        exec(code, {})
    assert "effect ['mass']" in capsys.readouterr().out


def test_the_page_on_diagnosis_says_which_flight_shows_an_effect():
    text = (HOUSE / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    rows = [line.split(" | ") for line in text.splitlines() if line.startswith("| ")]
    cards = {name: registry.load("effect", name).card for name in registry.names("effect")}
    for name, flight in ((name, card.flight) for name, card in cards.items() if card.flight):
        (row,) = (row for row in rows if len(row) == 4 and f"`{name}`" in row[1])
        assert flight in row[2]


def test_the_architecture_counts_the_effects():
    text = (HOUSE / "docs" / "architecture.md").read_text(encoding="utf-8")
    assert f"({len(entry_points(group='bench.effects'))} physical effects" in text
