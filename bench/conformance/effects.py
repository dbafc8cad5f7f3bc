"""What an effect must keep to: parameters that mean something, exactly nominal when neutral."""

import functools
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bench.conformance import flights
from bench.conformance.suite import (
    Check,
    declaration_checks,
    demand,
    equal,
    finite,
)
from simulators.contract import AbstractSimulator, with_effects
from simulators.effects import contract
from simulators.effects.contract import DOORS, AbstractEffect, Parameter

BASES = {
    "command": contract.CommandEffect,
    "autopilot": contract.AutopilotEffect,
    "plant": contract.PlantEffect,
    "response": contract.ResponseEffect,
    "wrench": contract.WrenchEffect,
    "state": contract.StateEffect,
}
"""What an effect that acts through a door is a subclass of."""
PLACE = 0.37
"""Where between its bounds a parameter stands while derivatives are compared."""


def declarations(cls: type[Any]) -> list[Check]:
    """Checks of what the class says of itself; the others need them."""
    return [
        *declaration_checks(cls, AbstractEffect),
        Check("its door is one that simulators have", lambda: _door(cls)),
        Check("every parameter says what it means", lambda: _parameters(cls)),
        Check("every number among its fields is a parameter", lambda: _fields(cls)),
        Check("its default is neutral", lambda: _neutral_default(cls)),
    ]


def behaviour(cls: type[Any], simulators: Mapping[str, type[Any]]) -> list[Check]:
    """Checks in every simulator that has its doors."""
    found = []
    able = {
        name: simulator()
        for name, simulator in simulators.items()
        if {cls.door, *cls.needs} <= set(simulator.doors)
    }
    if not able:
        return [Check("some simulator has its doors", lambda: _no_simulator(cls, simulators))]
    for name, nominal in able.items():
        checks = {
            "a step and a restore keep the structure of the state": _structure,
            "a neutral effect is nominal bit for bit": _neutral,
            "it does something": _acts,
            "no flight within its bounds becomes NaN": _stays_finite,
            "many worlds at once equal one by one": _worlds,
            "renumbering the drones renumbers the flight": _renumbering,
        }
        if name == next(iter(able)):
            checks["derivatives by its parameters equal finite differences"] = _derivatives
        found += [
            Check(f"in {name}, {sentence}", functools.partial(check, cls, nominal))
            for sentence, check in checks.items()
        ]
    return found


def _door(cls: type[Any]) -> None:
    demand(cls.door in BASES, f"`door` must be one of {', '.join(BASES)}, got {cls.door!r:.40}")
    base = BASES[cls.door]
    demand(
        issubclass(cls, base),
        f"an effect with the door '{cls.door}' must be a subclass of {base.__name__}; a simulator "
        "would never call it",
    )
    demand(
        isinstance(cls.needs, tuple) and set(cls.needs) <= set(DOORS),
        f"`needs` must be a tuple of doors among {', '.join(DOORS)}, got {cls.needs!r:.60}",
    )
    demand(isinstance(cls.order, int), f"`order` must be a whole number, got {cls.order!r:.40}")


def _parameters(cls: type[Any]) -> None:
    for name, parameter in cls.parameters.items():
        demand(
            isinstance(parameter, Parameter),
            f"`parameters['{name}']` must be a Parameter, got {parameter!r:.60}",
        )
        for field in ("unit", "source"):
            text = getattr(parameter, field)
            demand(
                isinstance(text, str) and text.strip(),
                f"parameter `{name}` has no {field}" + ', say "-"' * (field == "unit"),
            )
        low, high = parameter.low, parameter.high
        demand(
            np.isfinite([low, high]).all() and low < high,
            f"parameter `{name}` must have finite bounds with low < high, got {low} and {high}",
        )
        demand(not np.isnan(parameter.neutral), f"parameter `{name}` has NaN as its neutral value")


def _fields(cls: type[Any]) -> None:
    made = cls()
    for name in cls.parameters:
        demand(hasattr(made, name), f"parameter `{name}` is no field of `{cls.__name__}`")
        demand(
            eqx.is_inexact_array(getattr(made, name)),
            f"field `{name}` must be a floating-point array, so that a fit can differentiate by "
            f"it, got {getattr(made, name)!r:.40}; declare it with "
            "eqx.field(converter=jnp.asarray, default=...)",
        )
    numbers = {name for name, value in vars(made).items() if eqx.is_inexact_array(value)}
    numbers |= {name for name, value in vars(made).items() if isinstance(value, float)}
    demand(
        numbers <= set(cls.parameters),
        f"field {', '.join(f'`{n}`' for n in sorted(numbers - set(cls.parameters)))} is a number "
        "but no parameter; list it in `parameters`, or make it a constant of the module",
    )


def _neutral_default(cls: type[Any]) -> None:
    made = cls()
    for name, parameter in cls.parameters.items():
        value, neutral = float(getattr(made, name)), float(np.float32(parameter.neutral))
        demand(
            value == neutral,
            f"the default of `{name}` must be its neutral value {parameter.neutral}, got {value:g}",
        )


def _no_simulator(cls: type[Any], simulators: Mapping[str, type[Any]]) -> None:
    doors = ", ".join(f"{n} ({', '.join(s.doors)})" for n, s in simulators.items())
    demand(False, f"it needs {', '.join((cls.door, *cls.needs))}; looked at: {doors}")


def _at(cls: type[Any], share: float | None) -> AbstractEffect:
    """The effect with all parameters at a share of the way between their bounds; None: neutral."""
    values = {
        name: p.neutral if share is None else p.low + share * (p.high - p.low)
        for name, p in cls.parameters.items()
    }
    return cls(**{name: jnp.asarray(value, float) for name, value in values.items()})


def _flight(cls: type[Any], nominal: AbstractSimulator, share: float | None) -> object:
    simulator = with_effects(nominal, [_at(cls, share)])
    return flights.fly(simulator, flights.crowded(), flights.wild_cmds(nominal))


def _nominal_flight(nominal: AbstractSimulator) -> object:
    return flights.fly(nominal, flights.crowded(), flights.wild_cmds(nominal))


def _structure(cls: type[Any], nominal: AbstractSimulator) -> None:
    simulator = with_effects(nominal, [_at(cls, PLACE)])
    flights.demand_structure(simulator, "the memory that `init` made")


def _neutral(cls: type[Any], nominal: AbstractSimulator) -> None:
    demand(
        equal(_flight(cls, nominal, None), _nominal_flight(nominal)),
        "with all parameters at their neutral values the flight differs from the nominal one; "
        "write the effect so that the neutral value changes no bit (add 0, multiply by 1)",
    )


def _acts(cls: type[Any], nominal: AbstractSimulator) -> None:
    plain = _nominal_flight(nominal)
    demand(
        any(not equal(_flight(cls, nominal, share), plain) for share in (0.0, PLACE, 1.0)),
        "neither at its lower nor at its upper bounds does it change a flight of half a second, "
        "low, fast and close together",
    )


def _stays_finite(cls: type[Any], nominal: AbstractSimulator) -> None:
    for share, words in ((0.0, "lower"), (1.0, "upper")):
        demand(
            finite(_flight(cls, nominal, share)),
            f"with all parameters at their {words} bounds a flight becomes NaN or infinite",
        )


def _worlds(cls: type[Any], nominal: AbstractSimulator) -> None:
    flights.demand_worlds(with_effects(nominal, [_at(cls, PLACE)]))


def _renumbering(cls: type[Any], nominal: AbstractSimulator) -> None:
    simulator = with_effects(nominal, [_at(cls, PLACE)])
    flights.demand_renumbering(simulator, flights.crowded(), ("pos", "vel"))


def _derivatives(cls: type[Any], nominal: AbstractSimulator) -> None:
    if not cls.parameters:
        return
    with jax.enable_x64(True):
        wide = jax.tree.map(
            lambda x: jnp.asarray(x, jnp.float64) if eqx.is_inexact_array(x) else x, nominal
        )
        names = list(cls.parameters)
        spread = np.array([p.high - p.low for p in cls.parameters.values()])
        place = np.array([p.low for p in cls.parameters.values()]) + PLACE * spread
        pos = jnp.asarray(flights.crowded(), jnp.float64)
        cmds = jnp.asarray(flights.wild_cmds(nominal), jnp.float64)

        def final(values: jax.Array) -> jax.Array:
            effect = cls(**dict(zip(names, values, strict=True)))
            return flights.flown(with_effects(wide, [effect]), pos, cmds).pos[-1]

        @jax.jit
        def both(values: jax.Array, tangent: jax.Array) -> tuple[jax.Array, jax.Array]:
            return jax.jvp(final, (values,), (tangent,))

        for i, name in enumerate(names):
            unit, h = np.eye(len(names))[i], 1e-5 * spread[i]
            exact = np.asarray(both(jnp.asarray(place), jnp.asarray(unit))[1])
            plus, minus = (
                np.asarray(both(jnp.asarray(place + s * h * unit), jnp.asarray(unit))[0])
                for s in (1.0, -1.0)
            )
            numeric = (plus - minus) / (2.0 * h)
            size = max(np.abs(numeric).max(), 1e-6 / spread[i])
            demand(
                np.isfinite(exact).all() and np.abs(exact - numeric).max() <= 1e-3 * size,
                f"by `{name}` at {place[i]:g} the derivative of the final position is "
                f"{np.abs(exact).max():.4g}, finite differences give {np.abs(numeric).max():.4g}; "
                "a fit would go astray",
            )
