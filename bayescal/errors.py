"""The three ways a computation can end other than well, each with its exit code."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path


class BayescalError(Exception):
    """Base of every error that bayescal raises on purpose; its message is one line.

    Examples
    --------
    >>> issubclass(bc.BayescalError, ValueError)
    False
    """

    exit_code = 1


class InputError(BayescalError):
    """The input is at fault: the message names where, what was found and what was expected.

    Attributes
    ----------
    others : tuple of str
        What else is at fault in the same place, a line each, of which only a look at everything speaks.

    Examples
    --------
    >>> try:
    ...     bc.load_machine("nowhere.toml")
    ... except bc.InputError as error:
    ...     print(error)
    nowhere.toml: no such file...
    """

    exit_code = 2

    def __init__(self, message: str, others: Iterable[str] = ()) -> None:
        super().__init__(message)
        self.others = tuple(others)

    @property
    def lines(self) -> tuple[str, ...]:
        """The message, and what else is at fault."""
        return (str(self), *self.others)


def say_unknown(where: str, found: object, known: Iterable[str]) -> str:
    """Return that a name which was found somewhere is none of those known there."""
    return f"{where}: found {found!r}, expected one of {', '.join(known) or 'none'}"


def say_twice(where: str, name: str) -> str:
    """Return that a name stands somewhere more than once."""
    return f"{where}: found {name!r} twice, expected unique names"


def say_reversed(where: str, low: float, high: float) -> str:
    """Return that a range begins above its end."""
    return f"{where}: found {low:g} to {high:g}, expected the smaller first"


class SeveralFaultsError(InputError):
    """All faults that were looked for together; its message has a line for each."""

    def __init__(self, lines: Sequence[str]) -> None:
        super().__init__(lines[0], lines[1:])

    @property
    def lines(self) -> tuple[str, ...]:
        """The faults."""
        return (self.args[0], *self.others)

    def __str__(self) -> str:
        """Return the faults, a line each."""
        return "\n".join(self.lines)


class PoseInputError(InputError):
    """One pose of many, counted from zero, is at fault; whoever knows its name puts it instead of the number."""

    def __init__(self, index: int, fault: str) -> None:
        super().__init__(f"fit {index}: {fault}")
        self.index, self.fault = index, fault


class NumericalError(BayescalError):
    """The input was accepted, but a computation failed or did not converge.

    Examples
    --------
    >>> bc.NumericalError.exit_code, bc.InputError.exit_code
    (3, 2)
    """

    exit_code = 3


@contextmanager
def name_faults(what: Path | str) -> Iterator[None]:
    """Put the name of a file or a variant before what is wrong with it, where the message does not start with it."""
    try:
        yield
    except InputError as error:
        first, *others = (text if text.startswith(str(what)) else f"{what}: {text}" for text in error.lines)
        raise InputError(first, others) from error
