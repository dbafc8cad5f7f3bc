"""Claims on an off-spec drone against tables whose answers are known by hand."""

from tables_for_tests import Sheet

from bench.claims import write_claims
from bench.off_spec_claims import off_spec_claims

EFFECTS = "Drag(c=2)"
WORLD = f"crazyflow+{EFFECTS}"


def flown(recalibrated=-55.0, tracked=-90.0, team_size=3):
    """Figure8 with a drone of more drag, three seeds, beside a Hybrid on the nominal one."""
    cell = {"task": "figure8", "team_size": team_size}
    sheet = Sheet().add("hybrid", "mlp", rewards=three(-50.0), **cell)
    before = len(sheet.results)
    sheet.add("lf_baseline", variant=f"deployed_in={WORLD}", rewards=three(-80.0), **cell)
    variant = f"deployed_in={WORLD}, tracked=true"
    sheet.add("lf_baseline", variant=variant, rewards=three(tracked), **cell)
    sheet.add("hybrid", "mlp", variant=f"deployed_in={WORLD}", rewards=three(-60.0), **cell)
    sheet.add("recalibrated", variant=f"reality={WORLD}", rewards=three(recalibrated), **cell)
    for row in sheet.results[before:]:
        row["deployed_effects"] = EFFECTS
    return sheet


def three(mean):
    return (mean - 1.0, mean, mean + 1.5)


def test_all_hold_where_recalibration_recovers():
    above, beside_pd, kept, tracking = off_spec_claims(flown().tables())
    assert [c.holds for c in (above, beside_pd, kept, tracking)] == [True] * 4
    assert above.ours == "1 of 1 cells (1 significantly above, 0 significantly below)"
    assert above.lines[0][3] == "25.0"
    assert kept.ours == "loses 10.0 to 10.0 %"
    assert kept.lines[0][2] == "-59.8 ± 1.3 (n = 3)"


def test_none_holds_where_it_does_not_recover():
    found = off_spec_claims(flown(recalibrated=-95.0, tracked=-70.0).tables())
    assert [claim.holds for claim in found] == [False] * 4
    assert found[3].ours.startswith("above in 1 of 1 cells")


def test_other_settings_are_not_what_the_paper_compares():
    sheet = flown()
    for row in sheet.results:
        if row["method"] == "lf_baseline":
            row["variant"] += ", trainer.epochs=5"
    above, beside_pd, kept, tracking = off_spec_claims(sheet.tables())
    assert (above.holds, beside_pd.holds, kept.holds, tracking.holds) == (None, None, True, None)


def test_they_stand_in_the_document_only_where_something_was_recalibrated(tmp_path):
    path, other = tmp_path / "off_spec.md", tmp_path / "other.md"
    write_claims(flown().tables(), path)
    text = path.read_text(encoding="utf-8")
    assert "## On a drone that is off its specification" in text
    assert "](off_spec_worlds.png)" in text
    assert path.with_suffix(".html").read_text(encoding="utf-8").count("data:image/png") == 2
    write_claims(Sheet().add("hybrid", "mlp").tables(), other)
    assert "off its specification" not in other.read_text(encoding="utf-8")
    pictures = sorted(picture.name for picture in tmp_path.glob("*.png"))
    assert pictures == ["off_spec_summary.png", "off_spec_worlds.png", "other_summary.png"]
