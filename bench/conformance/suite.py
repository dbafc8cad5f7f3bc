"""Checks of a plug-in, one after another; whatever goes wrong becomes a sentence for its author."""

import dataclasses
import inspect
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from bench.plan.keys import SettingsError
from bench.plan.settings import build, describe_fields


class Violation(Exception):  # noqa: N818 - it is what the author did, not what failed here
    """A part of the contract that a plug-in does not keep; the message is for its author."""


@dataclasses.dataclass(frozen=True)
class Check:
    """One thing that a plug-in must do."""

    sentence: str
    """What is checked, as a statement that should be true."""
    run: Callable[[], None]
    """Raises a `Violation`, or whatever the plug-in raises."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """How a check ended."""

    sentence: str
    """What was checked."""
    problem: str
    """What is wrong; empty if nothing is."""


def execute(cls: type, checks: Iterable[Check]) -> Iterator[Finding]:
    """Findings, check by check; warnings of the plug-in are not its failures."""
    for check in checks:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                check.run()
        except Violation as violation:
            yield Finding(check.sentence, str(violation))
        except (Exception, SystemExit) as error:
            yield Finding(check.sentence, _in_authors_terms(cls, error))
        else:
            yield Finding(check.sentence, "")


def demand(kept: object, violation: str) -> None:
    """Raises a `Violation` unless the first argument is true."""
    if not bool(kept):
        raise Violation(violation)


def shapes(tree: object) -> list[tuple[tuple[int, ...], str]]:
    """Shape and type of every array, for comparison and for messages."""
    return [(tuple(x.shape), str(x.dtype)) for x in jax.tree.leaves(tree) if hasattr(x, "shape")]


def equal(a: object, b: object) -> bool:
    """Whether two pytrees hold the same bits; NaN equals NaN."""
    pairs = zip(*(jax.tree.leaves(eqx.filter(t, eqx.is_array)) for t in (a, b)), strict=True)
    return all(np.array_equal(_plain(x), _plain(y), equal_nan=_inexact(x)) for x, y in pairs)


def close(a: object, b: object, rtol: float = 1e-4, atol: float = 2e-5) -> bool:
    """Whether two pytrees agree up to what programs of different shape round differently."""
    pairs = zip(*(jax.tree.leaves(eqx.filter(t, eqx.is_array)) for t in (a, b)), strict=True)
    return all(np.allclose(_plain(x), _plain(y), rtol, atol, equal_nan=True) for x, y in pairs)


def finite(tree: object) -> bool:
    """Whether no number of a pytree is NaN or infinite."""
    return all(np.isfinite(_plain(x)).all() for x in jax.tree.leaves(tree) if _inexact(x))


def declaration_checks(cls: type, contract: type, **given: object) -> list[Check]:
    """What holds for every kind: a concrete class, a version, a docstring, plain settings."""
    return [
        Check(
            f"it is a class that implements {contract.__name__}",
            lambda: _implements(cls, contract),
        ),
        Check("it declares its `version`", lambda: _has_version(cls)),
        Check("it says in a docstring what it is", lambda: _has_docstring(cls)),
        Check(
            "it can be made with default settings, and these can be written to a file",
            lambda: _has_plain_settings(cls, given),
        ),
    ]


def _implements(cls: type, contract: type) -> None:
    demand(inspect.isclass(cls), f"it must be a class, got {cls!r:.80}; register the class itself")
    demand(
        issubclass(cls, contract),
        f"`{cls.__name__}` must be a subclass of `{contract.__module__}.{contract.__name__}`",
    )
    missing = sorted(getattr(cls, "__abstractmethods__", ()))
    missing += sorted(getattr(cls, "__abstractclassvars__", ()))
    missing += sorted(getattr(cls, "__abstractvars__", ()))
    demand(
        not missing,
        f"`{cls.__name__}` does not define {', '.join(f'`{name}`' for name in missing)}, which "
        f"{contract.__name__} asks for",
    )


def _has_version(cls: type) -> None:
    version = getattr(cls, "version", None)
    demand(
        isinstance(version, str) and version,
        f'`version` must be a text that is not empty, such as "1", got {version!r}; stored '
        "results are reused while it stays the same",
    )


def _has_docstring(cls: type) -> None:
    own = (inspect.getmodule(cls).__doc__, cls.__doc__)
    demand(
        any(text and text.strip() and not text.startswith(f"{cls.__name__}(") for text in own),
        f"neither `{cls.__name__}` nor its module has a docstring; `bench list` shows the first "
        "line",
    )


def _has_plain_settings(cls: type, given: dict[str, object]) -> None:
    try:
        made = build(cls, {}, f"`{cls.__name__}`", **given)  # pyright: ignore[reportArgumentType]
    except SettingsError as error:
        raise Violation(
            f"it cannot be made with default settings ({error}); give every field a default"
        ) from error
    try:
        describe_fields(made, f"`{cls.__name__}`")
    except SettingsError as error:
        raise Violation(f"{error} Settings must be numbers, texts, lists or modules") from error


def _in_authors_terms(cls: type, error: BaseException) -> str:
    """What was raised, and the innermost line of the plug-in's own file that led there."""
    words = " ".join(str(error).split())[:300]
    said = f"it raised {type(error).__name__}" + (f": {words}" if words else "")
    try:
        own = inspect.getsourcefile(cls)
    except TypeError:
        own = None
    lines = [f for f in traceback.extract_tb(error.__traceback__) if own and f.filename == own]
    if not lines:
        return said
    last = lines[-1]
    return f"{said} (in `{last.name}`, {Path(last.filename).name} line {last.lineno})"


def _plain(x: Any) -> np.ndarray:
    if hasattr(x, "dtype") and jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
        return np.asarray(jax.random.key_data(x))
    return np.asarray(x)


def _inexact(x: object) -> bool:
    return bool(eqx.is_inexact_array(x)) or isinstance(x, float | np.floating)
