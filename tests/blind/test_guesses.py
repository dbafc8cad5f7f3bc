"""Guesses of `Decision` that are halved and doubled, with a stub as the diagnosis."""

import dataclasses
import sys

import numpy as np
import pandas as pd
import pytest
from diagnoses_for_tests import effect, none

from blind.power import guesses
from diagnosis.decision import Decision
from diagnosis.result import Diagnosis


def test_only_guesses_are_redrawn_and_counts_stay_counts():
    made = [guesses.redrawn(np.random.default_rng(seed)) for seed in range(20)]
    for field in dataclasses.fields(Decision):
        values = {getattr(one, field.name) for one in made}
        if field.name not in guesses.guesses():
            assert values == {field.default}
            continue
        assert len(values) > 1
        assert {type(value) for value in values} == {type(field.default)}
        assert min(values) >= (1 if isinstance(field.default, int) else 0.5 * field.default)


@pytest.fixture
def stub(monkeypatch):
    """A diagnosis that finds nothing once `worth_nats` is doubled; counts its calls."""
    calls = []

    def diagnose(flights, decision=Decision()):
        calls.append(decision)
        lost = decision.worth_nats > Decision().worth_nats
        return Diagnosis.of_json(none() if lost else effect())

    monkeypatch.setattr(guesses, "diagnose", diagnose)
    monkeypatch.setattr(guesses, "fly_case", lambda case: [])
    monkeypatch.setattr(guesses, "read_back", lambda logs: None)
    return calls


def test_the_table_says_on_which_guess_answers_hang_and_is_not_made_twice(
    stub, monkeypatch, tmp_path, capsys
):
    out = tmp_path / "guesses.parquet"
    monkeypatch.setattr(sys, "argv", ["guesses", "--cases", "3", "--out", str(out)])
    guesses.main()
    said = capsys.readouterr().out
    table = pd.read_parquet(out)
    assert len(table) == len(stub) == 3 * (1 + guesses.REDRAWN)
    lost = sum(one.worth_nats == 6.0 for one in stub)
    assert 0 < lost < 3 * guesses.REDRAWN
    assert said.startswith(f"{lost} of {3 * guesses.REDRAWN} answers differ.")
    (line,) = [line for line in said.splitlines() if line.startswith("| `worth_nats`")]
    assert f"6: {lost} of {lost}" in line
    assert "3: 0 of" in line
    guesses.main()
    assert len(stub) == len(table)
    assert capsys.readouterr().out == said


def test_sizes_move_by_half_widths():
    first = Diagnosis.of_json(effect())
    (found,) = first.effects
    (size,) = found.parameters[:1]
    half = 0.5 * (size.high - size.low)
    other = dataclasses.replace(size, value=size.value + 2.0 * half)
    parameters = (other, *found.parameters[1:])
    moved = dataclasses.replace(first, effects=(dataclasses.replace(found, parameters=parameters),))
    assert guesses._moved(first, moved) == pytest.approx(2.0)
    assert guesses._moved(first, first) == 0.0
