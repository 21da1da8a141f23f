"""Kinematic models, by the names that configs use."""

from bayescal.models.base import BoundClosure, KinematicModel, Linearisation
from bayescal.models.six_pus import SixPus

MODELS: dict[str, type[KinematicModel]] = {SixPus.name: SixPus}

__all__ = ["MODELS", "BoundClosure", "KinematicModel", "Linearisation", "SixPus"]
