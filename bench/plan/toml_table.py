"""Makes dataclasses of the tables in a suite file; each error names the table and the key."""

import dataclasses
import functools
from typing import TypeVar

import pydantic
from pydantic_core import ErrorDetails

from bench.plan.keys import unknown_key
from bench.text.errors import UsageError

T = TypeVar("T")
KINDS = {
    "bool_type": "true or false",
    "dataclass_type": "a table",
    "dict_type": "a table",
    "int_type": "a whole number",
    "string_type": "text",
    "tuple_type": "a list",
}
"""What pydantic expected, by its name of the error, in words."""
_reader = functools.cache(pydantic.TypeAdapter)
"""What pydantic makes of the annotations of a dataclass."""


class SuiteError(UsageError):
    """A suite that cannot be run as it is written; the message is one line."""


def read_table(cls: type[T], table: object, where: str) -> T:
    """The `cls`, a dataclass, whose fields a table gives; `where` is what messages begin with.

    Raises:
        SuiteError: A key is unknown or missing, or its value is of another kind.
        ValueError: `cls` itself refuses the values; it is raised as it is.
    """
    try:
        return _reader(cls).validate_python(table)
    except pydantic.ValidationError as error:
        # A misspelt key is missing, too; the spelling says more.
        wrong = min(error.errors(), key=lambda e: e["type"] == "missing")
        raise _refused(cls, wrong, where) from error


def _refused(cls: type, wrong: ErrorDetails, where: str) -> Exception:
    """One error of pydantic as a person reads it."""
    kind, key = wrong["type"], str(*wrong["loc"][:1])
    if kind == "value_error":
        return wrong.get("ctx", {})["error"]
    if kind == "missing":
        return SuiteError(f"{where} lacks the key '{key}'.")
    if kind == "unexpected_keyword_argument":
        return SuiteError(unknown_key(where, key, [f.name for f in dataclasses.fields(cls)]))
    what = f"{where}: `{key}`" if key else where
    return SuiteError(f"{what} must be {KINDS[kind]}, got {wrong['input']!r}.")
