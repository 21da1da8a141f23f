"""Platform deformations, by the names that configs use."""

from bayescal.deformations.base import Deformation, DeformationBasis, NominalDeformation
from bayescal.deformations.linear import LinearDeformation
from bayescal.deformations.matrix import MatrixDeformation
from bayescal.deformations.none import NoDeformation

DEFORMATIONS: dict[str, type[Deformation]] = {
    deformation.name: deformation for deformation in (NoDeformation, LinearDeformation, MatrixDeformation)
}

__all__ = [
    "DEFORMATIONS",
    "Deformation",
    "DeformationBasis",
    "LinearDeformation",
    "MatrixDeformation",
    "NoDeformation",
    "NominalDeformation",
]
