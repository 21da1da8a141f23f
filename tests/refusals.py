"""What a call is refused with: one line."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from bayescal.errors import BayescalError, InputError


def line_of(call: Callable[..., object], *arguments: object, error: type[BayescalError] = InputError) -> str:
    """Return the one line with which a call fails."""
    with pytest.raises(error) as caught:
        call(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)
