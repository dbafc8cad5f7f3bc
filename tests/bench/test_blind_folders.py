"""How many cases of each kind a draw of any size has."""

from dataclasses import replace

import pytest

from bench.text.errors import UsageError
from blind.draw.cases import REFERENCE_SETS, Case
from blind.draw.folders import DEFAULT_COUNTS, Folders, scaled_counts, write_json


def test_counts_keep_proportions_and_every_kind():
    assert scaled_counts(sum(DEFAULT_COUNTS.values())) == DEFAULT_COUNTS
    for total in (5, 6, 40, 107, 640):
        counts = scaled_counts(total)
        assert sum(counts.values()) == total
        assert min(counts.values()) >= 1
    assert scaled_counts(107)["single"] == 42
    with pytest.raises(UsageError, match=r"`--cases` must be at least 5.*got 4"):
        scaled_counts(4)


def test_some_of_the_undisturbed_flights_are_not_all(tmp_path):
    folders = Folders(tmp_path)
    write_json(folders.state, {"reality": "crazyflow", "undisturbed": 2})
    for place in (folders.reference, folders.undisturbed / "1"):
        place.mkdir(parents=True)
    assert folders.gone(0)
    (folders.undisturbed / "2").mkdir()
    assert not folders.gone(0)


def test_a_draw_in_another_reality_needs_its_references(tmp_path):
    folders = Folders(tmp_path)
    write_json(folders.state, {"reality": "rotorpy"})
    for i in range(REFERENCE_SETS - 1):
        (folders.references / str(i)).mkdir(parents=True)
    for place in (folders.reference, folders.undisturbed):
        place.mkdir(parents=True)
    assert folders.gone(0)
    (folders.references / f"{REFERENCE_SETS - 1}.part").mkdir()
    assert folders.gone(0)
    (folders.references / str(REFERENCE_SETS - 1)).mkdir()
    assert not folders.gone(0)


def test_a_case_has_the_reference_of_its_label(tmp_path):
    folders, case = Folders(tmp_path), Case("a", "clean", (), "", seed=0, reality="rotorpy")
    assert folders.reference_of(replace(case, reference=5)) == folders.references / "5"
    assert folders.reference_of(replace(case, reality="crazyflow")) is None
    with pytest.raises(UsageError, match="older draw"):
        folders.reference_of(case)
