"""Studies beside the blind cases: kept item by item, tabulated, and shown in the report."""

import pandas as pd
import pytest
from rich.console import Console
from test_blind import tables

from bench.cli.app import main
from blind.draw.folders import Folders
from blind.report import limits_section as limits
from blind.report import next_flight_section as next_flight
from blind.report.page import write_report
from blind.report.tables import Tables
from blind.run import studies
from blind.run.studies import Study, run_study


def measured(out, broken=()):
    """The items that are measured in one run of a study of three."""
    asked = []

    def measure(item):
        if item in broken:
            raise KeyboardInterrupt
        asked.append(item)
        return [{"item": item, "value": float(len(item))}]

    study = Study("next_flight", "testing", ["a", "bb", "ccc"], measure)
    try:
        run_study(study, Folders(out), Console(quiet=True))
    except KeyboardInterrupt:
        asked.append("interrupted")
    return asked


def test_a_study_goes_on_where_it_was_interrupted(tmp_path):
    assert measured(tmp_path, broken=["ccc"]) == ["a", "bb", "interrupted"]
    assert not (tmp_path / "next_flight.parquet").exists()
    assert measured(tmp_path) == ["ccc"]
    table = pd.read_parquet(tmp_path / "next_flight.parquet")
    assert table["item"].tolist() == ["a", "bb", "ccc"]
    assert table["value"].tolist() == [1.0, 2.0, 3.0]


def test_what_another_program_measured_is_measured_again(tmp_path, monkeypatch):
    assert measured(tmp_path) == ["a", "bb", "ccc"]
    assert measured(tmp_path) == []
    monkeypatch.setattr(studies, "sources_digest", lambda **_: "f" * 64)
    assert measured(tmp_path) == ["a", "bb", "ccc"]


def margins(truth, rival, bland, advised):
    return {
        "truth": truth,
        "rival": rival,
        "advice": "fly | fast",
        "seconds": 10.0,
        "bland": bland,
        "advised": advised,
        "separated": advised >= 25.0,
    }


def limit(seconds, noise, size):
    return {
        "kind": "predicted",
        "effect": "drag",
        "unit": "1/s",
        "small": 0.15,
        "large": 1.0,
        "seconds": seconds,
        "noise": noise,
        "size": size,
        "bound": 0.3 * size,
        "rival": "quadratic_drag",
    }


def check(named, said):
    own = {"kind": "checked", "factor": 1.0, "predicted": 0.75, "named": named, "rival": said}
    return limit(10.0, 1.0, 0.1) | own


def test_studies_stand_in_the_report_with_what_went_wrong(tmp_path):
    given = tables({})
    given.save(tmp_path)
    of = {"diagnosis": "a" * 12}
    pd.DataFrame(
        [margins("mass", "drag", 1.0, 400.0) | of, margins("drag", "mass", 3.0, 2.0) | of]
    ).to_parquet(tmp_path / "next_flight.parquet")
    rows = [limit(s, n, 0.01 * n) for s in (10.0, 60.0, 600.0) for n in (0.3, 1.0, 3.0)]
    checks = [check(True, "drag"), check(False, "none")]
    pd.DataFrame(rows + checks).assign(**of).to_parquet(tmp_path / "limits.parquet")
    write_report([Tables.load(tmp_path)], tmp_path / "blind.md")
    text = (tmp_path / "blind_details.md").read_text()
    assert "separate 1 of 2 directions" in text
    assert "**Not separated: drag from mass.**" in text
    assert "No better than bland: drag from mass." in text
    assert "| mass / drag | fly \\| fast | 10 s | 1.0 / 3.0 | 400 / 2.0 |" in text
    assert "Checked by 2 diagnoses" in text
    assert "were named in 1; 1.5 were predicted" in text
    assert "| 10 s | 1 | 75 % | 1/2 | 1 to 99 % | drag: none |" in text
    for name in ("limits", "next_flight"):
        assert (tmp_path / "blind" / f"crazyflow_{name}.png").stat().st_size > 10_000


def test_a_report_without_studies_says_nothing_of_them(tmp_path):
    given = tables({})
    assert next_flight.section(given, []) == []
    assert limits.section(given, []) == []
    assert not limits.draw(given, tmp_path / "a.png")
    assert not next_flight.draw(given, tmp_path / "a.png")


@pytest.mark.parametrize(
    ("arguments", "needless"),
    [
        (["--limits", "--cases", "50"], "--cases"),
        (["--next-flight", "--seed", "3", "--jobs", "2"], "--seed, --jobs"),
        (["--report", "--reality", "rotorpy"], "--reality"),
        (["--report", "--limits"], "--limits"),
    ],
)
def test_options_without_a_meaning_are_refused(tmp_path, capsys, arguments, needless):
    assert main(["blind", "--out", str(tmp_path), *arguments]) == 2
    assert f"Leave out {needless}: not used with" in capsys.readouterr().err


@pytest.mark.parametrize("study", ["--next-flight", "--limits"])
def test_studies_are_flown_in_one_reality_only(tmp_path, capsys, study):
    assert main(["blind", "--reality", "rotorpy", "--out", str(tmp_path), study]) == 2
    assert "Studies are flown in crazyflow only" in capsys.readouterr().err
