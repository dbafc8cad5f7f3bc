"""Figures beside the claims: what is in them, and that pictures of it are written."""

import dataclasses

import matplotlib.image
import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.lines import Line2D
from paper_tables import WORLDS, around
from tables_for_tests import Sheet, empty, typical

from bench.paper.figures import (
    write_flights,
    write_settings,
    write_summary,
    write_worlds,
)
from bench.paper.pictures import write_cost
from bench.paper.values import HYBRID
from bench.report.page import data_uri
from bench.report.pictures.cost import points
from bench.report.pictures.looks import BUILT_IN, COLORS
from bench.stats.scores import undisturbed
from bench.stats.statistics import home_of

WRITERS = pytest.mark.parametrize("write", [write_cost, write_summary])


@pytest.fixture
def figures(monkeypatch):
    """The figures that were drawn, kept open until the test has seen them."""
    kept, close = [], plt.close
    monkeypatch.setattr(plt, "close", kept.append)
    yield kept
    for figure in kept:
        close(figure)


def crowd(n_others):
    """The built-in methods and others of hostile names; the first of these only for more drones."""
    sheet = Sheet()
    for n in (3, 7, 12):
        sheet.add_upper(-40.0, team_size=n)
        for entry in BUILT_IN:
            sheet.add(*entry[:2], team_size=n, rewards=around(-50.0))
        for i in range(n_others):
            if i or n > 3:
                sheet.add(f"other{i:02d}$\\bad$", team_size=n, rewards=around(-60.0 - i))
    return sheet.tables()


def legend_of(figure):
    """What the legend says, and the colour and marker of each line."""
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    lines = [line for line in legend.findobj(Line2D) if line.get_marker().lower() != "none"]
    looks = [(to_hex(line.get_color()).upper(), line.get_marker()) for line in lines]
    return dict(zip(names, looks, strict=True))


@WRITERS
def test_a_picture_has_points_in_the_methods_colours(tmp_path, write):
    path = tmp_path / "figure.png"
    assert write(typical(), path)
    pixels = matplotlib.image.imread(path)[..., :3]
    assert min(pixels.shape[:2]) > 200
    for color in (COLORS[0], COLORS[BUILT_IN.index(HYBRID)]):
        rgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
        assert np.all(np.abs(pixels - rgb) < 0.01, axis=-1).sum() > 30


@WRITERS
def test_nothing_is_drawn_where_there_is_nothing_to_draw(tmp_path, write):
    assert not write(empty(), tmp_path / "figure.png")
    assert not write(Sheet().add(status="failed").tables(), tmp_path / "figure.png")
    assert not list(tmp_path.iterdir())


def test_single_seeds_have_no_place_beside_their_cost(tmp_path):
    tables = Sheet().add(rewards=(-50.0,)).tables()
    assert not write_cost(tables, tmp_path / "cost.png")
    assert write_summary(tables, tmp_path / "summary.png")
    assert [path.name for path in tmp_path.iterdir()] == ["summary.png"]


@WRITERS
def test_the_legend_names_who_competes_and_not_the_upper_reference(tmp_path, write, figures):
    write(typical(), tmp_path / "figure.png")
    names = ["LF baseline", "HF scratch", "hot start", "Hybrid (affine)", "Hybrid"]
    # One seed has no place beside its cost.
    names += [] if write is write_cost else ["<script>alert(1)</script>|x"]
    assert list(legend_of(figures[0])) == names


@WRITERS
def test_more_methods_than_colours_differ_in_colour_or_marker(tmp_path, write, figures):
    n_others = len(COLORS) - len(BUILT_IN) + 5
    assert write(crowd(n_others), tmp_path / "figure.png")
    legend = legend_of(figures[0])
    assert len(legend) == len(BUILT_IN) + n_others
    assert len(set(legend.values())) == len(legend)
    # As long as there are colours nobody shares one.
    colors = [color for color, _ in legend.values()]
    assert colors[: len(COLORS)] == list(COLORS)


def test_a_method_of_larger_teams_alone_is_in_the_legend_of_team_sizes(tmp_path, figures):
    write_summary(crowd(2), tmp_path / "figure.png")
    assert r"other00\$\bad\$" in legend_of(figures[0])


@WRITERS
def test_who_flew_in_few_cells_is_left_out(tmp_path, write, figures):
    sheet = Sheet()
    for n in (3, 5, 7, 9, 12):
        sheet.add("hf_scratch", team_size=n, rewards=around(-50.0))
    sheet.add("lf_baseline", team_size=12, rewards=around(-60.0))
    write(sheet.tables(), tmp_path / "figure.png")
    assert list(legend_of(figures[0])) == ["HF scratch"]


def test_both_figures_give_a_method_the_same_look(tmp_path, figures):
    tables = crowd(3)
    write_cost(tables, tmp_path / "cost.png")
    write_summary(tables, tmp_path / "summary.png")
    cost, summary = map(legend_of, figures)
    assert cost == summary


def test_the_cost_figure_puts_rewards_over_minutes_by_task_and_team_size(tmp_path, figures):
    sheet = Sheet()
    for n, minutes in ((3, 40.0), (7, 80.0), (12, 130.0)):
        for task, reward in (("spread", -40.0), ("circle", -60.0)):
            rewards = (reward, reward - 2.0, reward - 8.0)
            shared = {"task": task, "team_size": n, "fleet_minutes": minutes}
            sheet.add("hybrid", "mlp", rewards=rewards, **shared)
    write_cost(sheet.tables(), tmp_path / "cost.png")
    panels = {panel.get_title(): panel for panel in figures[0].axes}
    assert list(panels) == ["circle, N = 3", "spread, N = 3", "circle, N = 12", "spread, N = 12"]
    (bars,) = panels["spread, N = 12"].containers
    assert bars.lines[0].get_xydata() == pytest.approx(np.array([[130.0, -42.0]]))  # the median
    (ends,) = bars.lines[2][0].get_segments()
    assert ends[:, 1] == pytest.approx([-48.0, -40.0])  # worst and best seed
    assert panels["spread, N = 12"].get_xlim()[1] > 130.0


def test_a_cell_without_runs_says_so_in_its_panel(tmp_path, figures):
    sheet = Sheet()
    for task, n in (("spread", 3), ("spread", 12), ("circle", 3)):
        sheet.add("hybrid", "mlp", rewards=(-40.0, -42.0), task=task, team_size=n)
    write_cost(sheet.tables(), tmp_path / "cost.png")
    panels = {panel.get_title(): panel for panel in figures[0].axes}
    said = {title: [text.get_text() for text in panel.texts] for title, panel in panels.items()}
    assert [title for title, texts in said.items() if "not run" in texts] == ["circle, N = 12"]
    assert not panels["circle, N = 12"].axison


def test_a_method_of_one_team_size_alone_does_not_choose_what_the_cost_figure_shows(
    tmp_path, figures
):
    sheet = Sheet()
    for n in (3, 12):
        sheet.add("hybrid", "mlp", rewards=(-40.0, -42.0), team_size=n, fleet_minutes=40.0)
    sheet.add("ppo", rewards=(-90.0, -95.0), team_size=3, fleet_minutes=3200.0)
    write_cost(sheet.tables(), tmp_path / "cost.png")
    assert [panel.get_title() for panel in figures[0].axes] == ["spread, N = 3", "spread, N = 12"]
    assert [t.get_text() for t in figures[0].legends[0].get_texts()] == ["Hybrid"]


def test_the_cost_figure_joins_the_budgets_of_a_method_and_leaves_other_settings_out(
    tmp_path, figures
):
    sheet = Sheet().add_upper(100.0)
    sheet.add("hybrid", "mlp", rewards=(-400.0, -420.0), fleet_minutes=40.0)
    sheet.add("hybrid", "mlp", variant="flights=3", rewards=(-500.0, -520.0), fleet_minutes=0.5)
    sheet.add("hybrid", "mlp", variant="nominal.attitude_tau=0.02", rewards=(-900.0, -900.0))
    tables = sheet.tables()
    drawn = [(p.entry.variant, p.minutes, round(p.value, 6)) for p in points(tables)[3]]
    assert drawn == [("", 40.0, 0.51), ("flights=3", 0.5, 0.61)]
    write_cost(tables, tmp_path / "cost.png")
    (panel,) = figures[0].axes
    joined = panel.get_lines()[0].get_xydata()
    assert joined == pytest.approx(np.array([[0.5, -510.0], [40.0, -410.0]]))
    assert [text.get_text() for text in figures[0].legends[0].get_texts()] == ["Hybrid"]


def test_a_sweep_in_another_simulator_is_judged_like_one_in_crazyflow():
    sheet = Sheet().add_upper(100.0).add(rewards=(-400.0, -420.0))
    sheet.add(variant="deployed_in=crazyflow", rewards=(-300.0, -310.0))
    for row in sheet.results:
        row["simulator"] = "crazyflow" if row["variant"] else "rotorpy"
    tables = sheet.tables()
    assert home_of(tables) == "rotorpy"
    assert {cell.simulator for cell in undisturbed(tables, "settled_reward")} == {"rotorpy"}
    assert [p.value for p in points(tables)[3]] == pytest.approx([0.51])


def test_a_budget_is_drawn_only_where_it_flew_every_task_of_its_default():
    sheet = Sheet()
    for task in ("spread", "circle"):
        sheet.add_upper(100.0, task=task).add(task=task, rewards=(-400.0, -420.0))
        sheet.add("hybrid", "mlp", task=task, rewards=(-300.0, -310.0), fleet_minutes=40.0)
        few = {"task": task, "rewards": (-350.0, -360.0), "fleet_minutes": 1.0}
        sheet.add("hybrid", "mlp", variant="flights=8", **few)
        if task == "circle":
            sheet.add("hybrid", "mlp", variant="flights=1", **few)
    drawn = {point.entry.variant for point in points(sheet.tables())[3]}
    assert drawn == {"", "flights=8"}


def test_the_summary_has_a_column_a_task_and_a_row_a_metric(tmp_path, figures, full_tables):
    write_summary(full_tables, tmp_path / "summary.png")
    grid = np.array(figures[0].axes).reshape(2, 4)
    assert {panel.get_title() for panel in grid[0]} == {
        "spread",
        "circle",
        "figure8",
        "pitchandexpand",
    }
    labels = [row[0].get_ylabel().split("\n")[0] for row in grid]
    assert labels == ["settled reward", "training steps"]


def means_of(panel):
    """The means that a panel shows, by x: the points of its lines."""
    drawn = [line for line in panel.get_lines() if line.get_marker() not in ("None", "")]
    return [dict(line.get_xydata().round(6).tolist()) for line in drawn if len(line.get_xdata())]


def test_few_flights_are_shown_by_what_they_lose_beside_the_same_seeds(tmp_path, figures):
    sheet = Sheet().add(rewards=(-150.0, -160.0)).add_upper()
    sheet.add("hybrid", "mlp", rewards=(-100.0, -100.0, -400.0))
    sheet.add("hybrid", "mlp", variant="flights=8", rewards=(-110.0, -130.0))
    sheet.add("hybrid", "mlp", variant="flights=8, x=1", rewards=(-900.0, -900.0))
    sheet.add("hybrid", "sindy", variant="flights=8", rewards=(-900.0, -900.0))
    assert write_flights(sheet.tables(), tmp_path / "flights.png")
    (panel,) = figures[0].axes
    assert means_of(panel) == [{0.0: 55.0, 8.0: 20.0}]
    assert panel.get_title() == "N = 3"


def test_a_setting_is_shown_by_what_it_changes_beside_its_default(tmp_path, figures):
    """Budgets of flight have a figure of their own; one seed has no interval."""
    sheet = Sheet().add("hybrid", "mlp", rewards=(-50.0, -51.0))
    sheet.add("hybrid", "mlp", variant="x=1", rewards=(-40.0, -41.5))
    sheet.add("hybrid", "mlp", variant="flights=8", rewards=(-60.0, -61.0))
    sheet.add("hybrid", "mlp", variant="y=2", rewards=(-40.0,))
    assert write_settings(sheet.tables(), tmp_path / "settings.png")
    (panel,) = figures[0].axes
    assert [label.get_text() for label in panel.get_yticklabels()] == ["Hybrid, x=1"]
    (bar,) = panel.containers
    (mean,) = bar.lines[0].get_xdata()
    assert mean == pytest.approx(100.0 * 9.75 / 50.5)
    ends = bar.lines[2][0].get_segments()[0][:, 0]
    np.testing.assert_allclose(ends, 100.0 * np.asarray([6.573, 12.927]) / 50.5, rtol=1e-3)


def test_cells_of_settings_differ_in_colour_or_mark(tmp_path, figures):
    sheet = Sheet()
    for task in ("circle", "figure8", "pitchandexpand", "spread"):
        for n in (3, 7, 12):
            for variant, rewards in (("", (-50.0, -51.0)), ("x=1", (-40.0, -41.5))):
                cell = {"task": task, "team_size": n}
                sheet.add("hybrid", "mlp", variant=variant, rewards=rewards, **cell)
    assert write_settings(sheet.tables(), tmp_path / "settings.png")
    (panel,) = figures[0].axes
    marks = [bar.lines[0] for bar in panel.containers]
    assert len({(tuple(mark.get_color()), mark.get_marker()) for mark in marks}) == 12


def test_a_world_has_a_row_and_every_seed_a_dot(tmp_path, figures, full_tables):
    write_worlds(full_tables, tmp_path / "worlds.png")
    (worlds,) = figures
    titles = {panel.get_title() for panel in worlds.axes}
    shown = [world.replace(", y=0, z=0", "") for world in WORLDS]
    assert titles == {f"{task}, {world}" for task in ("circle", "figure8") for world in shown}
    panel = worlds.axes[0]
    names = [label.get_text() for label in panel.get_yticklabels()]
    assert names == [
        "Hybrid on the unchanged drone",
        "recalibrated",
        "Hybrid",
        "LF baseline",
        "PD tracking",
    ]
    dots = np.concatenate([c.get_offsets() for c in panel.collections if len(c.get_offsets())])
    hybrid = dots[np.abs(dots[:, 1] - names.index("Hybrid on the unchanged drone")) < 0.5, 0]
    sizes = (-120.0, -100.0 - 60.0 / 7.0, -100.2)
    np.testing.assert_allclose(sorted(hybrid), sorted(x for n in sizes for x in around(n)))


@pytest.mark.parametrize("write", [write_flights, write_settings, write_worlds])
def test_what_was_not_studied_is_not_drawn(tmp_path, write):
    defaults = typical()
    plain = defaults.results["variant"].eq("")
    defaults = dataclasses.replace(defaults, results=defaults.results[plain])
    assert not write(defaults, tmp_path / "figure.png")
    assert not write(empty(), tmp_path / "figure.png")
    assert not list(tmp_path.iterdir())


def test_variants_and_other_worlds_are_not_drawn(tmp_path, figures):
    sheet = Sheet().add(rewards=(-50.0, -51.0)).add_upper()
    sheet.add("hybrid", "mlp", variant="x=1", rewards=(-1.0, -2.0))
    before = len(sheet.results)
    sheet.add("hf_scratch", rewards=(-1.0, -2.0)).add_upper()
    for row in sheet.results[before:]:
        row["deployed_effects"] = "wind(x=1.5)"
    tables = sheet.tables()
    write_cost(tables, tmp_path / "cost.png")
    write_summary(tables, tmp_path / "summary.png")
    (container,) = figures[0].axes[0].containers
    assert container.get_label() == "LF baseline"
    drawn = [line for line in figures[1].axes[0].get_lines() if len(line.get_xdata())]
    assert {tuple(line.get_ydata()) for line in drawn} == {(-50.5,)}


def test_a_picture_can_stand_in_a_page_that_has_no_files(tmp_path):
    (tmp_path / "figure.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert data_uri(tmp_path / "figure.png") == "data:image/png;base64,iVBORw0KGgo="
