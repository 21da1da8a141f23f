"""Classes by name: built-in ones, those of installed packages, and classes beside a config.

One look-up serves all: kinds of experiment, claims, machines. Nothing is imported that nobody named: a class's module
is loaded when a config or a command asks for it.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from types import ModuleType

import cloudpickle

from bayescal.config.load import look_up
from bayescal.errors import InputError


@dataclass(frozen=True)
class Registry:
    """Where classes of a sort are listed.

    Attributes
    ----------
    modules : tuple of str
        Packages that list what is theirs in a mapping of the registry's name: a class, or ``module:Class``, by name.
    group : str
        Entry points under which installed packages offer the same.
    """

    modules: tuple[str, ...]
    group: str


_EXPERIMENTS = ("bayescal.experiments", "bayescal.reproductions")
REGISTRIES = {
    "KINDS": Registry(_EXPERIMENTS, "bayescal.kinds"),
    "CLAIMS": Registry(_EXPERIMENTS, "bayescal.claims"),
    "MACHINES": Registry(("bayescal.machines.readings",), "bayescal.machines"),
}


@cache
def list_references(what: str) -> Mapping[str, str]:
    """Return ``module:Class`` by name, built-in ones and those of installed packages."""
    found: dict[str, str] = {}
    for module in REGISTRIES[what].modules:
        listed = getattr(importlib.import_module(module), what, {})
        found |= {name: one if isinstance(one, str) else _refer(one) for name, one in listed.items()}
    for one in entry_points(group=REGISTRIES[what].group):
        found.setdefault(one.name, one.value)
    return found


def _refer(found: type) -> str:
    return f"{found.__module__}:{found.__qualname__}"


def find_class[T](what: str, name: str, base: type[T], field: str, where: Path, folder: Path | None) -> type[T]:
    """Return a class by its name, or by ``module:Class`` or ``file.py:Class``.

    Parameters
    ----------
    what : str
        One of `REGISTRIES`.
    name : str
    base : type
        What it must be a subclass of.
    field : str
        Where the name stands, for the message.
    where : Path
        The file it stands in.
    folder : Path or None
        Where a file's name starts; None where only known names may be given.

    Raises
    ------
    InputError
        For an unknown name, a module that fails to import, and what is no such class.
    """
    references = list_references(what)
    reference = name
    if name in references or ":" not in name or folder is None:
        reference = look_up(references, name, field, where)
    location, _, attribute = reference.partition(":")
    fault = f"{where}: {field}: found {name!r}"
    try:
        module = _import(location, folder)
    except InputError as error:
        raise InputError(f"{fault}: {error}") from error
    except Exception as error:
        raise InputError(
            f"{fault}, whose module fails to import ({type(error).__name__}: {' '.join(str(error).split())}), "
            "expected one that can be imported"
        ) from error
    found = getattr(module, attribute, None)
    if not (isinstance(found, type) and issubclass(found, base)):
        raise InputError(f"{fault}, which is no {base.__name__}, expected a subclass of it")
    return found


def is_file(name: str) -> bool:
    """Whether a name is that of a class in a file beside the config."""
    return name.partition(":")[0].endswith(".py")


def list_sources(what: str, name: str) -> list[str]:
    """Return the file of a class beside the config, relative to it: a part of what determines results; else nothing."""
    return [name.partition(":")[0]] if is_file(name) and name not in list_references(what) else []


def _import(location: str, folder: Path | None) -> ModuleType:
    if not location.endswith(".py") or folder is None:
        return importlib.import_module(location)
    path = (folder / location).resolve()
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected a Python module")
    name = f"bayescal_file_{path.stem}_{zlib.crc32(str(path).encode()):08x}"
    if name in sys.modules:
        return sys.modules[name]
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None
    assert specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    _send_by_value(module)
    return module


def _send_by_value(module: ModuleType) -> None:
    """Let worker processes, which cannot import a file's module by name, be sent its functions and classes whole."""
    cloudpickle.register_pickle_by_value(module)  # between a run and its own workers, never to or from a file
