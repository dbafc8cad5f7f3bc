"""Which of the sets that calibration flights cannot tell apart a policy is trained in."""

import numpy as np
import pytest

from diagnosis.fit import Fit
from diagnosis.likelihood import Likelihood, Normal
from methods import identification


def chosen(monkeypatch, *sets):
    """The choice among (evidence, chi-square), which a search finds in the order of evidence."""
    evidence = {chi2: evidence for evidence, chi2 in sets}
    fits = [_fit(chi2) for _, chi2 in sorted(sets, reverse=True)]

    class Problem:
        def __init__(self, likelihood):
            self.phi = 1.0

        def search(self, largest):
            return fits

        def log_evidence(self, fit):
            return evidence[fit.objective]

    monkeypatch.setattr(identification, "Problem", Problem)
    monkeypatch.setattr(identification, "dispersion", lambda normal, n: 1.0)
    found = identification.choose(object.__new__(Likelihood), 3, 3).objective
    return evidence[found], found


def _fit(chi2):
    one, none = np.zeros(1), np.zeros((1, 1))
    normal = Normal(
        one,
        none[None],
        none,
        np.asarray([chi2]),
        one,
        np.zeros(1, int),
        one,
        np.zeros((1, 9)),
        np.zeros(1, bool),
    )
    return Fit(frozenset(), one, normal, one, one, 0.0)


@pytest.mark.parametrize(
    ("sets", "expected"),
    [
        ([(50.0, 900.0), (49.0, 880.0)], (49.0, 880.0)),  # as likely, and the better fit
        ([(50.0, 900.0), (47.9, 800.0)], (50.0, 900.0)),  # a better fit that is less likely
        ([(50.0, 900.0), (49.0, 910.0)], (50.0, 900.0)),
    ],
)
def test_of_equally_likely_sets_the_better_fit_is_taken(monkeypatch, sets, expected):
    assert chosen(monkeypatch, *sets) == expected
