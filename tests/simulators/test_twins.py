"""The two simulators agree to first order around hover and differ as the paper says."""

import importlib.util
import pathlib

import jax.numpy as jnp
import numpy as np
import pytest
from flying import HOVER, SIMULATORS, SPEC, fly, hold, hovering, positions

EXAMPLE = pathlib.Path(__file__).parents[2] / "examples" / "twin_table.py"
N, STEPS = 3, 50


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location("twin_table", EXAMPLE)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def rows(example):
    return {row.symbol: row for row in example.table()}


def test_the_table_has_a_line_for_every_number(example, rows):
    text = example.markdown(list(rows.values()))
    assert text.startswith("| symbol | meaning | LF | HF |\n|---|---|---|---|\n")
    assert len(text.splitlines()) == 2 + len(rows)
    assert f"| `drag` | {rows['drag'].meaning} | 0.000 | 0.499 |" in text


@pytest.mark.parametrize(
    ("symbol", "value", "tolerance"),
    [
        ("weight", 0.4258, 1e-4),
        ("pitch_dead", 0.040, 0.005),
        ("pitch_63", 0.14, 0.015),
        ("pitch_end", 0.4996, 0.001),
        ("thrust_63", 0.06, 0.01),
        ("drag", 0.499, 0.002),
        ("lift_full", 0.22, 0.02),
        ("lift_slow", 0.88, 0.02),
    ],
)
def test_crazyflow_has_the_numbers_measured_on_its_airframe(rows, symbol, value, tolerance):
    """Measured independently by an earlier prototype, at 50 Hz: hence up to 20 ms apart.

    `thrust_63` is from hover; the airframe's rotors have 0.057 s up and 0.062 s down.
    """
    assert rows[symbol].hf == pytest.approx(value, abs=tolerance)


def test_the_point_mass_has_the_numbers_of_its_equations(rows):
    """At 2 ms resolution; take-off is uniform acceleration over 0.05 m."""
    tau = float(SIMULATORS["point_mass"]().attitude_tau)
    lift = {newtons: (0.1 / (newtons / SPEC.mass - 9.81)) ** 0.5 for newtons in (0.8, 0.44)}
    expected = {
        "weight": HOVER,
        "pitch_dead": -tau * np.log(0.95),
        "pitch_63": tau,
        "pitch_end": 0.5 * (1 - np.exp(-1.0 / tau)),
        "thrust_63": 0.0,
        "drag": 0.0,
        "lift_full": lift[0.8],
        "lift_slow": lift[0.44],
    }
    assert {s: row.lf for s, row in rows.items()} == pytest.approx(expected, abs=0.004)


def steady_acceleration(name, cmd):
    """Acceleration at the end of 1 s under a command, without the airframe's own drag."""
    simulator = SIMULATORS[name]()
    vel = np.asarray(
        fly(simulator, hovering(simulator, positions(N)), hold(cmd, STEPS, N)).vel[:, 0]
    )
    drag = np.asarray(SPEC.drag) / SPEC.mass if name == "crazyflow" else np.zeros(3)
    return (vel[-1] - vel[-3]) / 0.04 + drag * vel[-2]


@pytest.mark.parametrize("tilt", [0.02, 0.05])
@pytest.mark.parametrize("axis", [0, 1])
def test_small_tilts_accelerate_both_alike(axis, tilt):
    cmd = jnp.asarray([0.0, 0.0, 0.0, HOVER]).at[axis].set(tilt)
    lf, hf = (steady_acceleration(name, cmd) for name in ("point_mass", "crazyflow"))
    np.testing.assert_allclose(hf, lf, atol=0.01 * 9.81 * tilt)
    assert abs(lf[1 - axis]) == pytest.approx(9.81 * tilt, rel=0.01)


@pytest.mark.parametrize("excess", [-0.02, 0.02])
def test_small_changes_of_thrust_accelerate_both_alike(excess):
    cmd = [0.0, 0.0, 0.0, (1 + excess) * HOVER]
    lf, hf = (steady_acceleration(name, cmd) for name in ("point_mass", "crazyflow"))
    np.testing.assert_allclose(hf, lf, atol=0.01 * abs(lf[2]))
    assert lf[2] == pytest.approx(9.81 * excess, rel=1e-3)
