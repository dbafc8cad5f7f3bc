"""`bench blind --real`: labelled flights of the user's own, with a stub as the diagnosis."""

import dataclasses
import json
import sys

import pandas as pd
import pytest
from diagnoses_for_tests import effect, named, none, parameter
from flights_for_tests import flight_set, made_log

from bench.cli.app import main
from blind.draw.manifest import LabelledSet, Manifest, files_digest
from blind.run import answering
from blind.run.real import run_real
from blind.score.real import by_airframe, outcome, real_rows
from diagnosis.interface.fault import InterfaceFault
from diagnosis.logs.flights import FlightLog, write_flights
from diagnosis.result import Diagnosis

STUB = """
import pathlib, shutil, sys
flights, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
text = (flights / "vehicle.toml").read_text()
assert "secret" not in text and "heavy" not in str(flights)
with open(pathlib.Path(sys.argv[0]).with_name("calls"), "a") as calls:
    print(text, file=calls)
out.mkdir()
what = "effect" if "--reference" in sys.argv else "none"
shutil.copy(pathlib.Path(sys.argv[0]).with_name(what + ".json"), out / "diagnosis.json")
"""
"""A diagnosis that blames the mass wherever there is a reference."""

MANIFEST = """
[sets.plain]
flights = "plain"
sha256 = "{plain}"
licence = "MIT"
airframe = "Quad"
label = "none"

[sets.heavy]
flights = "heavy"
sha256 = "{heavy}"
licence = "MIT"
airframe = "Quad"
label = ["mass"]
reference = "plain"
parameters.mass.e = 0.05
"""


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with a manifest of two sets; a stub in the place of a diagnosis."""
    for seed, name in enumerate(("plain", "heavy")):
        flights = flight_set([FlightLog(f"f{i}", (made_log(seed=9 * seed + i),)) for i in range(2)])
        vehicle = type(flights.vehicle)("secret", flights.vehicle.drone, flights.vehicle.mass)
        write_flights(tmp_path / name, vehicle, flights.flights)
    blamed = effect()
    blamed["effects"] = [named("mass", 0.9, parameter("e", 0.04, 0.03, 0.06, "-"))]
    (tmp_path / "effect.json").write_text(json.dumps(blamed))
    (tmp_path / "none.json").write_text(json.dumps(none()))
    (tmp_path / "stub.py").write_text(STUB)
    write(tmp_path)
    monkeypatch.setattr(answering, "DIAGNOSE", (sys.executable, str(tmp_path / "stub.py")))
    return tmp_path


def write(folder, text=MANIFEST):
    digests = {name: files_digest(folder / name) for name in ("plain", "heavy")}
    path = folder / "lab.toml"
    path.write_text(text.format(**digests))
    return path


def test_sets_are_diagnosed_scored_and_reported(lab, capsys):
    assert run_real(lab / "lab.toml", out=lab / "out", jobs=2) == 0
    rows = pd.read_parquet(lab / "out" / "sets.parquet").set_index("set")
    assert rows["outcome"].to_dict() == {"plain": "right", "heavy": "right"}
    numbers = pd.read_parquet(lab / "out" / "numbers.parquet")
    assert numbers[["set", "true", "inside"]].to_numpy().tolist() == [["heavy", 0.05, True]]
    text = (lab / "out" / "real.md").read_text()
    assert "| Quad | 2 | 2 | 0 | 0 | 0 | 0 | 0 | 100 % (16 to 100) | 100 % (16 to 100) |" in text
    assert "was changed" not in text
    assert (lab / "out" / "real.html").is_file()


def test_labels_may_change_without_a_diagnosis_but_not_unseen(lab):
    asked = {"out": lab / "out", "jobs": 1}
    run_real(lab / "lab.toml", **asked)
    calls = (lab / "calls").read_text()
    mended = MANIFEST.replace('["mass"]', '["delay"]')
    run_real(write(lab, mended.replace("parameters.mass.e = 0.05", "")), **asked)
    assert (lab / "calls").read_text() == calls
    assert (
        "The manifest was changed after the first diagnosis"
        in (lab / "out" / "real.md").read_text()
    )
    rows = pd.read_parquet(lab / "out" / "sets.parquet").set_index("set")
    assert rows.loc["heavy", "outcome"] == "wrong"


def test_only_flights_that_changed_are_diagnosed_again(lab):
    asked = {"out": lab / "out", "jobs": 1}
    run_real(lab / "lab.toml", **asked)
    table = lab / "heavy" / "flights" / "f0.parquet"
    pd.read_parquet(table).iloc[:-1].to_parquet(table)
    run_real(write(lab), **asked)
    n_calls = (lab / "calls").read_text().count("mass = ")
    assert n_calls == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"none"', '"nonne"', "label"),
        ('["mass"]', '["mas"]', "No effect is registered as 'mas'. Did you mean 'mass'?"),
        ('["mass"]', '["delay"]', "`parameters` speaks of mass, which is not in `label`."),
        ('reference = "plain"', 'reference = "plane"', "`reference` names no set of this file"),
        ('reference = "plain"', 'reference = "heavy"', "`reference` is the set itself."),
        ('licence = "MIT"', "", "`sets.plain.licence` is missing"),
        ('sha256 = "{plain}"', "", "`sha256` is missing; that of the files is"),
        ('sha256 = "{plain}"', 'sha256 = "00"', "`sha256` is 00; that of the files is"),
        ('flights = "heavy"', 'flights = "gone"', "gone holds no vehicle.toml."),
        ("[sets.plain]", "[sets.plain", "cannot be read"),
    ],
)
def test_a_wrong_manifest_gets_a_line_for_each_fault(lab, capsys, old, new, message):
    path = write(lab, MANIFEST.replace(old, new))
    assert main(["blind", "--real", str(path), "--out", str(lab / "out")]) == 2
    assert message in capsys.readouterr().err
    assert not (lab / "out").exists()


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--cases", "5"], "Leave out --cases: not used with --real."),
        (["--reality", "rotorpy"], "Leave out --reality: not used with --real."),
        (["--report"], "Leave out --real: not used with --report."),
    ],
)
def test_options_that_would_be_ignored_are_refused(lab, capsys, more, message):
    assert main(["blind", "--real", str(lab / "lab.toml"), *more]) == 2
    assert message in capsys.readouterr().err


def test_a_manifest_that_is_not_there_gets_one_line(capsys):
    assert main(["blind", "--real", "nowhere.toml"]) == 2
    assert "nowhere.toml" in capsys.readouterr().err


def labelled(label):
    return LabelledSet(flights="x", licence="MIT", airframe="Quad", label=label)


def answer(verdict, *effects):
    content = (effect() if effects else none()) | {"verdict": verdict, "effects": list(effects)}
    return Diagnosis.of_json(content)


MASS, DELAY = named("mass", 0.9), named("delay", 0.9)


@pytest.mark.parametrize(
    ("label", "found", "expected"),
    [
        (["mass"], answer("effect", MASS), "right"),
        (["mass"], answer("partly", MASS), "right"),
        (["mass"], answer("effect", MASS, DELAY), "wrong"),
        (["mass"], answer("effect", DELAY), "wrong"),
        (["mass"], answer("effect", DELAY | {"aliases": ["mass"]}), "right"),
        (["mass", "delay"], answer("effect", MASS), "in part"),
        (["mass", "delay"], answer("effect", MASS, DELAY), "right"),
        (["mass"], answer("none"), "missed"),
        (["mass"], answer("too_few"), "abstained"),
        (["mass"], answer("unexplained"), "abstained"),
        ("none", answer("none"), "right"),
        ("none", answer("too_few"), "abstained"),
        ("none", answer("unexplained"), "wrong"),
        ("none", answer("effect", MASS), "wrong"),
        ("unknown", answer("unexplained"), "right"),
        ("unknown", answer("none"), "missed"),
        ("unknown", answer("effect", MASS), "wrong"),
    ],
)
def test_an_answer_is_worth_what_the_table_says(label, found, expected):
    assert outcome(labelled(label), found) == expected


def test_a_fault_of_the_logs_that_is_not_there_is_a_wrong_answer():
    fault = InterfaceFault(part="thrust", readings=("other",), advice="Check it.", evidence=())
    for verdict in ("none", "too_few"):
        found = dataclasses.replace(answer(verdict), interface=(fault,))
        assert outcome(labelled("none"), found) == "wrong"


def test_refused_logs_are_an_abstention_and_a_crash_is_none():
    assert outcome(labelled("none"), None, "exit status 2: degrees?") == "abstained"
    assert outcome(labelled("none"), None, "exit status 1: Traceback") == "failed"


def test_shares_are_those_of_each_airframe():
    rows = pd.DataFrame(
        {
            "airframe": ["A", "A", "A", "B"],
            "outcome": ["right", "wrong", "abstained", "in part"],
        }
    )
    found = by_airframe(rows).set_index("airframe")
    assert found.loc["A", ["answered", "true"]].tolist() == pytest.approx([2 / 3, 0.5])
    assert found.loc["B", ["answered", "true"]].tolist() == [1.0, 1.0]


def test_a_set_without_an_answer_has_a_row_all_the_same():
    manifest = Manifest(sets={"a": labelled("none")})
    status = {"cause": "exit status 1: x", "seconds": 1.0, "status": "failed"}
    rows, numbers = real_rows(manifest, {}, {"a": status})
    assert rows["outcome"].tolist() == ["failed"]
    assert numbers.empty
