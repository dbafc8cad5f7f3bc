"""What code a plug-in runs: hashes of its own module and of every module that it imports.

Only modules of the benchmark's packages below `bench` and of the plug-in's own package count; what
is installed beside them has a version. Comments, docstrings and layout do not change a hash, nor
does the version of Python.
"""

import ast
import functools
import hashlib
import importlib.util
import sys
from collections.abc import Iterable
from pathlib import Path

PACKAGES = ("methods", "tasks", "simulators", "diagnosis")
"""Packages of the benchmark whose code decides a result."""


@functools.cache
def own_source(cls: type) -> str:
    """Hash of the module of a class, empty if it has no source."""
    return _hash(_text(cls.__module__))


def shared_sources(classes: Iterable[type]) -> dict[str, str]:
    """Hashes of what the modules of `classes` import, directly or not, by name of the module."""
    own = {cls.__module__ for cls in classes}
    packages = frozenset({*PACKAGES, *(name.split(".")[0] for name in own)} - {"builtins"})
    found, left = set(own), list(own)
    while left:
        new = _imports(left.pop(), packages) - found
        found |= new
        left += new
    return {name: _hash(_text(name)) for name in sorted(found - own)}


@functools.cache
def _text(module: str) -> str:
    """Source of a module, empty if there is none."""
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError):
        return ""  # part of no file, or a name that is no module's
    path = Path(spec.origin if spec and spec.origin else "")
    return path.read_text(encoding="utf-8") if path.suffix == ".py" and path.is_file() else ""


@functools.cache
def _hash(text: str) -> str:
    if not text:
        return ""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [line for line in body if not _is_text(line)]  # pyright: ignore[reportAttributeAccessIssue]
    return hashlib.sha256(_dump(tree).encode()).hexdigest()[:16]


def _dump(tree: ast.AST) -> str:
    """Text of a tree, as Python 3.11 writes it.

    Later versions know parameters of types, and leave out what is empty.
    """
    full = {"show_empty": True} if sys.version_info >= (3, 13) else {}
    return ast.dump(tree, **full).replace(", type_params=[]", "")


def _is_text(line: ast.AST) -> bool:
    """Whether a line is a text alone, as a docstring is."""
    return (
        isinstance(line, ast.Expr)
        and isinstance(line.value, ast.Constant)
        and isinstance(line.value.value, str)
    )


def _base(module: str, node: ast.ImportFrom) -> str:
    """The module after `from`, in full; empty where dots lead out of the package."""
    spec = importlib.util.find_spec(module) if node.level else None
    try:
        name = "." * node.level + (node.module or "")
        return importlib.util.resolve_name(name, spec.parent if spec else None)
    except ImportError:
        return ""


@functools.cache
def _imports(module: str, packages: frozenset[str]) -> frozenset[str]:
    """Modules of `packages` that a module imports, wherever the statement stands."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(_text(module))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and (base := _base(module, node)):
            names |= {base, *(f"{base}.{alias.name}" for alias in node.names)}
    own = {name for name in names if name.split(".")[0] in packages}
    return frozenset(name for name in own if _text(name))
