"""Rows with another low-fidelity simulator, and settings that came later."""

import json

import jax
import pytest

from bench.execution import worker
from bench.plan.expansion import expand
from bench.plan.keys import SettingsError
from bench.plan.suite import Row, Suite, SuiteError, load_suite
from bench.store.store import Store
from bench.text.errors import UsageError
from methods.contract import Ledger, Trained
from methods.training.context import Context
from methods.training.policy import make_policy
from simulators.registry import UnknownPluginError


def runs(*rows):
    return {run.method: run for run in expand(Suite("s", "", ("circle",), (3,), 1, rows)).runs}


def test_parents_are_trained_in_the_same_low_fidelity_simulator():
    found = runs(Row("hybrid", nominal={"attitude_tau": 0.02}))
    assert {run.variant for run in found.values()} == {"nominal.attitude_tau=0.02"}
    plain = runs(Row("hybrid"))
    assert {found[m].key for m in found}.isdisjoint(plain[m].key for m in plain)


def test_the_default_written_out_is_the_default():
    written, plain = runs(Row("hybrid", nominal={"attitude_tau": 0.104})), runs(Row("hybrid"))
    assert [run.key for run in written.values()] == [run.key for run in plain.values()]
    assert {run.variant for run in written.values()} == {""}


def test_an_unknown_field_of_the_simulator_is_named(tmp_path):
    with pytest.raises(SettingsError, match="Did you mean 'attitude_tau'"):
        runs(Row("lf_baseline", nominal={"atitude_tau": 0.1}))
    path = tmp_path / "s.toml"
    path.write_text(
        'tasks = ["circle"]\nteam_sizes = [3]\nseeds = 1\n[[methods]]\nmethod = "lf_baseline"\n'
        "nominal = 0.1\n"
    )
    with pytest.raises(SuiteError, match="`nominal` must be a table"):
        load_suite(str(path))


def test_a_worker_trains_in_it(tmp_path, monkeypatch):
    seen = []

    def stop(run, setup):
        seen.append(float(setup.nominal.attitude_tau))
        raise InterruptedError

    monkeypatch.setattr(worker, "_trained", stop)
    for given in ({"attitude_tau": 0.02}, {}):
        run = runs(Row("lf_baseline", nominal=given))["lf_baseline"]
        with pytest.raises(InterruptedError):
            worker.train_and_evaluate(run, Store(tmp_path), Context())
    assert seen == pytest.approx([0.02, 0.104])


@pytest.mark.parametrize("field", ["dt", "attitude_tau"])
def test_a_simulator_in_which_nothing_moves_is_refused(field):
    with pytest.raises(SettingsError, match=f"`{field}` must be above 0 s, got -1"):
        runs(Row("lf_baseline", nominal={field: -1.0}))


FLOOR = {"effects": "floor(height=0.0)"}


def test_the_low_fidelity_simulator_may_have_effects_for_parents_too():
    found, plain = runs(Row("hybrid", nominal=FLOOR)), runs(Row("hybrid"))
    assert {run.variant for run in found.values()} == {"nominal.effects=Floor(height=0)"}
    assert {found[m].key for m in found}.isdisjoint(plain[m].key for m in plain)
    written = json.dumps(found["lf_baseline"].resolved)
    assert '"effect Floor": "1"' in written
    assert '"effects": "Floor(height=0)"' in written
    assert "effect Floor" in found["lf_baseline"].sources


def test_one_effect_has_one_key_however_it_is_written():
    texts = ("floor(height=0.0)", " floor( height = 0.00 ) ")
    keys = {runs(Row("lf_baseline", nominal={"effects": t}))["lf_baseline"].key for t in texts}
    assert len(keys) == 1


def test_no_effects_are_the_default():
    empty, plain = runs(Row("lf_baseline", nominal={"effects": ""})), runs(Row("lf_baseline"))
    assert empty["lf_baseline"].key == plain["lf_baseline"].key


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        (["floor"], "must be text, such as"),
        ("flor(height=0)", "Did you mean 'floor'"),
        ("floor(height=7)", r"height of 'floor' must lie in \[-0.1, 0.1\], got 7"),
        ("mass(e~normal(0, 0.05))", "none is drawn"),
        ("attitude_gain", "is no effect; write NAME"),
    ],
)
def test_effects_that_are_not_understood_are_refused(effects, message):
    with pytest.raises((UsageError, UnknownPluginError), match=message):
        runs(Row("lf_baseline", nominal={"effects": effects}))


def test_a_worker_trains_and_evaluates_with_its_effects(tmp_path, monkeypatch):
    seen = []

    def untrained(run, setup):
        seen.append([type(effect).__name__ for effect in setup.nominal.effects])
        nominal = setup.nominal
        policy = make_policy(setup.task, nominal.spec, nominal.action_space, jax.random.key(0))
        return Trained(policy, Ledger(), {}, "ok")

    monkeypatch.setattr(worker, "_trained", untrained)
    run = runs(Row("lf_baseline", nominal=FLOOR, task_settings={"horizon": 10}))["lf_baseline"]
    outcome = worker.train_and_evaluate(run, Store(tmp_path), Context())
    assert seen == [["Floor"]]
    assert outcome.trained_effects == "Floor(height=0)"


@pytest.mark.parametrize(
    ("method", "settings", "variant"),
    [
        ("grey_box", {"flights": 3}, ""),
        ("grey_box", {"excitation": 0.2}, ""),
        ("hybrid", {"flown": "pool"}, ""),
        ("hf_scratch", {"trainer": {"share": 1.0}}, ""),
        ("grey_box", {"flights": 10}, "flights=10"),
        ("grey_box", {"excitation": 0.0}, "excitation=0.0"),
        ("hybrid", {"flown": "grey_box"}, "flown=grey_box"),
        ("hybrid", {"rows": 500}, "rows=500"),
        ("hf_scratch", {"trainer": {"share": 0.1}}, "trainer.share=0.1"),
    ],
)
def test_settings_that_came_later_move_a_key_only_where_they_are_used(method, settings, variant):
    changed, plain = runs(Row(method, settings=settings))[method], runs(Row(method))[method]
    assert changed.variant == variant
    assert (changed.key == plain.key) == (variant == "")
