"""What a Python file that a config names imports from beside itself: other files that results depend on.

They are found in its text, without importing anything: modules and packages next to the file, and what these import in
turn, as far as all of it lies in the folder of the file. Installed modules of the same name go first, as everywhere.
"""

from __future__ import annotations

import ast
import contextlib
import copyreg
import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import lru_cache
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from itertools import accumulate
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any, TypeAliasType, cast, get_type_hints


def find_local_imports(path: Path) -> dict[str, Path]:
    """Return the files that a file imports from beside itself, and these in turn, by their modules' names.

    One that cannot be read as Python imports nothing here, and fails when it is imported.
    """
    first = path.resolve()
    root = first.parent
    elsewhere = [one for one in sys.path if Path(one or ".").resolve() != root]
    found: dict[str, Path] = {}
    installed: dict[str, bool] = {"": True}
    looked_for: set[str] = set()
    waiting = [(first, "")]
    while waiting:
        file, package = waiting.pop()
        for name in _list_names(_read(file), package):
            top = name.partition(".")[0]
            if top not in installed:
                installed[top] = _is_installed(top, elsewhere)
            for module in () if installed[top] else accumulate(name.split("."), "{}.{}".format):
                if module in looked_for:
                    continue
                looked_for.add(module)
                place = _locate(module, root)
                if place is not None and place.is_relative_to(root) and place != first:
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


def _locate(module: str, root: Path) -> Path | None:
    """Return the file of a module beside a root, a package's before a file of the same name."""
    place = root.joinpath(*module.split("."))
    return next((one.resolve() for one in (place / "__init__.py", place.with_suffix(".py")) if one.is_file()), None)


def _is_installed(top: str, elsewhere: list[str]) -> bool:
    """Whether Python finds a module in the standard library or elsewhere on its path."""
    if top in sys.stdlib_module_names or top in sys.builtin_module_names:
        return True
    found = PathFinder.find_spec(top, elsewhere)
    return found is not None and found.origin is not None  # a mere folder of that name gives way to a module


class _Source(SourceFileLoader):
    """Runs a file as it was read: no bytecode that lies beside it, and nothing that was written since."""

    def __init__(self, name: str, path: Path, content: bytes) -> None:
        super().__init__(name, str(path))
        self.content = content

    def get_code(self, fullname: str) -> CodeType:
        return self.source_to_code(self.content, self.path)


class _NeighbourFinder(MetaPathFinder):
    """Finds the modules beside a file that its text imports, and no others."""

    def __init__(self, modules: Mapping[str, Path], contents: Mapping[Path, bytes]) -> None:
        self.modules, self.contents = modules, contents

    def find_spec(self, name: str, path: object = None, target: object = None) -> ModuleSpec | None:
        del path, target
        file = self.modules.get(name)
        if file is not None:
            found = spec_from_file_location(name, str(file), loader=_Source(name, file, self.contents[file]))
            if found is not None and file.name == "__init__.py":
                found.submodule_search_locations = []  # what is in it is found here alone
            return found
        if any(other.startswith(f"{name}.") for other in self.modules):  # a folder without __init__.py
            found = ModuleSpec(name, None, is_package=True)
            found.submodule_search_locations = []
            return found
        return None


def import_from(name: str, path: Path, local: Mapping[str, Path], contents: Mapping[Path, bytes]) -> None:
    """Import a file under a name in `sys.modules`, from contents that were read, and let it import from beside itself.

    What it imports are the files of `find_local_imports`; contents are those of all these. What modules of the same
    names were before, of other files, is forgotten.
    """
    for one in local:
        sys.modules.pop(one, None)
    specification = spec_from_file_location(name, str(path), loader=_Source(name, path, contents[path]))
    assert specification is not None
    assert specification.loader is not None
    sys.modules[name] = module_from_spec(specification)
    finder = _NeighbourFinder(local, contents)
    sys.meta_path.insert(0, finder)
    try:
        specification.loader.exec_module(sys.modules[name])
    except BaseException:
        del sys.modules[name]
        raise
    finally:
        sys.meta_path.remove(finder)


def send_by_value(module: ModuleType) -> None:
    """Let worker processes, which cannot import a file's module by name, be sent its functions and classes whole.

    Three things cloudpickle leaves by name or out of order: an alias of a type, what a dataclass's fields are where
    their annotations are texts, and what pydantic has built of a schema, whose parts lead back to the class.
    """
    import cloudpickle
    from pydantic_core import SchemaSerializer, SchemaValidator

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

    def __getattr__(self, name: str) -> object:
        if name.startswith("__"):
            raise AttributeError(name)
        if "built" not in self.__dict__:
            build, given = self.__dict__["recipe"]
            self.__dict__["built"] = build(*given)
        return getattr(self.__dict__["built"], name)
