"""Cases are balanced, and nothing in a folder tells what was withheld."""

import collections
import dataclasses
import itertools
import json
import shutil

import numpy as np
import pandas as pd
import pytest

from blind.draw import cases, catalogue
from diagnosis.logs.flights import load_flights

FAMILIES = (
    {"mass", "thrust_gain"},
    {"inertia", "motor_lag", "attitude_lag", "delay"},
    {"center_of_mass", "trim"},
    {"drag", "quadratic_drag", "rotor_drag"},
    {"wind", "gust"},
)
"""Effects that short flights can hardly tell apart."""
COUNTS = {"single": 57, "pair": 60, "clean": 10, "unknown": 18, "excluded": 19}


def test_counts_are_kept_and_singles_cover_every_effect_and_size_once():
    drawn = cases.draw_cases(COUNTS, entropy=1)
    assert collections.Counter(case.kind for case in drawn) == COUNTS
    singles = {(c.effects[0].name, c.size) for c in drawn if c.kind == "single"}
    assert len(singles) == 57
    unknown = [c.effects[0].name for c in drawn if c.kind == "unknown"]
    assert collections.Counter(unknown) == dict.fromkeys(catalogue.UNKNOWN, 3)


def test_order_does_not_tell_the_kind():
    kinds = [case.kind for case in cases.draw_cases({"single": 30, "clean": 30}, entropy=1)]
    assert 15 < sum(a != b for a, b in itertools.pairwise(kinds)) < 45


def test_pairs_are_of_different_families_and_not_small():
    for case in cases.draw_cases({"pair": 100}, entropy=2):
        a, b = (effect.name for effect in case.effects)
        assert a != b
        assert not any({a, b} <= family for family in FAMILIES)
        assert "small" not in case.size


def test_the_same_entropy_gives_the_same_cases_and_none_gives_others():
    assert cases.draw_cases(COUNTS, entropy=5) == cases.draw_cases(COUNTS, entropy=5)
    assert cases.draw_cases(COUNTS) != cases.draw_cases(COUNTS)


def test_an_excluded_case_withholds_its_effect():
    (case,) = cases.draw_cases({"excluded": 1}, entropy=4)
    assert case.exclude == (case.effects[0].name,)


def test_two_drones_fly_with_downwash_and_now_and_then_without():
    drawn = cases.draw_cases({"single": 153}, entropy=6)
    downwash = [c.drones for c in drawn if c.effects[0].name == "downwash"]
    others = [c.drones for c in drawn if c.effects[0].name != "downwash"]
    assert set(downwash) == {2}
    assert 5 <= others.count(2) <= 30


def test_sizes_grow():
    """Each effect's parameters move away from neutral from small to large."""
    for name in {**catalogue.LIBRARY, **catalogue.UNKNOWN}:
        sizes = []
        for size in range(3):
            effect = catalogue.draw_effect(name, size, np.random.default_rng(8), 10.0)
            values = list(effect.parameters.items())
            neutral = 1.0 if values[0][0] == "scale" else 0.0
            vector = [v for k, v in values if k in ("x", "y", "roll", "pitch")]
            directed = name not in ("tether",) and vector
            sizes.append(np.hypot(*vector[:2]) if directed else abs(values[0][1] - neutral))
        assert sizes[0] < sizes[1] < sizes[2], name


@pytest.mark.parametrize("counts", [{"sinlge": 3}, {"single": -1}])
def test_a_wrong_count_is_named(counts):
    with pytest.raises(ValueError, match="`counts` must give numbers from 0 for kinds among"):
        cases.draw_cases(counts)


@pytest.mark.parametrize("settings", [{"seconds": 1.0}, {"n_flights": 0}])
def test_flights_that_cannot_be_are_refused(settings):
    case = cases.make_case("clean", [], np.random.default_rng(0), **settings)
    with pytest.raises(ValueError, match="A case needs `n_flights` of at least 1 and `seconds`"):
        cases.fly_case(case)


def test_changed_labels_are_found_out(tmp_path):
    path = tmp_path / "labels.json"
    drawn = cases.draw_cases(COUNTS, entropy=5)
    sha256 = cases.write_labels(path, drawn)
    assert list(cases.read_labels(path, cases.Case.of, sha256).values()) == drawn
    path.write_text(path.read_text().replace("clean", "unknown"))
    with pytest.raises(ValueError, match=r"has changed: its SHA-256 is"):
        cases.read_labels(path, cases.Case.of, sha256)


def test_the_salt_keeps_equal_labels_from_having_equal_digests(tmp_path):
    drawn = cases.draw_cases(COUNTS, entropy=5)
    digests = {cases.write_labels(tmp_path / f"{i}.json", drawn) for i in range(3)}
    assert len(digests) == 3
    assert len(bytes.fromhex(json.loads((tmp_path / "0.json").read_text())["salt"])) == 32


def test_written_cases_load_and_do_not_tell_their_effect(tmp_path):
    rng = np.random.default_rng(9)
    settings = {"n_flights": 2, "seconds": 6.0}
    drawn = [
        dataclasses.replace(cases.make_case("single", [(name, 2)], rng, **settings), drones=2)
        for name in ("mass", "downwash")
    ]
    seen, hidden = tmp_path / "cases", tmp_path / "labels"
    for case in drawn:
        cases.write_case(seen, hidden, case)
    sha256 = cases.write_labels(hidden / "labels.json", drawn)
    assert list(cases.read_labels(hidden / "labels.json", cases.Case.of, sha256)) == [
        case.id for case in drawn
    ]
    assert {path.name for path in seen.iterdir()} == {case.id for case in drawn}
    assert len({(path / "vehicle.toml").read_text() for path in seen.iterdir()}) == 1
    for case in drawn:
        names = {p.name for p in (seen / case.id).rglob("*") if p.is_file()}
        assert names == {"vehicle.toml", "flight0.parquet", "flight1.parquet"}
        flights = load_flights(seen / case.id)
        assert not flights.left_out
        assert [len(flight.drones) for flight in flights.flights] == [2, 2]
        logged, true = (
            pd.read_parquet(root / case.id / "flights" / "flight1.parquet")
            for root in (seen, hidden / "true")
        )
        pd.testing.assert_series_equal(logged["cmd_thrust"], true["cmd_thrust"])
        assert 5e-4 < (logged["pos_x"] - true["pos_x"]).std() < 2e-3


def test_flights_that_are_gone_are_flown_again_from_their_labels(tmp_path):
    case = cases.make_case("single", [("gust", 1)], np.random.default_rng(2), seconds=4.0)
    kept = dataclasses.replace(case, id="kept", n_flights=1)
    gone = dataclasses.replace(case, id="gone", n_flights=1)
    path = tmp_path / "labels" / "labels.json"
    sha256 = cases.write_labels(path, [kept, gone])

    def fly():
        for case in cases.read_labels(path, cases.Case.of, sha256).values():
            cases.write_case(tmp_path / "cases", path.parent, case)
        found = [file for file in tmp_path.rglob("*") if file.is_file()]
        return {file: (file.read_bytes(), file.stat().st_mtime_ns) for file in found}

    before = fly()
    for half in (tmp_path / "cases" / "gone", path.parent / "true" / "kept"):
        shutil.rmtree(half)
        (half.with_name(f"{half.name}.part") / "flights").mkdir(parents=True)
    after = fly()
    assert {file: content for file, (content, _) in after.items()} == {
        file: content for file, (content, _) in before.items()
    }
    assert after[path] == before[path]
