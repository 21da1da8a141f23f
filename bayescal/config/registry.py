"""Classes by name: built-in ones, those of installed packages, and classes beside a config.

One look-up serves all: kinds of experiment, claims, machines, models, deformations, sensors, criteria and methods of
pose selection. Nothing is imported that nobody named: a class's module is loaded when a config or a command asks for
it.
"""

from __future__ import annotations

import importlib
import re
import sys
import zlib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoints, entry_points
from pathlib import Path
from types import ModuleType
from typing import Any

from bayescal.config.built_in import BUILT_IN
from bayescal.config.load import describe_unknown
from bayescal.config.local_imports import find_local_imports, import_from, send_by_value
from bayescal.config.trust import are_own_classes_allowed, hash_file, permit
from bayescal.errors import InputError, name_faults
from bayescal.search_path import list_elsewhere


@dataclass(frozen=True)
class Registry:
    """Where classes of a sort are listed.

    Modules are packages that list theirs in a mapping of the registry's name: a class, or ``module:Class``, by name.
    Members are texts that each class has as attributes, beside its methods; a ``name`` is what tables and files call
    it.
    """

    modules: tuple[str, ...]
    group: str  # entry points under which installed packages offer the same
    base: str  # ``module:Class`` of what all of them are
    members: tuple[str, ...] = ()


_MACHINES, _POSES = "bayescal.machines", "bayescal.pose_selection"
REGISTRIES = {
    "KINDS": Registry(("bayescal.experiments",), "bayescal.kinds", "bayescal.experiments.runner.experiment:Experiment"),
    "BLOCKS": Registry((), "bayescal.blocks", "bayescal.experiments.runner.blocks:PageBlock"),
    "CLAIMS": Registry(("bayescal.experiments",), "bayescal.claims", "bayescal.experiments.study.claims:Claims"),
    "MACHINES": Registry((f"{_MACHINES}.readings",), "bayescal.machines", f"{_MACHINES}.readings:ReadingMachine"),
    "INSTRUMENTS": Registry(
        (f"{_MACHINES}.readings",), "bayescal.instruments", f"{_MACHINES}.readings.instrument:Instrument"
    ),
    "READERS": Registry((), "bayescal.readers", "bayescal.data.reader:TableReader"),
    "MODELS": Registry(
        (f"{_MACHINES}.models",), "bayescal.models", f"{_MACHINES}.models:KinematicModel", ("name", "title")
    ),
    "DEFORMATIONS": Registry(
        (f"{_MACHINES}.deformations",), "bayescal.deformations", f"{_MACHINES}.deformations:Deformation", ("name",)
    ),
    "ERRORS": Registry(
        ("bayescal.density.calibration",), "bayescal.errors", "bayescal.density.calibration.terms:ErrorTerm"
    ),
    "SAMPLERS": Registry(("bayescal.inference",), "bayescal.samplers", "bayescal.inference.samplers:Sampler"),
    "SENSORS": Registry((f"{_MACHINES}.sensors",), "bayescal.sensors", f"{_MACHINES}.sensors:Sensor"),
    "CRITERIA": Registry(
        (f"{_POSES}.criteria",), "bayescal.criteria", f"{_POSES}.criteria:Criterion", ("name", "title", "source")
    ),
    "METHODS": Registry(
        (f"{_POSES}.methods",), "bayescal.methods", f"{_POSES}.methods:SelectionMethod", ("name", "title", "source")
    ),
}
NAME = re.compile(r"[A-Za-z0-9_.-]+")
_FILE_MODULE = "bayescal_file_"


def list_references(what: str) -> Mapping[str, str]:
    """Return ``module:Class`` by name, built-in ones and those of installed packages."""
    built_in = {name: one if isinstance(one, str) else _refer(one) for name, one in _list_built_in(what).items()}
    return _list_entry_points(REGISTRIES[what].group) | built_in


def list_names(what: str) -> list[str]:
    """Return the names of `list_references` in order, without importing what they name."""
    return sorted({*BUILT_IN[what], *_list_entry_points(REGISTRIES[what].group)})


def _list_built_in(what: str) -> dict[str, Any]:
    """Return classes, or ``module:Class``, by name, as they are listed now."""
    found: dict[str, object] = {}
    for module in REGISTRIES[what].modules:
        found |= getattr(importlib.import_module(module), what, {})
    return found


def _list_entry_points(group: str) -> dict[str, str]:
    return {one.name: one.value for one in _find_entry_points().select(group=group)}


@cache
def _find_entry_points() -> EntryPoints:
    """Return the entry points of all installed packages, read once: it takes as long for one group as for all."""
    with _leave_current_folder():
        return entry_points()


@contextmanager
def _leave_current_folder() -> Iterator[None]:
    """Import from installed packages alone, and not from the folder where this process happens to be."""
    before = sys.path[:]
    sys.path[:] = list_elsewhere()
    try:
        yield
    finally:
        sys.path[:] = before


def _refer(found: type) -> str:
    return f"{found.__module__}:{found.__qualname__}"


def find_class[T](what: str, name: str, base: type[T], field: str, file: Path | None, folder: Path | None) -> type[T]:
    """Return a class by its name, or by ``file.py:Class``, or by the ``module:Class`` of an entry point.

    ``what`` is one of `REGISTRIES`; ``field`` and ``file`` say where the name stands, for the message, without a file
    where the caller says it; a file's name starts at ``folder``, None where only known names may be given.
    InputError for an unknown name, a module that fails to import, and what is no subclass of ``base``.
    """
    with name_faults(file or ""):
        try:
            found = load_class(what, name, folder)
        except InputError as error:
            raise InputError(f"{field}: {error}") from error
        if not issubclass(found, base):
            raise InputError(f"{field}: found {name!r}, expected a subclass of {base.__name__}")
    return found


def load_class(what: str, name: str, folder: Path | None) -> type:
    """Return a class as `find_class` does; InputError says what was found and expected, but not where."""
    built_in, references = _list_built_in(what), list_references(what)
    if isinstance(listed := built_in.get(name), type):
        return listed
    if name not in references and (":" not in name or folder is None):
        raise InputError(
            describe_unknown(references, name) if references else f"found {name!r}, expected file.py:Class"
        )
    location, _, attribute = references.get(name, name).partition(":")
    if name not in built_in and not are_own_classes_allowed():
        known = ", ".join(sorted(built_in))
        raise InputError(f"found {name!r}, not built in, with --no-custom-code; expected one of {known}")
    beside = name not in references and is_file(name)
    if not beside and name not in {*references, *references.values()} and not location.startswith("bayescal."):
        raise InputError(f"found {name!r}, expected file.py:Class, or an entry point of {REGISTRIES[what].group!r}")
    try:
        if beside:
            module = _import_file(location, folder or Path())
        else:
            with _leave_current_folder():
                module = importlib.import_module(location)
    except InputError as error:
        raise InputError(f"found {name!r}: {error}") from error
    except Exception as error:
        raise InputError(
            f"found {name!r}, whose import fails ({type(error).__name__}: {' '.join(str(error).split())})"
        ) from error
    found = getattr(module, attribute, None)
    place, _, base_name = REGISTRIES[what].base.partition(":")
    base: type = getattr(importlib.import_module(place), base_name)
    if not (isinstance(found, type) and issubclass(found, base)):
        raise InputError(f"found {name!r}, expected a subclass of {base.__name__}")
    _check_members(what, name, found, built_in)
    return found


def _check_members(what: str, name: str, found: type, built_in: Mapping[str, object]) -> None:
    """Raise InputError where a class lacks a method or a text, or would be taken for a built-in one."""
    members = REGISTRIES[what].members
    texts = [one for one in members if not isinstance(getattr(found, one, None), str)]
    missing = [*sorted(getattr(found, "__abstractmethods__", ())), *texts]
    if missing:
        raise InputError(f"found {name!r} without {', '.join(missing)}, expected a class with them")
    own = getattr(found, "name", "") if "name" in members else "any"
    if not NAME.fullmatch(own):
        raise InputError(f"found {name!r} named {own!r}, expected letters, digits and _.-")
    if own in built_in and built_in[own] not in (found, _refer(found)):
        raise InputError(f"found {name!r} named {own!r}, expected no built-in name")


def is_file(name: str) -> bool:
    """Whether a name is that of a class in a file beside the config."""
    return name.partition(":")[0].endswith(".py")


def list_sources(what: str, name: str, folder: Path) -> list[str]:
    """Return the file that a class stands in, and what it imports from beside itself, relative to the config's folder.

    They are a part of what determines results. Of a class that stands elsewhere it is nothing.
    """
    if not is_file(name) or name in list_references(what):
        return []
    file = name.partition(":")[0]
    local = find_local_imports(folder / file).values()
    return [file, *(one.relative_to(folder.resolve(), walk_up=True).as_posix() for one in local)]


def hash_modules(classes: Iterable[type]) -> dict[str, str]:
    """Return the SHA-256 of the modules that somebody else's classes and their bases stand in, by module.

    Files beside a config are none of them: they belong to its files. InputError where a module is no file.
    """
    import cloudpickle

    found = {}
    for name in sorted({base.__module__ for one in classes for base in one.__mro__}):
        top = name.partition(".")[0]
        beside = top.startswith(_FILE_MODULE) or name in cloudpickle.list_registry_pickle_by_value()
        if beside or top == "bayescal" or top in sys.stdlib_module_names:
            continue
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is None or not Path(file).is_file():
            raise InputError(f"module {name}: found no file, expected one")
        found[name] = hash_file(Path(file).read_bytes())
    return found


def is_own(found: type) -> bool:
    """Whether a class is somebody else's, and not the library's."""
    return found.__module__.partition(".")[0] != "bayescal"


def _import_file(location: str, folder: Path) -> ModuleType:
    """Return the module of a file in a folder or below; InputError for another, and for one that nobody trusts."""
    root = folder.resolve()
    path = (root / location).resolve()
    if Path(location).is_absolute() or not path.is_relative_to(root):
        raise InputError(f"{location}: expected a file in {folder}")
    if not path.is_file():
        raise InputError(f"{path}: no such Python module")
    local = find_local_imports(path)
    contents = {file: file.read_bytes() for file in (path, *local.values())}
    permit(contents, folder)
    content = zlib.crc32(str(path).encode())  # a file that was changed, or what it imports, is another module
    for one in contents.values():
        content = zlib.crc32(one, content)
    name = f"{_FILE_MODULE}{path.stem}_{content:08x}"
    if name not in sys.modules:
        import_from(name, path, local, contents)
        for module in (sys.modules[name], *(sys.modules[other] for other in local if other in sys.modules)):
            send_by_value(module)
    return sys.modules[name]
