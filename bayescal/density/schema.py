"""Sections of configs that say what is known of parameters and of a model's error beforehand."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from bayescal.config.sections import PerLeg, Positive, PositivePerLeg, Section


class NormalConfig(Section):
    """Normal tolerance about the nominal value; sd in the parameter's unit (mm for lengths)."""

    prior: Literal["normal"]
    sd: PositivePerLeg


class UniformConfig(Section):
    """Uniform within a half width about the nominal value."""

    prior: Literal["uniform"]
    half_width: PositivePerLeg


class FixedConfig(Section):
    """Not free: held at the nominal value plus an offset."""

    prior: Literal["fixed"]
    offset: PerLeg = 0.0


type PriorConfig = Annotated[NormalConfig | UniformConfig | FixedConfig, Field(discriminator="prior")]


class ModelErrorConfig(Section):
    """Half-normal prior of the model error τ; one τ per leg or one for all legs."""

    scale_um: Positive = 10.0
    per_leg: bool = True


class BlundersConfig(Section):
    """Poses may be blunders: the share of them that is expected, whose posterior is inferred."""

    expected_share: Annotated[float, Field(gt=0.0, lt=0.5)] = 0.02
