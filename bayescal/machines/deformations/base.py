"""Deformation of the platform: a part that any kinematic model can take.

A deformation moves the joint b_i of each leg along the platform's z axis by a deflection that is linear in the
actuator displacements and linear in its own parameters (RR-8096 eqs. 1 and 2):
Δb_z = constant + Σ_k coefficient_k · parameter_k.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class DeformationBasis:
    """Actuator displacements and the deflections they cause, as a linear function of the parameters.

    Attributes
    ----------
    displacement : ndarray, shape (..., N)
        Δρ, actuator displacements from the nominal initial position, mm.
    constant : ndarray, shape (..., N)
        The part of Δb_z without parameters, mm.
    coefficients : mapping of symbol to ndarray, shape (..., N)
        The factor of each per-leg parameter, mm.
    actuator_gain : ndarray, shape (..., N, N)
        dΔb_z,i / dΔρ_j at the nominal parameters; leading axes broadcast against those of the poses.
    """

    displacement: Array
    constant: Array
    coefficients: Mapping[str, Array]
    actuator_gain: Array

    def deflection(self, layout: ParameterLayout, theta: Array) -> Array:
        """Return Δb_z in mm, leading axes broadcast, shape (..., N)."""
        result = self.constant
        for symbol, coefficient in self.coefficients.items():
            result = result + layout.take(theta, symbol) * coefficient
        return result


@dataclass(frozen=True)
class NominalDeformation:
    """What is known of a machine's deformation before it is calibrated.

    Attributes
    ----------
    kappa : float
        κ of every leg.
    matrix : callable
        Returns K, shape (N, N), in mm per mm; called only by a deformation that needs it.
    """

    kappa: float
    matrix: Callable[[], Array]


class Deformation(ABC):
    """A platform deformation: a name, its parameters and its basis.

    One of somebody else's is named in a config, ``deformation = "own.py:Own"``; where it has options, these are checked
    by its ``Config`` and handed to `from_config`.
    """

    name: ClassVar[str]
    Config: ClassVar[type[Section]] = Section
    uses_matrix: ClassVar[bool] = False
    """Whether K enters, so that the uncertainty of a measured K counts."""

    hides_joints: ClassVar[bool] = False
    """Whether it leaves joints known to no better than their tolerances, so that leg lengths have to follow them."""

    @classmethod
    def from_config(cls, config: Any, nominal: NominalDeformation) -> Self:
        """Return the deformation with its nominal values, and options of a config, which it has none of by default."""
        del config
        return cls.from_nominal(nominal)

    @classmethod
    def from_nominal(cls, nominal: NominalDeformation) -> Self:
        """Return the deformation with its nominal values; one without any takes none."""
        del nominal
        return cls()

    @abstractmethod
    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return the parameters with their nominal values."""

    @abstractmethod
    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        """Return the constant and the coefficients for displacements (..., N) in mm."""

    def basis(self, displacement: Array) -> DeformationBasis:
        """Return the deflection as a linear function of the parameters, for displacements (..., N) in mm."""
        n_legs = displacement.shape[-1]
        layout = ParameterLayout(self.blocks(n_legs))
        constant, coefficients = self._parts(displacement)
        unit_constant, unit_coefficients = self._parts(np.eye(n_legs))
        unit = DeformationBasis(np.eye(n_legs), unit_constant, unit_coefficients, np.zeros((n_legs, n_legs)))
        return DeformationBasis(displacement, constant, coefficients, unit.deflection(layout, layout.nominal).T)
