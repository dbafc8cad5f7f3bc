"""One contract suite over every registered method, on a cell of three drones and 0.3 s."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import (
    FLIGHTS,
    FLOWN,
    METHODS,
    RESIDUALS,
    TINY,
    Braking,
    Hold,
    fresh,
    leaning,
    same,
    setup,
    small,
)

from bench.conformance.methods import declarations
from bench.conformance.suite import execute
from methods import grey_box
from methods.calibration import identification
from methods.calibration.residual_effect import ResidualEffect
from methods.contract import Ledger, Setup
from methods.domain_randomization import DomainRandomization, randomized
from methods.hf_hotstart import HFHotStart
from methods.residuals import mlp
from methods.running.metered import train_metered
from methods.training.bptt import BPTT
from methods.training.context import Context
from methods.training.evaluate import evaluate, fly
from methods.training.meter import billed
from methods.training.policy import PolicyController, make_policy
from methods.upper_reference import UpperReference
from simulators import registry
from simulators.contract import with_effects
from simulators.crazyflow import Crazyflow
from simulators.effects import chain
from simulators.effects.mass import Mass

TASK = Hold()
KEY = jax.random.key(7)
PARENT, INIT = fresh(TASK, 1), leaning(TASK)
ROWS = [
    (name, residual)
    for name in METHODS
    if name != "ppo"  # which does not train by gradients through a simulator: `test_ppo.py`
    for residual in {"hybrid": sorted(RESIDUALS), "grey_box": ["", "affine"]}.get(name, [""])
]
BEFORE = ("hybrid", "recalibrated", "online", "grey_box")
"""Methods that calibrate and fit before they train."""
HF = [row for row in ROWS if METHODS[row[0]].simulator == "crazyflow"]
LF = [row for row in ROWS if METHODS[row[0]].simulator == "point_mass"]
# `make test` has Hybrid with two other residuals, a grey box without one (`test_variants.py` fits
# one to its rows), and a hot start, whose class the upper reference calls.
ALIKE = [("hybrid", "sindy"), ("hybrid", "affine"), ("grey_box", "affine"), ("upper_reference", "")]

COMPILED: list[str] = []
"""One a program that was compiled, or read from disk instead."""


@jax.monitoring.register_event_duration_secs_listener
def _listen(event, seconds, **_):
    if event.endswith("backend_compile_duration"):
        COMPILED.append(event)


@pytest.fixture(scope="module", autouse=True)
def _identified_once():
    """Identification takes half a minute; what other keys find differs by up to 1 % in numbers.

    The effects themselves may differ, too, and then a program does; `test_grey_box.py` has it all.
    Few candidates make small programs. Networks are updated three times: no test here asks how
    well they fit.
    """
    whole, fit_nets, kept = grey_box.identify, mlp.fit_nets, []
    others = {*registry.names("effect")} - {"delay", "drag", "thrust_lag"}

    def identify(nominal, reality, dt, largest, key, *chosen):
        bare = billed(reality, 3 * 500)
        if not kept:
            kept.append(whole(nominal, bare, dt, largest, jax.random.key(0)))
        share = 1.0 + 0.01 * jax.random.uniform(key)
        effects = jax.tree.map(lambda x: x * share if eqx.is_array(x) else x, kept[0].effects)
        return dataclasses.replace(kept[0], effects=effects)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(identification, "_no_candidates", lambda: others)
        patch.setattr(grey_box, "identify", identify)
        patch.setattr(mlp, "fit_nets", lambda *given: fit_nets(*given[:-1], 3))
        yield


def of_each(rows):
    """Cases of a test, a row of methods each."""
    marks = dict.fromkeys(ALIKE, pytest.mark.exhaustive)
    cases = [pytest.param(row, id="".join(row), marks=marks.get(row, ())) for row in rows]
    return pytest.mark.parametrize("row", cases)


def make(row):
    name, residual = row
    return small(name, **({"residual": residual} if residual else {}))


@pytest.fixture(scope="module")
def cell():
    return setup(TASK, Crazyflow(), PARENT)


@pytest.fixture(scope="module")
def train(cell):
    """Trains a row once per start and key, unless told to do it again; `heard` is its progress."""
    kept = {}

    def run(row, init=None, key=KEY, cell=cell, again=False, heard=False):
        name = (row, id(init), int(jax.random.key_data(key)[-1]), id(cell), again)
        if name not in kept:
            messages = []
            context = Context(lambda *message: messages.append(message))
            told = dataclasses.replace(cell, context=context)
            method = make(row)
            metered = init is None
            trained = train_metered(method, told, key) if metered else method.train(told, key, init)
            kept[name] = trained, messages
        return kept[name][heard]

    return run


@pytest.fixture
def again(train, monkeypatch):
    """Trains a row with the same key once more; its trainer says that it took minus a million s."""
    whole = BPTT.train

    def run(row):
        billed = lambda *given: dataclasses.replace(whole(*given), seconds=-1e6)  # noqa: E731
        monkeypatch.setattr(BPTT, "train", billed)
        return train(row, again=True)

    return run


def first_return(trained, policy, cell, row):
    """Return of `policy` in the simulator in which a row is trained, in the first epoch's episode.

    Only what draws its simulator anew in every episode depends on which episode it is.
    """
    simulator, episode = cell.reality if row in HF else cell.nominal, KEY
    if row[0] == "domain_randomization":
        simulator = randomized(dataclasses.replace(simulator, dt=make(row).dt))
        train_key = jax.random.split(KEY)[1]
        episode = jax.random.split(jax.random.fold_in(train_key, 0), 1)[0]
    if trained.effects:
        simulator = with_effects(
            dataclasses.replace(cell.nominal, dt=make(row).dt), trained.effects
        )
    if trained.residual is not None:
        effect = ResidualEffect(trained.residual, cell.nominal.spec.mass)
        simulator = with_effects(simulator, [effect])
    record = fly(TASK, simulator, PolicyController(TASK, policy), episode[None])
    return float(np.asarray(record.reward).sum(axis=1).mean())


@of_each(ROWS)
def test_a_method_trains_a_finite_policy_of_the_cells_shape(train, row):
    trained = train(row)
    weights, expected = (
        jax.tree.leaves(eqx.filter(policy, eqx.is_array)) for policy in (trained.policy, PARENT)
    )
    assert [leaf.shape for leaf in weights] == [leaf.shape for leaf in expected]
    assert all(np.isfinite(leaf).all() for leaf in weights)
    assert trained.policy(jnp.zeros((3, TASK.obs_size))).shape == (3, 3)
    assert trained.status == "ok"
    assert len(set(trained.curves["reward"])) == TINY.epochs  # every update changed it
    assert trained.notes["training_reward"] == pytest.approx(trained.curves["smooth_reward"][-1])


@of_each(ROWS)
def test_the_same_key_gives_the_same_result(train, again, row):
    first, second = train(row), again(row)
    assert same(first.policy, second.policy)
    for name, curve in first.curves.items():
        np.testing.assert_array_equal(curve, second.curves[name])
    for field in dataclasses.fields(first.ledger):
        if field.name != "train_seconds":
            assert getattr(first.ledger, field.name) == getattr(second.ledger, field.name)


@of_each(ROWS)
def test_another_seed_gives_another_result_and_compiles_nothing(train, cell, row):
    """Neither training nor deployment, whose programs the first seed left."""
    first = train(row)
    evaluate(TASK, cell.reality, PolicyController(TASK, first.policy), 0)
    before = len(COMPILED)
    other = train(row, key=jax.random.key(9))
    evaluate(TASK, cell.reality, PolicyController(TASK, other.policy), 9)
    assert len(COMPILED) == before
    if METHODS[row[0]].parents != ("lf_baseline",) or row in LF:
        assert not same(first.policy, other.policy)


def test_another_schedule_shares_the_program_of_an_epoch(cell):
    """Scratch and hot start of a cell fly the same program; only their learning rates differ."""

    def train(trainer):
        return trainer.train(TASK, cell.reality, INIT, jax.random.key(3), Context(), "test")

    train(TINY)
    before = len(COMPILED)
    trained = train(dataclasses.replace(TINY, epochs=5, lr=1e-3, final_lr=0.1, patience=50))
    assert trained.epochs == 5
    assert len(COMPILED) - before <= 1  # that of the schedule


def test_a_new_program_is_counted():
    before = len(COMPILED)
    jax.block_until_ready(jax.jit(lambda x: x + 1.0)(jnp.zeros(7)))
    assert len(COMPILED) > before


# Of a grey box, whose lags would be drawn anew in every episode, with a spread of nothing.
@of_each(ROWS)
def test_the_first_epoch_flies_init(train, cell, row):
    trained = train(row, init=INIT)
    assert trained.curves["reward"][0] == pytest.approx(
        first_return(trained, INIT, cell, row), rel=1e-5
    )
    assert abs(trained.curves["reward"][0] - train(row).curves["reward"][0]) > 0.01


@of_each(ROWS)
def test_every_step_of_high_fidelity_flight_is_billed(train, row):
    ledger = train(row).ledger
    episode = TASK.horizon * 0.02
    if row in HF:
        expected = TINY.epochs * TINY.worlds(TASK.n_drones) * episode * TASK.n_drones
    elif row[0] == "grey_box":
        expected = 3 * 10.0  # flights of its own length, whatever the task's
    elif row[0] == "hybrid_once":
        expected = FLOWN.hf_fleet_seconds
    elif row[0] == "online":
        expected = FLOWN.hf_fleet_seconds + FLIGHTS * episode * TASK.n_drones
    else:
        expected = episode * ledger.calibration_flights
    flights = {"hybrid": FLIGHTS, "recalibrated": FLIGHTS, "grey_box": 3}
    flights = flights | dict.fromkeys(("hybrid_once", "online"), FLOWN.calibration_flights)
    assert ledger.hf_fleet_seconds == pytest.approx(expected, rel=1e-9)
    assert ledger.calibration_flights == flights.get(row[0], 0)
    assert ledger.epochs == TINY.epochs
    assert ledger.skipped_updates == 0
    assert ledger.train_seconds > 0


@of_each(ROWS)
def test_training_time_is_what_the_trainer_says_and_what_came_before(again, row):
    """Of epochs that are flown for others, too, only a share: no method takes its own time."""
    said = again(row).ledger.train_seconds
    assert -1e6 <= said < -1e6 + 1e3
    assert (said > -1e6) == (row[0] in BEFORE)  # calibration and fits count


@of_each(ROWS)
def test_crashes_of_training_are_billed_where_they_happen(train, row):
    """The first two drones start 0.25 m apart: two crashes an episode, contact at every step."""
    trained = train(row)
    crashes = TINY.epochs * TINY.worlds(TASK.n_drones) * 2
    assert trained.curves["crashes"].sum() == crashes
    flown = crashes if row in HF else 2 * FLIGHTS if row[0] == "online" else 0
    assert trained.ledger.training_crashes == flown
    assert trained.ledger.lf_collisions == (0 if row in HF else crashes)
    assert trained.ledger.training_crash_step_rate == (1.0 if flown else 0.0)
    # One isolated drone cannot, but a parent's flights are billed with their crashes.
    parents = FLOWN.calibration_crashes if row[0] in ("hybrid_once", "online") else 0
    assert trained.ledger.calibration_crashes == parents


@of_each(HF)
def test_a_high_fidelity_run_that_its_budget_ended_before_patience_did_says_so(cell, row):
    patient = dataclasses.replace(make(row), trainer=dataclasses.replace(TINY, patience=50))
    assert patient.train(cell, KEY).status == "budget"


@pytest.mark.parametrize(
    "name", ["hf_hotstart", pytest.param("upper_reference", marks=pytest.mark.exhaustive)]
)
def test_fine_tuning_begins_with_its_parents_policy(train, cell, name):
    row = (name, "")
    trained = train(row)
    assert trained.curves["reward"][0] == pytest.approx(
        first_return(trained, PARENT, cell, row), rel=1e-5
    )


def test_the_upper_reference_is_a_hot_start_with_four_times_the_epochs(train):
    reference, hot = UpperReference(), HFHotStart()
    assert reference.trainer == dataclasses.replace(hot.trainer, epochs=4 * hot.trainer.epochs)
    assert same(train(("upper_reference", "")).policy, train(("hf_hotstart", "")).policy)


NO_FLIGHT = [
    *((name, {}) for name in ("lf_baseline", "domain_randomization", "hybrid_once")),
    ("recalibrated", {"flights": 0}),
]


@pytest.mark.parametrize(("name", "settings"), NO_FLIGHT, ids=[name for name, _ in NO_FLIGHT])
def test_what_flies_nothing_of_its_own_does_not_depend_on_the_reality(cell, name, settings):
    heavy = dataclasses.replace(cell, reality=with_effects(cell.nominal, [Mass(e=0.5)]))
    method = dataclasses.replace(small(name), **settings)
    first, second = (train_metered(method, given, KEY) for given in (cell, heavy))
    assert same(first.policy, second.policy)
    bill = FLOWN if name == "hybrid_once" else Ledger()
    for field in ("hf_fleet_seconds", "calibration_flights", "calibration_crashes"):
        assert getattr(first.ledger, field) == getattr(bill, field)


@pytest.mark.parametrize(("name", "settings"), NO_FLIGHT[2:], ids=["hybrid_once", "recalibrated"])
def test_a_frozen_residual_is_the_parents_and_is_trained_under(cell, name, settings):
    """Another residual of the parent, another policy; without one it says so."""
    method = dataclasses.replace(small(name), **settings)
    parent = cell.parents["hybrid"]

    def under(residual):
        changed = cell.parents | {"hybrid": dataclasses.replace(parent, residual=residual)}
        return method.train(dataclasses.replace(cell, parents=changed), KEY)

    trained = under(parent.residual)
    assert trained.residual is parent.residual
    spec, space = cell.nominal.spec, cell.nominal.action_space
    start = make_policy(TASK, spec, space, jax.random.split(KEY)[0])
    start = PARENT if name == "recalibrated" else start
    assert trained.curves["reward"][0] == pytest.approx(
        first_return(trained, start, cell, (name, "")), rel=1e-5
    )
    assert not same(trained.policy, under(Braking(rate=5.0)).policy)
    with pytest.raises(TypeError, match=f"`{name}` starts from has no residual"):
        under(None)


def test_identifying_again_gives_the_same_bits(cell):
    method = METHODS["grey_box"]()
    given = dataclasses.replace(cell.nominal, dt=method.dt), cell.reality, method.dt, method.largest
    found, again = (identification.identify(*given, KEY) for _ in range(2))
    assert same(found.flights, again.flights)
    assert same(found.effects, again.effects)
    assert chain.canonical(found.effects) == chain.canonical(again.effects)


def test_domain_randomization_draws_its_vehicles_where_the_grey_box_steps():
    assert DomainRandomization().dt == METHODS["grey_box"]().dt
    assert DomainRandomization().trainer == METHODS["grey_box"]().trainer


def test_hybrid_calibrates_on_its_parents_flights(train, cell):
    row = ("hybrid", "mlp")
    other = dataclasses.replace(cell.parents["lf_baseline"], policy=INIT)
    swapped = dataclasses.replace(cell, parents={"lf_baseline": other})
    assert not same(train(row).residual, train(row, cell=swapped).residual)


def test_recalibration_resumes_from_the_residual_and_the_policy_there_were(train, cell):
    """With learning rates of next to nothing both stay as they are."""
    hybrid = train(("hybrid", "mlp"), init=INIT)
    parents = cell.parents | {"hybrid": hybrid}
    still = dataclasses.replace(TINY, lr=1e-12)
    made = small("recalibrated", refit_epochs=2, refit_lr=1e-12)
    made = dataclasses.replace(made, trainer=still)
    trained = made.train(dataclasses.replace(cell, parents=parents), KEY)
    leaves = lambda x: jax.tree.leaves(eqx.filter((x.policy, x.residual), eqx.is_array))  # noqa: E731
    for old, new in zip(leaves(hybrid), leaves(trained), strict=True):
        np.testing.assert_allclose(old, new, atol=1e-6)
    assert trained.ledger.calibration_flights == FLIGHTS
    assert not same(made.train(cell, KEY).residual, trained.residual)


@pytest.mark.parametrize("name", [n for n in METHODS if METHODS[n].parents])
def test_a_missing_parent_is_not_replaced_in_silence(cell, name):
    with pytest.raises(KeyError, match="|".join(METHODS[name].parents)):
        small(name).train(Setup(TASK, cell.nominal, cell.reality), KEY)


@of_each(ROWS)
def test_progress_is_told_of_every_epoch(train, row):
    trained = train(row)
    epochs = [message for message in train(row, heard=True) if message[2] == TINY.epochs]
    assert [message[1] for message in epochs] == [1, 2, 3]
    np.testing.assert_allclose([message[3] for message in epochs], trained.curves["reward"])


@pytest.mark.parametrize("name", sorted(METHODS))
def test_it_says_what_it_is(name):
    cls = METHODS[name]
    assert [x for x in execute(cls, declarations(cls, {})) if x.problem] == []
