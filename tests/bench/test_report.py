"""The report: one file, nothing loaded, nothing executed that a name brings along."""

import dataclasses
import html.parser
import json
import re

import numpy as np
import pytest
import tables_for_tests
from tables_for_tests import TAKEOFF, Sheet

from bench.report.figures import BUILT_IN, curve_drawings, styles, summary_drawings
from bench.report.page import render_markdown, write_report
from bench.report.run_details import curve, run_lines
from bench.report.top_view import trajectory_drawings
from bench.stats.statistics import Entry


class Page(html.parser.HTMLParser):
    """Collects tags with attributes, scripts by type, and the text outside scripts."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.scripts, self.text, self._script = [], [], "", None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        self._script = dict(attrs) if tag == "script" else None

    def handle_endtag(self, tag):
        self._script = None

    def handle_data(self, data):
        if self._script is None:
            self.text += data
        else:
            self.scripts.append((self._script.get("type", ""), data))


@pytest.fixture(scope="module")
def typical():
    return tables_for_tests.typical()


@pytest.fixture(scope="module")
def page(typical, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(typical, path)
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    return Page(path.read_text(encoding="utf-8"))


def test_report_loads_nothing_from_elsewhere(page):
    for tag, attributes in page.tags:
        assert not {"src", "srcset", "data", "poster"} & set(attributes), tag
        assert tag not in ("link", "iframe", "object", "embed", "base")
        assert attributes.get("href", "#").startswith("#")
    policy = next(a["content"] for t, a in page.tags if a.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy


def test_report_stays_small(typical, tmp_path):
    write_report(typical, tmp_path / "report.html")
    assert (tmp_path / "report.html").stat().st_size < 6e6


def test_hostile_names_never_become_markup(page):
    assert "<script>alert(1)</script>|x" in page.text
    assert all(data.strip() != "alert(1)" for _, data in page.scripts)
    data = [json.loads(data) for kind, data in page.scripts if kind == "application/json"]
    figures = [value for value in data if "layout" in value]
    names = {trace.get("name") for figure in figures for trace in figure["data"]}
    assert not any("<" in name for name in names if name)
    assert "&lt;script&gt;alert(1)&lt;/script&gt;|x" in names


def test_every_plot_has_its_data_a_caption_and_a_text_for_the_blind(page):
    plots = [attrs for tag, attrs in page.tags if attrs.get("class") == "plot"]
    ids = [attrs["id"] for tag, attrs in page.tags if "id" in attrs]
    assert len(plots) == 1 + 2 + 2  # summary, curves of two tasks, top views of two cells
    assert len(ids) == len(set(ids))
    for plot in plots:
        assert plot["data-figure"] in ids
        assert plot["role"] == "img"
        assert plot["aria-label"]
    assert sum(tag == "figcaption" for tag, _ in page.tags) == len(plots)


def test_report_names_failed_and_diverged_runs_with_their_cause(typical, page):
    assert "out of memory" in page.text
    assert re.search(r"2 ok, 1 failed \(seed 2\)", page.text)
    lost = [line for line in run_lines(typical) if line["lost"]]
    assert sorted((line["method"], line["status"]) for line in lost) == [
        ("hf_scratch", "failed"),
        ("hybrid (affine)", "diverged"),
    ]
    listed = page.text.partition("Failed and diverged runs, with their cause")[2]
    listed = listed.partition("All runs")[0]
    assert [line["run"] in listed for line in run_lines(typical)] == [
        line["lost"] for line in run_lines(typical)
    ]


def test_report_says_that_contacts_are_flags(page):
    assert "Contacts are flags in this simulator: drones never push each other." in page.text


def test_plotly_is_inlined_once(page):
    assert sum(len(data) > 1_000_000 for _, data in page.scripts) == 1


def test_sortable_cells_carry_numbers(page):
    orders = [a["data-order"] for tag, a in page.tags if tag == "td" and a.get("data-order")]
    numbers = {float(text) for text in orders if re.fullmatch(r"-?[0-9.]+", text)}
    assert {-140.0, -150.0, -200.0, -70.5, -5039.5} <= numbers


def test_report_of_no_rows_is_a_page_that_says_so(tmp_path):
    write_report(tables_for_tests.empty(), tmp_path / "report.html")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert page.text.count("There are no runs in these tables.") == 2
    assert not [a for _, a in page.tags if a.get("class") == "plot"]
    assert (tmp_path / "report.html").stat().st_size < 50_000


def test_report_of_failed_runs_only_is_complete(tmp_path):
    tables = Sheet().add(status="failed", cause="<b>boom</b>").tables()
    write_report(tables, tmp_path / "report.html")
    assert "<b>boom</b>" in Page((tmp_path / "report.html").read_text(encoding="utf-8")).text


def test_settings_that_are_no_json_do_not_break_the_page(tmp_path):
    sheet = Sheet().add()
    sheet.runs[0]["settings"] = "{not json"
    write_report(sheet.tables(), tmp_path / "report.html")
    assert "{not json" in Page((tmp_path / "report.html").read_text(encoding="utf-8")).text


def test_summary_shows_means_with_bands_and_leaves_gaps_for_missing_cells():
    sheet = Sheet()
    for size in (3, 7, 12):
        sheet.add(team_size=size, rewards=(-10.0 * size, -12.0 * size))
        if size != 7:
            sheet.add("hf_scratch", team_size=size, rewards=(-5.0,))
    (drawing,) = summary_drawings(sheet.tables())
    lines = {t.name: t for t in drawing.plot.data if t.yaxis == "y3" and t.name}
    np.testing.assert_allclose(lines["lf_baseline"].y, TAKEOFF + np.array([-33.0, -77.0, -132.0]))
    np.testing.assert_array_equal(np.isnan(lines["hf_scratch"].y), [False, True, False])
    bands = [t for t in drawing.plot.data if t.yaxis == "y3" and t.fill == "toself"]
    half = np.std([30.0, 36.0], ddof=1)
    assert bands[0].y[0] == pytest.approx(TAKEOFF - 33.0 + half)


def test_variants_have_no_line_in_the_summary_but_a_row_in_the_table(typical, page):
    (drawing,) = summary_drawings(typical)
    assert not any("observe_attitude" in (t.name or "") for t in drawing.plot.data)
    assert "hybrid (mlp), observe_attitude=true" in page.text


def test_top_views_start_at_circles_and_end_at_stars(typical):
    spread = trajectory_drawings(typical)[-1]
    assert spread.title == "spread, N = 3"
    markers = [t for t in spread.plot.data if t.mode == "markers" and t.xaxis == "x"]
    starts, ends = markers
    assert (starts.marker.symbol, ends.marker.symbol) == ("circle-open", "star")
    np.testing.assert_allclose(starts.y, 0.0)
    np.testing.assert_allclose(ends.y, 1.9, rtol=1e-6)
    np.testing.assert_allclose(ends.x, [0.0, 1.0, 2.0])


def test_curves_keep_the_mean_of_what_they_bin():
    (drawing,) = curve_drawings(Sheet().add(drawn=True).tables())
    y = drawing.plot.data[0].y[:-1]  # the last is the gap between seeds
    assert len(y) == 30
    assert np.mean(y) == pytest.approx(np.mean([-100.0 / (1 + i) for i in range(30)]), rel=1e-6)


def test_a_frame_holds_most_of_a_curve_that_rises_to_the_end():
    tables = Sheet().add(drawn=True).tables()
    rising = tables.curves.assign(reward=-100.0 * 0.9 ** tables.curves["epoch"])
    (drawing,) = curve_drawings(dataclasses.replace(tables, curves=rising))
    low, high = drawing.plot.layout.yaxis.range
    assert low == pytest.approx(-100.0 * 0.9**7, rel=0.05)  # of 30 epochs the first 7 may be lost
    assert high > rising["reward"].max()


def test_marks_of_a_large_team_are_small():
    def sizes(team_size):
        (drawing,) = trajectory_drawings(Sheet().add(team_size=team_size, drawn=True).tables())
        return [t.marker.size for t in drawing.plot.data if t.mode == "markers"]

    assert sizes(18) == [8, 11]
    assert sizes(160) == [4, 5.5]


def test_built_in_methods_keep_their_colours(typical):
    alone, among = styles(tables_for_tests.empty()), styles(typical)
    assert all(alone[entry] == among[entry] for entry in BUILT_IN)
    assert len({alone[entry].color for entry in BUILT_IN}) == len(BUILT_IN)
    assert len(set(among.values())) == len(among)
    assert Entry("<script>alert(1)</script>|x") in among


def test_markdown_shows_html_and_does_not_interpret_it():
    found = render_markdown("<img src=x onerror=alert(1)> **bold** [x](javascript:alert(1))")
    assert "<img" not in found
    assert 'href="javascript' not in found
    assert "<strong>bold</strong>" in found


def details_of(page):
    (data,) = (
        json.loads(data)
        for kind, data in page.scripts
        if kind == "application/json" and data.startswith("[")
    )
    return data


def test_every_run_can_be_opened_with_settings_metrics_curve_and_flight(typical, page):
    details = details_of(page)
    assert sorted(run["run"] for run in details) == sorted(typical.runs["run"])
    drawn = set(typical.trajectories["run"])
    ids = {attrs["id"] for _, attrs in page.tags if "id" in attrs}
    results = typical.results.set_index(["run", "metric"])["value"]
    for run in details:
        assert (run["flight"] is not None) == (run["run"] in drawn)
        assert (run["curve"] is not None) == (run["run"] in drawn)
        assert {run["settings"], run["versions"]} <= ids
        metrics = {name: text for name, text, _ in run["metrics"]}
        if run["status"] == "failed":
            assert metrics == {}
            assert run["cause"] == "out of memory"
        else:
            assert float(metrics["reward"]) == pytest.approx(results[run["run"], "reward"])
    seeds = {tuple(run["seeds"]) for run in details if run["method"] == "hf_scratch"}
    assert sorted(map(len, seeds)) == [1, 3]


def test_every_row_of_the_leaderboard_leads_to_a_run_of_its_own(typical, page):
    details = details_of(page)
    links = [attrs["href"] for tag, attrs in page.tags if tag == "a" and "data-run" in attrs]
    ids = {attrs["id"] for _, attrs in page.tags if "id" in attrs}
    assert {link.removeprefix("#") for link in links} <= ids
    assert {link.removeprefix("#run-") for link in links} == set(map(str, range(len(details))))
    rows = typical.runs[["method", "residual", "variant", "task"]].drop_duplicates()
    boards = links[: len(rows)]  # they come before the runs
    opened = [details[int(link.removeprefix("#run-"))] for link in boards]
    assert len({(run["method"], run["task"]) for run in opened}) == len(rows)
    first = {(run["method"], run["task"]): run for run in opened}
    assert first["hf_scratch", "spread"]["status"] == "ok"  # not the one that failed


def test_a_training_curve_is_binned_and_its_gaps_stay_gaps():
    sheet = Sheet().add(drawn=True)
    tables = sheet.tables()
    frame = tables.curves.assign(epoch=tables.curves["epoch"])
    binned = curve(frame)
    assert binned["epoch"] == list(range(30))
    np.testing.assert_allclose(binned["reward"], frame["reward"], rtol=1e-4)
    assert curve(frame.assign(reward=float("nan"))) is None
    frame.loc[frame["epoch"] == 3, "reward"] = float("inf")
    assert curve(frame)["reward"][3] is None


def test_a_sweep_without_flights_and_curves_is_a_whole_page(tmp_path):
    tables = Sheet().add(rewards=(-1.0,)).tables()
    write_report(tables, tmp_path / "report.html")
    (run,) = details_of(Page((tmp_path / "report.html").read_text(encoding="utf-8")))
    assert run["flight"] is run["curve"] is None
