"""Claims on an off-spec drone against tables whose answers are known by hand."""

import pytest
from paper_tables import EFFECTS, add_off_spec, around
from tables_for_tests import Sheet

from bench.cli.app import main
from bench.paper.claims import CLAIMS, OFF_SPEC
from bench.paper.page import write_claims
from bench.paper.values import CLEAN, HYBRID, LF, RECALIBRATED, TRACKED, off_spec
from bench.stats.statistics import Cell
from bench.stats.verdicts import Verdict

CELL = {"task": "figure8", "team_size": 3}
WORLD = Cell("figure8", 3, deployed_effects=EFFECTS)


def flown(recalibrated=-55.0, tracked=-90.0, effects=EFFECTS, sheet=None):
    """Figure8 in a world of effects, beside a Hybrid that has -50 on the unchanged drone."""
    if sheet is None:
        sheet = Sheet().add("hybrid", "mlp", rewards=around(-50.0), **CELL)
    means = {"recalibrated": recalibrated, "lf": -80.0, "tracked": tracked, "hybrid": -60.0}
    return add_off_spec(sheet, CELL, **means, effects=effects)


def findings(sheet):
    """What is found of the four claims: above the baseline, above tracking, kept, tracking."""
    rules = [claim.rule for claim in CLAIMS if claim.section == OFF_SPEC]
    return [rule.judge(sheet.tables(), "settled_reward") for rule in rules]


def verdicts(sheet):
    return [found.verdict for found in findings(sheet)]


def test_values_are_those_of_each_world_by_what_is_flown_there():
    found = off_spec(flown(effects="wind(x=1.5)", sheet=flown()).tables(), "settled_reward")
    assert list(found) == [WORLD, Cell("figure8", 3, deployed_effects="wind(x=1.5)")]
    means = {entry: sum(seeds.values()) / 3.0 for entry, seeds in found[WORLD].items()}
    assert means == pytest.approx(
        {RECALIBRATED: -55.0, LF: -80.0, TRACKED: -90.0, HYBRID: -60.0, CLEAN: -50.0}
    )


def test_a_world_in_which_nothing_was_recalibrated_is_none():
    sheet = flown()
    sheet.results = [row for row in sheet.results if row["method"] != "recalibrated"]
    assert off_spec(sheet.tables(), "settled_reward") == {}
    assert verdicts(sheet) == [Verdict.UNTESTED] * 4


def test_all_are_supported_where_recalibration_recovers():
    above, beside_pd, kept, tracking = findings(flown())
    assert [f.verdict for f in (above, beside_pd, kept, tracking)] == [Verdict.SUPPORTED] * 4
    assert above.ours == "supported in 1 of 1"
    assert above.lines[0][0] == "figure8, N = 3, flown with drag(c=2)"
    assert float(above.lines[0][3]) == pytest.approx(25.0, abs=0.05)
    assert kept.lines[0][2] == "-50.0 ± 0.4 (n = 3)"
    assert float(kept.lines[0][3]) == pytest.approx(7.5, abs=0.05)


def test_all_are_refuted_where_it_does_not_recover():
    assert verdicts(flown(recalibrated=-95.0, tracked=-70.0)) == [Verdict.REFUTED] * 4


@pytest.mark.parametrize(
    ("recalibrated", "verdict"), [(-61.0, Verdict.SUPPORTED), (-64.0, Verdict.REFUTED)]
)
def test_a_quarter_of_the_nominal_drones_return_may_be_lost(recalibrated, verdict):
    assert verdicts(flown(recalibrated=recalibrated))[2] is verdict


def test_a_world_that_is_not_recovered_refutes_what_holds_in_another():
    sheet = flown(recalibrated=-95.0, effects="wind(x=1.5)", sheet=flown())
    assert findings(sheet)[0].ours == "supported in 1, refuted in 1 of 2"
    assert verdicts(sheet)[0] is Verdict.REFUTED


def test_tracking_is_compared_with_the_baseline_on_figure8_alone():
    sheet = flown()
    add_off_spec(sheet, {"task": "circle"}, recalibrated=-55.0, lf=-80.0, tracked=-60.0)
    assert verdicts(sheet)[3] is Verdict.SUPPORTED


@pytest.mark.parametrize(
    ("method", "expected"),
    [
        ("lf_baseline", ["not tested", "not tested", "supported", "not tested"]),
        ("recalibrated", ["not tested"] * 4),
    ],
)
def test_other_settings_are_not_what_the_paper_compares(method, expected):
    sheet = flown()
    for row in sheet.results:
        if row["method"] == method:
            row["variant"] += ", trainer.epochs=5"
    assert [verdict.value for verdict in verdicts(sheet)] == expected


def test_the_nominal_drones_return_is_not_that_in_the_world():
    sheet = flown()
    sheet.results = [row for row in sheet.results if row["deployed_effects"]]
    assert verdicts(sheet)[2] is Verdict.UNTESTED


def test_the_section_is_there_only_where_something_was_recalibrated(tmp_path):
    path, other = tmp_path / "off_spec.md", tmp_path / "other.md"
    write_claims(flown().tables(), path)
    write_claims(Sheet().add("hybrid", "mlp").tables(), other)
    assert f"\n## {OFF_SPEC}\n" in path.read_text(encoding="utf-8")
    assert f"## {OFF_SPEC}" not in other.read_text(encoding="utf-8")


def test_one_page_judges_the_tables_of_several_suites(tmp_path):
    """Of a run in several folders, the first one's row counts."""
    again = Sheet().add("hybrid", "mlp", rewards=around(-500.0), **CELL)
    paper = Sheet().add("hybrid", "affine", rewards=around(-90.0), **CELL)
    sheets = {"paper": paper, "off_spec": flown(), "again": again, "alone": flown()}
    for name, sheet in sheets.items():
        sheet.tables().save(tmp_path / name)
    folders = [str(tmp_path / name) for name in ("paper", "off_spec", "again")]
    assert main(["claims", *folders]) == 0
    assert main(["claims", str(tmp_path / "alone")]) == 0
    joined, alone = (
        (tmp_path / name / "claims.md").read_text(encoding="utf-8").split("\n## ")
        for name in ("paper", "alone")
    )
    section = [part for part in alone if part.startswith(OFF_SPEC)]
    assert section
    assert section == [part for part in joined if part.startswith(OFF_SPEC)]
