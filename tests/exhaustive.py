"""Which tests are exhaustive: products of plug-ins, simulators and settings, one by one.

`make test` leaves them out, `make test-exhaustive` and `make test-all` run them. A rule stands here
only if `make test` still runs the same lines in another case of the same test.
"""

import dataclasses
import re
from collections.abc import Iterable

import pytest


@dataclasses.dataclass(frozen=True)
class Rule:
    """Some cases of parametrised tests."""

    file: str
    """Path below `tests/`."""
    test: str
    """Regular expression of the whole name of the test functions."""
    cases: str
    """Regular expression of what stands in brackets in its name, from the start."""
    reason: str
    """What `make test` runs instead."""


RULES: tuple[Rule, ...] = (
    Rule(
        "simulators/test_effects.py",
        "test_a_neutral_effect_is_nominal_bit_for_bit",
        "crazyflow-",
        "all neutral effects together in crazyflow, and each of the point mass's there",
    ),
    Rule(
        "simulators/test_effects.py",
        "test_an_effect_keeps_the_structure_and_types_of_the_state",
        "crazyflow-",
        "derivatives of all effects in crazyflow, whose loop refuses a state that changes",
    ),
    Rule(
        "simulators/test_effects.py",
        "test_sensitivities_at_the_neutral_values_equal_one_sided_differences",
        "crazyflow$",
        "derivatives inside the bounds in crazyflow, and these sensitivities in the point mass",
    ),
    Rule(
        "simulators/test_collision.py",
        "test_derivatives_through_an_impact_equal_finite_differences",
        "rotorpy$",
        "the same impact in crazyflow; gradients of RotorPy in tests/simulators/test_rotorpy.py",
    ),
    Rule(
        "simulators/test_rotorpy.py",
        "test_gradients_equal_finite_differences",
        "2$",
        "the same over 25 steps",
    ),
    Rule(
        "diagnosis/test_remedy_flown.py",
        "test_after_the_remedy_the_drift_is_as_said_and_the_next_diagnosis_finds_nothing",
        "(?!trim)",
        "the same with a trim, and a heavier vehicle in tests/docs/test_pilot.py",
    ),
    Rule(
        "diagnosis/test_attribution.py",
        "test_a_withheld_effect_is_named_with_its_size",
        "effect(2|3|5|6)-",
        "wind, mass, gust and delay: a force, a property of the plant, an onset and a command",
    ),
    Rule(
        "methods/test_adjoint.py",
        "test_it_is_the_gradient_of_an_episode",
        "residual-True$",
        "the same residual in finer steps, and a point mass without one in steps as long",
    ),
    Rule(
        "methods/test_adjoint.py",
        "test_it_is_so_in_double_precision_for_every_task",
        "(Figure8|PitchAndExpand)-",
        "circle and spread; gradients of every task in tests/tasks/test_task_gradients.py",
    ),
    Rule(
        "methods/test_methods.py",
        "test_.*",
        "(hybridsindy|hybridaffine|grey_boxaffine|upper_reference)$",
        "Hybrid with two other residuals; a grey box without a residual, and a residual that "
        "tests/methods/test_variants.py fits to its rows; a hot start, whose class the upper "
        "reference calls",
    ),
)


def mark(items: Iterable[pytest.Item]) -> None:
    """Marks the tests that a rule names.

    Raises:
        pytest.UsageError: A rule names a test that its file does not have.
    """
    for item in items:
        path = getattr(item, "path", None)
        for rule in RULES:
            if path is None or not path.as_posix().endswith(f"/tests/{rule.file}"):
                continue
            if not any(re.fullmatch(rule.test, name) for name in dir(item.module)):
                raise pytest.UsageError(
                    f"tests/exhaustive.py names {rule.test}, which tests/{rule.file} does not have."
                )
            case, name = getattr(item, "callspec", None), item.originalname
            if case and re.fullmatch(rule.test, name) and re.match(rule.cases, case.id):
                item.add_marker(pytest.mark.exhaustive)
