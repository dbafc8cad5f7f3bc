"""`bench check`: whole plug-ins pass; each broken one fails where it is broken, in plain words.

Our own are checked with their kind: `tests/tasks/test_tasks.py` and so on.
"""

import dataclasses
import re
from typing import ClassVar

import broken_plugins as broken
import jax
import jax.numpy as jnp
import jaxtyping
import pytest

from bench.cli.app import main
from bench.conformance.command import behaviour, declarations, find, findings
from bench.conformance.suite import Check, execute
from bench.plan.keys import nested, parse_settings
from bench.text.errors import UsageError
from simulators import registry
from simulators.point_mass import PointMass
from tasks import contact
from tasks.circle import Circle

POINT_MASS = {"point_mass": PointMass}


@pytest.fixture(autouse=True)
def without_shape_checks():
    """As outside of the tests, where nothing but the suite looks at shapes."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


class Bully(Circle):
    """The first of drones that touch pays nothing for it."""

    def rewards(self, state):
        exact, smooth = Circle.rewards(self, state)
        return exact.at[0].add(contact.penalty(state.flight.pos)[0]), smooth


class Loose(Circle):
    """A slack of a shape that no team has."""

    def target(self, state):
        return dataclasses.replace(Circle.target(self, state), slack=jnp.zeros((1, 1)))


class Spokesman(PointMass):
    """Drone 0 reports another thrust than it has."""

    def flight(self, state):
        flight = PointMass.flight(self, state)
        return dataclasses.replace(flight, thrust=flight.thrust.at[0].multiply(1.1))


class Lonely(PointMass):
    """A drone that flies alone loses its row."""

    def step(self, state, action):
        state = PointMass.step(self, state, action)
        return dataclasses.replace(state, pos=jnp.squeeze(state.pos))


class TwoFaced(PointMass):
    """Flies higher where it is compiled."""

    def step(self, state, action):
        lift = 0.1 * isinstance(state.pos, jax.core.Tracer)
        return PointMass.step(self, state, action + lift)


class Wild(broken.Honest):
    """Its policy commands more than there is."""

    def train(self, setup, key, init=None):
        return broken.Honest.train(
            self, setup, key, init or broken.linear(setup.task, squash=jnp.asarray)
        )


class Headstrong(broken.Honest):
    """Starts from nothing that it is given."""

    def train(self, setup, key, init=None):
        return broken.Honest.train(self, setup, key)


class Elsewhere(broken.Honest):
    """Trains in a high-fidelity simulator of its own, which nobody bills."""

    simulator: ClassVar[str] = "crazyflow"

    def train(self, setup, key, init=None):
        own = dataclasses.replace(setup, reality=PointMass())
        return broken.Honest.train(self, own, key, init)


class Foster(broken.Honest):
    """A cell of a parent that it does not have."""

    parent_cells: ClassVar[dict] = {"lf_baseline": ("circle", 3)}


def problem(kind, cls, sentence):
    """What the one check with `sentence` in its own says."""
    checks = [*declarations(kind, cls, {}), *behaviour(kind, cls, POINT_MASS, {}, {})]
    (chosen,) = (check for check in checks if sentence in check.sentence)
    return next(execute(cls, [chosen])).problem


@pytest.mark.parametrize("cls", [broken.Honest, broken.Homemade])
def test_a_whole_method_passes_whatever_the_architecture_of_its_policy(cls):
    found = list(findings("method", cls, POINT_MASS, {}))
    assert len(found) > 3
    assert [x for x in found if x.problem] == []


@pytest.mark.parametrize(
    ("kind", "cls", "sentence", "said"),
    [
        ("effect", broken.WrongDoor, "its door is one", "must be a subclass of CommandEffect"),
        ("effect", broken.NoVersion, "its `version`", 'a text that is not empty, such as "1"'),
        ("effect", broken.NoUnit, "says what it means", "parameter `f` has no unit"),
        ("effect", broken.SwappedBounds, "says what it means", "low < high, got 1.0 and 0.0"),
        ("effect", broken.Hidden, "is a parameter", "field `strength` is a number but no param"),
        ("effect", broken.NotNeutral, "nominal bit for bit", "differs from the nominal one"),
        ("effect", broken.Idle, "does something", "neither at its lower nor at its upper"),
        ("effect", broken.Explosive, "becomes NaN", "at their upper bounds a flight becomes"),
        ("effect", broken.Favourite, "renumbering", "depends on the numbers of the drones"),
        (
            "effect",
            broken.Forgetful,
            "structure of the state",
            "a step changes the memory that `init` made",
        ),
        ("effect", broken.Unfelt, "finite differences", "by `f` at 0.037 the derivative .* is 0,"),
        (
            "effect",
            broken.Crashing,
            "does something",
            "RuntimeError: the rope is torn .in `wrench`",
        ),
        ("task", broken.InTheAir, "start on the floor", "got z = 1 m"),
        ("task", broken.Crowded, "start on the floor", "start 0.[0-9]+ m apart, which is a crash"),
        ("task", broken.Deaf, "another key another", "same episode for another key"),
        ("task", broken.Backwards, "moving by the offset", "is still .* m from its target"),
        ("task", broken.Perverse, "better than the target", "more than 0 at the target"),
        ("task", broken.OneNumber, "targets fit the team", "`task_reward` must have shape"),
        ("task", broken.Leader, "renumbering", "depend on the numbers of the drones"),
        ("task", Bully, "renumbering", "that they touch depend on the numbers"),
        ("task", Loose, "targets fit the team", "`target...slack` must be one number or 2"),
        ("residual", broken.Unbounded, "within the bound", "the bound is 35"),
        ("residual", broken.Dice, "same fit", "take randomness from `key` alone"),
        ("residual", broken.Blind, "heavier rows", "use `transitions.weight`"),
        ("method", broken.Bookkeeper, "left to the meter", "sets `ledger.hf_fleet_seconds`"),
        ("method", broken.Heir, "left to the meter", "its parents here flew nothing"),
        ("method", Wild, "returns a Trained", "between -1 and 1, got [0-9.e+]+; beyond"),
        ("method", Headstrong, "start from a given policy", "as `init` changes nothing"),
        ("method", broken.Nameless, "stored and deployed", "policy.squash is .* found by name"),
        ("method", broken.Unfinished, "policy is finite", "the policy holds NaN"),
        ("method", broken.Loud, "names of their own", "a note cannot be called 'reward'"),
        ("method", broken.Loud, "its status", "must be one of ok, diverged, budget"),
        ("method", broken.Orphan, "parents", "Did you mean 'lf_baseline'?"),
        ("method", Foster, "parents", "must name parents, got lf_baseline"),
        ("method", broken.Lucky, "same key gives the same policy", "end with different policies"),
    ],
)
def test_a_broken_plugin_is_told_what_is_wrong(kind, cls, sentence, said):
    assert re.search(said, problem(kind, cls, sentence))


def test_flight_in_a_reality_of_its_own_is_seen():
    crazyflow = registry.load("simulator", "crazyflow")
    checks = behaviour("method", Elsewhere, {"crazyflow": crazyflow}, {}, {})
    (chosen,) = (check for check in checks if "left to the meter" in check.sentence)
    assert "flew nothing there that was counted" in next(execute(PointMass, [chosen])).problem


def test_a_simulator_is_registered_under_its_name(monkeypatch):
    class Copy(PointMass):
        """Another simulator that calls itself as its parent does."""

    load, names = registry.load, registry.names
    monkeypatch.setattr(registry, "load", lambda *x: Copy if x[1] == "copy" else load(*x))
    monkeypatch.setattr(registry, "names", lambda kind: [*names(kind), "copy"])
    assert "registered as copy" in problem("simulator", Copy, "name")


def test_a_plugin_that_ends_the_program_fails_its_check():
    def leave():
        raise SystemExit(0)

    (finding,) = execute(PointMass, [Check("it stays", leave)])
    assert finding.problem


@pytest.mark.parametrize(
    ("cls", "sentence", "said"),
    [
        (broken.Mirrored, "tilt accelerates", "positive pitch must fly to +x"),
        (broken.Mute, "door 'wrench'", "promises 'wrench'"),
        (Spokesman, "renumbering", "`flight().thrust` depends on the numbers of the drones"),
        (Lonely, "one row per drone", "a step `flight().pos` must have shape (1, 3) for N = 1"),
        (TwoFaced, "compiled or not", "compiled, a step gives other numbers than eager"),
        (broken.Drifting, "can be placed", "not at the position and velocity"),
        (broken.Stubborn, "can be turned", "have not the attitude"),
        (broken.Whirling, "made faster", "changes drones that were not chosen"),
        (broken.Lazy, "made faster", "about 21 % more thrust, got 1 to 1 %"),
        (broken.Weak, "set to a thrust", "after `with_thrust` the thrust must be"),
        (broken.Absent, "a repeated step", "does not end in `after`"),
    ],
)
def test_a_broken_simulator_is_told_what_is_wrong(cls, sentence, said):
    assert said in problem("simulator", cls, sentence)


def test_the_number_of_checks_and_the_exit_status_are_those_of_the_suite(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "300")
    assert main(["check", "broken_plugins:Push", "--simulator", "point_mass"]) == 0
    out = capsys.readouterr().out
    assert out.count("\nok ") == 15
    assert "15 checks executed, all passed." in out
    assert main(["check", "broken_plugins:SwappedBounds"]) == 1
    out = capsys.readouterr().out
    assert "8 checks executed, 1 failed." in out
    assert "WRONG every parameter says what it means" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["drga"], "Did you mean 'drag'?"),
        (["effect:drga"], "Did you mean 'drag'?"),
        (["no_such_module:Thing"], "cannot be imported: ModuleNotFoundError"),
        (
            ["bench.store.store:Store"],
            "is no plug-in: it must be a subclass of one of AbstractMethod",
        ),
        (
            ["drag", "--setting", "c=1"],
            "`--setting` is for methods, and 'drag' is of another kind: effect.",
        ),
        (["hybrid", "--setting", "flights"], "must be KEY=VALUE"),
        (["lf_baseline", "--setting", "nope=1"], "Method 'LFBaseline' has no key 'nope'"),
        (["drag", "--simulator", "crazyflo"], "Did you mean 'crazyflow'?"),
        (
            ["circle", "--simulator", "crazyflow"],
            "`--simulator` is for effects and methods, and 'circle' is of another kind: task.",
        ),
        (
            ["hybrid", "--simulator", "crazyflow", "--simulator", "point_mass"],
            "`--simulator` may be given once for a method",
        ),
    ],
)
def test_a_wrong_request_gets_one_line(arguments, message, capsys):
    assert main(["check", *arguments]) == 2
    err = capsys.readouterr().err
    assert err.count("\n") == 1
    assert message in err


def test_what_is_no_class_is_told_to_be_one(monkeypatch, capsys):
    monkeypatch.setattr("bench.conformance.command.find", lambda plugin: ("method", print))
    assert main(["check", "a:printer"]) == 1
    assert "it must be a class, got <built-in function print>" in capsys.readouterr().out


def test_settings_are_read_as_in_a_suite():
    texts = ["trainer.epochs=3", "trainer.lr=0.1", "residual=mlp", "quoted='a b'", "on=true"]
    assert nested(parse_settings(texts)) == {
        "trainer": {"epochs": 3, "lr": 0.1},
        "residual": "mlp",
        "quoted": "a b",
        "on": True,
    }


def test_plugins_are_found_by_name_kind_and_module():
    with pytest.raises(UsageError, match="'compare' is a command, for which there is nothing"):
        find("compare")
    assert find("drag")[0] == find("effect:drag")[0] == "effect"
    assert find("tasks.circle:Circle") == ("task", find("circle")[1])
