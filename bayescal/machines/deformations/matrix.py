"""Matrix deformation: every actuator moves every joint, Δb_z = K Δρ (RR-8096 eq. 2).

As in RR-8096 section 7.3 the calibration can move the diagonal of K, there called κ; the rest of K comes from the
targets on the platform (eqs. 3 and 4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from bayescal.errors import InputError
from bayescal.machines.deformations.base import Deformation, NominalDeformation
from bayescal.machines.parameters import ParameterBlock
from bayescal.numerics.geometry import Array


@dataclass(frozen=True, eq=False)
class MatrixDeformation(Deformation):
    """Deflection through the coefficient matrix K, shape (N, N), in mm of Δb_z per mm of Δρ."""

    matrix: Array
    name: ClassVar[str] = "matrix"
    uses_matrix: ClassVar[bool] = True

    @classmethod
    def from_nominal(cls, nominal: NominalDeformation) -> Self:
        """Return the deformation with the nominal K."""
        return cls(nominal.matrix())

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return the diagonal of K as κ."""
        if self.matrix.shape != (n_legs, n_legs):
            raise InputError(f"deformation matrix: found shape {self.matrix.shape}, expected {(n_legs, n_legs)}")
        return (ParameterBlock("kappa", tuple(float(k) for k in np.diagonal(self.matrix)), unit="1"),)

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        off_diagonal = self.matrix - np.diag(np.diagonal(self.matrix))
        return displacement @ off_diagonal.T, {"kappa": displacement}
