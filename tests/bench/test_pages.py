"""Pages in a real browser: they open offline, sort, fly, and no name that they show can act."""

import re

import diagnoses_for_tests
import matplotlib.image
import numpy as np
import pytest
import tables_for_tests
from browser import needs_chromium, tab

from bench.diagnosis_report.page import diagnosis_page
from bench.report.page import write_report
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


def column(page, caption, heading):
    """Texts of a column of the table with that caption, as they stand."""
    return page.run(f"""(() => {{
        const table = [...document.querySelectorAll('table')].find(
            (t) => t.caption && t.caption.textContent === {caption!r});
        const index = [...table.tHead.rows[0].cells].findIndex(
            (c) => c.textContent.trim() === {heading!r});
        return [...table.tBodies[0].rows].map((row) => row.cells[index].textContent.trim());
    }})()""")


def click_heading(page, caption, heading):
    page.run(f"""[...document.querySelectorAll('table')].find(
        (t) => t.caption && t.caption.textContent === {caption!r})
        .querySelectorAll('th button').forEach(
            (b) => {{ if (b.textContent === {heading!r}) b.click(); }})""")


def seconds(page):
    return float(re.match(r"t = ([0-9.]+) s", page.run(PART.format("readout") + ".textContent"))[1])


def test_a_click_on_a_heading_sorts_and_a_second_one_reverses(report):
    cell, heading = "spread, N = 3", "settled reward (n)"
    click_heading(report, cell, heading)
    means = [float(text.split()[0]) for text in column(report, cell, heading) if text != "-"]
    assert len(means) > 4
    assert means == sorted(means)
    click_heading(report, cell, heading)
    means = [float(text.split()[0]) for text in column(report, cell, heading) if text != "-"]
    assert means == sorted(means, reverse=True)
    assert report.run("document.querySelectorAll('th[aria-sort=descending]').length") == 1


def test_ties_and_lost_runs_can_be_seen(report):
    ranks = dict(
        zip(
            column(report, "spread, N = 3", "method"),
            column(report, "spread, N = 3", "rank"),
            strict=True,
        )
    )
    assert ranks["hf_hotstart"] == ranks["hybrid (mlp)"]
    runs = column(report, "spread, N = 3", "runs")
    assert any("1 failed (seed 2)" in text for text in runs)
    assert any("1 diverged (seed 1)" in text for text in runs)
    assert "1 failed" in report.run("document.querySelector('.facts').textContent")


def test_a_method_of_the_leaderboard_opens_its_run_and_the_flight_plays(report):
    report.run("""[...document.querySelectorAll('tr a[data-run]')].find(
        (a) => a.textContent === 'hybrid (mlp)').click()""")
    report.wait_for("document.getElementById('run').open")
    facts = report.run("document.getElementById('run-facts').textContent")
    assert "hybrid (mlp)" in facts
    assert '"seed": 0' in report.run("document.getElementById('run-settings').textContent")
    assert "jax" in report.run("document.getElementById('run-versions').textContent")
    report.wait_for("document.querySelector('#run-curve .scatterlayer path') !== null")
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
    report.run("document.querySelector('table:not(.sortable) a[data-run]').click()")
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
    report.run("document.querySelectorAll('.plot').forEach(draw)")
    report.wait_for(
        f"[...document.querySelectorAll('text')].some((t) => t.textContent === {HOSTILE!r})"
    )
    scripts = report.run("[...document.scripts].map((s) => s.textContent.slice(0, 20))")
    assert not [text for text in scripts if text.startswith("alert")]


def test_every_figure_is_drawn(report):
    report.run("document.querySelectorAll('.plot').forEach(draw)")
    report.wait_for(
        "[...document.querySelectorAll('.plot')].every((p) => p.querySelector('.main-svg'))"
    )
    assert report.run("document.querySelectorAll('.plot').length") == 5


def test_the_keyboard_alone_sorts_and_plays(report):
    report.run("document.querySelector('table.sortable th button').focus()")
    report.press("Enter", 13)
    sorted_by = "document.querySelector('table.sortable th').getAttribute('aria-sort')"
    assert report.run(sorted_by) in ("ascending", "descending")
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
