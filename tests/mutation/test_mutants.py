"""Mutants differ from their module in one place each, and only where a test could notice."""

import pytest

from tests.mutation.mutants import mutants


@pytest.mark.parametrize(
    ("source", "changes"),
    [
        ("a = b + c", [("b + c", "b - c")]),
        ("a = b < c <= d", [("b < c <= d", "b <= c <= d"), ("b < c <= d", "b < c < d")]),
        ("a = b and c", [("b and c", "b or c")]),
        ("a = True", [("True", "False")]),
        ("a = 2", [("2", "3")]),
        ("a = b if c else d", [("c", "not c")]),
        ("if c:\n    pass", [("c", "not c")]),
        ("if c > 1:\n    pass", [("c > 1", "c >= 1"), ("1", "2")]),
        ("def f(a: x[1] = 2) -> y[3]:\n    'no 4'", [("2", "3")]),
        ("@d(1)\nclass A:\n    a: int | None = 'b'", []),
    ],
)
def test_each_mutant_has_one_change(source, changes):
    assert [(mutant.was, mutant.became) for mutant in mutants(source)] == changes


def test_a_mutant_is_the_whole_module_with_its_change_on_its_line():
    one, two = mutants("a = 1\nb = a * a\n")
    assert (one.line, one.source) == (1, "a = 2\nb = a * a")
    assert (two.line, two.source) == (2, "a = 1\nb = a / a")
