"""Numbers as a diagnosis writes them."""

import math

import numpy as np
import pytest

from bench.text.numbers import estimate, probability, quantity, rounded, significant
from bench.text.words import clean


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (rounded(0.00999, 2), "0.010"),
        (rounded(1234.5), "1234"),
        (rounded(math.nan), "-"),
        (rounded(np.float32(0.25), 2), "0.25"),
        (significant(np.int64(193)), "193"),
        (significant(0.50), "0.5"),
        (quantity(0.0341, "m", 2), "34 mm"),
        (quantity(1.26, "m", 2), "1.3 m"),
        (quantity(0.1, "rad"), "5.73°"),
        (estimate(12.03, 11.21, 12.74), ("12.0", "11.2 to 12.7")),
        (estimate(0.5, None, None), ("0.500", "")),
        (estimate(-0.0001, -0.5, 0.5), ("0.0", "-0.5 to 0.5")),
        (probability(0.9999), "> 0.99"),
        (probability(None), "-"),
        (clean("a\x1b[31m\nb\u202e"), "a [31m b"),
    ],
)
def test_numbers_read_well(text, expected):
    assert text == expected
