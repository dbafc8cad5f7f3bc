"""How long a diagnosis takes after compilation, how its cost grows, and what memory it takes."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np
import pytest
from flights_for_tests import SIGMA, flight_set, fly
from log_tables import folder, table

from diagnosis.decide.prepared import make_likelihood
from diagnosis.engine import diagnose
from diagnosis.logs.flights import load_flights
from diagnosis.replay.library import make_library
from diagnosis.replay.replay import make_replay
from simulators import registry
from simulators.contract import replayable_class, with_effects
from simulators.effects.drag import Drag

AIMS = {"point_mass": 20.0, "crazyflow": 60.0}
"""Longest time for a minute of flight on two cores [s]."""
LARGEST = 4096.0
"""Most memory for an hour of logs [MB]; a choice."""
LOADED = 10.0
"""Longest processor time in which they load [s]; a choice."""
HOUR = Path(__file__).parent / "programs" / "hour.py"


@pytest.fixture
def kept_programs(tmp_path):
    """Compiled programs are kept from one diagnosis to the next, as the command line does."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("JAX_COMPILATION_CACHE_DIR", str(tmp_path))
        jax.config.update("jax_compilation_cache_dir", str(tmp_path))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        yield
        jax.config.update("jax_compilation_cache_dir", None)


def dragged(name, seconds):
    """Flights of 10 s with more drag than the simulator has."""
    own = {"dt": replayable_class(name).replay_dt} if name == "point_mass" else {}
    simulator = with_effects(registry.load("simulator", name)(**own), [Drag(c=0.3)])
    return fly(simulator, n_flights=round(seconds / 10.0), seconds=10.0)


@pytest.mark.parametrize("name", ["point_mass", "crazyflow"])
def test_a_minute_of_flight_is_diagnosed(benchmark, kept_programs, name):
    flights = flight_set(dragged(name, 60.0))
    diagnose(flights, simulator=name)
    begun = time.process_time()
    found = benchmark.pedantic(lambda: diagnose(flights, simulator=name), rounds=2)
    cpu = 0.5 * (time.process_time() - begun)
    assert [effect.name for effect in found.effects] == ["drag"]
    benchmark.extra_info |= {"aim_s": AIMS[name], "met": benchmark.stats["min"] <= AIMS[name]}
    benchmark.extra_info["cpu_s"] = cpu


@pytest.mark.parametrize("name", ["point_mass", "crazyflow"])
def test_cost_is_linear_in_flight_seconds(benchmark, kept_programs, name):
    # The work of a diagnosis is replays; how many it takes depends on what it finds.
    replay = make_replay(
        make_library(registry.load("simulator", name)()), replayable_class(name).replay_dt
    )
    shift = np.eye(len(replay.library.slots))[0]
    cpu = {}
    for seconds in (60.0, 240.0):
        likelihood = make_likelihood(replay, dragged(name, seconds), SIGMA)
        likelihood.normal(replay.library.neutral)
        begun = time.process_time()
        for size in (0.01, 0.02, 0.03):
            likelihood.normal(replay.library.neutral + size * shift)
        cpu[seconds] = (time.process_time() - begun) / 3
    benchmark.pedantic(lambda: likelihood.normal(replay.library.neutral + 0.04 * shift), rounds=1)
    ratio = cpu[240.0] / cpu[60.0]
    benchmark.extra_info |= {"cpu_60_s": cpu[60.0], "cpu_240_s": cpu[240.0], "ratio": ratio}
    assert ratio < 5.0


def test_an_hour_of_logs_at_500_hz_loads(benchmark, tmp_path):
    path = folder(tmp_path, "long.parquet", table(rows=1_800_000, freq=500.0))
    begun = time.process_time()
    loaded = benchmark.pedantic(lambda: load_flights(path), rounds=1)
    benchmark.extra_info["cpu_s"] = time.process_time() - begun
    assert benchmark.extra_info["cpu_s"] < LOADED
    assert loaded.left_out == ()


def test_an_hour_of_logs_at_500_hz_fits_into_memory(benchmark, tmp_path):
    def measure():
        done = subprocess.run(
            [sys.executable, str(HOUR), str(tmp_path)],
            capture_output=True,
            text=True,
            check=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)},
        )
        return json.loads(done.stdout)

    found = benchmark.pedantic(measure, rounds=1)
    benchmark.extra_info |= found | {"aim_mb": LARGEST, "met": found["diagnosed_mb"] < LARGEST}
    assert found["effects"] == ["drag"]
    assert found["diagnosed_mb"] < LARGEST
