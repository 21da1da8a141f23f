"""An experiment as a Python call states it: the content of a config, and the files that it names, in memory."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from bayescal.config.sections import ExperimentConfig
from bayescal.errors import InputError, SeveralFaultsError
from bayescal.experiments.runner.load import check_content
from bayescal.files.memory import MemoryPath, write_tree
from bayescal.files.table_files import list_beside
from bayescal.files.toml import write_toml

if TYPE_CHECKING:
    import pandas as pd  # tables need it, naming things does not

CONFIG = "study.toml"
ARGUMENTS = {"parameters": "tolerances", "sensors": "noise", "poses.count": "poses"}
"""What a call names its arguments, by the keys of a config."""

type Table = pd.DataFrame | Mapping[str, ArrayLike] | Path | str
"""A table, or the CSV file of one."""


@dataclass(frozen=True, eq=False)
class StatedExperiment:
    """An experiment that a call states: the content of its config, and the files that this names.

    ``labels`` are what the caller knows parts of it by: of a file its argument or its path, of a key its argument;
    ``frames`` the files that are tables given in Python.
    ``file`` is the config's own name beside the files.
    """

    content: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)
    labels: dict[str, str] = field(default_factory=lambda: dict(ARGUMENTS))
    frames: set[str] = field(default_factory=set)
    file: str = CONFIG

    def state(self, **sections: object) -> None:
        """Add sections to the content, files and tables in them as names of files."""
        self.content.update({name: one for name, value in sections.items() if (one := self._state(value, name)) != {}})

    def _state(self, value: Any, label: str) -> Any:
        """Return a value with Python's own numbers, lists and mappings, without what is None."""
        if isinstance(value, Mapping):
            return {str(key): self._state(one, f"{label}.{key}") for key, one in value.items() if one is not None}
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        if isinstance(value, Path) or hasattr(value, "to_csv"):
            return self.add_table(value, f"data/{label.rpartition('.')[2]}.csv", label)
        return [self._state(one, label) for one in value] if isinstance(value, list | tuple) else value

    def add_table(self, table: Path | pd.DataFrame, name: str, label: str) -> str:
        """Keep a table, or a file by its own name, beside what is kept; return its name."""
        path = Path(f"data/{table.name}" if isinstance(table, Path) else name)
        while path.as_posix() in self.files:
            path = path.with_stem(f"{path.stem}_")
        name = path.as_posix()
        self.labels[name] = str(table) if isinstance(table, Path) else label
        if not isinstance(table, Path):
            self.frames.add(name)
            self.files[name] = name_rows(table).to_csv(index=False).encode()
        elif table.is_file():  # of one that is not there the reader says so
            self.files[name] = table.read_bytes()
            for beside in list_beside(table.name, table.parent)[1:]:
                self._add_beside(table.parent / beside, os.path.normpath(path.parent / beside))
        return name

    def _add_beside(self, path: Path, name: str) -> None:
        """Keep the table that a TOML file names."""
        content = path.read_bytes() if path.is_file() else None
        if content is not None and self.files.setdefault(name, content) != content:
            raise InputError(f"{path}: found another table of this name, expected one")
        self.labels[name] = str(path)

    @property
    def root(self) -> MemoryPath:
        """The folder of the files."""
        return MemoryPath(files=self.files)

    @contextmanager
    def named(self) -> Iterator[ExperimentConfig]:
        """Let messages name what the caller knows, all faults at once; the checked config."""
        from bayescal.experiments.runner.run import add_file_faults

        try:
            yield check_content(self.content, self.root / self.file)[1]
        except InputError as error:
            faults = add_file_faults(error, self.content, self.root)
            raise SeveralFaultsError([*dict.fromkeys(self._label(one) for one in faults.lines)]) from None

    def _label(self, line: str) -> str:
        """Return a fault with the caller's name of its place: of a row of a table given in Python its number."""
        said = re.sub(rf"^({re.escape(self.file)}: )+", "", line)
        for name in sorted(self.labels, key=len, reverse=True):
            if re.match(rf"{re.escape(name)}(?![\w/])", said):
                rest, label = said[len(name) :], self.labels[name]
                if name in self.frames:
                    rest = re.sub(r"\bline (\d+)", lambda found: f"row {int(found[1]) - 1}", rest)
                return label + rest
        return said

    def to_toml(self, folder: Path | str | None = None) -> str:
        """Return the config as the shell reads it; written with the files to a folder if one is named."""
        text = write_toml(self.content)
        if folder is not None:
            write_tree({**self.files, self.file: text.encode()}, Path(folder))
        return text


def name_rows(table: pd.DataFrame | Mapping[str, ArrayLike]) -> pd.DataFrame:
    """Return a table whose first column names the poses: its own, else the index, else P1, P2 ..."""
    import pandas as pd

    alone = isinstance(table, Mapping) and all(np.ndim(one) == 0 for one in table.values())
    found = pd.DataFrame([table] if alone else table)
    if "pose" not in found.columns:
        plain = isinstance(found.index, pd.RangeIndex)
        names = [f"P{k}" for k in range(1, len(found) + 1)] if plain else [str(one) for one in found.index]
        found = found.reset_index(drop=True)
        found.insert(0, "pose", names)
    return found
