"""Mutants of a module: its source with one operator, constant or condition changed.

Strings, annotations and decorators stay as they are: a change there says nothing of a test's
arithmetic. The mutations are those of DeMillo, Lipton and Sayward (1978), "Hints on test data
selection", that change arithmetic, comparisons, logic or a number.
"""

import ast
import dataclasses
import functools
from collections.abc import Callable, Iterator
from typing import Any

OTHER = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.And: ast.Or,
    ast.Or: ast.And,
}
"""What each operator becomes. `|` and `&` stay: of sets, tables and types the other is an error."""
UNTOUCHED = ("annotation", "returns", "decorator_list", "type_params")
"""Parts of a definition that are not mutated."""


@dataclasses.dataclass(frozen=True)
class Mutant:
    """A module with one change."""

    line: int
    """Where, from 1."""
    was: str
    """The expression before."""
    became: str
    """The expression in the mutant."""
    source: str
    """The whole mutated module."""


def mutants(source: str) -> list[Mutant]:
    """Every mutant of a module, in the order of the source."""
    found = []
    for number in range(sum(1 for _ in _sites(ast.parse(source)))):
        tree = ast.parse(source)
        node, change = list(_sites(tree))[number]
        was = ast.unparse(node)
        found.append(Mutant(node.lineno, was, ast.unparse(change()), ast.unparse(tree)))
    return found


def _sites(node: ast.AST) -> Iterator[tuple[ast.expr, Callable[[], ast.expr]]]:
    """Each expression that can be changed, and what changes it and returns the new one."""
    for name, value in ast.iter_fields(node):
        if name in UNTOUCHED:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _changes(child)
                yield from _sites(child)


def _changes(node: ast.AST) -> Iterator[tuple[ast.expr, Callable[[], ast.expr]]]:
    """The changes of one node, without those of its parts."""
    match node:
        case ast.Compare():
            for place, operator in enumerate(node.ops):
                if type(operator) in OTHER:
                    ops = [*node.ops]
                    ops[place] = OTHER[type(operator)]()
                    yield node, functools.partial(_with, node, ops=ops)
        case ast.BinOp() | ast.BoolOp() if type(node.op) in OTHER:
            yield node, functools.partial(_with, node, op=OTHER[type(node.op)]())
        case ast.Constant(value=bool() as value):
            yield node, functools.partial(_with, node, value=not value)
        case ast.Constant(value=int() | float() as value):
            yield node, functools.partial(_with, node, value=value + 1)
        case ast.IfExp() | ast.If() if not isinstance(node.test, ast.Compare | ast.BoolOp):
            yield node.test, functools.partial(_negated, node)


def _with(node: ast.expr, **fields: Any) -> ast.expr:
    for name, value in fields.items():
        setattr(node, name, value)
    return node


def _negated(node: ast.IfExp | ast.If) -> ast.expr:
    node.test = ast.UnaryOp(ast.Not(), node.test)
    return node.test
