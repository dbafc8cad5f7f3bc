"""What `make golden` calls a difference."""

import math

import pytest

from tests.golden.compare import RELATIVE, differences


@pytest.mark.parametrize(
    ("kept", "found"),
    [
        ({"a": [1.0, "x", None, True]}, {"a": [1.0 + 0.5 * RELATIVE, "x", None, True]}),
        (0.0, 1e-12),
        (math.nan, math.nan),
        (2, 2.0),
    ],
)
def test_rounding_is_no_difference(kept, found):
    assert differences(kept, found) == []


@pytest.mark.parametrize(
    ("kept", "found", "line"),
    [
        ({"a": {"b": 1.0}}, {"a": {"b": 1.0 + 3.0 * RELATIVE}}, "/a/b: 1.0 is 1.0003 now"),
        ({"a": 1}, {}, "/a: missing"),
        ({}, {"a": 1}, "/a: new"),
        ({"a": [1, 2]}, {"a": [1]}, "/a: 2 entries are 1 now"),
        ({"a": "wind"}, {"a": "gust"}, "/a: 'wind' is 'gust' now"),
        ({"a": True}, {"a": 1}, "/a: True is 1 now"),
        ({"a": 1.0}, {"a": math.nan}, "/a: 1.0 is nan now"),
        ({"a": None}, {"a": 0.0}, "/a: None is 0.0 now"),
    ],
)
def test_a_difference_is_named_with_its_place(kept, found, line):
    assert differences(kept, found) == [line]
