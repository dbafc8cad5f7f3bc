"""What can be withheld: how large it is drawn, and which numbers of the generator it sets.

An effect's parameters carry the names and meanings of the effect library, so that labels and
answers can be compared; the physics behind them is the generator's own (`disturbances.py`). An
effect without any here, a third party's for instance, is drawn as its card says and flown by its
own class, in crazyflow alone.
"""

import dataclasses
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np

from blind.fly.disturbances import CommandDisturbance, PlantDisturbance, WrenchDisturbance
from blind.fly.realities import Disturbance
from simulators import registry
from simulators.effects.card import load_card, load_cards

SIZES = ("small", "medium", "large")
"""Sizes of an effect, in order."""

Parameters = dict[str, float]
Draw = Callable[[int, np.random.Generator, float], Parameters]
"""Numbers at a size (index into the sizes), in a flight of so many seconds."""


@dataclasses.dataclass(frozen=True)
class Withheld:
    """One effect of a case."""

    name: str
    """Registered name of an effect, or a name in `UNKNOWN`."""
    parameters: Parameters
    """Numbers by name, SI."""


def draw_effect(name: str, size: int, rng: np.random.Generator, seconds: float) -> Withheld:
    """The effect at a size (index into `SIZES`), its signs, directions and times at random."""
    own = {**LIBRARY, **UNKNOWN}
    if name in own:
        return Withheld(name, own[name](size, rng, seconds))
    return Withheld(name, {**load_card(name).drawn[size]})


def fixed(parameter: str, *values: float) -> Draw:
    """The value of the size."""
    return lambda size, rng, seconds: {parameter: values[size]}


def signed(parameter: str, *values: float) -> Draw:
    """The value of the size, its sign at random."""
    return lambda size, rng, seconds: {parameter: float(rng.choice([-1.0, 1.0])) * values[size]}


def directed(names: tuple[str, str], *values: float) -> Draw:
    """A vector as long as the value of the size, its direction at random."""

    def draw(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
        angle = rng.uniform(0.0, 2 * np.pi)
        return {
            names[0]: float(values[size] * np.cos(angle)),
            names[1]: float(values[size] * np.sin(angle)),
        }

    return draw


def _gust(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
    wind = directed(("x", "y"), 0.4, 0.8, 1.5)(size, rng, seconds)
    return {**wind, "z": 0.0, "onset": float(seconds * rng.uniform(0.25, 0.75))}


def _wind(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
    return {**directed(("x", "y"), 0.2, 0.5, 1.0)(size, rng, seconds), "z": 0.0}


def _downwash(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
    return {"strength": (1.0, 2.0, 4.0)[size], "width": float(rng.uniform(0.08, 0.12))}


def _motor_lag(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
    """Slower motors; of the small size, every second one is faster instead."""
    if size == 0 and rng.random() < 0.5:
        return {"scale": 0.6}
    return {"scale": (1.3, 1.7, 2.5)[size]}


def _rotor_drag(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
    """Along the axis one to three times as much as across it; RotorPy's Crazyflie has 2.3."""
    lateral = (0.15, 0.35, 0.75)[size]
    return {"axial": float(lateral * rng.uniform(1.0, 3.0)), "lateral": lateral}


LIBRARY: dict[str, Draw] = {
    "mass": signed("e", 0.05, 0.12, 0.25),
    "thrust_gain": fixed("e", -0.05, -0.1, -0.2),
    "inertia": fixed("e", 0.3, 0.6, 1.2),
    "motor_lag": _motor_lag,
    "center_of_mass": directed(("x", "y"), 1e-3, 2.5e-3, 5e-3),
    "battery": fixed("rate", 0.003, 0.006, 0.012),
    "drag": fixed("c", 0.15, 0.4, 1.0),
    "quadratic_drag": fixed("k", 0.1, 0.3, 0.9),
    "rotor_drag": _rotor_drag,
    "translational_lift": fixed("k", 0.05, 0.12, 0.25),
    "wind": _wind,
    "gust": _gust,
    "ground_effect": fixed("c", 4.0, 8.0, 16.0),
    "downwash": _downwash,
    "attitude_lag": fixed("tau", 0.015, 0.03, 0.06),
    "attitude_gain": fixed("g", -0.05, -0.1, -0.2),
    "trim": directed(("roll", "pitch"), 0.01, 0.02, 0.035),
    "yaw_misalignment": signed("angle", 0.05, 0.12, 0.25),
    "delay": fixed("seconds", 0.01, 0.02, 0.05),
}
"""Effects of the library that the generator has its own physics for."""

BORROWING = "crazyflow"
"""The reality that flies effects of the library by their own classes."""


def known(reality: str) -> tuple[str, ...]:
    """Registered effects that cases of a reality are drawn from."""
    borrowed = [name for name, card in load_cards().items() if card.drawn and name not in LIBRARY]
    return (*LIBRARY, *borrowed) if reality == BORROWING else (*LIBRARY,)


def alike(a: str, b: str) -> bool:
    """Whether short flights can hardly tell two effects apart; pairs are of others."""
    return bool({*load_card(a).families} & {*load_card(b).families})


def _between(**ranges: tuple[float, float]) -> Draw:
    """Each number uniform in its range, the sizes being thirds of the first one's."""

    def draw(size: int, rng: np.random.Generator, seconds: float) -> Parameters:
        values = {}
        for i, (name, (low, high)) in enumerate(ranges.items()):
            share = rng.random() if i else (size + rng.random()) / 3.0
            values[name] = float(low + share * (high - low))
        return values

    return draw


UNKNOWN: dict[str, Draw] = {
    "slung_load": _between(mass=(0.003, 0.005), cable=(0.3, 0.65)),
    "periodic_wind": _between(size=(0.5, 1.5), freq=(0.5, 2.0), angle=(0.0, 2 * np.pi)),
    "turbulence": _between(size=(0.4, 1.2), time=(0.2, 0.6)),
    "thrust_play": _between(newton=(0.015, 0.04)),
    "wall_suction": _between(size=(0.8, 2.0), distance=(1.4, 1.7), angle=(0.0, 2 * np.pi)),
    "tether": _between(k=(0.3, 0.9), x=(-1.0, 1.0), y=(-1.0, 1.0), z=(0.0, 1.5)),
}
"""Effects that the library does not know; guesses of what a laboratory meets."""

LIFTED = {"slung_load": 0.8, "turbulence": 0.1, "downwash": 0.18}
"""How much higher low flights are [m], so that neither drone nor load touches the floor."""


def make_disturbance(
    effects: tuple[Withheld, ...], n_flights: int, rng: np.random.Generator
) -> Disturbance:
    """The generator's parameters, with a leading axis of flights; neutral without effects.

    Phases of periodic wind and turbulence differ from flight to flight.
    """
    fields = {k: jnp.asarray(v, float) for e in effects for k, v in _fields(e).items()}
    borrowed = tuple(
        registry.load("effect", effect.name)(**effect.parameters)
        for effect in effects
        if _is_borrowed(effect.name)
    )
    phases = rng.uniform(0.0, 2 * np.pi, n_flights)
    seeds = rng.integers(0, 2**31 - 1, n_flights)
    made = tuple(
        dataclasses.replace(kind(), **{k: fields[k] for k in vars(kind()) if k in fields})
        for kind in (CommandDisturbance, PlantDisturbance, WrenchDisturbance)
    )
    command, plant, wrench, *borrowed = jax.tree.map(
        lambda x: _spread(x, n_flights), (*made, *borrowed)
    )
    wrench = dataclasses.replace(
        wrench, swing_phase=jnp.asarray(phases, jnp.float32), seed=jnp.asarray(seeds, jnp.int32)
    )
    return Disturbance(command, plant, wrench, tuple(borrowed))


def _is_borrowed(name: str) -> bool:
    return name not in LIBRARY and name not in UNKNOWN


def _spread(value: float | int | jax.Array, n_flights: int) -> jax.Array:
    array = jnp.asarray(value, jnp.float32)
    return jnp.broadcast_to(array, (n_flights, *array.shape))


def _fields(effect: Withheld) -> Mapping:
    """Fields of the command, plant and wrench class that an effect sets."""
    if _is_borrowed(effect.name):
        return {}
    p = effect.parameters
    horizontal = [np.cos(p.get("angle", 0.0)), np.sin(p.get("angle", 0.0)), 0.0]
    return _SET[effect.name](p, np.asarray(horizontal))


_SET: dict[str, Callable[[Parameters, np.ndarray], Mapping]] = {
    "attitude_lag": lambda p, way: {"lag": p["tau"]},
    "attitude_gain": lambda p, way: {"tilt_gain": p["g"]},
    "trim": lambda p, way: {"trim": [p["roll"], p["pitch"]]},
    "yaw_misalignment": lambda p, way: {"yaw_offset": p["angle"]},
    "delay": lambda p, way: {"delay": p["seconds"]},
    "thrust_play": lambda p, way: {"play": p["newton"]},
    "mass": lambda p, way: {"excess_mass": p["e"]},
    "thrust_gain": lambda p, way: {"excess_thrust": p["e"]},
    "inertia": lambda p, way: {"excess_inertia": p["e"]},
    "motor_lag": lambda p, way: {"motor_slowness": p["scale"]},
    "battery": lambda p, way: {"discharge": p["rate"]},
    "center_of_mass": lambda p, way: {"offset": [p["x"], p["y"]]},
    "drag": lambda p, way: {"drag": p["c"]},
    "quadratic_drag": lambda p, way: {"quadratic_drag": p["k"]},
    "rotor_drag": lambda p, way: {"axial_drag": p["axial"], "lateral_drag": p["lateral"]},
    "wind": lambda p, way: {"wind": [p["x"], p["y"], p["z"]]},
    "gust": lambda p, way: {"gust": [p["x"], p["y"], p["z"]], "gust_onset": p["onset"]},
    "ground_effect": lambda p, way: {"ground_effect": p["c"]},
    "downwash": lambda p, way: {"downwash": p["strength"], "downwash_width": p["width"]},
    "slung_load": lambda p, way: {"load": p["mass"], "cable": p["cable"]},
    "translational_lift": lambda p, way: {"lift": p["k"]},
    "periodic_wind": lambda p, way: {"swing": p["size"] * way, "swing_freq": p["freq"]},
    "turbulence": lambda p, way: {"turbulence": p["size"], "turbulence_time": p["time"]},
    "wall_suction": lambda p, way: {
        "suction": p["size"],
        "wall_normal": way,
        "wall_distance": p["distance"],
    },
    "tether": lambda p, way: {"spring": p["k"], "anchor": [p["x"], p["y"], p["z"]]},
}
