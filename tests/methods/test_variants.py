"""Settings of the suites `budget` and `ablations`: fewer flights, other rows, cut-off trainings."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from cells import FLIGHTS, METHODS, TINY, Hold, fresh, same, setup, small
from jaxtyping import TypeCheckError

from methods import hybrid
from methods.calibration import identification
from methods.calibration.identification import PATHS, flown_paths
from methods.calibration.remainder import calibrate_as_grey_box, remaining_transitions
from methods.hf_scratch import HFScratch
from methods.running.metered import train_metered
from methods.training.bptt import BPTT
from methods.training.context import Context
from simulators.crazyflow import Crazyflow
from simulators.point_mass import PointMass

KEY = jax.random.key(0)
HOLD = Hold(n_drones=2)
WHOLE = BPTT(epochs=10, n_worlds=1, smoothing=2)


def train(trainer):
    return trainer.train(HOLD, PointMass(), fresh(HOLD), KEY, Context(), "test")


def test_a_share_of_a_training_is_the_beginning_of_the_whole():
    whole, part = train(WHOLE), train(dataclasses.replace(WHOLE, share=0.3))
    assert (whole.epochs, part.epochs) == (10, 3)
    np.testing.assert_array_equal(part.curves["reward"], whole.curves["reward"][:3])
    assert not part.out_of_budget
    assert same(train(dataclasses.replace(WHOLE, share=0.01)).policy, fresh(HOLD)) is False
    with pytest.raises(ValueError, match="`share` must lie in"):
        BPTT(share=0.0)


def test_a_cut_off_training_is_billed_for_what_it_has_flown():
    cell = setup(HOLD, PointMass(), fresh(HOLD))
    trainer = dataclasses.replace(WHOLE, share=0.5)
    cut = METHODS["hf_scratch"](trainer=trainer, epochs_base=8, epochs_per_drone=0.0)
    trained = train_metered(cut, cell, KEY)
    assert trained.ledger.epochs == 4
    assert trained.ledger.hf_fleet_seconds == pytest.approx(4 * HOLD.horizon * 0.02 * 2)
    assert trained.status == "ok"


def test_one_flight_moves_along_all_axes_and_many_begin_anew():
    assert flown_paths(1) == ["turns"]
    assert tuple(flown_paths(3)) == PATHS == tuple(identification.paths())
    assert flown_paths(5) == [*PATHS, "rise", "steps"]
    reach = np.ptp(np.asarray(identification.paths()["turns"].pos), axis=0)
    assert (reach > 1.0).all()


def test_flights_of_one_path_differ_by_their_dither():
    flights = identification.fly(PointMass(), PointMass(), KEY, 4)
    assert flights.contact.shape[0] == 4
    assert not np.allclose(flights.action[0], flights.action[3])
    still = identification.fly(PointMass(), PointMass(), KEY, 4, 0.0)
    np.testing.assert_allclose(still.action[0], still.action[3])


@pytest.fixture(scope="module")
def calibration():
    return calibrate_as_grey_box(PointMass(), Crazyflow(), KEY, 3, 0.2)


def test_hybrid_gets_the_very_rows_of_a_grey_box(calibration):
    flights = identification.fly(PointMass(), Crazyflow(), KEY)
    rows = jax.tree.map(lambda *x: jnp.concatenate(x), *remaining_transitions(PointMass(), flights))
    assert same(calibration.transitions, rows)
    assert calibration.flights == 3
    assert 1300 < len(rows.target) <= 1500


def test_hybrid_on_a_grey_boxs_flights_is_billed_for_them(calibration, monkeypatch):
    asked = []

    def calibrate(nominal, reality, key, n_flights, excitation):
        asked.append((n_flights, excitation))
        identification.fly(nominal, reality, key, n_flights, excitation)
        return calibration

    monkeypatch.setattr(hybrid, "calibrate_as_grey_box", calibrate)
    monkeypatch.setattr(hybrid, "calibrate", None)
    cell = setup(HOLD, Crazyflow(), fresh(HOLD))
    hybrid_of_few_rows = METHODS["hybrid"](trainer=TINY, flown="grey_box", rows=10)
    trained = train_metered(hybrid_of_few_rows, cell, KEY)
    assert asked == [(3, 0.2)]
    assert trained.ledger.hf_fleet_seconds == pytest.approx(30.0)
    assert trained.ledger.calibration_flights == 3


def test_rows_bound_each_members_fit():
    cell = setup(HOLD, PointMass(), fresh(HOLD))
    plain, few = (small("hybrid", rows=n).train(cell, KEY) for n in (None, 10))
    most = FLIGHTS * HOLD.horizon  # of all there are
    assert same(plain.residual, small("hybrid", rows=most).train(cell, KEY).residual)
    assert not same(plain.residual, few.residual)


@pytest.mark.parametrize(
    ("method", "settings", "match"),
    [
        ("hybrid", {"rows": 0}, "`rows` must be at least 1"),
        ("hybrid", {"flown": "grey_box", "hover_weight": 9.0}, "must have their defaults"),
        ("domain_randomization", {"dt": 0.05}, "`dt` must divide the control step"),
        ("hybrid", {"flights": 0}, "`flights` must be at least 1 or None, got 0"),
        ("recalibrated", {"flights": -1}, "`flights` must be at least 0, got -1"),
        ("hybrid", {"rows": 9, "residual": "affine"}, "and the residual 'mlp'"),
        ("grey_box", {"flights": 0}, "`flights` must be at least 1"),
        ("grey_box", {"flights": 1, "residual": "mlp"}, "`flights` must be at least 2"),
        ("grey_box", {"excitation": -0.1}, "`excitation` must be at least 0"),
    ],
)
def test_what_cannot_be_flown_is_refused(method, settings, match):
    with pytest.raises(ValueError, match=match):
        METHODS[method](**settings)


def test_the_budget_of_scratch_goes_through_the_papers_epochs():
    assert [HFScratch().budget(n) for n in (0, 12, 18)] == [400, 1400, 1899]
    limited = HFScratch(trainer=dataclasses.replace(HFScratch().trainer, epochs=1000))
    assert limited.budget(18) == 1000


def test_an_unknown_reading_of_the_attitude_is_refused():
    """By the class, or before that by the type checks that run in tests."""
    with pytest.raises((ValueError, TypeCheckError), match=r"filtered.*measured"):
        METHODS["hybrid"](attitude="guessed")
