"""Platform deformations, by the names that configs use."""

from bayescal.machines.deformations.base import Deformation, DeformationBasis, NominalDeformation
from bayescal.machines.deformations.free_matrix import FreeMatrixDeformation
from bayescal.machines.deformations.linear import LinearDeformation
from bayescal.machines.deformations.matrix import MatrixDeformation
from bayescal.machines.deformations.none import NoDeformation

DEFORMATIONS: dict[str, type[Deformation]] = {
    deformation.name: deformation
    for deformation in (NoDeformation, LinearDeformation, MatrixDeformation, FreeMatrixDeformation)
}

__all__ = [
    "DEFORMATIONS",
    "Deformation",
    "DeformationBasis",
    "FreeMatrixDeformation",
    "LinearDeformation",
    "MatrixDeformation",
    "NoDeformation",
    "NominalDeformation",
]
