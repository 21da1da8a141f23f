"""Whether code that is not the library's own may be imported because a file names it."""

from __future__ import annotations

from contextvars import ContextVar

_ALLOWED: ContextVar[bool] = ContextVar("own classes are imported", default=True)


def allow_own_classes(allowed: bool) -> None:
    """Say whether files beside configs, other modules and installed packages' classes may be imported from now on."""
    _ALLOWED.set(allowed)


def are_own_classes_allowed() -> bool:
    """Whether they may."""
    return _ALLOWED.get()
