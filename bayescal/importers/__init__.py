"""Machines and measurements from files of other programs: each format a module, by the name of the format.

A module has ``recognise(name, text)``, whether a file is of its format, and ``convert(path, text, options)``, which
returns the files of a project: ``machine.toml``, data and configs that run as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from string import Template
from typing import Final, Protocol, cast

from bayescal.errors import InputError

FORMATS: Final[Mapping[str, str]] = {
    "klipper": "Klipper's printer.cfg of a linear delta",
    "marlin": "M665 and M666 of a linear delta in Marlin or RepRapFirmware",
    "urdf": "an arm in URDF (.urdf)",
    "tpoint": "a star file of TPOINT (option ALTAZ)",
}
"""What each format is, in words, by the name of its module."""


@dataclass(frozen=True)
class Project:
    """Files of a project by their names in its folder, what was found in words, and the command that comes next."""

    files: Mapping[str, bytes]
    found: tuple[str, ...] = ()
    advice: str = "bayescal validate study.toml"


TEMPLATES = Path(__file__).parent / "templates"


def fill_template(name: str, /, **values: object) -> str:
    """Return a template of a project's file with values by the names that it has for them."""
    text = (TEMPLATES / f"{name}.toml").read_text(encoding="utf-8")
    return Template(text).substitute({key: str(value) for key, value in values.items()})


class Importer(Protocol):
    """What a module of a format has."""

    def recognise(self, name: str, text: str) -> bool:
        """Return whether a file of a name with a text is of this format."""

    def convert(self, path: Path, text: str, options: Mapping[str, str]) -> Project:
        """Return a file as a project; InputError, with the line, where it does not hold what one needs."""


def find_importer(path: Path) -> tuple[Importer, str]:
    """Return the format's module of a file, and its text; InputError for a file that is none or of no known format."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise InputError(f"{path}: not found") from error
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: {error}, expected a text file") from error
    for name in FORMATS:
        importer = cast(Importer, import_module(f"{__name__}.{name}"))
        if importer.recognise(path.name, text):
            return importer, text
    known = "; ".join(FORMATS.values())
    raise InputError(f"{path}: found no known format, expected one of: {known}")


def import_file(path: Path, options: Mapping[str, str] | None = None) -> Project:
    """Return a file of another program as a project; see `find_importer` and `Importer.convert`."""
    importer, text = find_importer(path)
    return importer.convert(path, text, options or {})
