"""The page of cells: each claim's table, and the settings that differ from the default."""

import re

import pytest
from tables_for_tests import Sheet

from bench.paper.choosing import beside_defaults
from bench.paper.claims import CLAIMS


def test_a_claim_leads_to_its_table_in_markdown_and_in_html(full, text, html, cells):
    led = re.findall(r"^\| \[(.*?)\]\(paper_cells\.md#(.*?)\) \|", text, re.MULTILINE)
    assert len(led) == len(CLAIMS)
    cells_html = (full / "paper_cells.html").read_text(encoding="utf-8")
    for title, place in led:
        assert f"\n## {title}\n" in cells
        assert f'href="paper_cells.html#{place}"' in html
        assert f'id="{place}"' in cells_html
    assert 'href="paper.html"' in cells_html
    assert ".md" not in re.sub(r"<style.*?</style>|data:[^\"]*", "", html, flags=re.DOTALL)


def line_of(sheet):
    """The only line of the table of settings."""
    (line,) = beside_defaults(sheet.tables(), [])[-1].splitlines()[2:]
    return [text.strip() for text in line.strip("|").split("|")]


@pytest.mark.parametrize(
    ("rewards", "word"),
    [
        ((-40.0, -41.5), "better"),
        ((-60.0, -61.5), "worse"),
        ((-50.0, -51.0), "tied"),
        ((-45.0, -56.0), "tied"),
        ((-40.0,), "one seed: no order"),
    ],
)
def test_a_variant_is_better_worse_or_tied(rewards, word):
    sheet = Sheet().add("hybrid", "mlp", rewards=(-50.0, -51.0))
    sheet.add("hybrid", "mlp", variant="x=1", rewards=rewards)
    assert line_of(sheet)[-1] == word


def test_a_variant_is_compared_over_the_seeds_that_both_have():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-90.0, -50.0, -51.0))
    sheet.add("hybrid", "mlp", variant="x=1", rewards=(-40.0, -41.5), first_seed=1)
    line = line_of(sheet)
    assert line[2:4] == ["-50.5 ± 0.7 (n = 2)", "-40.8 ± 1.1 (n = 2)"]
    assert line[4].startswith("9.8 (")


def test_a_variant_without_default_is_shown_alone_unless_it_was_made_for_another_world():
    sheet = Sheet().add("hybrid", "mlp", variant="y=2", rewards=(-40.0,))
    before = len(sheet.results)
    sheet.add("hybrid", "mlp", variant="deployed_in=crazyflow+wind(x=1.5)", task="circle")
    for row in sheet.results[before:]:
        row["deployed_effects"] = "wind(x=1.5)"
    sheet.add_upper(variant="z=3")
    assert line_of(sheet)[1:] == ["hybrid (mlp), y=2", "-", "-40.0 (n = 1)", "-", "no default row"]


def test_settings_that_chance_alone_would_call_better_are_counted_beside():
    sheet = Sheet()
    for task, apart in (("circle", (10.0, 10.1)), ("spread", (1.0, 1.1)), ("figure8", (5.0, -5.0))):
        sheet.add("hybrid", "mlp", task=task, rewards=(-50.0, -51.0))
        rewards = (-50.0 + apart[0], -51.0 + apart[1])
        sheet.add("hybrid", "mlp", task=task, variant="x=1", rewards=rewards)
    said, table = beside_defaults(sheet.tables(), [])[1:]
    assert "2 are better and 0 worse, where chance alone would make about 0 of either" in said
    # p = 0.0063 and 0.061, times three and two.
    assert "over the whole table 1 of these remains." in said
    assert table.count("| better |") == 2
    assert beside_defaults(Sheet().add("hybrid", "mlp", rewards=(-50.0,)).tables(), []) == []
