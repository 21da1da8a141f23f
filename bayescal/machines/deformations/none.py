"""No deformation: the platform is rigid, b* = b (RR-8096 section 7.1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from bayescal.machines.deformations.base import Deformation
from bayescal.machines.parameters import ParameterBlock
from bayescal.numerics.geometry import Array


class NoDeformation(Deformation):
    """A rigid platform."""

    name: ClassVar[str] = "none"

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return no parameters."""
        del n_legs
        return ()

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        return np.zeros_like(displacement), {}
