"""Tables of a flight, good and changed, in folders for `load_flights`."""

import numpy as np
import pandas as pd
from hypothesis import HealthCheck, settings

from diagnosis.logs.columns import GROUPS
from diagnosis.logs.flights import load_flights
from simulators.vehicle import GRAVITY

MASS = 0.032
"""Mass in vehicle.toml [kg]."""


def examples(n):
    """Settings of a test that makes a folder for each of `n` examples."""
    shared = [HealthCheck.function_scoped_fixture]
    return settings(max_examples=n, deadline=None, suppress_health_check=shared)


def table(rows=400, freq=100.0, amplitude=0.5, yaw=0.0):
    """A flight around a circle at 1 m, as the format's columns, with every group there is."""
    t = np.arange(rows) / freq
    w = 2.0
    pos = np.stack([amplitude * np.cos(w * t), amplitude * np.sin(w * t), 1.0 + 0 * t], axis=1)
    vel = np.stack([-w * pos[:, 1], w * pos[:, 0], 0 * t], axis=1)
    pitch = 0.1 * np.sin(w * t)
    half = 0.5 * (yaw + 0 * t)
    quat = np.stack(
        [
            -np.sin(0.5 * pitch) * np.sin(half),
            np.sin(0.5 * pitch) * np.cos(half),
            np.cos(0.5 * pitch) * np.sin(half),
            np.cos(0.5 * pitch) * np.cos(half),
        ],
        axis=1,
    )
    zero = 0 * t
    ang_vel = np.stack([zero, 0.1 * w * np.cos(w * t), zero], axis=1)
    acc = np.stack([zero, zero, zero + GRAVITY], axis=1)
    cmd = np.stack([zero, pitch, zero + yaw, zero + MASS * GRAVITY], axis=1)
    columns = {"t": t}
    fields = {"pos": pos, "vel": vel, "quat": quat, "ang_vel": ang_vel, "acc": acc, "cmd": cmd}
    fields |= {"rotor_vel": np.full((rows, 4), 1800.0), "pwm": np.full((rows, 4), 0.6)}
    for field, values in fields.items():
        columns |= dict(zip(GROUPS[field], values.T, strict=True))
    return pd.DataFrame(columns | {"battery": zero + 3.7, "interpolated": zero})


def folder(path, name="bad.parquet", frame=None, **more):
    """A flight set with a good flight beside `frame`."""
    (path / "flights").mkdir(parents=True, exist_ok=True)
    (path / "vehicle.toml").write_text('name = "x"\ndrone = "cf2x_L250"\nmass = 0.032\n')
    good = table(amplitude=0.49)
    for file, rows in ({"good.parquet": good, name: frame} | more).items():
        if rows is not None:
            save(rows, path / "flights" / file)
    return path


def save(frame, file):
    if file.suffix == ".csv":
        frame.to_csv(file, index=False)
    else:
        frame.to_parquet(file, index=False)


def why_left_out(path, frame=None, name="bad.parquet"):
    """Why the bad file is left out, while the good one beside it is used."""
    loaded = load_flights(folder(path, name, frame))
    assert [flight.name for flight in loaded.flights] == ["good"]
    (left,) = loaded.left_out
    assert left.name == name
    assert left.reason.startswith(f"flights/{name}: ")
    assert "\n" not in left.reason
    return left.reason


def changed(**columns):
    """The good table with columns changed: a function of the column, or row -> value."""
    frame = table()
    for name, change in columns.items():
        if callable(change):
            frame[name] = change(frame[name])
        else:
            frame[name] = frame[name].astype(object if _texts(change) else float)
            for row, value in change.items():
                frame.loc[row - 1, name] = value
            if _texts(change):
                frame[name] = frame[name].astype(str)
    return frame


def _texts(change):
    return any(isinstance(value, str) for value in change.values())


def scaled(group, factor):
    frame = table()
    frame[list(GROUPS[group])] *= factor
    return frame


def put(path, name, content):
    (folder(path) / "flights" / name).write_bytes(content)
    return path
