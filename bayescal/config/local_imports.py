"""What a Python file that a config names imports from beside itself: other files that results depend on.

They are found in its text, without importing anything: modules and packages next to the file, and what these import in
turn, as far as all of it lies in the folder of the file. Installed modules of the same name go first, as everywhere.
"""

from __future__ import annotations

import ast
import contextlib
import copyreg
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from functools import lru_cache
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAliasType, cast, get_type_hints

import cloudpickle
from pydantic_core import SchemaSerializer, SchemaValidator


def find_local_imports(path: Path) -> dict[str, Path]:
    """Return the files that a file imports from beside itself, and these in turn, by their modules' names.

    Parameters
    ----------
    path : Path
        A Python file; one that cannot be read as such imports nothing here, and fails when it is imported.
    """
    root = path.resolve().parent
    found: dict[str, Path] = {}
    installed: dict[str, bool] = {}
    waiting = [(path.resolve(), "")]
    while waiting:
        file, package = waiting.pop()
        for name in _list_names(_read(file), package):
            top = name.partition(".")[0]
            if top and top not in installed:
                installed[top] = _is_installed(top, root)
            for module, place in () if installed.get(top, True) else _locate(name, root):
                if module not in found and place.is_relative_to(root) and place != path.resolve():
                    found[module] = place
                    inside = module if place.name == "__init__.py" else module.rpartition(".")[0]
                    waiting.append((place, inside))
    return dict(sorted(found.items()))


def _read(file: Path) -> bytes:
    try:
        return file.read_bytes()
    except OSError:
        return b""


@lru_cache(maxsize=256)
def _list_names(content: bytes, package: str) -> tuple[str, ...]:
    """Return the dotted names that a file imports, wherever it does; those of members may be modules, too."""
    try:
        tree = ast.parse(content)
    except (SyntaxError, ValueError):
        return ()
    found: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [one.name for one in node.names]
        elif isinstance(node, ast.ImportFrom):
            parents = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
            base = ".".join([*parents, *([node.module] if node.module else [])])
            found += [base, *(f"{base}.{one.name}" for one in node.names)]
    return tuple(dict.fromkeys(found))


def _locate(name: str, root: Path) -> Iterator[tuple[str, Path]]:
    """Yield the modules of a dotted name that are files beside a root, its packages first."""
    parts = name.split(".")
    for n in range(1, len(parts) + 1):
        place = root.joinpath(*parts[:n])
        for file in (place / "__init__.py", place.with_suffix(".py")):
            if file.is_file():
                yield ".".join(parts[:n]), file.resolve()
                break


def _is_installed(top: str, root: Path) -> bool:
    """Whether Python finds a module before it looks beside the root."""
    if top in sys.stdlib_module_names or top in sys.builtin_module_names:
        return True
    elsewhere = [one for one in sys.path if Path(one or ".").resolve() != root]
    found = PathFinder.find_spec(top, elsewhere)
    return found is not None and found.origin is not None  # a mere folder of that name gives way to a module


@contextmanager
def import_from(root: Path, modules: dict[str, Path]) -> Iterator[None]:
    """Let a file import from beside itself: what modules of these names were before, of other files, is forgotten.

    No bytecode is left there: somebody's folder is read, and a file that changes within a second would be taken for the
    one that was.
    """
    for name in modules:
        sys.modules.pop(name, None)
    before, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    sys.path.append(str(root))
    try:
        yield
    finally:
        sys.path.remove(str(root))
        sys.dont_write_bytecode = before


def send_by_value(module: ModuleType) -> None:
    """Let worker processes, which cannot import a file's module by name, be sent its functions and classes whole.

    Three things cloudpickle leaves by name or out of order: an alias of a type, what a dataclass's fields are where
    their annotations are texts, and what pydantic has built of a schema, whose parts lead back to the class.
    """
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
        copyreg.pickle(one, cast("Any", lambda built: (_BuiltLater, (), {"recipe": built.__reduce__()[:2]})))


class _BuiltLater:
    """What pydantic builds of a schema, built when it is first asked for: by then the schema has come whole."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        if "built" not in self.__dict__:
            build, given = self.__dict__["recipe"]
            self.__dict__["built"] = build(*given)
        return getattr(self.__dict__["built"], name)
