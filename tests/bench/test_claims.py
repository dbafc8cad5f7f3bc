"""Claims against tables whose answers are known by hand."""

from pathlib import Path

import pytest
import tables_for_tests
from tables_for_tests import Sheet

from bench.claims import claims, variants, write_claims
from bench.errors import UsageError
from bench.side_claims import side_claims
from bench.tables import Tables

NAMES = (
    "above_baseline",
    "above_scratch",
    "scratch_below_hotstart",
    "gap_narrows",
    "gap_closed",
    "no_crashes",
    "fleet_minutes",
    "residual_classes",
    "crash_rates",
    "solved_in_lf",
)


def by_name(tables):
    return dict(zip(NAMES, claims(tables), strict=True))


def two_sizes():
    """Spread and circle at N = 3 and 12, as the paper has it but for circle at N = 3."""
    sheet = Sheet()
    for task in ("spread", "circle"):
        for n, hot, hybrid in ((3, -50.0, -60.0), (12, -100.0, -100.5)):
            cell = {"task": task, "team_size": n}
            lf = (hybrid - 20.0, hybrid - 21.0, hybrid - 22.5)
            lost = task == "circle" and n == 3
            scratch = hybrid + 5.0 if lost else hybrid - 5.0
            sheet.add("lf_baseline", rewards=lf, lf_position_error=0.01 * n, **cell)
            sheet.add(
                "hf_hotstart",
                rewards=(hot,) * 3,
                training_reward=-40.0,
                **cell,
                fleet_minutes=50.0 * n,
                training_crashes=9.0,
                training_crash_step_rate=0.01 * n,
            )
            sheet.add(
                "hf_scratch",
                rewards=(scratch,) * 3,
                training_reward=-45.0,
                **cell,
                fleet_minutes=90.0 * n,
                training_crashes=99.0,
                training_crash_step_rate=0.02 * n,
            )
            sheet.add(
                "hybrid",
                "mlp",
                rewards=(hybrid, hybrid - 1.0, hybrid + 1.0),
                **cell,
                fleet_minutes=10.0 * (n + 1),
                calibration_crashes=2.0,
                lf_collisions=30.0,
            )
            sheet.add("hybrid", "affine", rewards=(2.0 * hybrid,) * 3, **cell)
            sheet.add("hybrid", "sindy", rewards=(hybrid + 2.0,) * 3, **cell)
    return sheet


@pytest.fixture(scope="module")
def found():
    return by_name(two_sizes().tables())


def test_hybrid_above_baseline_counts_cells_and_significance(found):
    claim = found["above_baseline"]
    assert claim.holds is True
    assert claim.ours == "4 of 4 cells (4 significantly above, 0 significantly below)"
    assert [line[0] for line in claim.lines][:2] == ["circle, N = 3", "circle, N = 12"]
    assert claim.lines[0][1:4] == ("-60.0 ± 1.0 (n = 3)", "-81.2 ± 1.3 (n = 3)", "21.2")


def test_losing_to_scratch_where_the_paper_loses_does_not_break_the_claim(found):
    assert found["above_scratch"].ours.startswith("3 of 4 cells")
    assert found["above_scratch"].holds is True


def test_losing_to_scratch_elsewhere_breaks_the_claim():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-9.0,)).add("hf_scratch", rewards=(-8.0,))
    assert by_name(sheet.tables())["above_scratch"].holds is False


def test_scratch_above_hotstart_in_training_breaks_the_claim(found):
    assert found["scratch_below_hotstart"].holds is True
    sheet = two_sizes().add("hf_scratch", task="figure8", training_reward=-1.0)
    sheet.add("hf_hotstart", task="figure8", training_reward=-2.0)
    claim = by_name(sheet.tables())["scratch_below_hotstart"]
    assert claim.holds is False
    assert claim.ours.startswith("1 of 5 cells")


def test_gap_is_in_percent_of_hot_start_and_averaged_over_tasks(found):
    assert found["gap_narrows"].ours == (
        "20.0 % at N = 3, 0.5 % at N = 12; smaller for the largest team in 2 of 2 tasks"
    )
    assert found["gap_narrows"].holds is True
    assert found["gap_closed"].holds is True


def test_gap_averages_only_tasks_that_every_team_size_has():
    sheet = two_sizes().add("hybrid", "mlp", task="figure8", rewards=(-300.0,))
    sheet.add("hf_hotstart", task="figure8", rewards=(-100.0,))
    assert by_name(sheet.tables())["gap_narrows"].ours == (
        "20.0 % at N = 3, 0.5 % at N = 12; smaller for the largest team in 2 of 2 tasks"
    )


def test_a_single_team_size_has_no_trend():
    sheet = Sheet().add("hybrid", "mlp").add("hf_hotstart", rewards=(-40.0,))
    found = by_name(sheet.tables())
    assert found["gap_narrows"].ours == "25.0 % at N = 3"
    assert found["gap_narrows"].holds is found["gap_closed"].holds is None


def test_crashes_of_calibration_and_of_lf_training_stand_beside_the_zero(found):
    claim = found["no_crashes"]
    assert claim.holds is True
    assert claim.ours.startswith("0 in 12 runs; 2 crashes of calibration flights and 30 collisions")
    assert ("HF scratch, N = 12", "99", "0", "7") in claim.lines


def test_one_hf_training_crash_breaks_the_claim():
    sheet = two_sizes().add("hybrid", "mlp", task="figure8", training_crashes=1.0)
    assert by_name(sheet.tables())["no_crashes"].holds is False


def test_fleet_minutes_stand_beside_what_the_papers_flights_add_up_to(found):
    claim = found["fleet_minutes"]
    assert claim.holds is True
    assert claim.lines == (
        ("N = 3", "0", "40", "150", "270", "40"),
        ("N = 12", "0", "130", "600", "1080", "130"),
    )


def test_best_residual_class_is_bold_and_collapses_are_counted(found):
    claim = found["residual_classes"]
    assert claim.holds is False  # SINDy collapses nowhere
    assert claim.ours == (
        "affine: best in 0, collapses in 4 of 4; sindy: best in 4, collapses in 0 of 4; "
        "mlp: best in 0, collapses in 0 of 4"
    )
    assert claim.lines[0][2] == "**-58.0 ± 0.0 (n = 3)**"


def test_a_diverged_run_is_a_collapse():
    sheet = two_sizes().add("hybrid", "sindy", rewards=(-1.0,), status="diverged", first_seed=3)
    assert by_name(sheet.tables())["residual_classes"].holds is True


def test_crash_rates_are_percent_by_team_size(found):
    assert found["crash_rates"].holds is True
    assert ("circle, N = 12", "24.00", "12.00") in found["crash_rates"].lines
    assert "larger for the largest team in" in found["crash_rates"].ours


def test_crash_rates_must_grow_in_every_task():
    """A mean over tasks would hide figure8, and tasks that were flown at one size only."""

    def rates(circle, figure8):
        sheet = Sheet()
        for method in ("hf_scratch", "hf_hotstart"):
            for n, task, rate in (
                (3, "spread", 0.01),
                (12, "spread", 0.2),
                (3, "circle", 0.0),
                (12, "circle", circle),
                (3, "figure8", 0.05),
                (12, "figure8", figure8),
            ):
                sheet.add(method, task=task, team_size=n, training_crash_step_rate=rate)
        return by_name(sheet.tables())["crash_rates"]

    assert rates(0.0, 0.06).holds is True
    assert rates(0.0, 0.04).holds is False
    assert "in 2 of 4 tasks and methods" in rates(0.0, 0.04).ours


def test_means_at_team_sizes_are_of_the_same_tasks():
    sheet = Sheet()
    for method, residual, minutes in (
        ("hf_scratch", "", 300.0),
        ("hf_hotstart", "", 90.0),
        ("hybrid", "mlp", 40.0),
        ("lf_baseline", "", 0.0),
    ):
        sheet.add(method, residual, task="circle", team_size=3, fleet_minutes=minutes)
        sheet.add(method, residual, task="circle", team_size=12, fleet_minutes=minutes)
    sheet.add("hf_scratch", task="spread", team_size=12, fleet_minutes=1.0)
    assert "scratch 300" in by_name(sheet.tables())["fleet_minutes"].ours.split(";")[1]


def test_lf_policies_must_be_within_15_cm_in_every_cell(found):
    assert found["solved_in_lf"].ours == "4 of 4 cells"
    sheet = two_sizes().add("lf_baseline", task="figure8", lf_position_error=0.151)
    claim = by_name(sheet.tables())["solved_in_lf"]
    assert (claim.ours, claim.holds) == ("4 of 5 cells", False)


def test_lost_runs_are_missing_cells_and_no_victories():
    sheet = two_sizes().add("hybrid", "mlp", task="figure8", rewards=(-1.0,))
    sheet.add("lf_baseline", task="figure8", rewards=(-9.0,), status="diverged")
    text = by_name(sheet.tables())["above_baseline"].ours
    assert text.startswith("4 of 4 cells")
    assert text.endswith("; 1 more without a finished run of one of them")


def test_other_worlds_and_variants_are_no_evidence_for_the_claims():
    sheet = two_sizes().add("hybrid", "mlp", variant="x=1", task="figure8").add(task="figure8")
    for row in sheet.results[-24:]:
        row["deployed_effects"] = "wind(1.5)"
    assert by_name(sheet.tables())["above_baseline"].ours.startswith("4 of 4 cells (4 sig")


def test_no_rows_decide_nothing():
    found = claims(tables_for_tests.empty())
    assert [claim.holds for claim in found] == [None] * len(NAMES)


def test_variants_stand_beside_their_default():
    sheet = Sheet().add("hybrid", "mlp", rewards=(-50.0, -51.0))
    sheet.add("hybrid", "mlp", variant="x=1", rewards=(-40.0, -41.5))
    sheet.add("hybrid", "mlp", variant="y=2", task="circle", rewards=(-40.0,))
    before = len(sheet.results)
    sheet.add("hybrid", "mlp", variant="deployed_in=crazyflow+wind(1.5)", task="circle")
    for row in sheet.results[before:]:
        row["deployed_effects"] = "wind(1.5)"
    _, lines = variants(sheet.tables())
    alone, beside = lines
    assert alone[2:] == ("-", "-40.0 (n = 1)", "-", "-", "-")
    assert beside[2:5] == ("-50.5 ± 0.7 (n = 2)", "-40.8 ± 1.1 (n = 2)", "9.8")
    assert beside[6] == "better"


def test_document_is_written_twice_with_the_notes(tmp_path):
    notes = tmp_path / "notes.md"
    notes.write_text("## Why\n\nBecause of *lag*.\n", encoding="utf-8")
    write_claims(two_sizes().tables(), tmp_path / "out" / "pilot.md", notes)
    text = (tmp_path / "out" / "pilot.md").read_text(encoding="utf-8")
    html = (tmp_path / "out" / "pilot.html").read_text(encoding="utf-8")
    assert text.endswith("## Why\n\nBecause of *lag*.\n")
    assert "<em>lag</em>" in html
    side = 3  # of four, the one that needs a team of 18 has nothing to show
    assert text.count("\n## ") == len(NAMES) + side + 2
    assert "**does not hold**" in text
    assert "<strong>does not hold</strong>" in html


def test_notes_that_cannot_be_read_are_named_before_anything_is_written(tmp_path):
    (tmp_path / "notes.md").write_bytes(b"\xff\xfe\xff")
    for notes in ("notes.md", "nowhere.md"):
        with pytest.raises(UsageError, match=rf"notes in .*{notes} cannot be read"):
            write_claims(two_sizes().tables(), tmp_path / "out" / "pilot.md", tmp_path / notes)
    with pytest.raises(UsageError, match="HTML beside it"):
        write_claims(two_sizes().tables(), tmp_path / "out" / "pilot.html")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("name", ["pilot", "off_spec"])
def test_the_committed_documents_are_those_of_the_committed_tables(tmp_path, name):
    reports = Path(__file__).parents[2] / "reports"
    tables = Tables.load(reports.parent / "results" / name)
    write_claims(tables, tmp_path / f"{name}.md", reports / f"{name}_notes.md")
    written = (tmp_path / f"{name}.md").read_text(encoding="utf-8")
    assert written == (reports / f"{name}.md").read_text(encoding="utf-8")


def test_document_of_no_rows_is_complete(tmp_path):
    write_claims(tables_for_tests.empty(), tmp_path / "pilot.md")
    text = (tmp_path / "pilot.md").read_text(encoding="utf-8")
    assert text.count("| not tested |") == len(NAMES) + len(side_claims(tables_for_tests.empty()))
    assert "None was run." in text
