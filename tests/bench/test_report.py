"""The report: one file, nothing loaded, nothing executed that a name brings along."""

import json
import re

import numpy as np
import pytest
import tables_for_tests
from html_for_tests import Page
from tables_for_tests import Sheet

from bench.report.answer import answer
from bench.report.board import boards, filters
from bench.report.leaderboard import leaderboard_rows
from bench.report.page import render_markdown, write_report
from bench.report.pictures.cost import GAP, LOSS, cost_panels
from bench.report.pictures.curves import broken_line, curve_panels, robust_range
from bench.report.pictures.looks import BUILT_IN, legend, look_of, ordered
from bench.report.pictures.summary import summary_panels
from bench.report.pictures.top_view import top_views
from bench.report.run_details import curve, run_lines
from bench.stats.statistics import Entry


@pytest.fixture(scope="module")
def typical():
    return tables_for_tests.typical()


@pytest.fixture(scope="module")
def page(typical, tmp_path_factory):
    path = tmp_path_factory.mktemp("report") / "report.html"
    write_report(typical, path, "typical")
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    return Page(path.read_text(encoding="utf-8"))


def test_report_loads_nothing_from_elsewhere(page):
    page.check_loads_nothing()
    policy = next(a["content"] for t, a in page.tags if a.get("http-equiv"))
    assert policy.startswith("default-src 'none'")
    assert "http" not in policy


def test_a_report_of_the_quick_suites_size_stays_small(tmp_path):
    """16 runs on two tasks with curves and flights of usual length."""
    rng, sheet = np.random.default_rng(0), Sheet()
    for task in ("spread", "circle"):
        for entry in BUILT_IN[:8]:
            sheet.add(*entry[:2], task=task, fleet_minutes=40.0, rewards=(-50.0,))
    for run in (row["run"] for row in sheet.runs):
        for epoch in range(400):
            row = {"epoch": epoch, "reward": float(rng.normal(-100.0)), "smooth_reward": -1.0}
            sheet.curves.append({"run": run, **row, "crashes": 0.0, "grad_norm": 1.0})
        for drone in range(3):
            for i, where in enumerate(rng.normal(0.0, 0.05, (100, 3)).cumsum(axis=0)):
                pos = dict(zip(("pos_x", "pos_y", "pos_z"), map(float, where), strict=True))
                sheet.trajectories.append({"run": run, "drone": drone, "t": 0.1 * i, **pos})
    write_report(sheet.tables(), tmp_path / "report.html")
    assert 3e5 < (tmp_path / "report.html").stat().st_size < 1.5e6


def test_hostile_names_never_become_markup(page):
    assert "<script>alert(1)</script>|x" in page.text
    assert all(data.strip() != "alert(1)" for _, data in page.scripts)
    assert not [attrs for attrs in page.all("script") if attrs.get("src")]


def test_every_picture_has_a_text_for_the_blind(typical, page):
    said = [attrs["aria-label"] for tag, attrs in page.tags if attrs.get("role") == "img"]
    drawn = [p for p in said if not p.startswith(("Flight", "Training return against epoch"))]
    # The score against the cost; five flights from above. Curves are of two cells.
    assert len(drawn) == 1 + 4
    assert sum(text.startswith("Training return against epoch on") for text in said) == 2
    assert all(said)
    assert len(page.ids) == len(set(page.ids))


def test_the_first_screen_names_the_suite_its_origin_and_the_answer(page):
    before = page.text.partition("How to read")[0]
    for text in ("typical: which method at which cost", "2026-01-01", "0123abcd", "1 budget"):
        assert text in before
    assert "N = 3 (spread): without high-fidelity flight lf_baseline" in before
    said = before.partition("from 40 fleet-minutes on hybrid (mlp), not separated from ")[2]
    assert said.partition("from 80 fleet-minutes on hf_hotstart, not separated from hybrid (mlp) ")[
        1
    ]
    assert "hybrid (affine) (score at most 80 lower)" in said
    details = [i for i, (tag, _) in enumerate(page.tags) if tag == "details"]
    figure = [i for i, (_, attrs) in enumerate(page.tags) if attrs.get("class") == "first"]
    board = [i for i, (_, attrs) in enumerate(page.tags) if attrs.get("class") == "board"]
    assert figure[0] < details[0] < board[0]


def test_the_answer_of_single_runs_claims_no_order():
    sheet = Sheet().add("lf_baseline").add("mine|", rewards=(-40.0,)).add("mine|", task="circle")
    sheet.add("mine|", variant="x=1", rewards=(-1.0,))
    tables = sheet.tables()
    (line,) = answer(tables, leaderboard_rows(tables))
    assert line == (
        "One seed a method, so no order is claimed. Highest settled reward: **mine\\|** on circle, "
        "N = 3; spread, N = 3."
    )
    assert answer(tables_for_tests.empty(), []) == []


def test_the_answer_of_each_team_size_is_a_sentence():
    sheet = Sheet()
    for n, best in ((3, -50.0), (12, -70.0)):
        cell = {"team_size": n}
        sheet.add_upper(-40.0, **cell).add(rewards=(-80.0, -81.0, -82.5), **cell)
        sheet.add("costly", rewards=(best, best - 1.0, best - 2.5), fleet_minutes=40.0, **cell)
        near = (best - 0.5, best - 0.9, best - 3.1)
        sheet.add("near", rewards=near, fleet_minutes=400.0, **cell)
    tables = sheet.tables()
    first, second = answer(tables, leaderboard_rows(tables))
    assert first == (
        "N = 3 (spread): without high-fidelity flight **lf_baseline**; from 40 fleet-minutes on "
        "**costly**."  # `near` costs ten times as much and is not better
    )
    assert second.startswith("N = 12 (spread): ")


def test_the_board_is_one_table_and_other_settings_another(typical):
    rows = leaderboard_rows(typical)
    main, others = boards(rows, {})
    headings = [column["heading"] for column in main["columns"]]
    assert headings[:5] == ["method", "task", "N", "rank", "ties"]
    assert len(main["lines"]) == len(rows) - 1
    (line,) = others["lines"]
    assert line["method"] == "hybrid (mlp)"  # found by its default's name
    assert line["cells"][0][0] == "hybrid (mlp), observe_attitude=true"
    assert [heading for heading, _ in filters(rows)] == ["task", "N", "method"]
    assert filters(rows)[1][1] == ["3", "12"]


def test_the_first_figure_needs_no_scores(typical):
    (panel,), keys = cost_panels(typical)
    assert panel.alt.startswith(f"{GAP[0].upper()}{GAP[1:]}, N = 3: hf_hotstart 0.0")
    assert "LF" not in [key.label for key in keys]
    assert "<title>hybrid (mlp): 0.0070, 40 min</title>" in panel.svg
    tables = Sheet().add(rewards=(-90.0,)).add("mine", rewards=(-45.0,)).tables()
    (panel,), _ = cost_panels(tables)
    assert panel.alt == (
        f"{LOSS[0].upper()}{LOSS[1:]}, N = 3: mine 0.05 at 0 fleet-minutes; lf_baseline 0.1 at 0 "
        "fleet-minutes."
    )


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
    assert "Contacts are flags: drones push each other only in worlds with" in page.text


def test_cells_of_the_board_carry_numbers_to_sort_by(page):
    orders = [a["data-order"] for a in page.all("td") if a.get("data-order")]
    numbers = {float(text) for text in orders if re.fullmatch(r"-?[0-9.]+", text)}
    assert {-140.0, -150.0, -200.0, -70.5, -5039.5} <= numbers


def test_report_of_no_rows_is_a_page_that_says_so(tmp_path):
    write_report(tables_for_tests.empty(), tmp_path / "report.html")
    page = Page((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert page.text.count("There are no runs in these tables.") == 1
    assert not [tag for tag, _ in page.tags if tag in ("svg", "table", "form", "dialog")]
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


def test_one_team_size_has_no_lines_against_it(typical):
    assert summary_panels(Sheet().add().add("mine").tables())[0] == []
    sheet = Sheet().add(rewards=(-30.0, -36.0)).add(team_size=7, rewards=(-70.0, -84.0))
    sheet.add("hf_scratch", rewards=(-15.0,)).add(task="circle")
    sheet.add(variant="x=1").add(variant="x=1", team_size=7)
    ((title, panels),), keys = summary_panels(sheet.tables())
    assert (title, [panel.title for panel in panels]) == (
        "spread",
        ["settled reward", "HF fleet-minutes", "HF training crashes"],
    )
    assert [key.label for key in keys] == ["lf_baseline", "hf_scratch"]
    assert panels[0].svg.count("<title>lf_baseline</title>") == 1


def test_top_views_start_at_circles_and_end_at_discs(typical):
    (_, circle), (label, spread) = top_views(typical)
    assert (label, len(circle), len(spread)) == ("spread, N = 3", 1, 3)
    svg = spread[0].svg
    open_, filled_ = (
        re.findall(rf'<circle cx="(\d+)" cy="(\d+)" r="22"{fill}/>', svg)
        for fill in ("", ' fill="[^"]+"')
    )
    assert len(open_) == len(filled_) == 3
    assert [x for x, _ in open_] == [x for x, _ in filled_]  # straight along y, from 0 to 1.9 m
    (unit,) = map(int, re.findall(r'<path d="M30 970h(\d+)"', svg))
    assert [int(a) - int(b) for (_, a), (_, b) in zip(open_, filled_, strict=True)] == (
        pytest.approx([1.9 * unit] * 3, abs=2)
    )
    assert len({int(x) for x, _ in open_}) == 3


def test_curves_keep_the_mean_of_what_they_bin():
    frame = Sheet().add(drawn=True).tables().curves
    xy = broken_line([frame], 3)[:-1]  # the last is the gap between seeds
    assert len(xy) == 10
    assert xy[:, 1].mean() == pytest.approx(frame["reward"].mean(), rel=1e-6)
    panels, keys = curve_panels(Sheet().add(drawn=True).add(task="circle", drawn=True).tables())
    assert [panel.title for panel in panels] == ["circle, N = 3", "spread, N = 3"]
    assert [key.label for key in keys] == ["lf_baseline"]


def test_a_frame_holds_most_of_a_curve_that_rises_to_the_end():
    frame = Sheet().add(drawn=True).tables().curves
    rising = frame.assign(reward=-100.0 * 0.9 ** frame["epoch"])
    low, high = robust_range([rising])
    assert low == pytest.approx(-100.0 * 0.9**7, rel=0.05)  # of 30 epochs the first 7 may be lost
    assert high > rising["reward"].max()
    assert robust_range([]) == (None, None)


def test_marks_of_a_large_team_are_small():
    def sizes(team_size):
        ((_, (panel,)),) = top_views(Sheet().add(team_size=team_size, drawn=True).tables())
        return set(re.findall(r'r="(\d+)"', panel.svg))

    assert sizes(18) == {"22"}
    assert sizes(160) == {"11"}


def test_built_in_methods_keep_their_look_and_no_two_share_one():
    others = [Entry("<script>alert(1)</script>|x"), *(Entry(f"other{i}") for i in range(20))]
    everybody = ordered([*others, *BUILT_IN])
    assert everybody[: len(BUILT_IN)] == list(BUILT_IN)
    assert all(look_of(e, everybody) == look_of(e, BUILT_IN) for e in BUILT_IN)
    assert len({look_of(entry, everybody) for entry in everybody}) == len(everybody)
    for key in legend(everybody, everybody):
        assert key.swatch.count("<polygon points=") == 1


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
    results = typical.results.set_index(["run", "metric"])["value"]
    for run in details:
        assert (run["flight"] is not None) == (run["run"] in drawn)
        assert (run["curve"] is not None) == (run["run"] in drawn)
        assert {run["settings"], run["versions"]} <= set(page.ids)
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
    links = [attrs["href"] for attrs in page.all("a") if "data-run" in attrs]
    assert {link.removeprefix("#") for link in links} <= set(page.ids)
    assert {link.removeprefix("#run-") for link in links} == set(map(str, range(len(details))))
    rows = typical.runs[["method", "residual", "variant", "task"]].drop_duplicates()
    first = links[: len(rows)]  # boards come before the runs
    opened = [details[int(link.removeprefix("#run-"))] for link in first]
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
