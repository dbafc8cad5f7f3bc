"""The programs that a blind run starts: what they are given, and what they leave."""

import json
import sys
import types

import pytest

from blind.draw import cases as drawing
from blind.draw.cases import REFERENCE_SETS, Case, draw_cases, read_labels, write_labels
from blind.draw.catalogue import Withheld
from blind.draw.folders import Folders, write_json
from blind.run import answer_baselines as baselines
from blind.run import generate, measuring, one
from diagnosis.logs.flights import LogError

COUNTS = {"single": 5, "pair": 2, "clean": 4}


@pytest.fixture
def asked(monkeypatch):
    """Stands in for the engine; remembers what it was asked."""
    requests = []

    def diagnose(flights, reference, exclude):
        requests.append((flights, reference, exclude))
        return types.SimpleNamespace(to_json=lambda: {"schema": 1})

    monkeypatch.setattr(one, "diagnose", diagnose)
    monkeypatch.setattr(one, "load_flights", lambda path: f"flights of {path}")
    return requests


def started(monkeypatch, *arguments):
    monkeypatch.setattr(sys, "argv", ["one", *map(str, arguments)])
    return one.main()


def test_a_diagnosis_gets_its_flights_the_reference_and_what_is_excluded(
    asked, monkeypatch, tmp_path
):
    options = ("--reference", "base", "--exclude", "mass", "--exclude", "drag")
    assert started(monkeypatch, "here", "--out", tmp_path / "out", *options) == 0
    assert asked == [("flights of here", "flights of base", ["mass", "drag"])]
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text()) == {"schema": 1}
    assert json.loads((tmp_path / "out" / "program.json").read_text())["sources"]


def test_without_a_reference_none_is_loaded(asked, monkeypatch, tmp_path):
    assert started(monkeypatch, "here", "--out", tmp_path) == 0
    assert asked == [("flights of here", None, [])]


def test_logs_that_hold_nothing_are_status_2_and_leave_nothing(monkeypatch, tmp_path, capsys):
    def nothing(path):
        raise LogError(f"{path}: the folder is empty.")

    monkeypatch.setattr(one, "load_flights", nothing)
    assert started(monkeypatch, "here", "--out", tmp_path / "out") == 2
    assert capsys.readouterr().err == "here: the folder is empty.\n"
    assert not (tmp_path / "out").exists()


@pytest.fixture
def flown(monkeypatch):
    """What would have been flown, instead of flying it."""
    cases = []

    def fly(case):
        cases.append(case)
        return [types.SimpleNamespace(logged=case.id, true=case.id)]

    def write_case(directory, labels_directory, case):
        cases.append(case)

    monkeypatch.setattr(drawing, "fly_case", fly)
    monkeypatch.setattr(drawing, "write_flights", lambda folder, tables: folder.mkdir(parents=True))
    monkeypatch.setattr(generate, "write_case", write_case)
    return cases


def test_a_draw_is_that_of_its_seed_in_its_reality(flown, tmp_path):
    folders = Folders(tmp_path)
    generate.generate(folders, "rotorpy", COUNTS, 7, undisturbed=2)
    expected = draw_cases(COUNTS, "rotorpy", 7)
    state = folders.read_state()
    assert read_labels(folders.labels, Case.of, state["sha256"]) == {
        case.id: case for case in expected
    }
    clean, drawn = flown[: 3 + REFERENCE_SETS], flown[3 + REFERENCE_SETS :]
    assert drawn == expected
    undisturbed = {(c.kind, c.reality, c.drones) for c in clean}
    assert undisturbed == {("clean", "rotorpy", 1)}
    assert len({case.seed for case in flown}) == len(flown)
    assert {int(p.name) for p in folders.references.iterdir()} == set(range(REFERENCE_SETS))
    assert [case.reference for case in drawn] == [
        i % REFERENCE_SETS for i in range(sum(COUNTS.values()))
    ]
    assert sorted(p.name for p in folders.undisturbed.iterdir()) == ["1", "2"]
    assert (state["reality"], state["seed"], state["entropy"]) == ("rotorpy", 7, 7)


def test_without_a_seed_every_draw_is_another_that_can_be_flown_again(flown, tmp_path):
    for name in ("a", "b"):
        generate.generate(Folders(tmp_path / name), "crazyflow", COUNTS, None, undisturbed=1)
    first, second = flown[: len(flown) // 2], flown[len(flown) // 2 :]
    assert not {case.id for case in first} & {case.id for case in second}
    del flown[:]
    folders = Folders(tmp_path / "a")
    for flights in (folders.reference, folders.undisturbed / "1"):
        flights.rmdir()
    generate.fly_again(folders)
    assert {case.seed for case in flown} == {case.seed for case in first}


MASS = Case("a" * 16, "single", (Withheld("mass", {"e": 0.1}),), "small", seed=1)
CLEAN = Case("b" * 16, "clean", (), "", seed=2)


def test_a_measure_is_a_file_a_case_and_a_failure_costs_no_other(monkeypatch, tmp_path, capsys):
    folders = Folders(tmp_path)
    write_labels(folders.labels, [MASS, CLEAN])
    write_json(folders.state, {"reality": "rotorpy"})
    desks = []

    def measure(desk, case):
        desks.append(desk.with_reference)
        if case.kind == "clean":
            raise ValueError("no flights")
        return {"decidable": True, "of": case.id}

    monkeypatch.setattr("blind.score.measures.measure", measure)
    assert measuring._measure(folders, [CLEAN.id, MASS.id]) == 1
    assert "no flights" in capsys.readouterr().err
    found = measuring.read_measures(folders, read_labels(folders.labels, Case.of))
    assert found[MASS.id] | {"program": ""} == {"decidable": True, "of": MASS.id, "program": ""}
    assert found[MASS.id]["program"]
    assert list(found) == [MASS.id]
    assert desks == [True, True]


def test_baselines_are_calibrated_on_undisturbed_flights(monkeypatch, tmp_path):
    """One that measures a strength by the folder: 1 and 2 undisturbed, 9 in the case."""
    folders = Folders(tmp_path)
    write_labels(folders.labels, [MASS])
    for name in ("1", "2"):
        (folders.undisturbed / name).mkdir(parents=True)
    strengths = {"1": 1.0, "2": 2.0, MASS.id: 9.0}
    compared = []

    def find(flights, reference):
        compared.append(reference)
        return types.SimpleNamespace(strength=strengths[flights])

    def answer(finding, limit, seconds):
        return {"strength": finding.strength, "limit": limit, "seconds": seconds}

    monkeypatch.setattr("blind.score.baselines.BASELINES", {"simple": find})
    monkeypatch.setattr("blind.score.baselines.answer", answer)
    monkeypatch.setattr("diagnosis.logs.flights.load_flights", lambda path: path.name)
    found = baselines._answers(folders)
    assert 1.0 < found["thresholds"]["simple"] <= 2.0
    limit = found["thresholds"]["simple"]
    (said,) = found["answers"]["simple"].values()
    assert said == {"strength": 9.0, "limit": limit, "seconds": MASS.seconds}
    assert set(compared) == {"reference"}


def test_baselines_answer_anew_where_another_program_did(monkeypatch, tmp_path):
    programs = iter("aab")
    given = iter(range(3))
    monkeypatch.setattr(baselines, "sources_digest", lambda with_generator: next(programs))
    monkeypatch.setattr(baselines, "_answers", lambda folders: {"answers": {"n": next(given)}})
    found = [baselines.answer_baselines(Folders(tmp_path))["n"] for _ in range(3)]
    assert found == [0, 0, 1]
