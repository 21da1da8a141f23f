"""Arrays kept between calls of a hot loop: the page faults of fresh ones cost more than the arithmetic done in them."""

from __future__ import annotations

from math import prod

import numpy as np

from bayescal.numerics.geometry import Array


class Scratch:
    """Named scratch arrays, contents undefined; every array is valid until its name is taken again."""

    def __init__(self) -> None:
        self._buffers: dict[str, Array] = {}

    def take(self, name: str, *shape: int) -> Array:
        """Return a C-contiguous scratch array of the given shape."""
        size = prod(shape)
        buffer = self._buffers.get(name)
        if buffer is None or buffer.size < size:
            buffer = self._buffers[name] = np.empty(size)
        return buffer[:size].reshape(shape)
