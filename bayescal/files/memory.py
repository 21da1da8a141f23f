"""Files in memory with the interface of `pathlib.Path`: what a Python call reads and writes needs no folder."""

from __future__ import annotations

import errno
import io
import os
import stat
import zlib
from collections.abc import Generator, Mapping
from pathlib import Path, PurePath
from typing import Any, Self

MODES = {"file": stat.S_IFREG | 0o644, "folder": stat.S_IFDIR | 0o755}


class MemoryPath(Path):
    """A path of a tree of files that is held in memory.

    All paths made from one share its tree: contents by their names relative to its root, whose folders are those that
    the names have. Whatever asks the operating system for such a path raises TypeError and never meets a file on disk.

    Parameters
    ----------
    *segments : str or PathLike
        Parts of the path, relative to the root of the tree.
    files : mapping of str to bytes, optional
        The tree's contents by their POSIX names; shared and changed in place where it is a dict.
    """

    files: dict[str, bytes]

    def __init__(self, *segments: str | os.PathLike[str], files: Mapping[str, bytes] | None = None) -> None:
        super().__init__(*(str(one) for one in segments))
        self.files = files if isinstance(files, dict) else dict(files or {})

    def with_segments(self, *segments: str | os.PathLike[str]) -> Self:
        """Return another path of the same tree."""
        return type(self)(*segments, files=self.files)

    def __fspath__(self) -> str:
        """Refuse: there is no such file on disk."""
        raise TypeError(f"{self}: a file in memory")

    def __eq__(self, other: object) -> bool:
        """Whether two paths are the same of the same tree."""
        return isinstance(other, MemoryPath) and self.files is other.files and self.parts == other.parts

    def __hash__(self) -> int:
        """Return a hash that equal paths share."""
        return hash(self.parts)

    def __reduce__(self) -> tuple[object, ...]:
        """Take the tree along to other processes."""
        return _restore, (type(self), self.parts, self.files)

    @property
    def _key(self) -> str:
        return os.path.normpath(self.as_posix())

    def resolve(self, strict: bool = False) -> Self:
        """Return the path without ``..`` in it."""
        del strict
        return self.with_segments(self._key)

    def absolute(self) -> Self:
        """Return the path itself."""
        return self

    def stat(self, *, follow_symlinks: bool = True) -> os.stat_result:
        """Return kind and size; FileNotFoundError where there is no such file and no folder of one."""
        del follow_symlinks
        key = self._key
        content = self.files.get(key)
        if content is None and key != "." and not any(name.startswith(f"{key}/") for name in self.files):
            raise _fail(FileNotFoundError, errno.ENOENT, self)
        mode = MODES["folder" if content is None else "file"]
        content = content or b""
        return os.stat_result((mode, zlib.crc32(content), 0, 1, 0, 0, len(content), 0, 0, 0))

    def open(self, mode: str = "r", *_: Any, encoding: str | None = None, **options: Any) -> Any:
        """Open a file as the built-in function does, to be read or to be written whole."""
        text = options if "b" not in mode else {}
        if "r" not in mode:
            if "x" in mode and self._key in self.files:
                raise _fail(FileExistsError, errno.EEXIST, self)
            stream: io.BytesIO = _Written(self)
        elif self._key in self.files:
            stream = io.BytesIO(self.files[self._key])
        else:
            self.stat()
            raise _fail(IsADirectoryError, errno.EISDIR, self)
        newline = text.get("newline")
        return stream if "b" in mode else io.TextIOWrapper(stream, encoding or "utf-8", newline=newline)

    def mkdir(self, mode: int = 0o777, parents: bool = False, exist_ok: bool = False) -> None:
        """Make nothing: a folder is there with its first file."""

    def unlink(self, missing_ok: bool = False) -> None:
        """Remove a file."""
        if self.files.pop(self._key, None) is None and not missing_ok:
            raise _fail(FileNotFoundError, errno.ENOENT, self)

    def replace(self, target: str | os.PathLike[str]) -> Self:
        """Give a file another name in its tree."""
        moved = self.with_segments(target)
        self.files[moved._key] = self.files.pop(self._key)
        return moved

    def rglob(self, pattern: str, **_: object) -> Generator[Self, None, None]:
        """Yield the files below a folder whose names match a pattern."""
        for name in sorted(self.files):
            path = self.with_segments(name)
            if path.is_relative_to(self.resolve()) and PurePath(name).match(pattern):
                yield self / PurePath(name).relative_to(self._key)

    def iterdir(self) -> Generator[Self, None, None]:
        """Yield files and folders of a folder."""
        names = [path.relative_to(self).parts[0] for path in self.rglob("*")]
        yield from (self / name for name in dict.fromkeys(names))

    def glob(self, pattern: str, **_: object) -> Generator[Self, None, None]:
        """Yield the files below a folder whose relative names match a pattern."""
        depth = len(PurePath(pattern).parts)
        yield from (path for path in self.rglob(pattern) if len(path.relative_to(self).parts) == depth)


class _Written(io.BytesIO):
    """Takes what is written, and puts it into the tree when it is closed."""

    def __init__(self, path: MemoryPath) -> None:
        super().__init__()
        self.path = path

    def close(self) -> None:
        if not self.closed:
            self.path.files[self.path._key] = self.getvalue()
        super().close()


def _fail(kind: type[OSError], number: int, path: MemoryPath) -> OSError:
    return kind(number, os.strerror(number), str(path))


def _restore(kind: type[MemoryPath], parts: tuple[str, ...], files: dict[str, bytes]) -> MemoryPath:
    return kind(*parts, files=files)


def write_tree(files: Mapping[str, bytes], folder: Path) -> None:
    """Write files by their names into a folder."""
    for name, content in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
