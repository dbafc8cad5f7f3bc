"""A blind run end to end with a stub in the place of `bench diagnose`, and what may go wrong."""

import dataclasses
import inspect
import json
import os
import shutil
import sys
from pathlib import Path
from typing import get_args

import pandas as pd
import pytest
from blind_for_tests import CLEAN, GAIN, MASS, STUB, answer, answered, made, measured, tables
from diagnoses_for_tests import effect

from bench.cli.app import main
from blind import command as options
from blind.draw.cases import Case, read_labels
from blind.draw.folders import write_json
from blind.fly.realities import REALITIES
from blind.report import page as report
from blind.report import sections
from blind.report.failures import failed
from blind.report.in_short import in_short
from blind.report.page import write_report
from blind.report.tables import OURS, Tables
from blind.run import answering
from blind.run import command as blind
from blind.run.answering import STATUS, missing, read_documents
from blind.run.children import scrubbed


@pytest.fixture
def stub(tmp_path, monkeypatch):
    """In the place of a diagnosis."""
    path = tmp_path / "stub.py"
    path.write_text(STUB)
    path.with_name("effect.json").write_text(json.dumps(effect()))
    monkeypatch.setattr(answering, "DIAGNOSE", (sys.executable, str(path)))


@pytest.fixture
def no_measuring(monkeypatch):
    """Measures and baselines without flights."""

    def measure_all(folders, cases, jobs, on_done):
        for one in cases:
            write_json(folders.measures / f"{one.id}.json", measured())

    monkeypatch.setattr(blind, "measure_all", measure_all)
    monkeypatch.setattr(blind, "answer_baselines", lambda folders: {})


def test_a_diagnosis_sees_its_flights_and_nothing_else(tmp_path, monkeypatch, stub, no_measuring):
    monkeypatch.setenv("BLIND_LABELS", str(tmp_path / "secret"))
    folders = made(tmp_path / "out", (GAIN, "none"))
    assert blind.run_blind(None, "crazyflow", folders.out, None, 1) == 0
    seen = json.loads((folders.answers / GAIN.id / "seen.json").read_text())
    assert seen["cwd"] == []
    assert set(seen["beside"]) == {GAIN.id, "empty", "log", "answer"}
    assert not any(str(tmp_path / "out") in argument for argument in seen["argv"])
    assert seen["argv"][-2:] == ["--exclude", "thrust_gain"]
    assert "BLIND_LABELS" not in seen["environment"]
    assert "BLIND_LABELS" not in scrubbed()
    assert "--xla_cpu_multi_thread_eigen=false" in scrubbed()["XLA_FLAGS"]


@pytest.mark.parametrize(
    ("what", "cause"),
    [
        ("crash", "exit status 1: no such luck"),
        ("half", "diagnosis.json cannot be read"),
        ("hang", "took longer than 1 s"),
    ],
)
def test_a_failing_diagnosis_is_counted_and_kept(tmp_path, stub, monkeypatch, what, cause):
    monkeypatch.setattr(answering, "TIMEOUT", 1.0 if what == "hang" else 20.0)
    folders = made(tmp_path / "out", (MASS, what), (CLEAN, "none"))
    statuses = answered(folders)
    assert statuses[MASS.id]["status"] == "failed"
    assert cause in statuses[MASS.id]["cause"]
    assert statuses[CLEAN.id]["status"] == "ok"
    assert missing(folders, read_labels(folders.labels, Case.of)) == []


def test_resuming_redoes_what_is_half_written_and_nothing_else(tmp_path, stub):
    folders = made(tmp_path / "out", (MASS, "mass"), (GAIN, "mass"), (CLEAN, "none"))
    assert set(answered(folders)) == {MASS.id, GAIN.id, CLEAN.id}
    assert answered(folders) == {}
    (folders.answers / GAIN.id / STATUS).unlink()  # killed before the answer was whole
    shutil.rmtree(folders.answers / CLEAN.id)
    (folders.answers / f".{CLEAN.id}.part").mkdir()
    assert set(answered(folders)) == {GAIN.id, CLEAN.id}
    assert sorted(os.listdir(folders.answers)) == [MASS.id, GAIN.id, CLEAN.id]


def test_a_run_prints_the_hash_scores_and_reports(tmp_path, stub, no_measuring, capsys):
    out = tmp_path / "out"
    folders = made(out, (MASS, "mass"), (GAIN, "mass"), (CLEAN, "none"))
    assert blind.run_blind(None, "crazyflow", out, None, 1) == 0
    printed = capsys.readouterr().out
    sha256 = folders.read_state()["sha256"]
    assert printed.index(sha256) < printed.index(MASS.id)
    table = Tables.load(out).cases.set_index("case")
    assert table.loc[MASS.id, "exact"]
    assert not table.loc[GAIN.id, "abstained"]
    text = (out / "blind.md").read_text()
    assert sha256 in text
    assert f"#### {GAIN.id}" in text
    assert f"#### {MASS.id}" not in text
    for page in ("blind", "blind_details"):
        assert "data:image/png" in (out / f"{page}.html").read_text()
        assert f"]({page.removesuffix('_details')}/crazyflow_" in (out / f"{page}.md").read_text()
    assert (out / "labels.json").read_bytes() == folders.labels.read_bytes()


def test_tables_in_the_folder_of_the_reports_are_those_reported(
    tmp_path, stub, no_measuring, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    out = blind.DOCUMENT.parent
    folders = made(out, (MASS, "mass"), (CLEAN, "none"))
    assert blind.run_blind(None, "crazyflow", out, None, 1) == 0
    assert folders.read_state()["sha256"] in blind.DOCUMENT.read_text()


def test_flights_that_are_gone_are_flown_again_before_the_diagnoses(
    tmp_path, stub, no_measuring, monkeypatch
):
    folders = made(tmp_path, (MASS, "mass"), (CLEAN, "none"))
    assert not folders.gone(2)
    folders.reference.rmdir()
    assert folders.gone(2)
    folders.reference.mkdir()
    shutil.rmtree(folders.cases / MASS.id)

    def fly(_, settings, total, console):
        assert (settings, total) == ({"out": str(tmp_path)}, 2)
        place = folders.cases / MASS.id / "flights"
        place.mkdir(parents=True)
        (place / "what").write_text("mass")

    monkeypatch.setattr(blind, "_fly", fly)
    assert blind.run_blind(None, "crazyflow", tmp_path, None, 1) == 0
    assert set(read_documents(folders, [MASS.id, CLEAN.id])[0]) == {MASS.id, CLEAN.id}


def test_a_run_with_a_failed_diagnosis_says_so(tmp_path, stub, no_measuring, capsys):
    out = tmp_path / "out"
    made(out, (MASS, "crash"), (CLEAN, "none"))
    assert blind.run_blind(None, "crazyflow", out, None, 1) == 1
    assert "1 of 2 diagnoses failed" in capsys.readouterr().out
    assert "exit status 1: no such luck" in (out / "blind.md").read_text()


def test_tampered_labels_are_noticed_before(tmp_path, stub, no_measuring, capsys):
    out = tmp_path / "out"
    folders = made(out, (MASS, "drag"))
    folders.labels.write_text(folders.labels.read_text().replace('"mass"', '"drag"'))
    assert blind.run_blind(None, "crazyflow", out, None, 1) == 1
    assert "has changed" in capsys.readouterr().out
    assert not folders.answers.exists()


def test_labels_that_change_meanwhile_are_noticed_after(
    tmp_path, stub, no_measuring, monkeypatch, capsys
):
    out = tmp_path / "out"
    folders = made(out, (MASS, "drag"))
    answer = blind.answer_shown

    def tamper(*arguments, **settings):
        answer(*arguments, **settings)
        folders.labels.write_text(folders.labels.read_text().replace('"mass"', '"drag"'))

    monkeypatch.setattr(blind, "answer_shown", tamper)
    assert blind.run_blind(None, "crazyflow", out, None, 1) == 1
    assert "Nothing is scored" in capsys.readouterr().out.replace("\n", " ")
    assert not (out / "cases.parquet").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--cases", "2"], "`--cases` must be at least 5"),
        (["--reality", "mars"], '"mars" for --reality. Choose from: "crazyflow", "rotorpy"'),
        (["--jobs", "0"], "`--jobs` must be at least 1, got 0."),
        (["--seed", "-1"], "`--seed` must be at least 0, got -1."),
        (["--report"], "is missing; `bench blind` writes it"),
    ],
)
def test_a_wrong_request_gets_one_line(tmp_path, capsys, arguments, message):
    assert main(["blind", "--out", str(tmp_path / "out"), *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert not (tmp_path / "out").exists()


def test_another_draw_in_the_place_of_counted_tables_is_refused(tmp_path, capsys):
    """A fresh clone has the tables and not the flights; notes and studies are of that draw."""
    (tmp_path / "run.json").write_text("{}")
    assert main(["blind", "--out", str(tmp_path), "--cases", "5"]) == 2
    assert "holds the tables of a draw whose flights are not here" in capsys.readouterr().err


def test_a_new_draw_leaves_studies_alone(tmp_path):
    folders = made(tmp_path, (MASS, "mass"))
    study = folders.runs / "limits" / "drag.json"
    write_json(study, {})
    assert folders.cases in folders.drawn()
    assert not any(study.is_relative_to(place) for place in folders.drawn())


def test_another_run_in_the_same_folder_is_refused(tmp_path, capsys):
    made(tmp_path, (MASS, "mass"))
    for arguments, message in (
        (["--cases", "40"], "holds a draw of 3 cases"),
        (["--reality", "rotorpy"], "holds a draw of reality crazyflow"),
        (["--seed", "6"], "holds a draw with the seed 5"),
    ):
        assert main(["blind", "--out", str(tmp_path), *arguments]) == 2
        assert message in capsys.readouterr().err


def test_what_was_not_measured_proves_nothing(tmp_path):
    given = tables({MASS.id: answer("mass"), GAIN.id: answer(), CLEAN.id: answer()})
    facts = " ".join(sections.facts(given))
    assert "0 of 1 cases with an effect that were measured are undecidable" in facts
    assert "2 cases were not measured, 0 of them with several drones" in facts
    aims = "\n".join(sections.aims(given))
    assert "| median shrink over the true effect's | n = 0 |" in aims
    assert "decidable cases |" not in aims


def test_shrink_and_probability_are_counted_case_by_case():
    cases = pd.DataFrame(
        {
            "kind": ["single", "pair", "single", "single", "clean"],
            "decidable": [True, True, True, False, True],
            "measured": [True, True, True, True, True],
            "shrink": [80.0, 70.0, None, 0.0, None],
            "shrink_oracle": [81.0, 90.0, 60.0, 90.0, None],
        }
    )
    name, hits, value, *_ = sections._near(cases)
    assert (hits, value) == ("1/3", "33.3 %")
    assert "worst case: 77.8 %" in name
    given = tables({MASS.id: answer("drag"), GAIN.id: answer(), CLEAN.id: answer()})
    line = sections._calibrated(given)
    assert line[1] == "0/1"
    # One case of one proves nothing.
    assert line[4:] == ("90.0 %, the mean of what was stated", "met")


def test_the_first_screen_counts_what_is_right(tmp_path):
    given = tables({MASS.id: answer("mass"), GAIN.id: answer("mass"), CLEAN.id: answer()})
    text = write_report([given], tmp_path / "blind.md").read_text()
    first = text.split("## How it was done")[0]
    assert "| cases | 3 |" in first
    assert "| one effect acts: it is named, and nothing else | 1 of 1 |" in first
    assert "| no candidate describes what acts: the answer says that more acts | 0 of 1 |" in first
    assert "| the same, and no effect is blamed | 0 of 1 |" in first
    assert "| nothing acts: nothing is found | 1 of 1 |" in first
    assert "| two effects act: both are named, and nothing else | - |" in first
    assert in_short([], []) == []


def test_baselines_are_not_asked_what_they_cannot_say():
    given = tables({MASS.id: answer("mass"), GAIN.id: answer(), CLEAN.id: answer()})
    lines = "\n".join(sections.baselines(given)).splitlines()
    (abstention,) = [line for line in lines if line.startswith("| abstention, both")]
    assert abstention.count("-") == 1
    assert "%" in abstention


def test_a_study_of_another_program_says_so():
    given = tables({MASS.id: answer("mass"), GAIN.id: answer(), CLEAN.id: answer()})
    frame = pd.DataFrame({"effect": ["drag"], "diagnosis": ["a" * 12]})
    studied = dataclasses.replace(given, studies={"limits": frame})
    (line,) = sections.measured_by(studied, "limits")
    assert line.startswith("Not measured:")
    assert " drag," not in line
    assert " mass," in line
    old = dataclasses.replace(given, studies={"limits": frame.assign(diagnosis="b" * 12)})
    said = str(sections.measured_by(old, "limits"))
    assert "another version of the program than the cases: bbbbbbbbbbbb" in said


def test_the_committed_report_is_built_from_the_committed_tables_and_notes():
    """Notes that were edited without `bench blind --report` would not stand in it."""
    root = Path(__file__).parents[2] / "reports"
    remarks, rest = report._notes(root / "blind_notes.md")
    text = (root / "blind.md").read_text(encoding="utf-8")
    assert rest
    for part in [*rest, *remarks.values()]:
        assert part in text


def test_tables_survive_the_disk_and_compare_with_baselines(tmp_path):
    given = tables({MASS.id: answer("mass"), GAIN.id: answer(), CLEAN.id: answer()})
    given.save(tmp_path)
    again = Tables.load(tmp_path)
    for name in ("cases", "parameters", "proportions"):
        pd.testing.assert_frame_equal(getattr(again, name), getattr(given, name), check_dtype=False)
    top1 = again.proportions.query("score == 'top-1 of singles' and cases == 'all'")
    assert dict(zip(top1["who"], top1["value"], strict=True)) == {OURS: 1.0, "stlsq": 0.0}
    # e is off by 0.005, its bound, and thrust over mass is off as much as its own.
    assert again.parameters["over_bound"].iloc[0] == pytest.approx(1.0, rel=0.02)


def test_remarks_stand_at_their_failure_and_other_notes_at_the_end(tmp_path):
    given = tables({MASS.id: answer("mass"), GAIN.id: answer("mass"), CLEAN.id: answer()})
    notes = tmp_path / "notes.md"
    notes.write_text(f"### {GAIN.id}\n\nNames the partner.\n\n## Why\n\nBecause.\n")
    text = write_report([given], tmp_path / "blind.md", notes).read_text()
    place = text.index(f"#### {GAIN.id}")
    assert place < text.index("Remark: Names the partner.") < text.index("## Why")
    assert text.rstrip().endswith("Because.")


def test_every_wrong_kind_of_answer_is_a_failure():
    given = tables({MASS.id: answer("drag"), GAIN.id: answer("mass"), CLEAN.id: answer("mass")})
    assert all(failed(row) for row in given.cases.to_dict("records"))
    status = {"status": "failed", "cause": "lost", "seconds": 1.0, "sources": "a" * 64}
    given = tables({GAIN.id: answer(), CLEAN.id: answer()}, {MASS.id: status})
    assert [failed(row) for row in given.cases.to_dict("records")] == [True, True, False]


def test_the_command_offers_every_reality():
    (offered, _) = get_args(inspect.signature(options.blind).parameters["reality"].annotation)
    assert get_args(offered) == tuple(REALITIES)
