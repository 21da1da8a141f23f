"""Whose code is run: files that configs and results name, once their user has trusted them; nothing else.

A file is trusted by its content, wherever it lies: hashes are kept per user, and a file that was changed asks again.
With ``BAYESCAL_TRUST=1`` everything is trusted, for machines where nobody can be asked.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bayescal.config.local_imports import find_local_imports
from bayescal.errors import InputError
from bayescal.files.atomic import make_directory, read_json, write_atomically

TRUST = "BAYESCAL_TRUST"
"""Environment variable that trusts all code, unless it is empty or 0."""
NAMED = re.compile(r"(?P<file>[^:]+\.py):\w+")
"""A class in a file, as configs name it."""


@dataclass(frozen=True)
class Policy:
    """What becomes of code that is not the library's own."""

    own: bool = True  # whether any is run, that of installed packages among it
    everything: bool = False  # whether files are trusted unasked
    ask: Callable[[str], bool] | None = None  # asks at the terminal; without it untrusted code is refused
    say: Callable[[str], None] | None = None  # takes the line that names the files that are run
    said: set[str] = field(default_factory=set)  # what was said before


_POLICY: ContextVar[Policy | None] = ContextVar("policy", default=None)
_trusted_here: set[str] = set()  # by this process alone


def change_policy(**changes: Any) -> None:
    """Change fields of the policy from now on; without any the policy is as it was at first."""
    _POLICY.set(replace(_find_policy(), **changes) if changes else None)


@contextmanager
def trusting(everything: bool = True) -> Iterator[None]:
    """Trust all code meanwhile, or, where that is not wanted, what was trusted before."""
    token = _POLICY.set(replace(_find_policy(), everything=True) if everything else _POLICY.get())
    try:
        yield
    finally:
        _POLICY.reset(token)


def _find_policy() -> Policy:
    return _POLICY.get() or Policy()


def are_own_classes_allowed() -> bool:
    """Whether files beside configs and installed packages' classes may be imported at all."""
    return _find_policy().own


def permit(files: Mapping[Path, bytes], folder: Path) -> None:
    """Let the code of files be run, and say so; whoever sits at a terminal is asked for what they have not trusted.

    The file that is named comes first; its name starts at ``folder``, for the message. InputError where nobody has
    trusted one of them; nothing of them has been run then.
    """
    policy, hashes = _find_policy(), {path: hash_file(content) for path, content in files.items()}
    if set(hashes.values()) <= _trusted_here:
        return
    code = f"{', '.join(str(path.relative_to(folder.resolve(), walk_up=True)) for path in files)} in {folder}"
    if not policy.everything and os.environ.get(TRUST, "0") in ("", "0"):
        kept = _read_kept()
        unknown = [path for path, found in hashes.items() if found not in kept and found not in _trusted_here]
        if unknown:
            changed = set(map(str, unknown)) & set(kept.values())
            state = f"code ({code}) that {'changed since trusted' if changed else 'nobody has trusted'}"
            asked = f"Found {state}; it can do whatever you can. Run it?"
            again = asked in policy.said
            policy.said.add(asked)  # once a command, whatever the answer
            if policy.ask is None or again or not policy.ask(asked):
                place = folder.parent if (folder.parent / "provenance.json").is_file() else folder
                raise InputError(f"{state}: read it, then bayescal trust {place}")
            with suppress(OSError):  # where nothing can be kept, it is asked for again
                remember(unknown)
            _trusted_here.update(hashes.values())
            return
    said = f"running code of {code}"
    if policy.say is not None and said not in policy.said:
        policy.said.add(said)
        policy.say(said)


def vouch(contents: Iterable[bytes]) -> None:
    """Trust files by their contents for as long as this process lives: whoever made them runs them anyway."""
    _trusted_here.update(map(hash_file, contents))


def trust(folder: Path | str) -> list[Path]:
    """Trust the code that configs and results in a folder or below name, as ``bayescal trust`` does; return its files.

    What Python passes as a class or an object has been run anyway and needs no trust; what a TOML file names is run
    only where its user has trusted the file, or ``BAYESCAL_TRUST=1`` is set.

    Examples
    --------
    >>> import bayescal as bc
    >>> [path.name for path in bc.trust("examples/own_machine")]
    ['linear_delta.py']
    """
    files = list_code(Path(folder))
    remember(files)
    return files


def remember(paths: Iterable[Path]) -> None:
    """Trust files from now on, for this user."""
    found = {hash_file(path.read_bytes()): str(path.resolve()) for path in paths}
    kept = {sha: path for sha, path in _read_kept().items() if path not in found.values()} | found
    make_directory(_store().parent)
    write_atomically(_store(), (json.dumps({"sha256": kept}, indent=1) + "\n").encode())


def forget(paths: Iterable[Path]) -> None:
    """Trust files no longer, nor what stood in them when they were trusted."""
    gone = {str(path.resolve()): hash_file(path.read_bytes()) for path in paths}
    _trusted_here.difference_update(gone.values())
    kept = {sha: path for sha, path in _read_kept().items() if path not in gone and sha not in gone.values()}
    write_atomically(_store(), (json.dumps({"sha256": kept}, indent=1) + "\n").encode())


def _store() -> Path:
    """Return where trusted files are kept, in the platform's folder for settings of a user."""
    from typer import get_app_dir

    return Path(get_app_dir("bayescal")) / "trusted.json"


def _read_kept() -> dict[str, str]:
    """Return the SHA-256 of trusted files, with where they were."""
    if not _store().is_file():
        return {}
    kept = read_json(_store()).get("sha256")
    if not isinstance(kept, dict) or not all(isinstance(path, str) for path in kept.values()):
        raise InputError(f"{_store()}: found no hashes of trusted files")
    return kept


# --- which files would be run ----------------------------------------------------------------------------------------


def list_code(folder: Path) -> list[Path]:
    """Return the files whose code configs and results in a folder or below name, with what these import from beside.

    Nothing is imported for it. Files of xacro evaluate expressions, those of YAML beside them too.
    """
    found: dict[Path, None] = {}
    if any(folder.rglob("*.xacro")):
        found |= {path.resolve(): None for end in ("xacro", "yaml", "yml") for path in sorted(folder.rglob(f"*.{end}"))}
    for path in sorted(folder.rglob("*.toml")):  # results keep their config
        for name in _list_named(path):
            file = path.parent / name
            if file.is_file() and file.resolve().is_relative_to(folder.resolve()):
                found |= dict.fromkeys([file.resolve(), *find_local_imports(file).values()])
    return list(found)


def _list_named(path: Path) -> Iterator[str]:
    """Yield the files of classes that a config names."""
    import tomllib

    try:
        waiting: list[object] = [tomllib.loads(path.read_text(encoding="utf-8-sig"))]
    except (OSError, ValueError, RecursionError):  # whoever reads it says so
        return
    while waiting:
        one = waiting.pop()
        if isinstance(one, dict | list):
            waiting += one.values() if isinstance(one, dict) else one
        elif isinstance(one, str) and (named := NAMED.fullmatch(one)):
            yield named["file"]


# --- whether files are those that results were made of ---------------------------------------------------------------


def check_same(folder: Path, names: Iterable[str], known: Collection[str] | None) -> None:
    """Raise InputError for a file that is none of those that results go back to, by their SHA-256."""
    for name in names:
        path = folder / name
        if not path.is_file():
            raise InputError(f"{path}: no such file, expected the results' copy")
        if known is not None and hash_file(path.read_bytes()) not in known:
            raise InputError(f"{path}: differs from the file of the results")


def hash_file(content: bytes) -> str:
    """Return the SHA-256 of a file."""
    return hashlib.sha256(content).hexdigest()
