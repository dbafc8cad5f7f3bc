"""Trainings in one program: each as if it were alone, whatever the others do."""

import dataclasses
import threading
import types
from concurrent.futures import ThreadPoolExecutor

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import TINY, Hold, fresh, setup, small

from methods.running.metered import train_metered
from methods.training import together
from methods.training.context import Context
from methods.training.together import Team
from simulators.contract import with_effects
from simulators.effects.drag import Drag
from simulators.point_mass import PointMass

WAIT = 300.0
TRAINER = dataclasses.replace(TINY, epochs=4, n_worlds=2)


def as_team(works):
    """What each returns, given one context of a common team, all at once."""
    team = Team(len(works))

    def one(work):
        with team.member():
            return work(Context(team=team))

    with ThreadPoolExecutor(len(works)) as pool:
        return [future.result(WAIT) for future in [pool.submit(one, work) for work in works]]


def training(seed, trainer=TRAINER, simulator=None, task=None):
    task = task or Hold()

    def work(context=Context()):  # noqa: B008
        key = jax.random.key(seed)
        policy, flown = fresh(task, seed), simulator or PointMass()
        return trainer.train(task, flown, policy, key, context, "test")

    return work


def test_members_take_turns_where_each_is_billed_for_its_own_time():
    inside, most = set(), []

    def work(context):
        with context.in_turn():
            inside.add(threading.get_ident())
            most.append(len(inside))
            threading.Event().wait(0.05)
            inside.remove(threading.get_ident())

    as_team([work] * 4)
    assert most == [1, 1, 1, 1]
    work(Context())  # alone, without a team


def assert_alike(one, other, rtol=1e-4):
    assert one.curves.keys() == other.curves.keys()
    for name, curve in one.curves.items():
        np.testing.assert_allclose(curve, other.curves[name], rtol=rtol, atol=1e-6)
    for a, b in zip(
        jax.tree.leaves(eqx.filter(one.policy, eqx.is_array)),
        jax.tree.leaves(eqx.filter(other.policy, eqx.is_array)),
        strict=True,
    ):
        np.testing.assert_allclose(a, b, rtol=rtol, atol=1e-5)


@pytest.fixture
def programs(monkeypatch):
    """Sizes of the common calls, in their order."""
    sizes = []
    whole = together._together

    def counted(given, room):
        sizes.append(len(given[-1]))
        return whole(given, room)

    monkeypatch.setattr(together, "_together", counted)
    return sizes


def test_seeds_train_in_one_program_as_each_alone(programs):
    works = [training(seed) for seed in range(4)]
    found = as_team(works)
    assert programs == [4] * TRAINER.epochs
    for one, work in zip(found, works, strict=True):
        assert_alike(one, work())
    rewards = [one.curves["reward"].tolist() for one in found]
    assert rewards[0] != rewards[1]


def dragged(seed, c):
    return training(seed, simulator=with_effects(PointMass(), [Drag(c=c)]))


def test_numbers_of_the_simulator_may_differ(programs):
    works = [dragged(0, c) for c in (0.2, 2.0)]
    slow, fast = as_team(works)
    assert programs == [2] * TRAINER.epochs
    assert_alike(slow, works[0]())
    assert_alike(fast, works[1]())
    assert slow.curves["reward"][0] != fast.curves["reward"][0]


def test_one_that_ends_earlier_is_waited_for_no_more(programs):
    short = dataclasses.replace(TRAINER, epochs=4)
    works = [training(0, short), training(1, short), training(2, short), _quits]
    *found, quit = as_team(works)
    assert quit == "gone"
    for seed, one in enumerate(found):
        assert_alike(one, training(seed, short)())
    # Three of four places are filled; the program is that of four.
    assert programs == [4] * 4


def _quits(context):
    return "gone"


def test_half_empty_programs_are_left(programs):
    team, gone = Team(3), threading.Event()

    def leaves():
        with team.member():
            team.call(_double, jnp.ones(2), lambda n: None)
        gone.set()

    def stays():
        with team.member():
            first, _ = team.call(_double, jnp.ones(2), lambda n: None)
            gone.wait(WAIT)
            return first, team.call(_double, jnp.full(2, 3.0), lambda n: None)

    with ThreadPoolExecutor(3) as pool:
        futures = [pool.submit(work) for work in (leaves, leaves, stays)]
        (first,), ((second,), _) = futures[-1].result(WAIT)
    np.testing.assert_array_equal(first, 2.0)
    np.testing.assert_array_equal(second, 6.0)
    assert programs[0] == 3
    assert programs[-1] < 3


def _double(given, room):
    return 2.0 * given, room


def test_other_shapes_fly_apart(programs):
    works = [dragged(0, 0.2), dragged(1, 0.2), training(2, task=Hold(n_drones=2))]
    found = as_team(works)
    for one, work in zip(found, works, strict=True):
        assert_alike(one, work())
    assert sorted(programs) == [1] * TRAINER.epochs + [2] * TRAINER.epochs


def test_an_error_concerns_those_of_its_call_only():
    def fails(given, room):
        raise ValueError("the propellers fell off")

    def work(function):
        def call(team):
            return team.call(function, jnp.ones(2), lambda n: None)[0]

        return call

    team_of = [work(fails), work(_double)]
    team = Team(2)

    def one(work):
        with team.member():
            try:
                return work(team)
            except ValueError as error:
                return str(error)

    with ThreadPoolExecutor(2) as pool:
        failed, (doubled,) = pool.map(one, team_of)
    assert failed == "the propellers fell off"
    np.testing.assert_array_equal(doubled, 2.0)


def test_time_is_shared_and_waiting_is_nobodys(monkeypatch):
    """Of a common call, each of three has a third; of one that nobody shares, the whole."""
    clock, inside = [0.0], threading.Barrier(3)
    monkeypatch.setattr(together, "time", types.SimpleNamespace(perf_counter=lambda: clock[0]))

    def flown(given, room):
        clock[0] += 6.0
        return [(x,) for x in given[2]], room

    monkeypatch.setattr(together, "_together", flown)

    def own(n, before=0.0):
        def work(context):
            begun = clock[0]
            inside.wait(WAIT)
            if before:  # what a member does while the two others wait for it
                while len(context.team._waiting) < 2:
                    threading.Event().wait(0.01)
                clock[0] += before
            waited = context.team.call(_double, jnp.ones(n), lambda size: None)[1]
            return clock[0] - begun - before - waited

        return work

    assert as_team([own(2)] * 3) == [2.0] * 3
    assert as_team([own(2), own(2), own(2, before=4.0)]) == [2.0] * 3
    assert as_team([own(2), own(2), own(5)]) == [3.0, 3.0, 6.0]


@pytest.mark.parametrize("name", ["hf_scratch", "hybrid"])
def test_whole_methods_need_not_know(name, programs):
    """Calibration and fits of their own, in between and at once."""
    task, reality = Hold(n_drones=2), with_effects(PointMass(), [Drag(c=0.5)])

    def work(seed):
        def train(context=None):
            given = setup(task, reality, fresh(task, seed), context)
            method = small(name, **({"rows": 10} if name == "hybrid" else {}))
            return train_metered(method, given, jax.random.key(seed))

        return train

    found = as_team([work(0), work(1)])
    assert set(programs) == {2}
    for seed, one in enumerate(found):
        alone = work(seed)()
        assert one.ledger.epochs == alone.ledger.epochs > 0
        assert one.ledger.hf_fleet_seconds == pytest.approx(alone.ledger.hf_fleet_seconds)
        np.testing.assert_allclose(one.curves["reward"], alone.curves["reward"], rtol=1e-3)


def test_who_has_no_team_in_its_context_trains_alone(programs):
    """Even in a thread that is a member: nothing is ambient."""
    with Team(1).member():
        training(0)()
    assert programs == []
