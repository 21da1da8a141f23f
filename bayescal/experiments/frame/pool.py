"""Tasks by what determines them: one result computed once, whichever run asks for it, and when."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bayescal.experiments.frame.store import Store
from bayescal.experiments.frame.versions import list_versions
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class Pool(Store):
    """A folder of finished tasks whose names are hashes of all that determines them; ``out`` is the folder.

    A task computed by another bayescal, or with other versions of what numbers depend on, counts as not finished. The
    folder may be removed at any time: what is missing is computed anew.
    """

    def locate_task(self, key: str) -> Path:
        """Return the file of a finished task, in one of 256 folders."""
        return self.out / key[-2:] / f"{key}.npz"

    def save_task(self, key: str, arrays: dict[str, Array]) -> None:
        """Keep a finished task; where another run keeps the same one just now, it may."""
        self.locate_task(key).parent.mkdir(parents=True, exist_ok=True)
        with suppress(FileExistsError, FileNotFoundError):
            super().save_task(key, arrays)

    @property
    def partial(self) -> Path:
        """Directory of the finished tasks."""
        return self.out


def open_pool(folder: Path) -> Pool:
    """Return a folder's tasks, those of this bayescal and these versions."""
    return Pool(folder, json.dumps(list_versions(), sort_keys=True))
