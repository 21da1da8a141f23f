"""Sections of configs that say how much effort inference makes."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import Positive, Section


class SamplerConfig(Section):
    """Ensembles of walkers."""

    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    burn_in: Annotated[int, Field(ge=0, le=100_000)] = 40
    steps: Annotated[int, Field(ge=2, le=100_000)] = 80


class EvidenceConfig(Section):
    """Effort of the evidence estimators; importance sampling goes on until its standard error is small enough.

    On demand each evidence is checked by tempering, which owes nothing to the search for modes.
    """

    draws: Annotated[int, Field(ge=1000, le=10_000_000)] = 20_000
    max_draws: Annotated[int, Field(ge=1000, le=10_000_000)] = 100_000
    target_error: Positive = 0.01
    check: Literal["tempered"] | None = Field(default=None, exclude_if=lambda value: value is None)

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.max_draws < self.draws:
            raise ValueError(f"found max_draws {self.max_draws} below draws {self.draws}, expected it not below")
        return self


class DrawsConfig(Section):
    """Draws of the posterior, all ensembles together: by default many where there are data, otherwise none."""

    draws: Annotated[int, Field(ge=0, le=10_000_000)] | None = None
    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    burn_in: Annotated[int, Field(ge=0, le=100_000)] = 20
