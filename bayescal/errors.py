"""The three ways a computation can end other than well, each with its exit code."""

from __future__ import annotations


class BayescalError(Exception):
    """Base of every error that bayescal raises on purpose; its message is one line."""

    exit_code = 1


class InputError(BayescalError):
    """The input is at fault: the message names where, what was found and what was expected."""

    exit_code = 2


class NumericalError(BayescalError):
    """The input was accepted, but a computation failed or did not converge."""

    exit_code = 3
