"""Fields of a config that name a class, which brings options of its own.

A class stands in a config by its name, or as a table of its name and its options,
``model = { class = "own_model.py:OwnModel", depth_mm = 3.0 }``; where a section is nothing but the choice of a class,
such as an instrument's, its options are the section's other keys. The class's own ``Config`` checks the options.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, get_args, get_origin

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, model_validator
from pydantic_core import CoreSchema, InitErrorDetails, PydanticCustomError, core_schema

from bayescal.config.load import FOLDER, check_section, describe_unknown_key
from bayescal.config.registry import find_class, is_own, list_names, list_sources, load_class
from bayescal.config.sections import FileMark, Section
from bayescal.errors import BayescalError, InputError
from bayescal.files.table_files import list_beside

CLASS = "class"
UNFIT = re.compile(r"[^A-Za-z0-9_.-]")


class ClassName(str):
    """A class's name as a config gives it, with its options there; and the class where it was read from a file."""

    registry: str
    options: Mapping[str, object]
    found: type | None

    def __new__(
        cls, name: str, registry: str = "", options: Mapping[str, object] | None = None, found: type | None = None
    ) -> Self:
        """Make a name that knows its class."""
        self = super().__new__(cls, name)
        self.registry, self.options, self.found = registry, options or {}, found
        return self

    @property
    def label(self) -> str:
        """What tables and files call it: the class's own name where the config's says where it stands."""
        own = getattr(self.found, "name", None)
        return own if ":" in self and isinstance(own, str) else UNFIT.sub("-", self)


@dataclass(frozen=True)
class ClassMark:
    """Marks a text that names a class of a registry: the field holds a `ClassName`."""

    registry: str
    beside: bool = False  # whether options stand beside the name, in its section (see `OwnSection`)

    def __get_pydantic_core_schema__(self, source: object, handler: object) -> CoreSchema:
        """Return the schema of a name, or of a table with a name and options."""
        del source, handler
        return core_schema.with_info_plain_validator_function(
            self._read, serialization=core_schema.plain_serializer_function_ser_schema(_write)
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: object) -> dict[str, object]:
        """Return what an editor is told: the known names, or any reference, or a table with a class's options."""
        del schema, handler
        known = {"enum": list_names(self.registry)}
        reference = {"type": "string", "pattern": ":", "description": "module:Class or file.py:Class"}
        table = {"type": "object", "properties": {"class": {"type": "string"}}, "required": ["class"]}
        return {"anyOf": [known, reference, table]}

    def _read(self, value: object, info: ValidationInfo) -> ClassName:
        name, options = _split(value)
        if options and self.beside:
            raise ValueError(f"found a table of {', '.join(options)}, expected a name")
        folder = (info.context or {}).get(FOLDER)
        if folder is None:
            return ClassName(name, self.registry, options, getattr(value, "found", None))
        try:
            found = load_class(self.registry, name, folder)
        except InputError as error:
            raise ValueError(str(error)) from error
        if not self.beside:
            check_options(found, options)
        return ClassName(name, self.registry, options, found)


def _split(value: object) -> tuple[str, Mapping[str, object]]:
    """Return name and options of what stands in a config."""
    if isinstance(value, ClassName):
        return str(value), value.options
    if isinstance(value, str):
        return value, {}
    name = value.get(CLASS) if isinstance(value, dict) else None
    if not isinstance(value, dict) or not isinstance(name, str):
        raise PydanticCustomError("class_type", "Input should be a name, or a table")
    return name, {key: one for key, one in value.items() if key != CLASS}


def _write(value: str) -> str | dict[str, object]:
    name, options = _split(value)
    return {CLASS: name, **options} if options else name


def label_class(name: str) -> str:
    """Return what tables and files call a class that a config names."""
    return ClassName(name, found=getattr(name, "found", None)).label


class OwnSection(Section):
    """A section that chooses a class, whose options are all keys that stand beside the section's own."""

    model_config = ConfigDict(extra="allow")
    chooses: ClassVar[str] = "kind"  # the field that names the class

    @property
    def options(self) -> dict[str, Any]:
        """The class's options."""
        return dict(self.model_extra or {})

    @model_validator(mode="after")
    def _check_options(self) -> Self:
        found = getattr(getattr(self, self.chooses), "found", None)
        if found is not None:
            check_options(found, self.options)
        return self


def check_options(found: type, options: Mapping[str, object]) -> Section:
    """Return options as the section of their class; ValidationError where they are none.

    An unknown key is told those that the class knows.
    """
    schema = _schema_of(found)
    try:
        return schema.model_validate(dict(options))
    except ValidationError as error:
        faults = [one for one in error.errors() if one["type"] == "extra_forbidden" and len(one["loc"]) == 1]
        if not faults:
            raise
        key = str(faults[0]["loc"][0])
        words = describe_unknown_key(schema.model_fields, key).replace("{", "{{").replace("}", "}}")
        told = PydanticCustomError("value_error", words)
        unknown = InitErrorDetails(type=told, loc=(key,), input=faults[0]["input"])
        raise ValidationError.from_exception_data(schema.__name__, [unknown]) from error


def _schema_of(found: type) -> type[Section]:
    schema = getattr(found, "Config", Section)
    if not (isinstance(schema, type) and issubclass(schema, BaseModel)):
        raise ValueError(f"found class {found.__name__} whose Config is {schema!r}, expected a Section")
    return schema  # type: ignore[return-value]  # a plain pydantic model does as well


@dataclass(frozen=True)
class ClassReference[T]:
    """A class that a config names, with its checked options."""

    found: type[T]
    options: object

    def make(self, *context: object) -> T:
        """Return one of the class: by `__init__(config, ...)` where it has one of its own.

        ``context`` is what the class is made for, such as the mechanism of a model. Without an `__init__` of its own it
        is made as the built-in class that it derives from.
        """
        start = next(one for one in self.found.__mro__ if "__init__" in vars(one))
        own: Callable[..., T] = self.found
        built_in: Callable[..., T] = getattr(self.found, "from_config", own)
        return (own if is_own(start) and start is not object else built_in)(self.options, *context)


def choose[T](
    what: str, name: str, base: type[T], field: str, folder: Path, options: Mapping[str, object] | None = None
) -> ClassReference[T]:
    """Return the class of a registry that a config names, a subclass of a base, and its options.

    ``field`` says where the name stands, for the message, whose file the caller adds; names of files start at
    ``folder``. ``options`` are those that stand beside the name, and not with it.
    """
    found = getattr(name, "found", None)
    if found is None or not issubclass(found, base):
        found = find_class(what, name, base, field, None, folder)
    given = dict(_split(name)[1] if options is None else options)
    return ClassReference(found, check_section(_schema_of(found), given, Path(field), "", folder))


@contextmanager
def name_failures(found: type, field: str) -> Iterator[None]:
    """Make one line of whatever somebody else's class raises while it is made, with the field of its name."""
    try:
        yield
    except BayescalError:
        raise
    except Exception as error:
        if not is_own(found):
            raise
        text = " ".join(str(error).split())
        hint = ": __init__(self, config)" if "positional argument" in text else ""
        raise InputError(f"{field}: class {found.__name__} fails with {type(error).__name__}: {text}{hint}") from error


def find_files(section: Section, folder: Path) -> list[str]:
    """Return the names in all fields of a config that are marked as `InputFile`, and the files of its classes.

    With the TOML file of a table comes the table.
    """
    found: list[str] = []
    for one, mark in _walk(section):
        if isinstance(one, ClassName):
            found += list_sources(one.registry, one, folder)
        elif isinstance(one, str) and mark is not None and one not in mark.but:
            found += list_beside(one, folder)
    return list(dict.fromkeys(found))


def find_classes(section: Section, folder: Path) -> list[type]:
    """Return the classes that a config names, those in files relative to a folder."""
    names = [one for one, _ in _walk(section) if isinstance(one, ClassName)]
    return [one.found or load_class(one.registry, one, folder) for one in names]


def _walk(value: object, mark: FileMark | None = None) -> Iterator[tuple[object, FileMark | None]]:
    """Yield everything in a section that holds nothing else, with the mark of a field that may name a file."""
    if isinstance(value, Section):
        for name, own in _mark_fields(type(value)).items():
            yield from _walk(getattr(value, name), own)
    elif isinstance(value, dict | list | tuple):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _walk(one, mark)
    else:
        yield value, mark


@cache
def _mark_fields(section: type[Section]) -> dict[str, FileMark | None]:
    """Return the fields of a section with the marks of those that may name a file."""
    found = {}
    for name, field in section.model_fields.items():
        marks = [*field.metadata, *_list_metadata(field.annotation)]
        found[name] = next((one for one in marks if isinstance(one, FileMark)), None)
    return found


def _list_metadata(annotation: object) -> Iterator[object]:
    """Yield what annotations say beside types, inside unions too."""
    if get_origin(annotation) is Annotated:
        yield from get_args(annotation)[1:]
    for one in get_args(annotation):
        yield from _list_metadata(one)
