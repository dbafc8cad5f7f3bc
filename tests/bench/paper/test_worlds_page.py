"""The page of worlds: who survives where, from small tables of two suites."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from tables_for_tests import SPAWN_SETTLED, Sheet

from bench.paper.world_views import AS_IS, TO_PERFECT, TO_UPPER, World, matrix, views, ways
from bench.paper.worlds_page import add_worlds_page, document, write_worlds_page
from bench.plan.realities import parse_reality
from bench.stats.scores import UPPER
from bench.stats.statistics import Entry
from bench.store.tables import Tables
from simulators.effects.chain import canonical

ROOT = Path(__file__).parents[3]
CONTACT = canonical(parse_reality("contact").effects)
PLAIN, ROTORPY, PUSHING = World("crazyflow"), World("rotorpy"), World("crazyflow", CONTACT)
LF, HYBRID, GREY = Entry("lf_baseline"), Entry("hybrid", "mlp"), Entry("grey_box")


def add(
    sheet,
    world,
    method,
    residual="",
    *,
    mean,
    apart=2.0,
    trained=True,
    home="crazyflow",
    settings="",
    **more,
):
    """Two seeds of a method in a world, as a suite whose home is another would write them."""
    before, key = len(sheet.results), "reality" if trained else "deployed_in"
    place = f"{key}={world.text}" if world.text != home else ""
    variant = ", ".join(filter(None, (place, settings)))
    sheet.add(
        method, residual, variant=variant, rewards=(mean - apart / 2.0, mean + apart / 2.0), **more
    )
    for row in sheet.results[before:]:
        row["simulator"], row["deployed_effects"] = world


def suites(upper=True):
    """Crazyflow and contact in one suite, RotorPy as home of another.

    LF holds everywhere but in RotorPy, grey box is second everywhere, Hybrid breaks with contacts.
    """
    one, two = Sheet(), Sheet()
    for sheet, world, home, lf, hybrid, grey in (
        (one, PLAIN, "crazyflow", -90.0, -60.0, -70.0),
        (one, PUSHING, "crazyflow", -90.0, -400.0, -80.0),
        (two, ROTORPY, "rotorpy", -300.0, -60.0, -75.0),
    ):
        place = {"home": home}
        add(sheet, world, "lf_baseline", mean=lf, trained=world is not PUSHING, **place)
        add(sheet, world, "hybrid", "mlp", mean=hybrid, fleet_minutes=40.0, **place)
        add(sheet, world, "grey_box", mean=grey, fleet_minutes=0.5, **place)
        if upper:
            add(sheet, world, UPPER, mean=-50.0, fleet_minutes=900.0, **place)
    return [one.tables(), two.tables()]


def viewed(tables):
    found = views(tables)
    return found, matrix(found) if len(found) > 1 else None


def test_each_world_is_home_in_its_view():
    found = views(suites())
    assert list(found) == [PLAIN, ROTORPY, PUSHING]
    for tables in found.values():
        assert set(tables.results["deployed_effects"]) == {""}
        assert set(tables.runs["variant"]) == {""}
        assert len(tables.runs) == 8
    assert PUSHING.name == "contact"


def test_a_run_that_two_suites_call_differently_counts_once():
    home, elsewhere = Sheet(), Sheet()
    add(home, ROTORPY, "grey_box", mean=-70.0, home="rotorpy", fleet_minutes=0.5)
    add(elsewhere, ROTORPY, "grey_box", mean=-70.0, fleet_minutes=0.5)
    (view,) = views([home.tables(), elsewhere.tables()]).values()
    assert len(view.runs) == 2  # two seeds


def test_who_knows_another_world_is_named_apart_where_it_is_only_deployed():
    sheet = Sheet()
    add(sheet, PLAIN, "hybrid", "mlp", mean=-60.0, fleet_minutes=40.0)
    add(sheet, ROTORPY, "hybrid", "mlp", mean=-80.0, trained=False)
    add(sheet, ROTORPY, "lf_baseline", mean=-90.0, trained=False)
    found = views([sheet.tables()])[ROTORPY].runs
    assert set(found["variant"]) == {AS_IS, ""}
    assert set(found.loc[found["variant"].eq(""), "method"]) == {"lf_baseline"}


def test_scores_the_worst_world_and_the_front_are_those_of_a_recount():
    found = matrix(views(suites()))
    assert found.scale == TO_UPPER
    by_entry = {s.entry: s for s in found.standings}
    score = lambda mean: (mean - SPAWN_SETTLED) / (-50.0 - SPAWN_SETTLED)  # noqa: E731
    assert by_entry[LF].worst == ROTORPY
    assert by_entry[LF].worst_score == pytest.approx(score(-300.0))
    assert by_entry[HYBRID].worst == PUSHING
    assert by_entry[GREY].worst_score == pytest.approx(score(-80.0))
    assert [s.entry for s in found.standings] == [GREY, LF, HYBRID]
    assert found.front == {LF, GREY}  # Hybrid flies more and is worse in its worst world
    assert by_entry[GREY].minutes == pytest.approx(0.5)
    mean, low, high = by_entry[GREY].scores[PLAIN]
    half = 12.706 * np.sqrt(2.0) / np.sqrt(2.0) / (-50.0 - SPAWN_SETTLED)  # t(1) * std / sqrt(2)
    np.testing.assert_allclose([mean - low, high - mean], half, rtol=1e-3)


def test_a_policy_that_is_deployed_as_it_is_has_its_own_line_with_its_home_score():
    sheet = Sheet()
    for world, hybrid in ((PLAIN, -60.0), (ROTORPY, -300.0), (PUSHING, -70.0)):
        add(sheet, world, "hybrid", "mlp", mean=hybrid, trained=world is PLAIN, fleet_minutes=40.0)
        add(sheet, world, "lf_baseline", mean=-90.0, trained=world is PLAIN)
    found = matrix(views([sheet.tables()]))
    as_is = HYBRID._replace(variant=AS_IS)
    by_entry = {s.entry: s for s in found.standings}
    assert list(by_entry[as_is].scores) == [PLAIN, ROTORPY, PUSHING]
    assert by_entry[as_is].worst == ROTORPY
    assert by_entry[as_is].scores[PLAIN] == by_entry[HYBRID].scores[PLAIN]
    assert by_entry[HYBRID].worst is None  # trained in one world of three
    assert [s.entry for s in found.standings] == [LF, as_is, HYBRID]


def test_without_an_upper_reference_scores_run_to_a_perfect_return():
    found = matrix(views(suites(upper=False)))
    assert found.scale == TO_PERFECT
    (grey,) = [s for s in found.standings if s.entry == GREY]
    assert grey.worst_score == pytest.approx(1.0 - 80.0 / 900.0)


def test_who_did_not_fly_everywhere_has_no_worst_world():
    one, two = Sheet(), Sheet()
    for sheet, world in ((one, PLAIN), (two, ROTORPY)):
        add(sheet, world, "lf_baseline", mean=-90.0)
    add(two, ROTORPY, "grey_box", mean=-60.0, fleet_minutes=0.5)
    add(two, ROTORPY, "lf_baseline", mean=-90.0, team_size=12)
    found = matrix(views([one.tables(), two.tables()]))
    assert [(c.team_size, found.left_out) for c in found.cells] == [(3, ())]
    (grey,) = [s for s in found.standings if s.entry == GREY]
    assert grey.worst is None
    assert found.standings[-1] == grey
    assert found.front == {LF}


def test_the_summary_names_only_methods_that_the_table_has():
    """Grey box has the highest mean in RotorPy, but flew nowhere else."""
    one, two = Sheet(), Sheet()
    for sheet, world in ((one, PLAIN), (two, ROTORPY)):
        add(sheet, world, "lf_baseline", mean=-90.0)
        add(sheet, world, "hybrid", "mlp", mean=-80.0, fleet_minutes=40.0)
    add(two, ROTORPY, "grey_box", mean=-60.0, fleet_minutes=0.5)
    text = document(*viewed([one.tables(), two.tables()]), "worlds_gaps.png")
    assert "- Highest mean in rotorpy: Hybrid, " in text
    assert "grey box" not in text


def test_the_summary_says_who_is_not_shown_to_be_worse_than_the_best():
    """By seeds in pairs: Hybrid is 9 ahead and 13 behind, the LF baseline 30 behind in both."""
    sheet = Sheet()
    for world in (PLAIN, ROTORPY):
        add(sheet, world, "grey_box", mean=-60.0, fleet_minutes=0.5)
        add(sheet, world, "hybrid", "mlp", mean=-62.0, apart=-20.0, fleet_minutes=40.0)
        add(sheet, world, "lf_baseline", mean=-90.0)
    found, made = viewed([sheet.tables()])
    assert made.best == dict.fromkeys(found, (GREY, HYBRID))
    (line,) = [x for x in document(found, made).splitlines() if "Highest mean in rotorpy" in x]
    assert "grey box, " in line
    assert line.endswith("; not shown to be above Hybrid.")


def test_with_one_seed_nobody_is_shown_to_be_worse_than_the_best():
    sheet = Sheet()
    for world in (PLAIN, ROTORPY):
        add(sheet, world, "grey_box", mean=-60.0)
        add(sheet, world, "hybrid", "mlp", mean=-62.0)
    tables = sheet.tables()
    one = {n: f.loc[f["seed"].eq(0)] for n, f in vars(tables).items() if "seed" in f}
    found, made = viewed([dataclasses.replace(tables, **one)])
    assert made.best == dict.fromkeys(found, (GREY, HYBRID))


def test_claims_that_no_other_world_decides_are_left_out():
    sheet = Sheet()
    for world in (PLAIN, ROTORPY):
        add(sheet, world, "hybrid", "mlp", mean=-60.0, fleet_minutes=40.0)
        add(sheet, world, "lf_baseline", mean=-90.0)
    text = document(*viewed([sheet.tables()]))
    assert "of the claims" not in text
    assert "| claim |" not in text


def test_the_page_says_it_in_words_and_is_the_same_whatever_the_order(tmp_path):
    own = suites()
    write_worlds_page(own, tmp_path / "worlds.md")
    text = (tmp_path / "worlds.md").read_text(encoding="utf-8")
    assert (tmp_path / "worlds.html").is_file()
    assert "| **grey box** | " in text
    assert "| contact | 0.965 | 0.5 |" in text
    assert "with 0.5 fleet-minutes of flight**: grey box, 0.965 in contact." in text
    assert f"`contact`: {PUSHING.text}" in text.replace("\\", "")
    assert "| Hybrid deploys above the LF baseline in every cell | " in text
    assert document(*viewed(own[::-1]), "worlds_gaps.png") == text


def test_cells_that_not_everybody_flew_everywhere_are_left_out_by_name():
    sheet = Sheet()
    for world in (PLAIN, ROTORPY):
        for size in (3, 12):
            add(sheet, world, "lf_baseline", mean=-90.0, trained=False, team_size=size)
        add(sheet, world, "domain_randomization", mean=-80.0, trained=False)
    text = document(*viewed([sheet.tables()]))
    assert "means over spread, N = 3. Methods that did not fly" in text
    assert "Means over the cells named above, which every method here flew in every world" in text
    assert "not every method flew there in every world: spread, N = 12." in text


def test_claims_are_judged_of_policies_as_they_are_by_what_they_return_there():
    sheet = Sheet()
    for world, hybrid in ((PLAIN, -60.0), (ROTORPY, -300.0)):
        trained = world is PLAIN
        add(sheet, world, "hybrid", "mlp", mean=hybrid, trained=trained, fleet_minutes=40.0)
        add(sheet, world, "lf_baseline", mean=-90.0, trained=trained)
    text = document(*viewed([sheet.tables()]))
    assert "| claim | crazyflow | rotorpy, as it is |" in text
    assert (
        "| Hybrid deploys above the LF baseline in every cell | undecided | **refuted** |" in text
    )
    said = (
        "- *Hybrid deploys above the LF baseline in every cell*: **refuted** in rotorpy (as it is)."
    )
    assert said in text[: text.index("## Scores")]
    assert "needs the least HF flight" not in text  # about training, which was elsewhere
    assert "Hybrid, as it is | 0.93" in text
    (flight,) = [one.split("|")[-2].strip() for one in text.splitlines() if "Hybrid, as it" in one]
    assert flight == "40"  # what its training flew, although nothing was flown where it is deployed


def test_another_residual_that_was_trained_there_stays_beside_policies_as_they_are():
    sheet = Sheet()
    for world in (PLAIN, ROTORPY):
        add(sheet, world, "hybrid", "affine", mean=-70.0, fleet_minutes=40.0)
        add(sheet, world, "hybrid", "mlp", mean=-60.0, trained=world is PLAIN, fleet_minutes=40.0)
    (found,) = [own for way, own in ways(views([sheet.tables()])[ROTORPY]).items() if way == AS_IS]
    assert set(found.results["residual"]) == {"affine", "mlp"}
    assert set(found.results["variant"]) == {""}
    assert "fleet_minutes" not in set(found.results["metric"])


def test_the_page_shows_who_flew_everywhere_and_ends_with_notes(tmp_path):
    notes = tmp_path / "notes.md"
    notes.write_text("## Why\n\nBecause.\n", encoding="utf-8")
    write_worlds_page(suites(), tmp_path / "worlds.md", notes)
    assert (tmp_path / "worlds_gaps.png").stat().st_size > 5000
    text = (tmp_path / "worlds.md").read_text(encoding="utf-8")
    assert "](worlds_gaps.png)" in text
    assert text.endswith("## Why\n\nBecause.\n")
    assert text.startswith("# Worlds that differ")
    assert "data:image/png" in (tmp_path / "worlds.html").read_text(encoding="utf-8")


def test_notes_that_begin_with_a_heading_give_the_page_its_title_and_its_lead(tmp_path):
    notes = tmp_path / "notes.md"
    notes.write_text("# Contact\n\n**It costs.**\n\n## Why\n\nBecause.\n", encoding="utf-8")
    write_worlds_page(suites(), tmp_path / "contact.md", notes)
    text = (tmp_path / "contact.md").read_text(encoding="utf-8")
    assert text.startswith("# Contact\n\n## In short\n\n**It costs.**\n\n- **Best")
    assert text.count("It costs.") == 1
    assert text.endswith("\n\n## Why\n\nBecause.\n")
    assert "<title>Contact" in (tmp_path / "contact.html").read_text(encoding="utf-8")


def test_one_world_alone_is_no_comparison():
    sheet = Sheet()
    add(sheet, PLAIN, "lf_baseline", mean=-90.0)
    assert "fewer than 2 worlds" in document(*viewed([sheet.tables()]))
    assert "fewer than 2 worlds" in document(*viewed([Tables.empty()]))


def test_the_worst_tenth_of_all_drones_stands_beside_the_mean():
    one = Sheet()
    for world in (PLAIN, PUSHING):
        add(one, world, "lf_baseline", mean=-90.0, trained=False, worst_decile_reward=-140.0)
    text = document(*viewed([one.tables()]))
    assert "## The worst tenth of all drones" in text
    assert "| LF baseline | -140 | -140 |" in text


def test_a_world_in_which_most_have_no_worst_tenth_is_left_out_there():
    one = Sheet()
    for world, more in ((PLAIN, {}), (PUSHING, {"worst_decile_reward": -140.0})):
        add(one, world, "lf_baseline", mean=-90.0, trained=False, **more)
    assert "| method | contact |" in document(*viewed([one.tables()]))


def test_a_sweep_through_three_worlds_shows_their_matrix(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    sheet = Sheet()
    for world in (PLAIN, ROTORPY, PUSHING):
        add(sheet, world, "lf_baseline", mean=-90.0, trained=False)
    sheet.tables().save(tmp_path / "tables")
    add_worlds_page(tmp_path / "tables", tmp_path / "pages")
    shown = capsys.readouterr().out
    assert all(word in shown for word in ("crazyflow", "rotorpy", "contact", "LF baseline", "0.9"))
    assert (tmp_path / "pages" / "worlds.md").is_file()


def test_a_sweep_in_one_world_shows_none(tmp_path, capsys):
    sheet = Sheet()
    add(sheet, PLAIN, "lf_baseline", mean=-90.0)
    sheet.tables().save(tmp_path / "tables")
    add_worlds_page(tmp_path / "tables", tmp_path / "pages")
    add_worlds_page(tmp_path / "nowhere", tmp_path / "pages")
    assert capsys.readouterr().out == ""
    assert not (tmp_path / "pages").exists()


@pytest.mark.parametrize(
    ("page", "suites", "notes"),
    [
        ("worlds.md", ("paper", "transfer"), "worlds_notes.md"),
        ("worlds_trained.md", ("worlds",), "worlds_trained_notes.md"),
        ("rotorpy.md", ("paper", "paper_rotorpy"), "rotorpy_notes.md"),
        ("field_parts.md", ("paper", "field_parts"), "field_parts_notes.md"),
        ("contact.md", ("paper", "contact"), "contact_notes.md"),
    ],
)
def test_the_committed_pages_are_those_of_the_committed_tables(
    tmp_path, monkeypatch, page, suites, notes
):
    monkeypatch.setattr(Figure, "savefig", lambda self, path, **_: Path(path).write_bytes(b""))
    reports = ROOT / "reports"
    tables = [Tables.load(ROOT / "results" / suite) for suite in suites]
    write_worlds_page(tables, tmp_path / page, reports / notes)
    own = (tmp_path / page).read_text(encoding="utf-8")
    assert own == (reports / page).read_text(encoding="utf-8")


def test_other_settings_have_a_line_where_they_flew_all_that_is_compared():
    """A setting that flew fewer cells takes none from the others."""
    sheet = Sheet()
    flown = [
        (world, n, settings, mean)
        for world in (PLAIN, ROTORPY)
        for n in (3, 12)
        for settings, mean in (("", -80.0), ("push=0.5", -60.0), ("push=1", -60.0))
        if (n, settings) != (12, "push=1")
    ]
    for world, n, settings, mean in flown:
        more = {"settings": settings, "team_size": n, "fleet_minutes": 0.5}
        add(sheet, world, "grey_box", mean=mean, trained=world is PLAIN, **more)
    found, made = viewed([sheet.tables()])
    assert [cell.team_size for cell in made.cells] == [3, 12]
    best = made.standings[0]
    assert best.entry == GREY._replace(variant=f"{AS_IS}, push=0.5")
    assert list(best.scores) == [PLAIN, ROTORPY]
    text = document(found, made)
    assert f"grey box (push=0.5), {AS_IS}" in text
    assert "push=1" not in text
