"""What a file beside a config defines, sent to processes that cannot import it: whole, and not by its name.

Functions and classes are sent so by cloudpickle. Three things it leaves by name or out of order: an alias of a type,
what a dataclass's fields are where their annotations are texts, and what pydantic has built of a schema, whose parts
lead back to the class that is being sent.
"""

from __future__ import annotations

import contextlib
import copyreg
from collections.abc import Callable
from dataclasses import is_dataclass
from types import ModuleType
from typing import Any, TypeAliasType, cast, get_type_hints

import cloudpickle
from pydantic_core import SchemaSerializer, SchemaValidator


def send_by_value(module: ModuleType) -> None:
    """Let worker processes, which cannot import a file's module by name, be sent its functions and classes whole."""
    cloudpickle.register_pickle_by_value(module)  # between a run and its own workers, never to or from a file
    copyreg.pickle(TypeAliasType, lambda alias: (TypeAliasType, (alias.__name__, alias.__value__)))
    for found in vars(module).values():
        if isinstance(found, type) and is_dataclass(found) and found.__module__ == module.__name__:
            with contextlib.suppress(NameError):  # of what only a type checker imports
                found.__annotations__ = {
                    name: hint
                    for name, hint in get_type_hints(found, include_extras=True).items()
                    if name in found.__annotations__
                }
    for one in (SchemaSerializer, SchemaValidator):
        copyreg.pickle(one, cast("Any", _reduce_built))


class _BuiltLater:
    """What pydantic builds of a schema, built when it is first asked for: by then the schema has come whole."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if "built" not in self.__dict__:
            build, given = self.__dict__["recipe"]
            self.__dict__["built"] = build(*given)
        return getattr(self.__dict__["built"], name)


def _reduce_built(built: Any) -> tuple[Callable[..., object], tuple[()], dict[str, Any]]:
    return _BuiltLater, (), {"recipe": built.__reduce__()[:2]}
