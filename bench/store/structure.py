"""The structure of a policy as text, so that one of a method's own architecture can be stored.

A run's arrays are stored in the order of its policy's pytree. For the shared policy that is enough.
For any other, the text says of which classes the pytree is made, what their fields hold, and where
the arrays stand: JSON, in which classes and functions are named as `module:name`. Nothing is
pickled, no code is stored: whoever loads the policy needs the package that it came from.
"""

import json
import pkgutil
from collections.abc import Iterator, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

PLAIN = (bool, int, float, str, type(None))
"""Values that JSON keeps as they are."""


def describe(tree: Any) -> str:
    """The structure of `tree` as text.

    Raises:
        TypeError: It holds something that cannot be found again by name, e.g. a lambda.
    """
    text = json.dumps(_described(tree, "policy"))
    leaves = [np.asarray(x) for x in jax.tree.leaves(eqx.filter(tree, eqx.is_array))]
    try:
        again = rebuild(text, leaves)
    except ValueError as error:
        raise TypeError(f"The policy could not be loaded again: {error}.") from error
    if jax.tree.structure(again) != jax.tree.structure(tree):
        raise TypeError("The policy could not be loaded again: its structure would be different.")
    return text


def rebuild(text: str, arrays: Sequence[np.ndarray]) -> Any:
    """The tree that `describe` described, with `arrays` in the order of its leaves.

    Raises:
        ValueError: The text is not that of a structure, or does not fit the arrays.
        ImportError: The package of a class or function is not installed.
    """
    left = iter(arrays)
    try:
        tree = _rebuilt(json.loads(text), left)
    except (KeyError, TypeError, AttributeError, StopIteration) as error:
        raise ValueError(f"its structure cannot be rebuilt ({error})") from error
    if len(list(left)) > 0:
        raise ValueError("it holds more arrays than its structure names")
    return tree


def _described(value: Any, where: str) -> dict[str, Any]:
    if eqx.is_array(value):
        return {"array": str(value.dtype), "shape": list(value.shape)}
    if isinstance(value, PLAIN):
        return {"value": value}
    if isinstance(value, list | tuple) and type(value) in (list, tuple):
        items = [_described(x, f"{where}[{i}]") for i, x in enumerate(value)]
        return {type(value).__name__: items}
    if isinstance(value, eqx.Module):
        fields = {
            name: _described(getattr(value, name), f"{where}.{name}")
            for name in type(value).__dataclass_fields__
            if hasattr(value, name)
        }
        return {"class": _name(type(value), where), "fields": fields}
    if callable(value):
        return {"function": _name(value, where)}
    raise TypeError(
        f"{where} is a {type(value).__name__}, which cannot be stored. A policy is made of "
        "equinox modules, arrays, lists, tuples, numbers, text, and functions that have a name."
    )


def _name(thing: Any, where: str) -> str:
    """`module:name` of a class or function, from which it can be found again."""
    for module in (getattr(thing, "__module__", None), "jax.numpy", "jax.nn"):
        name = getattr(thing, "__qualname__", None) or getattr(thing, "__name__", "")
        text = f"{module}:{name}"
        try:
            if pkgutil.resolve_name(text) is thing:
                return text
        except (ImportError, AttributeError, ValueError):
            continue
    raise TypeError(
        f"{where} is {thing!r:.60}, which cannot be found by name, so that the policy could not be "
        "loaded again. Define it at the top of a module."
    )


def _rebuilt(node: dict[str, Any], arrays: Iterator[np.ndarray]) -> Any:
    if "array" in node:
        stored = next(arrays)
        if list(stored.shape) != node["shape"]:
            raise ValueError(f"an array has the shape {list(stored.shape)}, not {node['shape']}")
        return jnp.asarray(stored, node["array"])
    if "value" in node:
        return node["value"]
    for kind in (list, tuple):
        if kind.__name__ in node:
            return kind(_rebuilt(x, arrays) for x in node[kind.__name__])
    if "function" in node:
        return pkgutil.resolve_name(node["function"])
    cls = pkgutil.resolve_name(node["class"])
    if not (isinstance(cls, type) and issubclass(cls, eqx.Module)):
        raise ValueError(f"{node['class']} is no equinox module")
    made = object.__new__(cls)
    for name, value in node["fields"].items():
        object.__setattr__(made, name, _rebuilt(value, arrays))
    return made
