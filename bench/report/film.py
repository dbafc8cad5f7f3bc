r"""A rendered film of a flight, through MuJoCo, in a child process.

Which graphics library MuJoCo uses is settled when it is imported, and a broken driver can end a
process; so a child renders, with each library in turn. Only positions are stored, so attitudes are
drawn as the motion demands them (Mellinger and Kumar 2011, "Minimum snap trajectory generation and
control for quadrotors"): the thrust axis along a + g e_z, yaw zero, with

    a = second difference of the positions,     g = 9.81 m/s^2

Spheres have the collision radius.
"""

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from PIL import Image

from simulators.vehicle import COLLISION_RADIUS, GRAVITY

FORMATS = (".gif", ".png", ".webp")
"""Endings of animated pictures that can be written."""
FPS = 20
"""Pictures per second of flight."""
WIDTH, HEIGHT = 640, 480
"""Size of a picture [px]."""
BACKENDS = ("egl", "osmesa", "glfw")
"""Graphics libraries of MuJoCo, in the order in which they are tried."""
TIMEOUT = 600.0
"""Longest time that a child may take [s]."""
ARM = 0.046
"""From the centre of a Crazyflie to each motor [m], enlarged twice in the film."""
COLORS = (
    "0.84 0.37 0",
    "0 0.45 0.7",
    "0 0.62 0.45",
    "0.8 0.47 0.65",
    "0.34 0.71 0.91",
    "0.9 0.6 0",
)
"""Of the rotors, drone after drone, after Okabe and Ito (2008)."""
NOWHERE = -100.0
"""Height at which a drone without a position waits, below the floor [m]."""


class NoGraphicsError(RuntimeError):
    """No graphics library of this machine gives MuJoCo a context to draw in."""


def write_film(
    t: Float[np.ndarray, " time"], pos: Float[np.ndarray, "time drones 3"], path: Path
) -> None:
    """Writes a film of positions [m] at times [s], in the format that the ending of `path` says.

    Raises:
        NoGraphicsError: No graphics library works here; the message says what each one answered.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        flight = Path(folder) / "flight.npz"
        np.savez(flight, t=t, pos=pos)
        answers = {}
        for backend in _candidates():
            answers[backend] = _child(backend, str(flight), str(path.absolute()))
            if answers[backend] == "":
                return
    reasons = "; ".join(f"{name}: {answer}" for name, answer in answers.items())
    raise NoGraphicsError(
        f"No film: MuJoCo finds no graphics context on this machine ({reasons}). The interactive "
        "page needs none. On a headless machine install EGL (libegl1) or OSMesa (libosmesa6)."
    )


def graphics() -> dict[str, str]:
    """What each graphics library answers when MuJoCo asks it for a context; empty: it works."""
    return {backend: _child(backend) for backend in _candidates()}


def _candidates() -> tuple[str, ...]:
    """The library that the environment names, or all."""
    named = os.environ.get("MUJOCO_GL", "")
    return (named,) if named else BACKENDS


def _child(backend: str, *arguments: str) -> str:
    """Renders in a child process; its complaint in one line, empty if all went well."""
    command = [sys.executable, "-m", "bench.report.film", *arguments]
    variables = os.environ | {"MUJOCO_GL": backend}
    root = str(Path(__file__).parents[2])
    variables["PYTHONPATH"] = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, env=variables, timeout=TIMEOUT, check=False
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {TIMEOUT:.0f} s"
    if done.returncode == 0:
        return ""
    said = [line.strip() for line in done.stderr.splitlines() if line.startswith("film: ")]
    return said[-1].removeprefix("film: ") if said else f"ended with status {done.returncode}"


def frames(
    t: Float[np.ndarray, " time"], pos: Float[np.ndarray, "time drones 3"]
) -> list[UInt8[np.ndarray, "height width 3"]]:
    """Pictures of the flight, `FPS` a second, drawn in this process."""
    import mujoco

    mj: Any = mujoco  # type checkers do not know what its compiled part holds
    model = mj.MjModel.from_xml_string(_scene(pos.shape[1]))
    data = mj.MjData(model)
    camera = _camera(pos, mj.MjvCamera())
    times = np.arange(t[0], t[-1] + 1e-9, 1.0 / FPS)
    places, leans = _sampled(t, pos, times), _sampled(t, _thrust_axis(t, pos), times)
    found = []
    with mj.Renderer(model, HEIGHT, WIDTH) as renderer:
        for place, lean in zip(places, leans, strict=True):
            known = np.isfinite(place).all(axis=1, keepdims=True)
            place = np.where(known, place, [0.0, 0.0, NOWHERE])
            below = np.where(known, place * [1.0, 1.0, 0.0], [0.0, 0.0, NOWHERE])
            data.mocap_pos[:] = np.concatenate([place, below])
            data.mocap_quat[: len(place)] = _quat(np.where(known, lean, [0.0, 0.0, 1.0]))
            mj.mj_forward(model, data)
            renderer.update_scene(data, camera)
            found.append(renderer.render().copy())
    return found


def _sampled(
    t: Float[np.ndarray, " time"],
    values: Float[np.ndarray, "time drones 3"],
    times: Float[np.ndarray, " frames"],
) -> Float[np.ndarray, "frames drones 3"]:
    """`values` at other times, linear between."""
    flat = values.reshape(len(t), -1)
    columns = [np.interp(times, t, flat[:, i]) for i in range(flat.shape[1])]
    return np.stack(columns, axis=-1).reshape(len(times), *values.shape[1:])


def _thrust_axis(
    t: Float[np.ndarray, " time"], pos: Float[np.ndarray, "time drones 3"]
) -> Float[np.ndarray, "time drones 3"]:
    """Unit vectors along the thrust that the motion demands."""
    acc = np.zeros_like(pos)
    if len(t) > 2:
        acc = np.gradient(np.gradient(pos, t, axis=0), t, axis=0)
    axis = np.nan_to_num(acc) + np.array([0.0, 0.0, GRAVITY])
    return axis / np.linalg.norm(axis, axis=-1, keepdims=True).clip(1e-9)


def _quat(axis: Float[np.ndarray, "drones 3"]) -> Float[np.ndarray, "drones 4"]:
    """The smallest turns of e_z onto `axis`, scalar first as MuJoCo has it."""
    x, y, z = axis.T
    quat = np.stack([1.0 + z, -y, x, np.zeros_like(x)], axis=-1)
    return quat / np.linalg.norm(quat, axis=-1, keepdims=True).clip(1e-9)


def _camera(pos: Float[np.ndarray, "time drones 3"], camera: Any) -> Any:
    """A fixed camera that sees all but the farthest positions."""
    known = pos[np.isfinite(pos).all(axis=-1)]
    low, high = np.quantile(known, [0.01, 0.99], axis=0) if len(known) else np.zeros((2, 3))
    camera.lookat[:] = 0.5 * (low + high)
    camera.distance = 1.5 + 1.3 * float(np.linalg.norm(high - low))
    camera.azimuth, camera.elevation = 120.0, -30.0
    return camera


def _scene(n_drones: int) -> str:
    """The world of the film as MJCF: a floor and one mocap body a drone."""
    arm = 2.0 * ARM / 2**0.5
    places = [(x, y) for x in (-arm, arm) for y in (-arm, arm)]
    bodies = []
    for drone in range(n_drones):
        color = COLORS[drone % len(COLORS)]
        rotors = "".join(
            f'<geom type="cylinder" size=".045 .004" pos="{x:.4f} {y:.4f} .012" rgba="{color} 1"/>'
            for x, y in places
        )
        arms = "".join(
            f'<geom type="capsule" size=".008" fromto="{-x:.4f} {-y:.4f} 0 {x:.4f} {y:.4f} 0" '
            'rgba=".15 .15 .15 1"/>'
            for x, y in places[:2]
        )
        shell = f'<geom size="{COLLISION_RADIUS}" rgba="{color} .12"/>'
        bodies.append(f'<body mocap="true">{arms}{rotors}{shell}</body>')
    # Discs below the drones show the height; MuJoCo's own shadows flicker on so large a floor.
    disc = '<body mocap="true"><geom type="cylinder" size=".1 .002" rgba=".2 .2 .2 .5"/></body>'
    bodies += [disc] * n_drones
    return f"""
<mujoco>
<visual>
<global offwidth="{WIDTH}" offheight="{HEIGHT}"/>
<headlight ambient=".4 .4 .4" diffuse=".6 .6 .6"/>
</visual>
<asset>
<texture type="skybox" builtin="gradient" rgb1=".93 .96 1" rgb2=".7 .8 .9" width="64" height="64"/>
<texture name="grid" type="2d" builtin="checker" rgb1=".82 .85 .88" rgb2=".72 .76 .8" width="256"
 height="256"/>
<material name="grid" texture="grid" texuniform="true" texrepeat=".5 .5"/>
</asset>
<worldbody>
<light pos="0 0 8" dir="0 0 -1" directional="true" castshadow="false" diffuse=".4 .4 .4"/>
<geom type="plane" size="30 30 .1" material="grid"/>
{"".join(bodies)}
</worldbody>
</mujoco>"""


def _main(arguments: list[str]) -> int:
    """The child: renders a stored flight into a file, or one picture to see whether it can."""
    try:
        if not arguments:
            frames(np.zeros(1), np.zeros((1, 1, 3)))
            return 0
        with np.load(arguments[0], allow_pickle=False) as flight:
            first, *rest = (Image.fromarray(x) for x in frames(flight["t"], flight["pos"]))
        first.save(
            arguments[1], save_all=True, append_images=rest, duration=round(1000 / FPS), loop=0
        )
    except Exception as error:
        words = " ".join(str(error).split())[:200]
        sys.stderr.write(f"film: {type(error).__name__}{f' ({words})' if words else ''}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(_main(sys.argv[1:]))
