"""The references, generated on each build: TOML keys from the schemas, the command line from typer, public names.

Every key has its meaning, unit, default and an example. Meanings are the docstrings of the schemas' fields; a unit is
what the key ends with, or stands in brackets at the end of the meaning; examples come from the shipped configs.
"""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic_core import PydanticUndefined

import bayescal
from bayescal.config.load import FOLDER, read_toml
from bayescal.config.registry import find_class, list_references
from bayescal.config.sections import FileMark, Section, describe_fields
from bayescal.experiments import USES
from bayescal.experiments.runner.experiment import Experiment
from bayescal.experiments.runner.load import find_kind, load
from bayescal.files.rows import ColumnType
from bayescal.machines.readings import ReadingMachine
from bayescal.machines.schema import LegsMachineConfig, MachineFileConfig, MechanismConfig, SlidingPlatformConfig
from bayescal.report.findings import FindingRow

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo
    from sphinx.application import Sphinx

ROOT = Path(__file__).parents[2]
SUFFIXES = {
    **{
        "mm": "mm",
        "um": "µm",
        "deg": "degrees",
        "arcsec": "arcsec",
        "urad": "µrad",
        "ppm": "1e-6",
        "rad": "rad",
        "kg": "kg",
        "n": "N",
    },
    **{"n_mm": "N mm", "n_mm2": "N mm²", "gpa": "GPa", "m_s2": "m/s²", "per_million": "1e-6/N"},
}
UNIT = re.compile(r"\s*\[([^\[\]]+)\](?=\.?$)")
LONGEST = 60
TABLE = "see its table"


@dataclass(frozen=True, eq=False)
class Place:
    """A section and where it stands in a file."""

    schema: type[BaseModel]
    headings: list[str] = field(default_factory=list)


# --- what a schema says ------------------------------------------------------------------------------------------


def unwrap(kind: Any) -> Any:
    """Return a type without its alias and its marks."""
    while True:
        if hasattr(kind, "__value__"):
            kind = kind.__value__
        elif get_origin(kind) is Annotated:
            kind = get_args(kind)[0]
        else:
            return kind


def list_sections(kind: Any, heading: str = "[{}]") -> Iterator[tuple[type[BaseModel], str]]:
    """Return the sections inside a type, each with the form of its heading in TOML."""
    kind = unwrap(kind)
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        yield kind, heading
    form = {list: "[[{}]]", dict: "[{}.NAME]"}.get(get_origin(kind), heading)
    for inner in get_args(kind):
        yield from list_sections(inner, form)


def list_places(schema: type[BaseModel], heading: str = "the file itself") -> list[Place]:
    """Return a schema and all sections below it, each once, in the order of their keys."""
    places = {schema: Place(schema, [heading])}
    queue = [(schema, "")]
    for section, path in queue:
        for name, info in section.model_fields.items():
            for inner, form in list_sections(info.annotation):
                here = f"{path}{name}"
                known = inner in places
                place = places.setdefault(inner, Place(inner))
                if form.format(here) not in place.headings:
                    place.headings.append(form.format(here))
                if not known:
                    queue.append((inner, f"{here}.NAME." if "NAME" in form else f"{here}."))
    return list(places.values())


def split_unit(schema: type[Section], name: str) -> tuple[str, str]:
    """Return a key's meaning and its unit; no unit of what is no number."""
    meaning = " ".join(describe_fields(schema).get(name, "").split())
    stated = UNIT.search(meaning)
    if stated:
        unit = "–" if stated[1] == "1" else stated[1]
        return UNIT.sub("", meaning), unit
    endings = [one for one in SUFFIXES if name.endswith(f"_{one}")]
    return meaning, SUFFIXES[max(endings, key=len)] if endings else ""


def has_numbers(kind: Any) -> bool:
    """Whether a type has room for a number that is no count."""
    kind = unwrap(kind)
    return kind is float or any(has_numbers(inner) for inner in get_args(kind) if inner is not type(None))


def describe_type(kind: Any) -> str:
    """Return in a few words what a key takes."""
    if any(isinstance(mark, FileMark) for mark in getattr(kind, "__metadata__", ())):
        return "file"
    kind = unwrap(kind)
    origin, inner = get_origin(kind), [one for one in get_args(kind) if one is not type(None)]
    if origin is Literal:
        return ", ".join(f"`{json.dumps(one)}`" for one in inner)
    if origin in (Union, types.UnionType):
        return " or ".join(dict.fromkeys(describe_type(one) for one in inner))
    if origin is list:
        return f"list of {describe_type(inner[0])}"
    if origin is dict:
        return f"table of {describe_type(inner[1])}"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return "table"
    return {str: "text", bool: "true, false", int: "count", float: "number", Any: "anything"}.get(kind, "text")


def describe_default(info: FieldInfo) -> str:
    """Return what holds where a key is missing."""
    if info.default_factory is not None:
        return "from the others" if info.default_factory not in (list, dict) else "none"
    if info.default is PydanticUndefined:
        return "**needed**"
    if info.default is None or info.default in ({}, []):
        return "none"
    return "its defaults" if isinstance(info.default, BaseModel) else f"`{write_value(info.default)}`"


def write_value(value: Any) -> str:
    """Return a value as TOML has it, cut where it is long."""
    if isinstance(value, BaseModel):
        value = value.model_dump(exclude_unset=True)
    if isinstance(value, dict):
        text = "{ " + ", ".join(f"{key} = {write_value(one)}" for key, one in value.items()) + " }"
    elif isinstance(value, list | tuple):
        text = "[" + ", ".join(write_value(one) for one in value) + "]"
    else:
        text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 2]} …"


# --- examples ----------------------------------------------------------------------------------------------------

type Examples = dict[tuple[type[BaseModel], str], Any]


def collect_examples() -> Examples:
    """Return a value of every key that a shipped file sets, by the section and the key."""
    found: Examples = {}
    for path in sorted([*ROOT.glob("experiments/*/*.toml"), *ROOT.glob("examples/*/*.toml")]):
        for section in read_shipped(path):
            note_examples(section, found)
    return found


READ_ALONE: dict[str, type[BaseModel]] = {"legs": LegsMachineConfig, "sliding_platform": SlidingPlatformConfig}
"""Machines whose file is one section."""


def read_shipped(path: Path) -> Iterator[BaseModel]:
    """Return the sections of a shipped file: of an experiment, or of a machine."""
    content, _ = read_toml(path)
    kind = str(content.get("kind", ""))
    if kind in READ_ALONE:
        yield READ_ALONE[kind].model_validate(content)
    elif isinstance(content.get("machine"), dict) and "seed" not in content:
        yield MachineFileConfig.model_validate({key: one for key, one in content.items() if key != "machine"})
        own = find_class("MACHINES", kind, ReadingMachine, "kind", path, path.parent)
        section = getattr(own, "Config", Section)
        yield section.model_validate(content["machine"], context={FOLDER: path.parent})
    elif "legs" in content:
        yield MechanismConfig.model_validate(content)
    else:
        yield load(path)[1]


def note_examples(value: Any, found: Examples) -> None:
    """Note what a section sets, and what those below it do."""
    if isinstance(value, BaseModel):
        for name in sorted(value.model_fields_set & set(type(value).model_fields)):
            one = getattr(value, name)
            if not holds_sections(one):
                found.setdefault((type(value), name), one)
            note_examples(one, found)
    elif isinstance(value, dict | list | tuple):
        for one in value.values() if isinstance(value, dict) else value:
            note_examples(one, found)


def holds_sections(value: Any) -> bool:
    """Whether a value is a section or holds one."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list | tuple) else ()
    return isinstance(value, BaseModel) or any(holds_sections(one) for one in inner)


def find_example(schema: type[BaseModel], name: str, examples: Examples) -> str:
    """Return an example of a key: a shipped one, one beside this file, what must be, its table, or its default."""
    info = schema.model_fields[name]
    kind = unwrap(info.annotation)
    alike = [other for other, key in examples if key == name and share_key(other, schema, name)]
    if (schema, name) in examples or alike:
        return show_key(name, examples[schema if (schema, name) in examples else alike[0], name])
    if name in (given := read_given().get(schema.__name__, {})):
        return show_key(name, given[name])
    if get_origin(kind) is Literal and len(get_args(kind)) == 1:
        return show_key(name, get_args(kind)[0])
    if any(True for _ in list_sections(info.annotation)):
        return TABLE
    known = info.default not in (PydanticUndefined, None) and info.default_factory is None
    return show_key(name, info.default) if known else ""


def share_key(one: type[BaseModel], other: type[BaseModel], name: str) -> bool:
    """Whether two sections have a key from the same section that both are."""
    return any(name in inspect.get_annotations(base) for base in one.__mro__ if base in other.__mro__)


def show_key(name: str, value: Any) -> str:
    """Return a key with its value as code."""
    return f"`{name} = {write_value(value)}`"


@cache
def read_given() -> dict[str, dict[str, Any]]:
    """Return the examples beside this file, by section and key."""
    return read_toml(Path(__file__).with_name("examples.toml"))[0]


# --- pages -------------------------------------------------------------------------------------------------------


def list_schemas() -> dict[str, tuple[str, str, type[BaseModel]]]:
    """Return title, first sentence and schema of every page, by its name."""
    pages: dict[str, tuple[str, str, type[BaseModel]]] = {
        "mechanism": ("Machine: legs", "A machine of legs, `mechanism` in an experiment.", MechanismConfig),
        "machine": (
            "Machine: one function",
            "A machine of one function, `machine` in an experiment.",
            MachineFileConfig,
        ),
        "legs": ("Machine: legs with readings", "Legs as `machine` in a calibration.", LegsMachineConfig),
        "sliding_platform": ("Machine: sliding platform", "The file of a planar machine.", SlidingPlatformConfig),
    }
    for what, title in (("MACHINES", "Machine"), ("INSTRUMENTS", "Instrument")):
        for name in sorted(list_references(what)):
            found = find_class(what, name, ReadingMachine, "kind", ROOT, None)
            page = (f"{title}: options of {name}", summarise(found), getattr(found, "Config", Section))
            pages.setdefault(name, page)
    for kind, found in list_kinds().items():
        pages[f"kind_{kind}"] = (f'kind = "{kind}"', summarise(type(found)), found.schema)
    return pages


def describe(schema: type) -> str:
    """Return a section's docstring without its attributes and examples, in one line."""
    text = re.split(r"\n\n(?:Attributes|Examples)\n", inspect.getdoc(schema) or "")[0]
    return " ".join(text.split()).replace("``", "`")


def summarise(found: type) -> str:
    """Return the first sentence of a docstring, in one line."""
    return " ".join((inspect.getdoc(found) or "").partition("\n\n")[0].split()).replace("``", "`")


def write_page(title: str, text: str, schema: type[BaseModel], examples: Examples) -> str:
    """Return the page of a file."""
    parts = [f"# {title}\n\n{text}\n"]
    for place in list_places(schema):
        lines = "\n".join(write_row(place.schema, name, examples) for name in place.schema.model_fields)
        parts.append(
            f"## {write_heading(place)}\n\n"
            f"{describe(place.schema)}\n\n"
            f"| key | meaning, and an example | unit | takes | default |\n|---|---|---|---|---|\n{lines}\n"
        )
    return "\n".join(parts)


def write_heading(place: Place) -> str:
    """Return where a section stands, with the key that chooses it where there are several."""
    headings = ", ".join(f"`{one}`" if one.startswith("[") else one for one in place.headings)
    for name, info in place.schema.model_fields.items():
        kind = unwrap(info.annotation)
        if place.headings[0].startswith("[") and get_origin(kind) is Literal and len(get_args(kind)) == 1:
            return f"{headings} with {show_key(name, get_args(kind)[0])}"
    return headings


def write_row(schema: type[BaseModel], name: str, examples: Examples) -> str:
    """Return the row of a key."""
    info = schema.model_fields[name]
    meaning, unit = split_unit(schema, name)
    kind = Annotated[info.annotation, *info.metadata] if info.metadata else info.annotation
    example = find_example(schema, name, examples)
    told = f"{meaning} {example[0].upper()}{example[1:]}." if example == TABLE else f"{meaning}<br>{example}"
    cells = [f"`{name}`", told, unit, describe_type(kind), describe_default(info)]
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def write_index(pages: dict[str, tuple[str, str, type[BaseModel]]]) -> str:
    """Return the page that leads to all others."""
    rows = "\n".join(f"| [{title}]({name}.md) | {text} |" for name, (title, text, _) in pages.items())
    return (
        "# TOML keys\n\nEvery key of every file, generated from the schemas that check them. `bayescal schema KIND` "
        "prints the same for editors. Unknown keys and wrong types are refused, with the line and the nearest key.\n\n"
        f"| file | what it is |\n|---|---|\n{rows}\n\n```{{toctree}}\n:hidden:\n\n" + "\n".join(pages) + "\n```\n"
    )


def write_commands() -> str:
    """Return the page of the command line, as typer has it."""
    command = [sys.executable, "-m", "typer", "bayescal.cli", "utils", "docs", "--name", "bayescal"]
    text = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    text = re.sub(r"^Example: (.*)$", r"```sh\n\1\n```", text, flags=re.MULTILINE)
    return text.replace("# `bayescal`", "# Command line", 1)


def write_names() -> str:
    """Return the page of the public names."""
    parts = [
        "# Public names\n\nWhat `import bayescal` offers, in the order in which it is needed; everything else may "
        "change. Examples go on from one to the next.\n"
    ]
    for name in bayescal.__all__:
        found = getattr(bayescal, name)
        what = "class" if inspect.isclass(found) else "function"
        options = "\n   :members:\n   :exclude-members: Config" if what == "class" else ""
        parts.append(f"## {name}\n\n```{{eval-rst}}\n.. auto{what}:: bayescal.{name}{options}\n```\n")
    return "\n".join(parts)


def list_kinds() -> dict[str, Experiment[Any, Any]]:
    """Return every kind of experiment by its name."""
    return {kind: find_kind(kind, ROOT, None) for kind in sorted({**list_references("KINDS"), **USES})}


def write_tables() -> str:
    """Return the page of the tables of results, from the declarations of their rows."""
    parts = [
        "# Tables of results\n\nThe CSV files of each kind of experiment and their columns; in Python they are "
        "`results.tables`. A column in italics is there where it applies.\n"
    ]
    for kind, found in list_kinds().items():
        parts.append(f'## kind = "{kind}"\n')
        for row in (FindingRow, *found.rows):
            lines = "\n".join(write_column(one) for one in row.list_columns())
            parts.append(
                f"### {row.table}.csv\n\n{describe(row)}\n\n| column | meaning | unit |\n|---|---|---|\n{lines}\n"
            )
    return "\n".join(parts)


def write_column(one: ColumnType) -> str:
    """Return the row of a column."""
    name = f"*`{one.name}`*" if one.is_optional else f"`{one.name}`"
    choices = f": {', '.join(f'`{text}`' for text in one.choices)}" if one.choices else ""
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in (name, one.meaning + choices, one.unit)) + " |"


def write_references(app: Sphinx) -> None:
    """Write all generated pages where they are not so already."""
    folder = Path(app.srcdir) / "reference"
    pages, examples = list_schemas(), collect_examples()
    texts = {f"toml/{name}.md": write_page(*page, examples) for name, page in pages.items()}
    texts |= {
        "toml/index.md": write_index(pages),
        "cli.md": write_commands(),
        "python.md": write_names(),
        "tables.md": write_tables(),
    }
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before any is read."""
    app.connect("builder-inited", write_references)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
