"""Faults written into logs, and a run of `bench blind --inject` with a stub as the diagnosis."""

import dataclasses
import json
import sys

import flying
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest
from diagnoses_for_tests import effect, named, none, parameter
from flights_for_tests import flight_set, made_log
from scipy.spatial.transform import Rotation

from bench.cli.app import main
from blind.draw.cases import read_labels
from blind.draw.faults import ALL, able
from blind.draw.folders import Folders
from blind.draw.injected import NOTHING, Injected, draw_injected
from blind.fly import log_faults
from blind.report.in_short import INJECTED, in_short
from blind.report.injected_section import InjectedTables, by_size, section
from blind.run import answering
from blind.run.answering import STATUS
from blind.run.injecting import run_injected
from blind.score.injected import injected_rows, power, shares
from diagnosis.logs.flights import FlightLog, LogError, load_flights, write_flights
from diagnosis.logs.inputs import thrust_of_pwm, thrust_of_rotors
from simulators import registry
from simulators.contract import with_effects
from simulators.point_mass import PointMass
from simulators.vehicle import VEHICLES

SPEC = VEHICLES["cf21B_500"]

STUB = """
import pathlib, shutil, sys
from pyarrow.parquet import read_table
flights, out = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[sys.argv.index("--out") + 1])
files = list((flights / "flights").iterdir())
if "--reference" in sys.argv:
    other = pathlib.Path(sys.argv[sys.argv.index("--reference") + 1])
    assert not {f.name for f in files} & {f.name for f in (other / "flights").iterdir()}
rolls = [read_table(f, columns=["cmd_roll"])["cmd_roll"].to_pylist() for f in files]
if max(abs(roll) for column in rolls for roll in column) > 3.2:
    print("cmd_roll: are they in degrees?", file=sys.stderr)
    sys.exit(2)
mass = (flights / "vehicle.toml").read_text().split("mass = ")[1].strip()
out.mkdir()
what = "none" if mass == "0.0434" else "effect"
shutil.copy(pathlib.Path(sys.argv[0]).with_name(what + ".json"), out / "diagnosis.json")
"""
"""A diagnosis that knows the true mass, and that no roll is above 180 degrees."""


def made_set(n=6, **settings):
    return flight_set([FlightLog(f"f{i}", (made_log(seed=i, **settings),)) for i in range(n)])


TWINS = {
    "thrust_gain": ("thrust_gain", {"e": 0.1}),
    "trim": ("trim", {"roll": 0.03, "pitch": -0.02}),
    "attitude_gain": ("attitude_gain", {"g": -0.2}),
    "delay": ("delay", {"seconds": 0.04}),
    "yaw_misalignment": ("yaw_misalignment", {"angle": 0.1}),
    "tilt_turned_in_yaw": ("frame_misalignment", {"angle": 0.1}),
}
"""Faults with the effect of the library that they must equal."""


def flown(simulator, cmd):
    """Positions under commands, from rest."""
    cmds = jnp.asarray(cmd)[:, None]
    rest = flying.hover_flight(jnp.asarray([[0.0, 0.0, 1.0]]))
    state = flying.restore(simulator, rest, jnp.repeat(cmds[:1], 10, axis=0))
    return np.asarray(flying.fly(simulator, state, cmds, 0.01).pos[:, 0])


@pytest.mark.parametrize("name", TWINS)
def test_a_fault_equals_the_effect_that_its_label_names(name):
    """The vehicle with the effect, told what the fault logs, flies the path that was flown."""
    effect, parameters = TWINS[name]
    one = made_log(seconds=0.6)
    one = dataclasses.replace(one, cmd=np.where(one.t[:, None] < 0.1, one.cmd[:1], one.cmd))
    fault = ALL[name]
    changed = fault.change(one, parameters, flight_set([]).vehicle)
    assert dict(fault.answers(parameters))[effect] == parameters
    nominal = PointMass(dt=0.01, spec=SPEC)
    real = with_effects(nominal, [registry.load("effect", effect)(**parameters)])
    # A late vehicle does at a row what it was told some rows before; the log ends earlier.
    wanted = flown(nominal, one.cmd)[: len(changed.t)]
    apart = np.abs(flown(real, changed.cmd) - wanted).max()
    assert apart < 0.02 * np.abs(flown(nominal, changed.cmd) - wanted).max() + 1e-6


def test_thrust_over_every_kind_of_input_changes_by_the_same_factor():
    rng = np.random.default_rng(1)
    rows = 200
    one = made_log(
        rotor_vel=rng.uniform(1500, 2200, (rows, 4)),
        pwm=rng.uniform(0.4, 0.7, (rows, 4)),
        battery=rng.uniform(3.3, 4.1, rows),
    )
    changed = log_faults.more_thrust(one, 0.1, SPEC)
    np.testing.assert_allclose(changed.cmd[:, 3], one.cmd[:, 3] / 1.1)
    np.testing.assert_allclose(
        thrust_of_rotors(changed.rotor_vel, SPEC), thrust_of_rotors(one.rotor_vel, SPEC) / 1.1
    )
    np.testing.assert_allclose(
        thrust_of_pwm(changed.pwm, one.battery), thrust_of_pwm(one.pwm, one.battery) / 1.1
    )


def test_thrust_that_no_duty_makes_is_refused_and_drawn_again():
    """By the map a motor makes 70 gf at most, at 3.1 V."""
    full = made_log(pwm=np.full((200, 4), 0.9), battery=np.full(200, 4.0))
    with pytest.raises(ValueError, match="no duty makes the thrust"):
        log_faults.more_thrust(full, -0.05, SPEC)
    assert (log_faults.more_thrust(full, 0.05, SPEC).pwm < full.pwm).all()
    bare = dataclasses.replace(full, cmd=None, pwm=None, rotor_vel=np.full((200, 4), 2000.0))
    unknown = dataclasses.replace(SPEC, rpm2thrust=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="nothing in the log says how much thrust"):
        log_faults.more_thrust(bare, 0.05, unknown)


def test_thrust_without_angles_is_scaled_and_shifted():
    one = dataclasses.replace(made_log(), cmd=None, thrust=np.linspace(0.2, 0.5, 200))
    np.testing.assert_allclose(log_faults.more_thrust(one, 0.1, SPEC).thrust, one.thrust / 1.1)
    np.testing.assert_array_equal(log_faults.shifted(one, 0.03).thrust, one.thrust[3:])


def test_a_shift_of_stamps_since_1970_is_the_same():
    one = made_log()
    epoch = dataclasses.replace(one, t=one.t + 1.7e9)
    for seconds in (0.02, 0.04):
        now, then = (log_faults.shifted(log, seconds) for log in (one, epoch))
        np.testing.assert_array_equal(now.cmd, then.cmd)


def test_a_shift_moves_inputs_and_keeps_the_path():
    one = made_log()
    late = log_faults.shifted(one, 0.03)
    np.testing.assert_array_equal(late.cmd, one.cmd[3:])
    np.testing.assert_array_equal(late.pos, one.pos[:-3])
    early = log_faults.shifted(one, -0.03)
    np.testing.assert_array_equal(early.cmd, one.cmd[:-3])
    np.testing.assert_array_equal(early.pos, one.pos[3:])
    drifting = log_faults.shifted(one, 0.0, drift=0.05)
    at = np.searchsorted(one.t, 1.0)
    np.testing.assert_array_equal(drifting.cmd[at], one.cmd[at + 5])


def test_commands_are_early_by_the_number_of_rows_that_comes_nearest():
    one = made_log()
    uneven = dataclasses.replace(one, t=one.t * 0.396)  # rows every 3.96 ms
    early = log_faults.shifted(uneven, -0.02)  # 5.05 rows
    kept = len(early.cmd)
    np.testing.assert_array_equal(early.cmd, uneven.cmd[-kept - 5 : -5])


def test_turns_keep_lengths_and_turn_back():
    one = made_log()
    for turned in (log_faults.turned_path, log_faults.turned_tilt):
        again = turned(turned(one, 0.3), -0.3)
        np.testing.assert_allclose(again.pos, one.pos, atol=1e-12)
        np.testing.assert_allclose(again.cmd, one.cmd, atol=1e-12)
    body = log_faults.body_velocity(one)
    np.testing.assert_allclose(Rotation.from_quat(one.quat).apply(body.vel), one.vel, atol=1e-12)


def test_every_fault_is_drawn_and_none_that_a_log_cannot_have():
    flights = made_set()
    assert "pwm_scale" not in able(flights)
    assert set(able(flights)) == {n for n, f in ALL.items() if not f.needs or "cmd" in f.needs}
    drawn = draw_injected(flights, 160, entropy=1)
    assert {case.fault for case in drawn} == {NOTHING, *able(flights)}
    assert sum(case.fault == NOTHING for case in drawn) == 40
    for case in drawn:
        assert not set(case.target) & set(case.reference)
        assert {*case.target, *case.reference} == {f.name for f in flights.flights}


def test_the_same_seed_draws_the_same_cases():
    assert draw_injected(made_set(), 20, 7) == draw_injected(made_set(), 20, 7)
    assert draw_injected(made_set(), 20, 7) != draw_injected(made_set(), 20, 8)


@pytest.mark.parametrize(("n", "count", "what"), [(3, 9, "at least 4 usable"), (6, 1, "`cases`")])
def test_too_little_to_draw_from_is_refused(n, count, what):
    with pytest.raises(ValueError, match=what):
        draw_injected(made_set(n), count)


@pytest.fixture
def stub(tmp_path, monkeypatch):
    """In the place of a diagnosis."""
    blamed = effect()
    blamed["effects"] = [named("mass", 0.9, parameter("e", 0.0, -0.06, 0.06, "-"))]
    (tmp_path / "effect.json").write_text(json.dumps(blamed))
    (tmp_path / "none.json").write_text(json.dumps(none()))
    path = tmp_path / "stub.py"
    path.write_text(STUB)
    monkeypatch.setattr(answering, "DIAGNOSE", (sys.executable, str(path)))


@pytest.fixture
def folder(tmp_path):
    flights = made_set(4)
    write_flights(tmp_path / "mine", flights.vehicle, flights.flights)
    return tmp_path / "mine"


def test_a_run_scores_what_was_answered_and_resumes(tmp_path, folder, stub, capsys):
    out = tmp_path / "out"
    asked = {"reference": True, "cases": 16, "out": out, "seed": 15, "jobs": 2}
    assert run_injected(folder, **asked) == 0
    folders = Folders(out)
    labels = read_labels(folders.labels, Injected.of, folders.read_state()["sha256"])
    cases = pd.read_parquet(out / "cases.parquet").set_index("case")
    assert set(cases.index) == set(labels)
    for case in labels.values():
        tells_nothing(folders.cases / case.id, case)
    by_fault = cases.groupby("fault")
    assert by_fault.get_group("believed_mass")["named"].all()
    assert by_fault.get_group("degrees")["refused"].all()
    assert by_fault.get_group("degrees")["found"].all()
    assert not by_fault.get_group(NOTHING)["found"].any()
    assert not by_fault.get_group("delay")["found"].any()
    numbers = pd.read_parquet(out / "numbers.parquet")
    true = numbers["true"].abs()
    assert len(true)
    assert (numbers["inside"] == (true <= 0.06)).all()
    text = (out / "injected.md").read_text()
    assert "| an effect blamed in undisturbed flights | 0/4 | 0.0 % | 0.0 to 60.2 % |" in text
    assert (out / "labels.json").read_bytes() == folders.labels.read_bytes()
    one = next(iter(labels))
    (folders.answers / one / STATUS).unlink()
    assert run_injected(folder, **asked) == 0
    assert f"{len(labels) - 1} of {len(labels)} cases have an answer" in capsys.readouterr().out
    text = (out / "injected.md").read_text()  # with the time of the answer that was made again
    (out / "injected.md").unlink()
    assert main(["blind", "--report", "--out", str(out)]) == 0
    assert (out / "injected.md").read_text() == text


def tells_nothing(place, case):
    """Fails unless nothing but logs is written where a diagnosis looks."""
    seen = load_flights(place) if case.fault not in REFUSED else None
    assert case.fault not in (place / "vehicle.toml").read_text().replace(NOTHING, "")
    assert seen is None or {f.name for f in seen.flights} == set(case.target)


REFUSED = ("degrees", "grams", "scalar_first", "body_velocity")
"""Faults that `load_flights` may refuse by itself."""


def test_another_request_in_the_same_folder_is_refused(tmp_path, folder, stub, capsys):
    out = str(tmp_path / "out")
    asked = {"cases": 4, "out": tmp_path / "out", "seed": 1, "jobs": 2}
    run_injected(folder, **asked)
    told = ["blind", "--inject", str(folder), "--out", out]
    for more, message in (
        (["--cases", "5"], "holds a draw of 4 cases"),
        (["--seed", "2"], "holds a draw with the seed 1"),
        (["--reference"], "holds a draw without `--reference`"),
        (["--reality", "rotorpy"], "Leave out --reality: not used with --inject."),
        (["--limits"], "Leave out --limits: not used with --inject."),
    ):
        assert main([*told, *more]) == 2
        assert message in capsys.readouterr().err
    table = folder / "flights" / "f0.parquet"
    pd.read_parquet(table).iloc[:-1].to_parquet(table)
    assert main(told) == 2
    assert "these before they changed" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--reference"], "`--reference` needs `--inject FLIGHTS`"),
        (["--inject", "nowhere"], "nowhere: does not exist"),
    ],
)
def test_a_wrong_request_gets_one_line(tmp_path, capsys, arguments, message):
    assert main(["blind", "--out", str(tmp_path / "out"), *arguments]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def case(number, fault, **parameters):
    return Injected(f"{number:016x}", fault, "small" if parameters else "", parameters, (), ())


def test_scores_count_aliases_refusals_and_wrong_effects():
    cases = {
        c.id: c
        for c in (
            case(1, "thrust_gain", e=0.05),
            case(2, "thrust_gain", e=0.1),
            case(3, "delay", seconds=0.02),
            case(4, "delay", seconds=0.02),
            case(5, NOTHING),
            case(6, NOTHING),
            case(7, "path_turned_in_yaw", angle=0.09),
            case(8, "clock_drift", rate=0.01),
        )
    }
    given = []
    for effects, verdict in (
        ([named("mass", 0.9, parameter("e", -0.05, -0.06, -0.04, "-"))], "effect"),
        ([named("mass", 0.9, parameter("e", -0.05, -0.06, -0.04, "-"))], "partly"),
        ([named("attitude_lag", 0.9) | {"aliases": ["delay"]}], "effect"),
        ([named("wind", 0.9)], "effect"),
        ([named("wind", None, blamed=False)], "unexplained"),
    ):
        given.append((effect() if effects else none()) | {"verdict": verdict, "effects": effects})
    answers = dict(zip(cases, given, strict=False))
    fault = {"part": "frame of the path", "readings": ["turned"], "advice": "", "evidence": []}
    answers |= dict.fromkeys([f"{i:016x}" for i in (7, 8)], none() | {"interface": [fault]})
    ok = {"status": "ok", "cause": "", "seconds": 1.0}
    statuses = dict.fromkeys(cases, ok)
    statuses[f"{6:016x}"] = {"status": "failed", "cause": "exit status 2: why", "seconds": 1.0}
    table, numbers = injected_rows(cases, answers, statuses)
    assert table["named"].tolist() == [True, True, True, False, False, False, True, False]
    assert table["misled"].tolist() == [False, False, False, True, *[False] * 4]
    assert table["found"].all()
    # 1/1.05 - 1 is -0.048, and 1/1.1 - 1 is -0.091.
    assert numbers["inside"].tolist() == [True, False]
    found = power(table).set_index("fault")
    assert found.loc["delay", "named"] == 1
    assert found.loc["delay", "named_low"] == pytest.approx(0.0126, abs=1e-4)
    score = shares(table, numbers).set_index("score")["hits"]
    assert score["an effect blamed in undisturbed flights"] == 0
    assert score["anything wrong found in undisturbed flights"] == 2
    run = {"injected": "<b>", "seed": None, "reference": False, "sources": ["a" * 64]}
    run |= {"flights": 4, "started": "", "sha256": "", "described": ["delay", "thrust_gain"]}
    found = InjectedTables(table, numbers, run)
    assert in_short([], [found])[1] == INJECTED
    quiet = table.assign(verdict=table["verdict"].mask(table["fault"].eq(NOTHING), "too_few"))
    quiet["found"] = quiet["refused"]
    untold = shares(quiet, numbers).set_index("score")
    assert untold.loc["anything wrong found in undisturbed flights", "n"] == 1
    assert "| &lt;b&gt; | 4 of 6 | 0 of 6 | 1 of 6 | 2 of 2 | 1 of 2 |" in in_short([], [found])[-1]
    text = "\n".join([*section(found), *by_size([found])])
    assert "<b>" not in text
    assert "| delay | small (0.02) | 2 | 2/2 (16 to 100 %) | 1/2 (1 to 99 %) | 1 | 0 |" in text


def test_believed_mass_and_units_reach_the_file(tmp_path):
    flights = made_set(2)
    heavy = ALL["believed_mass"].apply(flights, {"e": 0.1})
    write_flights(tmp_path / "heavy", heavy.vehicle, heavy.flights)
    assert load_flights(tmp_path / "heavy").vehicle.mass == pytest.approx(0.0434 / 1.1)
    grams = ALL["grams"].apply(flights, {})
    write_flights(tmp_path / "grams", grams.vehicle, grams.flights)
    with pytest.raises(LogError, match="Is it in grams"):
        load_flights(tmp_path / "grams")
