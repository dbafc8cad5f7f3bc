"""Trainings that are killed and go on: equal to those that were not, bit for bit."""

import dataclasses

import jax
import numpy as np
import pytest
from cells import Hold, Memory, fresh, same, setup

from methods.hf_hotstart import HFHotStart
from methods.running.metered import train_metered
from methods.training import bptt
from methods.training.bptt import BPTT
from methods.training.context import Context
from simulators.point_mass import PointMass

KEY = jax.random.key(5)
TASK = Hold(n_drones=2, horizon=40, spacing=(3.0, 3.0))
TRAINER = BPTT(epochs=20, lr=1e-4, n_worlds=1, smoothing=3, patience=5, min_improvement=1.0)
"""It improves at every epoch, but never by as much as patience wants: one that forgot when it last
improved enough would go on for longer."""


class Killed(BaseException):
    """Ends a training from outside."""


def train(keeper, policy=None, key=KEY, die_at=0, epochs=None):
    """A hot start in the point mass; `epochs` gets the epochs that were flown."""

    def progress(stage, epoch, of, reward):
        if epochs is not None:
            epochs.append(epoch)
        if epoch == die_at:
            raise Killed

    context = Context(progress, keeper=keeper)
    cell = setup(TASK, PointMass(), policy or fresh(TASK), context)
    return train_metered(HFHotStart(trainer=TRAINER), cell, key)


@pytest.fixture(scope="module")
def whole():
    return train(Memory())


def check_equal(trained, other):
    assert same(trained.policy, other.policy)
    for name, column in other.curves.items():
        np.testing.assert_array_equal(trained.curves[name], column)
    ledgers = [dataclasses.replace(t.ledger, train_seconds=0.0) for t in (trained, other)]
    assert ledgers[0] == ledgers[1]
    assert trained.notes == other.notes
    assert trained.status == other.status


def test_the_reference_ends_by_patience_before_its_budget(whole):
    """Else the tests below would not see that patience is restored."""
    assert whole.ledger.epochs == 8
    assert (np.diff(whole.curves["smooth_reward"]) > 0.0).all()
    assert whole.ledger.hf_fleet_seconds == pytest.approx(8 * 40 * 0.02 * 2)


@pytest.mark.parametrize("die_at", [1, 2, 4, 7])
def test_a_resumed_training_equals_the_uninterrupted_one_bit_for_bit(whole, die_at):
    keeper, flown = Memory(), []
    with pytest.raises(Killed):
        train(keeper, die_at=die_at, epochs=flown)
    check_equal(train(keeper, epochs=flown), whole)
    assert flown == list(range(1, whole.ledger.epochs + 1))  # none twice


def test_two_kills_in_a_row_cost_nothing_and_time_before_them_is_billed_once(whole, monkeypatch):
    """By a clock on which an epoch takes a second and nothing else takes any."""
    now = [0.0]
    monkeypatch.setattr(bptt.time, "perf_counter", lambda: now[0])
    course_add = bptt._Course.add

    def add(course, *given):
        now[0] += 1.0
        course_add(course, *given)

    monkeypatch.setattr(bptt._Course, "add", add)
    keeper = Memory()
    for die_at in (3, 5):
        with pytest.raises(Killed):
            train(keeper, die_at=die_at)
        now[0] += 1000.0  # until somebody starts it again
    resumed = train(keeper)
    check_equal(resumed, whole)
    assert resumed.ledger.train_seconds == train(Memory()).ledger.train_seconds == 8.0


def test_a_training_that_had_ended_is_not_flown_again(whole):
    keeper, flown = Memory(always=False), []
    train(keeper)
    assert keeper.saves == 1
    check_equal(train(keeper, epochs=flown), whole)
    assert flown == []


@pytest.mark.parametrize("other", [{"key": jax.random.key(6)}, {"policy": fresh(TASK, seed=1)}])
def test_what_began_otherwise_is_not_restored(other):
    keeper, flown = Memory(), []
    with pytest.raises(Killed):
        train(keeper, die_at=4)
    train(keeper, epochs=flown, **other)
    assert flown[0] == 1


def test_every_training_of_a_method_has_a_place_of_its_own():
    keeper, settings = Memory(always=False), dataclasses.replace(TRAINER, epochs=3)
    ends = []
    for _ in range(2):
        context = Context(keeper=keeper)
        for i, seed in enumerate((0, 1, 0)):
            policy = fresh(TASK, seed)
            ends.append(settings.train(TASK, PointMass(), policy, KEY, context, f"restart {i}"))
    assert sorted(stage for stage, _ in keeper.files) == ["restart 0", "restart 1", "restart 2"]
    for first, again in zip(ends[:3], ends[3:], strict=True):
        assert same(first.policy, again.policy)
    assert not same(ends[0].policy, ends[1].policy)


def test_the_order_of_trainings_decides_nothing():
    """A method whose first training was not begun again would else resume the second's."""
    keeper, flown = Memory(), []
    settings = dataclasses.replace(TRAINER, epochs=3)
    for stages in (("first", "second"), ("second",)):
        context = Context(lambda stage, *_: flown.append(stage), keeper=keeper)
        for stage in stages:
            settings.train(TASK, PointMass(), fresh(TASK), KEY, context, stage)
    assert flown == ["first"] * 3 + ["second"] * 3


def test_two_trainings_of_one_name_are_refused_where_they_are_kept():
    settings = dataclasses.replace(TRAINER, epochs=1)
    context = Context(keeper=Memory())
    settings.train(TASK, PointMass(), fresh(TASK), KEY, context, "restarts")
    with pytest.raises(ValueError, match=r"called 'restarts'.*Give each a stage of its own"):
        settings.train(TASK, PointMass(), fresh(TASK, 1), KEY, context, "restarts")


def test_without_a_keeper_nothing_is_kept():
    place = Context().place("training", "settings", KEY)
    assert place.load() is None
    assert not place.due()
    place.save({})
