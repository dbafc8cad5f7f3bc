"""Traced programs, and what is made of reference flights, kept on disk beside XLA's own cache.

Tracing the whole library in forward mode takes longer than flying a minute of logs through it. A
program is kept under the hash of everything that goes into it: the source of every module that the
simulator and its effects come from, the versions of JAX and crazyflow, shapes and constants; a fit,
or flights as channels, under that and the logs. Programs are kept in the folder of JAX's own
programs, if it has one; the rest only where the variable `JAX_COMPILATION_CACHE_DIR` names that
folder, so that tests share programs and fit for themselves. What cannot be read is made anew.
"""

import dataclasses
import hashlib
import importlib
import importlib.metadata
import io
import os
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import jax
import numpy as np
from jax import export

from diagnosis.replay.library import Library


def cached(
    name: str, trace: Callable, library: Library, settings: str, args: tuple
) -> jax.stages.Wrapped:
    """`trace` compiled for `args`, from disk where it was traced before."""
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if not folder:
        return jax.jit(trace)
    key = _key(library, settings, args, "diagnosis.replay.replay", "diagnosis.replay.library")
    path = Path(folder) / f"{name}-{key}.stablehlo"
    try:
        return jax.jit(export.deserialize(bytearray(path.read_bytes())).call)
    except Exception:
        # Missing, cut off or of another version: the folder is a cache and may hold anything.
        exported = export.export(jax.jit(trace))(*args)
    _keep(path, bytes(exported.serialize()))
    return jax.jit(exported.call)


def remembered(
    name: str,
    make: Callable[[], dict[str, np.ndarray]],
    library: Library,
    settings: str,
    args: Sequence[np.ndarray],
) -> dict[str, np.ndarray]:
    """The arrays that `make` returns, from disk where they were made of the same arrays before."""
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if not folder:
        return make()
    digest = hashlib.sha256()
    for array in args:
        digest.update(np.ascontiguousarray(array).tobytes())
    settings += digest.hexdigest()
    path = Path(folder) / f"{name}-{_key(library, settings, tuple(args), 'diagnosis')}.npz"
    try:
        with path.open("rb") as raw, np.load(raw, allow_pickle=False) as file:
            return dict(file)
    except Exception:
        # As above.
        made = make()
    buffer = io.BytesIO()
    np.savez(buffer, **made)  # pyright: ignore[reportArgumentType]
    _keep(path, buffer.getvalue())
    return made


def _keep(path: Path, content: bytes) -> None:
    """Written beside and renamed; a folder that cannot be written to is no cache."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
            file.write(content)
        Path(file.name).replace(path)
    except OSError:
        return


def _key(library: Library, settings: str, args: tuple, *code: str) -> str:
    digest = hashlib.sha256()
    shapes = jax.tree.map(lambda x: (x.shape, str(x.dtype)), args)
    versions = [f"{p}={importlib.metadata.version(p)}" for p in ("jax", "crazyflow", "equinox")]
    for text in (settings, repr(shapes), repr(versions), jax.default_backend(), _shown(library)):
        digest.update(text.encode())
    for path in _files(library, *code):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:32]


def _shown(library: Library) -> str:
    """The library's constants as text; which effects may be blamed changes no program."""
    leaves, structure = jax.tree.flatten(
        dataclasses.replace(library, withheld=frozenset(), absent=frozenset())
    )
    return repr(([str(leaf) for leaf in leaves], structure, library.slots))


def _files(library: Library, *code: str) -> list[Path]:
    """Every module of the simulators, of the effects, and in or below `code`, sorted by name.

    Those that nobody imported are among them: a key must not depend on what else a process does.
    """
    packages = {kind.__module__.split(".")[0] for kind in library.effects.values()}
    packages |= {"simulators", type(library.simulator).__module__.split(".")[0], *code}
    files = []
    for module in map(importlib.import_module, sorted(packages)):
        folders, file = getattr(module, "__path__", ()), getattr(module, "__file__", None)
        files += [path for folder in folders for path in sorted(Path(folder).rglob("*.py"))]
        files += [Path(file)] if file and not folders else []
    return files
