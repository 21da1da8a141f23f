"""Free matrix: every actuator moves every joint, Δb_z = K Δρ, and nothing of K is known but a tolerance.

The entries of K are parameters like any other, K_j of a leg what actuator j does to it. With normal priors about zero
that is the structured model error that is linear in the travel, its coefficients explicit: what needs poses that err
independently of each other, blunders for instance, has them then.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayescal.machines.deformations.base import Deformation
from bayescal.machines.parameters import ParameterBlock
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class FreeMatrixDeformation(Deformation):
    """Deflection through a coefficient matrix K whose entries are all parameters, nominally zero."""

    name: ClassVar[str] = "free_matrix"
    hides_joints: ClassVar[bool] = True

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return the columns of K."""
        return tuple(ParameterBlock(f"K_{j + 1}", (0.0,) * n_legs, unit="1") for j in range(n_legs))

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        columns = np.broadcast_to(displacement[..., None, :], (*displacement.shape, displacement.shape[-1]))
        return np.zeros_like(displacement), {
            f"K_{j + 1}": columns[..., j].copy() for j in range(displacement.shape[-1])
        }
