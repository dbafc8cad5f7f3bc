"""When an answer about forces, judged under the measured attitude, is believed."""

import types

import pytest

from diagnosis.diagnose import Study
from diagnosis.verdict import Structure


@pytest.mark.parametrize(
    ("found", "kind", "share", "convinces"),
    [
        (50.0, "effect", 0.05, True),
        (50.0, "effect", 0.2, False),
        (50.0, "unexplained", 0.05, False),
        (1.13, "effect", 0.0, False),
    ],
)
def test_forces_convince_only_with_a_gap_and_a_clear_cause(found, kind, share, convinces):
    """A gap of mere noise, of which nothing is left to explain, has no cause."""
    verdict = types.SimpleNamespace(
        found=Structure(found, 700, 8), kind=kind, unexplained_share=share
    )
    study = object.__new__(Study)  # without flights: the answer alone is asked
    study.__dict__.update(base=None, verdict=verdict)
    assert study.convinces() is convinces
