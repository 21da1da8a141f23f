"""Linear deformation: each joint follows its own actuator, Δb_z,i = κ_i Δρ_i (RR-8096 eq. 1)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from bayescal.machines.deformations.base import Deformation, NominalDeformation
from bayescal.machines.parameters import ParameterBlock
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class LinearDeformation(Deformation):
    """Deflection proportional to the leg's own actuator displacement, with the nominal coefficient ``kappa``."""

    kappa: float
    name: ClassVar[str] = "linear"

    @classmethod
    def from_nominal(cls, nominal: NominalDeformation) -> Self:
        """Return the deformation with the nominal κ."""
        return cls(nominal.kappa)

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return κ of each leg."""
        return (ParameterBlock("kappa", (self.kappa,) * n_legs, unit="1"),)

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        return np.zeros_like(displacement), {"kappa": displacement}
