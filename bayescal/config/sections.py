"""What every config is made of: checked sections, and numbers that are no slips.

Keys carry their units; lengths are in mm, noise in µm, angles in degrees.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Annotated, Any

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    FiniteFloat,
    GetJsonSchemaHandler,
    ValidationInfo,
    field_validator,
)
from pydantic_core import CoreSchema

from bayescal.files.plain_text import is_plain
from bayescal.limits import (
    BOUNDS,
    LARGEST,
    LARGEST_FACTOR,
    LARGEST_SEED,
    LONGEST,
    LONGEST_NAME,
    LONGEST_TEXT,
    NOISE_BOUNDS,
)


def check_once[T: list[Any]](values: T) -> T:
    """Return a list; ValueError where something stands in it twice."""
    for value in values:
        if values.count(value) > 1:
            raise ValueError(f"found {value!r} twice, expected it once")
    return values


type Number = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST)]
type Positive = Annotated[FiniteFloat, Field(gt=0, ge=1 / LARGEST, le=LARGEST)]
type Length = Annotated[FiniteFloat, Field(gt=0, ge=1 / LARGEST, le=LONGEST)]
type Factor = Annotated[FiniteFloat, Field(ge=1 / LARGEST_FACTOR, le=LARGEST_FACTOR)]
type NotNegative = Annotated[FiniteFloat, Field(ge=0, le=LARGEST)]
type PerLeg = Number | list[Number]
type PositivePerLeg = Positive | list[Positive]
type Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
type Names = Annotated[list[str], AfterValidator(check_once)]
type Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=LONGEST_NAME)]


@dataclass(frozen=True)
class FileMark:
    """Marks a field that names an input file, whose content then belongs to the experiment's identity."""

    but: tuple[str, ...] = ()  # values that name no file


InputFile = Annotated[str, FileMark()]


class Section(BaseModel):
    """A table of a config: unknown keys and wrong types are errors; docstrings of its fields describe the keys.

    Examples
    --------
    >>> class RodConfig(bc.Section):
    ...     length_mm: float
    ...     '''Between the centres of its joints.'''
    >>> RodConfig(length_mm=120.0)
    RodConfig(length_mm=120.0)
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        """Return the JSON Schema with the fields' descriptions."""
        found = handler(schema)
        properties = handler.resolve_ref_schema(found).get("properties", {})
        for name, text in describe_fields(cls).items():
            key = cls.model_fields[name].alias or name
            properties.get(key, {}).setdefault("description", text)
        return found

    @field_validator("*")
    @classmethod
    def _check_text(cls, value: object) -> object:
        """Refuse texts of any length, and what would command a terminal or turn what is read around.

        Lines and tabs are all that a text may have besides letters.
        """
        if isinstance(value, str) and not is_plain(value, but="\n\t"):
            raise ValueError(f"found control characters in {value!r}, expected plain text")
        for text in _list_texts(value):
            if len(text) > LONGEST_TEXT:
                raise ValueError(f"found {len(text)} letters, expected at most {LONGEST_TEXT}")
        return value

    @field_validator("*")
    @classmethod
    def _check_size(cls, value: object, info: ValidationInfo) -> object:
        """Refuse numbers that nobody means in the unit that their key ends with."""
        key = info.field_name or ""
        unit = key.rpartition("_")[2]
        smallest, largest = (NOISE_BOUNDS if "noise" in key else BOUNDS).get(unit, (0.0, LARGEST))
        for number in _list_numbers(value):
            if abs(number) > largest or 0.0 < abs(number) < smallest:
                size = f"between {smallest:g} and {largest:g}" if smallest else f"at most {largest:g}"
                raise ValueError(f"found {number:g}, expected {size} in size")
        return value


def describe_fields(section: type[Section]) -> dict[str, str]:
    """Return what fields of a section are described by: a description of their own, or the docstring below them.

    Docstrings are read from the source when they are asked for, here: pydantic's `use_attribute_docstrings` reads them
    whenever a section is imported, which takes a tenth of a second from every command.
    """
    found: dict[str, str] = {}
    for one in reversed(section.__mro__):
        found |= _read_docstrings(one.__module__).get(one.__qualname__, {}) if issubclass(one, Section) else {}
    stated = {name: info.description for name, info in section.model_fields.items() if info.description is not None}
    return {name: text for name, text in (found | stated).items() if name in section.model_fields}


@cache
def _read_docstrings(module: str) -> dict[str, dict[str, str]]:
    """Return the docstrings below fields of a module's classes, by class and field; without a source there are none."""
    try:
        tree = ast.parse(inspect.getsource(sys.modules[module]))
    except (OSError, TypeError):
        return {}
    found: dict[str, dict[str, str]] = {}
    waiting: list[tuple[ast.AST, str]] = [(tree, "")]
    while waiting:
        node, before = waiting.pop()
        if isinstance(node, ast.ClassDef):
            found[before + node.name] = {}
            for field, below in pairwise(node.body):
                match field, below:
                    case ast.AnnAssign(target=ast.Name(name)), ast.Expr(ast.Constant(str(text))):
                        found[before + node.name][name] = inspect.cleandoc(text)
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            before += f"{node.name}." if isinstance(node, ast.ClassDef) else f"{node.name}.<locals>."
        waiting += [(one, before) for one in ast.iter_child_nodes(node) if isinstance(one, ast.stmt)]
    return found


def _list_texts(value: object) -> Iterator[str]:
    """Yield the texts of a field, those of its lists and the keys of its tables too."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list | Mapping):
        for one in value:
            yield from _list_texts(one)


def _list_numbers(value: object) -> Iterator[float]:
    """Yield the numbers of a field, those of its lists and tables too; sections look at their own."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)
    elif isinstance(value, list | Mapping):
        for one in value.values() if isinstance(value, Mapping) else value:
            yield from _list_numbers(one)


class ExperimentConfig(Section):
    """What the config of every experiment has."""

    kind: str
    """Kind of the experiment; `bayescal list kinds` shows all."""
    name: Name
    """Name of the results directory, and of the experiment in tables; letters, digits, `_` and `-`."""
    title: str
    """Headline of the page."""
    seed: Annotated[int, Field(ge=0, le=LARGEST_SEED)]
    """Seed of all random numbers: the same seed gives the same results."""
    page_sections: list[str] = Field(default=[], exclude_if=lambda value: not value)
    """Custom sections that the page has besides, each `file.py:Class`."""
