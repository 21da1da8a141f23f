"""The 6-PUS model: flexures as perfect spherical joints, legs of fixed length (RR-8096 section 4.1).

Closure of leg i (eq. 30): f = l - |g| with g = p + R (b + Δb_z e_z) - a - ρ u. The model holds for any number of legs.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from bayescal.machines.deformations import DeformationBasis
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.models.base import BoundClosure
from bayescal.machines.models.leg_distance import LegDistance, LegDistanceClosure, list_point_blocks
from bayescal.machines.models.legs import chart_of
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array


class SixPus(LegDistance):
    """P-U-S legs with perfect joints."""

    name: ClassVar[str] = "six_pus"
    title: ClassVar[str] = "6-PUS"

    def blocks(self, mechanism: Mechanism) -> tuple[ParameterBlock, ...]:
        """Return a, b, u (two components, see `parameters`), l and ρ^0 of each leg."""
        chart = mechanism.chart
        components = chart.to_local(mechanism.directions)[:, :2].T
        return (
            *list_point_blocks(mechanism),
            *(
                ParameterBlock(symbol, tuple(v.tolist()), "1", lower=-1.0, upper=1.0)
                for symbol, v in zip(chart.symbols, components, strict=True)
            ),
            ParameterBlock("l", tuple(mechanism.leg_lengths.tolist()), lower=0.0),
            ParameterBlock("rho0", tuple(mechanism.initial_actuator_positions.tolist())),
        )

    def bind(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> BoundClosure:
        """Return the closure as matrix products per leg."""
        return SixPusClosure(layout, position, rotation, basis)


class SixPusClosure(LegDistanceClosure):
    """f = l - |g| for batches; lower joints a + ρ u have the features c = a + ρ^0 u and, times Δρ, u."""

    n_travel: ClassVar[int] = 3

    def __init__(self, layout: ParameterLayout, position: Array, rotation: Array, basis: DeformationBasis) -> None:
        super().__init__(layout, position, rotation, basis)
        for k in range(3):
            self._design[k, :, :, k - 3] = basis.displacement.T
        self._chart = chart_of(layout)
        self._direction = np.stack([layout.index[symbol] for symbol in self._chart.symbols])

    def _fill_lower(self, parameters: Array, lower: Array) -> None:
        """Write c and u, shapes (3, N, B)."""
        home, direction = lower[:3], lower[3:]
        np.take(parameters, self._direction, axis=0, out=direction[:2], mode="clip")
        self._chart.complete(direction)
        np.multiply(parameters[self._layout.index["rho0"]], direction, out=home)
        home += parameters[self._base]
