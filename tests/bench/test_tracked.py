"""Runs that train nothing: a PD controller flies the paths of another run's policy."""

import pytest

from bench.execution.worker import train_and_evaluate
from bench.plan.expansion import expand
from bench.plan.suite import Row, Suite
from bench.store.store import Store
from methods.contract import Ledger
from methods.training.context import Context


def test_a_tracked_run_flies_its_parents_paths_by_pd_control(plugins, tmp_path):
    """From a fresh policy, which climbs in the nominal simulator and drifts in the other."""
    row = Row("instant", tracked=True, task_settings={"horizon": 60})
    parent, child = expand(Suite("test", "", ("spread",), (2,), 1, (row,))).runs
    store = Store(tmp_path)
    flown = train_and_evaluate(parent, store, Context())
    store.commit(parent, flown)
    tracked = train_and_evaluate(child, store, Context())
    assert tracked.metrics["reward"] != pytest.approx(flown.metrics["reward"], rel=1e-3)
    assert tracked.metrics["lf_reward"] == pytest.approx(flown.metrics["lf_reward"], rel=0.05)
    assert tracked.trained.ledger == Ledger()
    assert flown.trained.ledger != Ledger()
