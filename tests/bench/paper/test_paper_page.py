"""The page of claims: what stands in it, and that it is a function of the tables."""

import dataclasses
import functools
import itertools
import re
from pathlib import Path

import pytest
from browser import needs_chromium, tab
from matplotlib.figure import Figure
from paper_tables import TASKS, add_off_spec, lines_of
from tables_for_tests import Sheet, empty, typical

from bench.paper import claims
from bench.paper.claims import CLAIMS
from bench.paper.page import (
    CELLS,
    SOURCE,
    THE_PAPER,
    TITLE,
    WHY,
    cells_document,
    content_of,
    document,
    judged,
    write_claims,
)
from bench.paper.values import WORDS
from bench.stats.scores import PRIMARY
from bench.stats.verdicts import Verdict
from bench.store.tables import Tables
from bench.text.errors import UsageError

ROOT = Path(__file__).parents[3]
HOSTILE = "<script>alert(1)</script>|x` $\\bad$ ![](http://example.org/x.png)"
"""A name that would be a script, a cell, a formula and a picture if it were not escaped."""


def written(tables):
    """The Markdown of both pages, whose figures nobody draws."""
    own = content_of(tables)
    return document(own, [], {}, "cells.md") + cells_document(own, {}, "answers.md")


@pytest.mark.parametrize("name", ["page.md", "page_cells.md", "page_why.md"])
def test_a_folder_in_the_place_of_a_page_is_refused_before_anything_is_written(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(UsageError, match="is a folder, so no file can be written there"):
        write_claims(Sheet().tables(), tmp_path / "page.md")
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_markdown_html_and_all_figures_are_written(full):
    assert sorted(path.name for path in full.iterdir()) == [
        "paper.html",
        "paper.md",
        "paper_cells.html",
        "paper_cells.md",
        "paper_cost.png",
        "paper_flights.png",
        "paper_pipeline.png",
        "paper_summary.png",
        "paper_why.html",
        "paper_why.md",
        "paper_worlds.png",
    ]


def test_figures_stand_in_the_markdown_by_name_and_in_the_html_whole(text, html):
    parts = ("cost", "pipeline", "summary", "flights", "worlds")
    names = [f"paper_{part}.png" for part in parts]
    assert re.findall(r"!\[.*\]\((.*)\)", text) == names
    assert html.count('<img src="data:image/png;base64,iVBOR') == len(names)
    assert "paper_cost.png" not in html


def test_notes_are_a_page_whose_headings_the_answers_list(text, html, full):
    assert "## Why\n\n- [Lags](paper_why.md#lags)\n\n" in text
    assert "*lag*" not in text
    assert 'href="paper_why.html#lags"' in html
    why = (full / "paper_why.md").read_text(encoding="utf-8")
    assert why == f"# {WHY}\n\n[The answers](paper.md).\n\n## Lags\n\nBecause of *lag*.\n"
    assert "<em>lag</em>" in (full / "paper_why.html").read_text(encoding="utf-8")


def test_tasks_stand_beside_a_team_size_where_they_differ():
    sheet = Sheet().add_upper().add(rewards=(-50.0, -51.0))
    cell = {"task": "circle", "team_size": 7}
    sheet.add_upper(**cell).add(rewards=(-50.0, -51.0), **cell)
    found = written(sheet.tables())
    assert lines_of(found, "| N = 3 (spread) | from 0 |")
    assert lines_of(found, "| N = 7 (circle) | from 0 |")
    assert "Scores are means over" not in found


def test_a_claim_that_every_cell_run_so_far_supports_is_listed_apart():
    sheet = Sheet()
    for method, residual, reward in (("lf_baseline", "", -9.0), ("hybrid", "mlp", -5.0)):
        rewards = tuple(reward - 0.01 * seed for seed in range(5))
        sheet.add(method, residual, task="spread", team_size=3, rewards=rewards)
    _, listed = written(sheet.tables()).split("- **Supported so far, with cells still to run** (")
    listed = listed.split("- **")[0].splitlines()
    assert "  - Hybrid deploys above the LF baseline in every cell" in listed
    assert "  - Hybrid deploys above the LF baseline in most cells" in listed


@pytest.mark.parametrize("sizes", [(3, 5, 7, 9, 12, 18), (3, 5)])
def test_what_holds_on_average_alone_is_listed_apart_once_all_cells_were_run(sizes):
    sheet = Sheet()
    for task, size in itertools.product(TASKS, sizes):
        cell = {"task": task, "team_size": size}
        sheet.add_upper(**cell)
        for seed in range(5):
            lead = 20.0 if task == "circle" else 0.2 * (seed - 2)  # clear, and none
            base = -60.0 - 0.1 * seed
            sheet.add(rewards=(base,), first_seed=seed, **cell)
            sheet.add("hybrid", "mlp", rewards=(base + lead,), first_seed=seed, **cell)
    (claim,) = (j for j in judged(sheet.tables()) if j.claim is CLAIMS[0])
    assert claim.finding.verdict is Verdict.UNDECIDED
    assert "Hybrid's score is" in claim.finding.ours
    _, *listed = written(sheet.tables()).split(
        "- **Undecided cell by cell, though the mean over all cells speaks for it"
    )
    assert bool(listed) == (len(sizes) == 6)
    assert all(f"\n  - {CLAIMS[0].title}\n" in part.split("- **")[0] for part in listed)


def test_an_average_that_most_cells_contradict_is_not_listed():
    sheet = Sheet()
    for task, lead in (("circle", 90.0), ("spread", -1.0), ("figure8", -1.0)):
        sheet.add_upper(task=task)
        for seed in range(5):
            sheet.add(rewards=(-99.0 - 0.1 * seed,), first_seed=seed, task=task)
            rewards = (-99.0 - 0.1 * seed + lead,)
            sheet.add("hybrid", "mlp", rewards=rewards, first_seed=seed, task=task)
    found = CLAIMS[0].rule.judge(sheet.tables(), PRIMARY)
    assert "higher over 3 cells. In 2 of these LF baseline is better" in found.ours
    assert found.pooled is Verdict.UNDECIDED


def test_sections_without_anything_tested_are_left_out():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-50.0, -51.0))
    found = written(sheet.tables())
    assert [line.removeprefix("## ") for line in lines_of(found, "## ")] == [
        "What holds",
        claims.PAPER,
        "Hybrid has no HF training crash",
        SOURCE,
    ]
    assert "- **Not tested** (" in found


@pytest.mark.parametrize(("simulator", "title"), [("crazyflow", ""), ("rotorpy", " in rotorpy")])
def test_the_title_names_a_simulator_that_is_not_the_default(simulator, title):
    tables = Sheet().add("hybrid", "mlp", rewards=(-50.0, -51.0)).tables()
    results = tables.results.assign(simulator=simulator)
    found = document(content_of(dataclasses.replace(tables, results=results)), [], {}, "x.md")
    assert found.startswith(f"# How to train a drone team{title}: the paper's claims beside ours\n")


def test_a_page_of_no_rows_is_complete_and_has_no_figure_of_rows(tmp_path):
    write_claims(empty(), tmp_path / "page.md")
    found = (tmp_path / "page.md").read_text(encoding="utf-8")
    ours = sum(claim.section == claims.OWN for claim in CLAIMS)
    papers = len(CLAIMS) - ours
    said = (
        f"{THE_PAPER} makes {papers} claims that can be tested here. By the settled reward, which "
        f"leaves out take-off, {papers} are not tested ([which](#what-holds)). By the return of "
        f"the whole episode, the paper's own measure, {papers} are not tested. Of {ours} claims "
        f"that we add, {ours} are not tested by the settled reward."
    )
    begin = f"# {TITLE.format('')}\n\n{said}\n\n{WORDS}\n\n## What holds\n\n"
    assert found.startswith(f"{begin}- **Not tested** (")
    cells = (tmp_path / "page_cells.md").read_text(encoding="utf-8")
    assert cells == f"# {CELLS}\n\n[What follows from these tables](page.md).\n"
    assert found.endswith("\n\n0 runs.\n")
    n_paper = sum(claim.section == claims.PAPER for claim in CLAIMS)
    assert found.count("| - | not tested | not tested |") == n_paper
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "page.html",
        "page.md",
        "page_cells.html",
        "page_cells.md",
        "page_pipeline.png",
    ]


def test_the_same_tables_make_the_same_bytes(tmp_path):
    for folder in ("first", "second"):
        write_claims(typical(), tmp_path / folder / "page.md")
    first, second = (
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()}
        for folder in ("first", "second")
    )
    assert len(first) == 8
    assert first == second


def test_rows_in_another_order_make_the_same_page():
    tables = typical()
    turned = {
        name: getattr(tables, name).iloc[::-1].reset_index(drop=True)
        for name in ("results", "curves", "trajectories", "runs")
    }
    assert written(Tables(**turned)) == written(tables)


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """A page of tables in which every name is hostile."""
    path = tmp_path_factory.mktemp("hostile") / "page.md"
    sheet = Sheet()
    for method, residual in ((HOSTILE, ""), ("hybrid", "mlp"), ("lf_baseline", "")):
        cell = {"task": HOSTILE, "rewards": (-50.0, -51.0)}
        sheet.add(method, residual, **cell)
        sheet.add(method, residual, variant=HOSTILE, **cell)
    sheet.add("hybrid", "mlp", variant="flights=32", **cell)
    sheet.add_upper(task=HOSTILE)
    world = {"recalibrated": -55.0, "lf": -80.0, "tracked": -90.0, "effects": HOSTILE}
    add_off_spec(sheet, {"task": HOSTILE}, **world)
    for row in sheet.runs:
        row.update(commit=HOSTILE, machine=HOSTILE)
    write_claims(sheet.tables(), path)
    return path


def test_hostile_names_stay_text(hostile):
    for path, n_pictures in ((hostile, 5), (hostile.with_stem("page_cells"), 1)):
        found = path.read_text(encoding="utf-8")
        html = path.with_suffix(".html").read_text(encoding="utf-8")
        body = html[html.index("<main") : html.index("</main>")]
        assert "<script" not in body
        assert "&lt;script&gt;alert(1)&lt;/script&gt;" in body
        assert re.findall(r'<img src="([^"]{10})', body) == ["data:image"] * n_pictures
        for table in re.findall(r"(?:^\|.*\n)+", found, re.MULTILINE):
            bars = {len(re.findall(r"(?<!\\)\|", line)) for line in table.splitlines()}
            assert len(bars) == 1, table


@needs_chromium
@pytest.mark.parametrize(("name", "n_pictures"), [("page.html", 5), ("page_cells.html", 1)])
def test_a_hostile_page_opens_without_a_complaint_or_a_request(hostile, tmp_path, name, n_pictures):
    path = hostile.with_name(name)
    with tab(tmp_path / "profile") as opened:
        opened.open(path)
        assert "alert(1)" in opened.run("document.body.textContent")
        drawn = "[...document.images].map((image) => image.naturalWidth)"
        assert len(opened.run(drawn)) == n_pictures
        assert min(opened.run(drawn)) > 100
        assert opened.complaints == []
        assert all(url.startswith(("file:", "data:")) for url in opened.requests)


def test_notes_that_cannot_be_read_are_named_before_anything_is_written(tmp_path):
    (tmp_path / "notes.md").write_bytes(b"\xff\xfe\xff")
    for notes in ("notes.md", "nowhere.md"):
        with pytest.raises(UsageError, match=rf"notes in .*{notes} cannot be read"):
            write_claims(empty(), tmp_path / "out" / "page.md", tmp_path / notes)
    with pytest.raises(UsageError, match="HTML beside it"):
        write_claims(empty(), tmp_path / "out" / "page.html")
    assert not (tmp_path / "out").exists()


def test_the_committed_page_is_that_of_the_committed_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: Path(path).write_bytes(b""))
    (claimed,) = re.findall(r"^CLAIMED := (.+)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    suites = [Tables.load(ROOT / "results" / name) for name in claimed.split()]
    tables, reports = functools.reduce(Tables.merged, suites), ROOT / "reports"
    write_claims(tables, tmp_path / "paper.md", reports / "paper_notes.md")
    for name in ("paper.md", "paper_cells.md", "paper_why.md"):
        own = (tmp_path / name).read_text(encoding="utf-8")
        assert own == (reports / name).read_text(encoding="utf-8")
    found = (tmp_path / "paper.md").read_text(encoding="utf-8")
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    settled = re.findall(r"leaves out take-off, (.+?) \(\[which", found)
    whole = re.findall(r"the paper's own measure, (.+?)\. Of ", found)
    assert [(text in readme) for text in settled + whole] == [True, True]
    write_claims(Tables.load(ROOT / "results" / "paper_rotorpy"), tmp_path / "rotorpy_claims.md")
    for name in ("rotorpy_claims.md", "rotorpy_claims_cells.md"):
        own = (tmp_path / name).read_text(encoding="utf-8")
        assert own == (reports / name).read_text(encoding="utf-8")
