"""The tutorials: their files and commands are executed, their numbers are those of the tables."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from installed import fresh_registry

import bench
from bench.cli.app import main
from bench.report.leaderboard import leaderboard_rows, split
from bench.stats.scores import scored
from bench.stats.statistics import Cell, Entry, seed_values
from bench.store.tables import Tables
from tests.docs.blocks import blocks

HOUSE = Path(__file__).parents[2]
METHOD, BOARD = (HOUSE / "docs" / f"tutorial_{name}.md" for name in ("method", "leaderboard"))
PAPER = HOUSE / "results" / "paper"
CELL = Cell("circle", 12)
"""The example of the page on leaderboards."""
SMALL = ["--seeds", "1", "--setting", "trainer.epochs=2", "--setting", "trainer.n_worlds=1"]
"""What makes a training of the tutorial take seconds."""


@pytest.fixture(scope="module")
def tables():
    return bench.load(PAPER)


@pytest.fixture
def workplace(tmp_path):
    """A folder that looks like the root of a clone, with the files that the page has one write."""
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "paper").symlink_to(PAPER)
    folder = tmp_path / "guessed_drag"
    folder.mkdir()
    ((code,), (project,)) = blocks(METHOD, "python"), blocks(METHOD, "toml")
    (folder / "guessed_drag.py").write_text(code)
    (folder / "pyproject.toml").write_text(project)
    return tmp_path


@pytest.fixture
def call(workplace, monkeypatch, capsys):
    """Exit status and all that is said by pip, or by a program that then finds it."""
    site = workplace / "site"
    site.mkdir()
    pip = [sys.executable, "-m", "pip", "--disable-pip-version-check"]

    def called(program, *arguments):
        if program != "pip":
            return main([*arguments]), "".join(capsys.readouterr())
        # As the page says, but into a folder of this test, and from what is on this machine.
        given = [x for x in arguments if x != "-e"] + ["--no-index", "--target", str(site)]
        done = subprocess.run(
            [*pip, *given], capture_output=True, text=True, check=False, timeout=600
        )
        return done.returncode, done.stdout + done.stderr

    monkeypatch.chdir(workplace)
    monkeypatch.setenv("COLUMNS", "200")
    with fresh_registry(site):
        yield called
    sys.modules.pop("guessed_drag", None)


def test_the_method_gets_from_an_empty_folder_to_a_row_that_is_verified(workplace, call):
    commands = [
        shlex.split(line.removeprefix("$ "))
        for line in "\n".join(blocks(METHOD, "console")).splitlines()
        if line
    ]
    said, statuses = {}, {}
    for program, *arguments in commands:
        if arguments[0] == "run":
            seeds = arguments.index("--seeds")
            arguments = [*arguments[:seeds], *arguments[seeds + 2 :], *SMALL, "--jobs", "1"]
        if arguments[0] == "compare":
            continue  # one seed compares with nothing; the command is parsed like all others
        status, text = call(program, *arguments)
        statuses[arguments[0]], said[arguments[0]] = status, text
    assert [*statuses] == ["install", "list", "check", "run", "submit", "verify"]
    assert {*statuses.values()} == {0}, said
    assert "A point mass with guessed drag and delay" in said["list"]
    assert "guessed-drag 1.0.0" in said["list"]
    assert re.search(r"Beside \d+ runs of results/paper, in circle, N = 3\.", said["run"])
    assert "reproduced to the digit" in said["verify"]
    board = (workplace / "results" / "mine" / "leaderboard.md").read_text()
    assert "guessed_drag" in board
    assert "| grey_box |" in board
    own = Tables.load(workplace / "results" / "mine")
    assert [*own.runs["method"]] == ["guessed_drag"]


def test_the_method_is_the_one_of_the_readme():
    ((tutorial,), (readme,)) = blocks(METHOD, "python"), blocks(HOUSE / "README.md", "python")
    assert len(readme.splitlines()) <= 15
    for line in readme.splitlines():
        # The tutorial annotates `train`, and what it guesses are settings.
        if not line.strip().startswith(("def train(", "guess = ")):
            assert line in tutorial.splitlines()


def with_board(page: str, tables: Tables) -> str:
    """The page with the rows that the tables have now in the place of those that it shows."""
    lines = page.splitlines(keepends=True)
    shown = [i for i, line in enumerate(lines) if line.startswith("|")]
    headings = [cell.strip() for cell in lines[shown[0]].strip("|\n").split("|")]
    columns, own = next(
        (columns, rows) for columns, rows in split(leaderboard_rows(tables)) if rows[0]["cell"]
    )
    by_heading = {column.heading: column for column in columns}
    rows = [
        f"| {' | '.join(by_heading[heading].text(row) for heading in headings)} |\n"
        for row in own
        if row["cell"] == CELL
    ]
    return "".join([*lines[: shown[0] + 2], *rows, *lines[shown[-1] + 1 :]])


def test_the_board_on_the_page_is_that_of_the_tables(tables):
    """Where it is not: `PYTHONPATH=tests:. python -m tests.docs.test_tutorials` writes it anew."""
    page = BOARD.read_text(encoding="utf-8")
    assert with_board(page, tables) == page


def test_the_answer_on_the_page_is_that_of_the_command(capsys, monkeypatch):
    monkeypatch.chdir(HOUSE)
    (command,), (answer,) = blocks(BOARD, "console"), blocks(BOARD, "text")
    assert main(shlex.split(command.removeprefix("$ bench "))) == 0
    assert capsys.readouterr().out == answer


def test_the_numbers_in_the_text_are_those_of_the_tables(tables):
    text = " ".join(BOARD.read_text(encoding="utf-8").split())
    settled = seed_values(tables.results, "settled_reward")[CELL]
    mean = {entry.method: sum(x.values()) / len(x) for entry, x in settled.items()}
    worst, best = min(settled[Entry("grey_box")].values()), max(settled[Entry("grey_box")].values())
    assert f"lie between {worst:.1f} and {best:.1f}" in text
    assert f"{mean['hf_scratch'] - mean['grey_box']:.1f} behind for half a minute" in text
    times = mean["lf_baseline"] / mean["hf_scratch"]
    scores = seed_values(scored(tables), "score")[CELL][Entry("lf_baseline")].values()
    score = sum(scores) / len(scores)
    assert f"{times:.0f} times that of `hf_scratch`" in text
    assert f"and its score is {score:.3f}" in text


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ("--team-size", "5", "--budget", "5000"),
            "to be worse: hf_hotstart, score 0.989",
        ),
        (("--team-size", "3", "--budget", "0"), "N = 3, up to 0 fleet-minutes: lf_baseline."),
        (("--team-size", "6", "--budget", "5"), "runs with these numbers of drones: 3, 5"),
        (
            ("--team-size", "12", "--budget", "5000", "--task", "circle"),
            "N = 12, up to 5000 fleet-minutes: hf_scratch.",
        ),
        (("--team-size", "3", "--budget", "5", "--task", "cirle"), "no runs of 'cirle'; its tasks"),
        (("--team-size", "3", "--budget", "-1"), "must be at least 0 fleet-minutes, got -1.0."),
    ],
)
def test_a_choice_names_ties_and_what_there_is(arguments, said, capsys):
    main(["choose", str(PAPER), *arguments])
    assert said in "".join(capsys.readouterr())


if __name__ == "__main__":
    BOARD.write_text(with_board(BOARD.read_text(encoding="utf-8"), bench.load(PAPER)), "utf-8")
