"""The 6-UPS model: struts between fixed joints, whose lengths the actuators change (Yu, Wu and Wang 2023 section 2.1).

Closure of leg i: f = l + Δρ - |g| with g = p + R (b + Δb_z e_z) - a, the strut's vector of their eq. (1), and |g| its
length of eq. (3); l is the length at the initial actuator position. They call the joints on the platform a and those
on the base b; here a is the base's, as in RR-8096. The model holds for any number of legs.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

import numpy as np

from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Drive, Mechanism
from bayescal.machines.models.base import BoundClosure, Linearisation
from bayescal.machines.models.leg_distance import LegDistance, LegDistanceClosure, list_point_blocks
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array


class SixUps(LegDistance):
    """U-P-S struts with perfect joints."""

    name: ClassVar[str] = "six_ups"
    title: ClassVar[str] = "6-UPS"
    drive: ClassVar[Drive] = "strut"

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return a, b and l of each leg."""
        lengths = ParameterBlock("l", tuple(mechanism.leg_lengths.tolist()), lower=0.0)
        return (*list_point_blocks(mechanism), lengths)

    def _close(
        self,
        layout: ParameterLayout,
        theta: Array,
        position: Array,
        rotation: Array,
        basis: DeformationBasis,
        with_parameters: bool = True,
    ) -> Linearisation:
        """Return l + Δρ - |g| and its exact derivatives; see `Closure` for shapes and frames."""
        still = super()._close(layout, theta, position, rotation, basis, with_parameters)
        actuators = still.actuators + np.eye(basis.displacement.shape[-1])
        return replace(still, residual=still.residual + basis.displacement, actuators=actuators)

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure as matrix products per leg."""
        return SixUpsClosure(layout, position, rotation, basis)


class SixUpsClosure(LegDistanceClosure):
    """f = l + Δρ - |g| for batches."""

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        super().__init__(layout, position, rotation, basis)
        self._displacement = np.ascontiguousarray(basis.displacement.T)[..., None]

    def evaluate(self, theta: Array) -> Array:
        """Return f, shape (N, P, B)."""
        result = super().evaluate(theta)
        result += self._displacement
        return result
