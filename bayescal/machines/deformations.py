"""Deformation of the platform: a part that any kinematic model can take, by the names that configs use.

A deformation moves the joint b_i of each leg along the platform's z axis by a deflection that is linear in the
actuator displacements and linear in its own parameters (RR-8096 eqs. 1 and 2):
Δb_z = constant + Σ_k coefficient_k · parameter_k.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from bayescal.config.sections import Section
from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock, ParameterLayout
from bayescal.numerics.geometry import Array


@dataclass(frozen=True)
class DeformationBasis:
    """Actuator displacements and the deflections they cause, as a linear function of the parameters."""

    displacement: Array  # (..., N): Δρ, actuator displacements from the nominal initial position, mm
    constant: Array  # (..., N): the part of Δb_z without parameters, mm
    coefficients: Mapping[str, Array]  # (..., N): the factor of each per-leg parameter, mm
    # (..., N, N): dΔb_z,i / dΔρ_j at the nominal parameters; leading axes broadcast against those of the poses
    actuator_gain: Array

    def deflection(self, layout: ParameterLayout, theta: Array) -> Array:
        """Return Δb_z in mm, leading axes broadcast, shape (..., N)."""
        result = self.constant
        for symbol, coefficient in self.coefficients.items():
            result = result + layout.take(theta, symbol) * coefficient
        return result


@dataclass(frozen=True)
class NominalDeformation:
    """What is known of a machine's deformation before it is calibrated."""

    kappa: float  # κ of every leg
    matrix: Callable[[], Array]  # returns K, shape (N, N), in mm per mm; called only by a deformation that needs it


class Deformation(ABC):
    """A platform deformation: a name, its parameters and its basis.

    One of somebody else's is named in a config, ``deformation = "own.py:Own"``; its ``Config`` checks its options, and
    `__init__(self, config, nominal)` makes it.
    """

    name: ClassVar[str]
    Config: ClassVar[type[Section]] = Section
    uses_matrix: ClassVar[bool] = False
    is_rigid: ClassVar[bool] = False
    """Whether K enters, so that the uncertainty of a measured K counts."""

    @classmethod
    def from_config(cls, config: Any, nominal: NominalDeformation) -> Self:
        """Return a built-in deformation with its nominal values."""
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

    def coupling(self, n_legs: int) -> Array:
        """Return K, what is known of how actuators move all joints, shape (N, N), mm per mm; zeros by default."""
        return np.zeros((n_legs, n_legs))

    @abstractmethod
    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        """Return the constant and the coefficients for displacements (..., N) in mm."""

    def basis(self, displacement: Array) -> DeformationBasis:
        """Return the deflection as a linear function of the parameters, for displacements (..., N) in mm."""
        n_legs = displacement.shape[-1]
        if n_legs not in self._gains:
            self._gains[n_legs] = self._find_gain(n_legs)
        return DeformationBasis(displacement, *self._parts(displacement), self._gains[n_legs])

    @cached_property
    def _gains(self) -> dict[int, Array]:
        """`DeformationBasis.actuator_gain` by the number of legs: the same wherever the actuators stand."""
        return {}

    def _find_gain(self, n_legs: int) -> Array:
        layout, unit = ParameterLayout(self.blocks(n_legs)), np.eye(n_legs)
        moved = DeformationBasis(unit, *self._parts(unit), np.zeros((n_legs, n_legs)))
        return moved.deflection(layout, layout.nominal).T


class NoDeformation(Deformation):
    """No deformation: the platform is rigid, b* = b (RR-8096 section 7.1)."""

    name: ClassVar[str] = "none"
    is_rigid: ClassVar[bool] = True

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return no parameters."""
        del n_legs
        return ()

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        return np.zeros_like(displacement), {}


@dataclass(frozen=True)
class LinearDeformation(Deformation):
    """Each joint follows its own actuator, Δb_z,i = κ_i Δρ_i (RR-8096 eq. 1); ``kappa`` is nominal."""

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


@dataclass(frozen=True, eq=False)
class MatrixDeformation(Deformation):
    """Every actuator moves every joint, Δb_z = K Δρ (RR-8096 eq. 2), K of shape (N, N) in mm per mm.

    As in RR-8096 section 7.3 the calibration can move the diagonal of K, there called κ; the rest of K comes from the
    targets on the platform (eqs. 3 and 4).
    """

    matrix: Array
    name: ClassVar[str] = "matrix"
    uses_matrix: ClassVar[bool] = True

    @classmethod
    def from_nominal(cls, nominal: NominalDeformation) -> Self:
        """Return the deformation with the nominal K."""
        return cls(nominal.matrix())

    def coupling(self, n_legs: int) -> Array:
        """Return K."""
        del n_legs
        return self.matrix

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return the diagonal of K as κ."""
        if self.matrix.shape != (n_legs, n_legs):
            raise InputError(f"deformation matrix: found shape {self.matrix.shape}, expected {(n_legs, n_legs)}")
        return (ParameterBlock("kappa", tuple(float(k) for k in np.diagonal(self.matrix)), unit="1"),)

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        off_diagonal = self.matrix - np.diag(np.diagonal(self.matrix))
        return displacement @ off_diagonal.T, {"kappa": displacement}


@dataclass(frozen=True)
class FreeMatrixDeformation(Deformation):
    """Every actuator moves every joint, Δb_z = K Δρ, and nothing of K is known but a tolerance: nominally it is zero.

    The entries of K are parameters like any other, K_j of a leg what actuator j does to it. With normal priors about
    zero that is a model error that is linear in the travel, its coefficients explicit: what needs poses
    that err independently of each other, outliers for instance, has them then.
    """

    name: ClassVar[str] = "free_matrix"

    def blocks(self, n_legs: int) -> tuple[ParameterBlock, ...]:
        """Return the columns of K."""
        return tuple(ParameterBlock(f"K_{j + 1}", (0.0,) * n_legs, unit="1") for j in range(n_legs))

    def _parts(self, displacement: Array) -> tuple[Array, Mapping[str, Array]]:
        columns = np.broadcast_to(displacement[..., None, :], (*displacement.shape, displacement.shape[-1]))
        return np.zeros_like(displacement), {
            f"K_{j + 1}": columns[..., j].copy() for j in range(displacement.shape[-1])
        }


DEFORMATIONS: dict[str, type[Deformation]] = {
    deformation.name: deformation
    for deformation in (NoDeformation, LinearDeformation, MatrixDeformation, FreeMatrixDeformation)
}
