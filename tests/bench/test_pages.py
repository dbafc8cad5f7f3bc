"""Pages in a real browser: they open offline, filter, fly, and no name that they show can act."""

import csv
import re

import diagnoses_for_tests
import matplotlib.image
import numpy as np
import pytest
import tables_for_tests
from browser import needs_axe, needs_chromium, tab

from bench.diagnosis_report.page import diagnosis_page
from bench.report.page import write_page, write_report
from bench.report.replay import write_replay

pytestmark = needs_chromium
HOSTILE = "<script>alert(1)</script>|x"
PART = "document.querySelector('[data-part={}]')"


@pytest.fixture(scope="module")
def chromium(tmp_path_factory):
    with tab(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def report(chromium, tmp_path_factory):
    """The report, open in the browser; what it complains of later is seen by the last test."""
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(tables_for_tests.typical(), path)
    chromium.open(path)
    return chromium


@pytest.fixture(autouse=True)
def nothing_goes_wrong(chromium):
    """Every test ends without a complaint of the console and without a request to elsewhere."""
    yield
    assert chromium.complaints == []
    assert [
        url for url in chromium.requests if not url.startswith(("file:", "data:", "blob:"))
    ] == []


BOARD = "document.querySelector('table.board')"


def column(page, heading, table=BOARD):
    """Texts of a column of the board, as they stand."""
    return page.run(f"""(() => {{
        const table = {table};
        const index = [...table.tHead.rows[0].cells].findIndex(
            (c) => c.textContent.trim() === {heading!r});
        return [...table.tBodies[0].rows].map((row) => row.cells[index].textContent.trim());
    }})()""")


def click_heading(page, heading):
    page.run(f"""[...{BOARD}.tHead.rows[0].cells].find(
        (c) => c.textContent.trim() === {heading!r}).querySelector('.dt-column-order').click()""")


def choose(page, **chosen):
    """Sets filters of the board, as a person would."""
    for name, value in chosen.items():
        page.run(f"filters.elements[{name!r}].value = {value!r}")
    page.run("filters.dispatchEvent(new Event('change'))")


def reset(page):
    page.run("filters.reset()")
    page.wait_for("location.hash === ''")


def seconds(page):
    return float(re.match(r"t = ([0-9.]+) s", page.run(PART.format("readout") + ".textContent"))[1])


def test_a_click_on_a_heading_sorts_and_a_second_one_reverses(report):
    heading = "settled reward (n)"
    found = []
    for _ in range(2):
        click_heading(report, heading)
        found.append([float(text.split()[0]) for text in column(report, heading)])
    assert len(found[0]) > 6
    assert found == [sorted(found[0]), sorted(found[0], reverse=True)]
    assert report.run("document.querySelectorAll('th[aria-sort=descending]').length") == 1
    reset(report)


def test_filters_choose_rows_of_every_board_and_the_address_keeps_them(report, chromium):
    choose(report, N="3", method="hybrid (mlp)")
    others = "document.querySelectorAll('table.board')[1]"
    assert column(report, "method") == ["hybrid (mlp)"]
    assert column(report, "method", others) == ["hybrid (mlp), observe_attitude=true"]
    click_heading(report, "method")
    assert report.run("location.hash") == "#N=3&method=hybrid+%28mlp%29&sort=method%3Aasc"
    report.run("location.hash = '#task=circle&sort=settled+reward+(n):asc&columns=all'")
    report.wait_for(f"{BOARD}.tBodies[0].rows.length === 3")
    means = [float(text.split()[0]) for text in column(report, "settled reward (n)")]
    assert means == [-200.0, -150.0, -140.0]
    assert len(column(report, "epochs")) == 3
    assert report.run("filters.elements.task.value") == "circle"
    # A run that is opened and closed leaves the board and its address as they were.
    report.run(f"{BOARD}.querySelector('a[data-run]').click()")
    report.wait_for("document.getElementById('run').open")
    report.run("document.getElementById('run-close').click()")
    report.wait_for("location.hash.startsWith('#task=circle')")
    reset(report)
    assert len(column(report, "method")) == 9


def test_an_address_with_nonsense_shows_the_whole_board(report):
    report.run("location.hash = '#task=nowhere&sort=nothing:up&other=1'")
    report.wait_for(f"{BOARD}.tBodies[0].rows.length === 9")
    reset(report)


def test_the_board_is_downloaded_as_csv(report):
    choose(report, task="circle")
    report.run("""(() => {
        URL.createObjectURL = (blob) => { blob.text().then((t) => window.saved = t); return '#'; };
        document.querySelector('.buttons-csv').click();
    })()""")
    report.wait_for("window.saved !== undefined")
    rows = list(csv.reader(report.run("window.saved").lstrip("\ufeff").splitlines()))
    assert rows[0][:3] == ["method", "task", "N"]
    assert "epochs" in rows[0]
    assert [row[:3] for row in rows[1:] if row] == [
        ["hf_scratch", "circle", "12"],
        [HOSTILE, "circle", "12"],
        ["lf_baseline", "circle", "12"],
    ]
    reset(report)


def test_ties_and_lost_runs_can_be_seen(report):
    choose(report, N="3")
    ties = dict(zip(column(report, "method"), column(report, "ties"), strict=True))
    assert ties["hf_hotstart"] == ties["hybrid (mlp)"] == "a"
    report.run("filters.elements.columns.click()")
    runs = column(report, "runs")
    assert any("1 failed (seed 2)" in text for text in runs)
    assert any("1 diverged (seed 1)" in text for text in runs)
    assert "1 failed" in report.run("document.querySelector('.facts').textContent")
    reset(report)


@pytest.mark.parametrize("width", [1280, 390])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_no_page_is_wider_than_its_window_and_its_colours_follow_the_scheme(
    chromium, tmp_path, width, scheme
):
    chromium.prefer(scheme)
    write_report(tables_for_tests.typical(), tmp_path / "report.html")
    chromium.open(tmp_path / "report.html", width=width)
    chromium.run("document.querySelectorAll('details').forEach((d) => d.open = true)")
    assert chromium.run("document.documentElement.scrollWidth") == width
    paper, ink = (
        [int(x) for x in re.findall(r"\d+", chromium.run(f"getComputedStyle({where}).{what}"))]
        for where, what in (
            ("document.body", "backgroundColor"),
            ("document.querySelector('.panel svg text')", "fill"),
        )
    )
    assert (sum(paper) > sum(ink)) == (scheme == "light")
    chromium.prefer("light")


def test_a_method_of_the_leaderboard_opens_its_run_and_the_flight_plays(report):
    report.run("""[...document.querySelectorAll('tr a[data-run]')].find(
        (a) => a.textContent === 'hybrid (mlp)').click()""")
    report.wait_for("document.getElementById('run').open")
    facts = report.run("document.getElementById('run-facts').textContent")
    assert "hybrid (mlp)" in facts
    assert '"seed": 0' in report.run("document.getElementById('run-settings').textContent")
    assert "jax" in report.run("document.getElementById('run-versions').textContent")
    drawn = report.run("document.querySelector('#run-curve path').getAttribute('d')")
    assert drawn.startswith("M0.0 220.0L")  # from the lowest return up
    assert drawn.count("L") == 29
    before = report.run(PART.format("canvas") + ".toDataURL()")
    assert seconds(report) == 0.0
    report.run(PART.format("play") + ".click()")
    report.wait_for(f"Number({PART.format('time')}.value) > 1.0")
    assert report.run(PART.format("canvas") + ".toDataURL()") != before
    report.wait_for(f"Number({PART.format('time')}.value) >= 1.9 - 1e-6")
    report.wait_for(f"{PART.format('play')}.textContent === 'Play'")
    assert seconds(report) == 1.9


def test_details_follow_the_seed_and_close_with_the_escape_key(report):
    report.run("""[...document.querySelectorAll('#run-seeds a')].find(
        (a) => a.textContent === 'seed 2').click()""")
    report.wait_for("document.querySelector('#run-seeds [aria-current]').textContent === 'seed 2'")
    assert '"seed": 2' in report.run("document.getElementById('run-settings').textContent")
    report.press("Escape", 27)
    report.wait_for("!document.getElementById('run').open")
    report.wait_for("location.hash === ''")


def test_a_lost_run_says_why_and_shows_no_player(report):
    report.run(
        "document.querySelector('td.lost').closest('tr').querySelector('a[data-run]').click()"
    )
    report.wait_for("document.getElementById('run').open")
    assert report.run("document.getElementById('run-cause').textContent") != ""
    assert report.run("document.querySelector('[data-replay]').offsetParent") is None
    assert report.run("document.getElementById('run-no-flight').offsetParent !== null")
    report.run("document.getElementById('run-close').click()")


def test_a_hostile_name_is_text_in_tables_details_and_figures(report):
    report.run(f"""[...document.querySelectorAll('tr a[data-run]')].find(
        (a) => a.textContent === {HOSTILE!r}).click()""")
    report.wait_for("document.getElementById('run').open")
    assert HOSTILE in report.run("document.getElementById('run-facts').textContent")
    report.run("document.getElementById('run-close').click()")
    scripts = report.run("[...document.scripts].map((s) => s.textContent.slice(0, 20))")
    assert not [text for text in scripts if text.startswith("alert")]


def test_every_picture_is_seen(report):
    report.run("document.querySelectorAll('details').forEach((d) => d.open = true)")
    sizes = report.run("""[...document.querySelectorAll('.panel svg')].map(
        (s) => Math.min(s.getBoundingClientRect().width, s.getBoundingClientRect().height))""")
    assert len(sizes) == 1 + 2 + 4
    assert min(sizes) > 100


def test_the_keyboard_alone_sorts_and_plays(report):
    report.run(f"{BOARD}.querySelector('th .dt-column-order').focus()")
    report.press("Enter", 13)
    report.wait_for(f"{BOARD}.querySelector('th').getAttribute('aria-sort') === 'ascending'")
    reset(report)
    report.run("location.hash = '#run-' + allDetails().findIndex((run) => run.flight)")
    report.wait_for("document.getElementById('run').open")
    report.run(PART.format("play") + ".focus()")
    report.press("Enter", 13)
    report.wait_for(f"Number({PART.format('time')}.value) > 0.3")
    report.run("document.getElementById('run-close').click()")


def test_a_replay_page_flies_and_its_screenshot_shows_the_drones(chromium, tmp_path):
    tables = tables_for_tests.typical()
    run = tables.trajectories["run"].iloc[0]
    write_replay(tables, run, tmp_path / "replay.html")
    chromium.open(tmp_path / "replay.html")
    assert run in chromium.run("document.title")
    chromium.run(PART.format("play") + ".click()")
    chromium.wait_for(f"Number({PART.format('time')}.value) > 1.0")
    chromium.run(f"{PART.format('view')}.value = 'above'")
    chromium.run(f"{PART.format('view')}.dispatchEvent(new Event('change'))")
    chromium.screenshot(tmp_path / "replay.png")
    pixels = matplotlib.image.imread(tmp_path / "replay.png")[..., :3]
    colorful = (pixels.max(axis=-1) - pixels.min(axis=-1)) > 0.4
    assert colorful.sum() > 300


def test_a_report_of_nothing_and_of_one_seed_open_without_complaint(chromium, tmp_path):
    write_report(tables_for_tests.empty(), tmp_path / "empty.html")
    chromium.open(tmp_path / "empty.html")
    assert "There are no runs in these tables." in chromium.run("document.body.textContent")
    one = tables_for_tests.Sheet().add(drawn=True).add("hf_scratch", status="failed").tables()
    write_report(one, tmp_path / "one.html")
    chromium.open(tmp_path / "one.html")
    chromium.run("location.hash = '#run-1'")
    chromium.wait_for("document.getElementById('run').open")
    assert np.isfinite(seconds(chromium))


@needs_axe
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_no_violation(tmp_path, scheme):
    pages = {name: tmp_path / f"{name}.html" for name in ("report", "one", "replay", "markdown")}
    tables = tables_for_tests.typical()
    write_report(tables, pages["report"], "typical")
    write_report(tables_for_tests.Sheet().add(drawn=True).tables(), pages["one"])
    write_replay(tables, tables.trajectories["run"].iloc[0], pages["replay"])
    write_page("# A\n\nText, [a link](#a).\n\n| b |\n|---|\n| c |\n", pages["markdown"], "A")
    for name in ("effect", "partly", "unexplained"):
        pages[name] = tmp_path / f"{name}.html"
        content = diagnoses_for_tests.load(getattr(diagnoses_for_tests, name)())
        pages[name].write_text(diagnosis_page(content))
    with tab(tmp_path / "profile") as opened:
        opened.prefer(scheme)
        for name, page in pages.items():
            opened.open(page)
            opened.run("document.querySelectorAll('details').forEach((d) => d.open = true)")
            assert opened.violations() == [], name
            if name == "report":
                opened.run("location.hash = '#run-2'")
                opened.wait_for("document.getElementById('run').open")
                assert opened.violations() == [], "an opened run"


def test_bars_of_a_diagnosis_are_seen(tmp_path):
    """A rule of another page's class of the same name once left them no height."""
    path = tmp_path / "diagnosis.html"
    path.write_text(diagnosis_page(diagnoses_for_tests.load(diagnoses_for_tests.effect())))
    with tab(tmp_path / "profile") as opened:
        opened.open(path)
        bars = "[...document.querySelectorAll('.gauge rect')]"
        heights = opened.run(f"{bars}.map((bar) => bar.getBoundingClientRect().height)")
    assert len(heights) > 5
    assert min(heights) > 5.0
