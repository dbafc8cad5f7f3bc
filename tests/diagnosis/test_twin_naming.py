"""What speaks for an effect beside a twin, and which of those that look alike is named."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from test_twin import EVERY, LIBRARY, column, flight

from diagnosis.twin.diagnose_change import answer_change
from diagnosis.twin.evidence import WIDTHS, Evidence
from diagnosis.twin.twin import make_twin
from diagnosis.twin.units import Estimate


def test_evidence_is_that_of_a_gaussian_change_of_some_width():
    """With many degrees of freedom; source of the closed form: Bishop (2006), Sec. 3.5.1."""
    rng, k = np.random.default_rng(2), 5
    delta, M, dof = 2.0 * rng.normal(size=k), 3.0 * rng.normal(size=(k, 3)), 1e7
    weighed = Evidence(delta, M, dof, float(delta @ delta), np.eye(3, k), np.zeros(3))
    each = [
        stats.multivariate_normal.logpdf(delta, cov=np.eye(k) + s**2 * M[:, :2] @ M[:, :2].T)
        for s in WIDTHS
    ]
    nothing = stats.multivariate_normal.logpdf(delta, cov=np.eye(k))
    expected = np.logaddexp.reduce(each) - np.log(len(WIDTHS)) - nothing
    assert weighed.log_evidence([0, 1]) == pytest.approx(expected, abs=1e-4)
    # Where the difference is taken at a change, a part of it, the evidence is the same.
    part = np.asarray([0.02, -0.01, 0.0])
    there = dataclasses.replace(weighed, delta=delta - M @ part, at=part)
    assert there.log_evidence([0, 1]) == pytest.approx(expected, abs=1e-4)
    # What is not among the parameters does not change: its part of the change is taken back.
    assert there.log_evidence([1]) == pytest.approx(weighed.log_evidence([1]), abs=1e-9)
    assert there.log_evidence([]) == pytest.approx(0.0, abs=1e-9)


def test_a_settling_step_is_the_mean_of_a_gaussian_posterior():
    """Source of the closed form: Bishop (2006), Eqs. 3.50 and 3.51."""
    rng = np.random.default_rng(3)
    root, value, width = rng.normal(size=(3, 3)), rng.normal(size=3), 0.3
    cov = root @ root.T
    precision = np.linalg.inv(cov)
    mean = np.linalg.solve(precision + np.eye(3) / width**2, precision @ value)
    np.testing.assert_allclose(Estimate(value, cov, 10.0).shrunk(width), mean)


def test_of_effects_that_look_alike_one_of_a_possible_size_is_named_first():
    at, like = column("attitude_gain", "g"), column("thrust_gain", "e")
    size, impossible = 0.05, 1.4 * LIBRARY.slots[like].high

    def alike(one):
        """The flight with an effect that must be impossibly large to do what the other does.

        It fits better: the other also does a little that does not show.
        """
        slopes = one.slopes.copy()
        slopes[like] = slopes[at] * size / impossible
        slopes[at] += 0.15 * slopes[column("drag", "c")]
        return dataclasses.replace(one, slopes=slopes)

    twin = make_twin([alike(flight(i)) for i in range(5)], LIBRARY, EVERY)
    found, _ = answer_change(twin, [alike(flight(100 + i, [(at, size)])) for i in range(5)])
    assert [c.effect for c in found.candidates[:2]] == ["thrust_gain", "attitude_gain"]
    assert not found.candidates[0].possible
    assert found.aliases == {"attitude_gain": ("thrust_gain",)}
