"""Kinematic models, by the names that configs use."""

from bayescal.machines.models.base import BoundClosure, KinematicModel, Linearisation
from bayescal.machines.models.beam import Beam
from bayescal.machines.models.jacobian import Jacobian
from bayescal.machines.models.six_pus import SixPus
from bayescal.machines.models.six_ups import SixUps
from bayescal.machines.models.stiffness import FixedStiffness, Stiffness

MODELS: dict[str, type[KinematicModel]] = {
    model.name: model for model in (SixPus, Jacobian, Beam, Stiffness, FixedStiffness, SixUps)
}

__all__ = [
    "MODELS",
    "Beam",
    "BoundClosure",
    "FixedStiffness",
    "Jacobian",
    "KinematicModel",
    "Linearisation",
    "SixPus",
    "SixUps",
    "Stiffness",
]
