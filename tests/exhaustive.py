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
        "",
        "all neutral effects together",
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
        "diagnosis/test_bad_logs.py",
        "test_a_bad_table_gives_one_line",
        "csv-(?!(missing|time as a date|no rows)$)",
        "the same tables as Parquet, and three of them as CSV, one for each way to read it",
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
        "(residual-True|point_mass-False)$",
        "the same residual in finer steps, and a point mass without one in steps as long; layers "
        "that are computed again in crazyflow",
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
    Rule(
        "methods/test_grey_box.py",
        "test_an_effect_on_the_reality_is_found_as_well",
        "mass$",
        "the same with a wind",
    ),
    Rule(
        "methods/test_calibration.py",
        "test_what_the_nominal_simulator_knows_is_not_corrected",
        "(effects-measured|fine steps-filtered)$",
        "effects and the filtered attitude, fine steps and the measured one",
    ),
    Rule(
        "tasks/test_crash_accounting.py",
        "test_.*",
        "crazyflow$",
        "the same in the point mass; all the counting is in `tasks/`",
    ),
    Rule(
        "tasks/test_own_reward.py",
        "test_its_gradient_equals_finite_differences",
        "crazyflow$",
        "the same in the point mass; gradients through crazyflow of every task of ours",
    ),
    Rule(
        "tasks/test_slack.py",
        "test_(nobody|pay|slopes).*",
        ".*-18$",
        "the same of a team of two",
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
