"""Sections of configs that say how much effort inference makes."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import Positive, Section


class SamplerConfig(Section):
    """Ensembles of walkers."""

    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    """Number of independent ensembles of walkers, each of which is a chain."""
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    """Walkers of an ensemble."""
    burn_in: Annotated[int, Field(ge=0, le=100_000)] = 40
    """Steps that are dropped at the beginning."""
    steps: Annotated[int, Field(ge=2, le=100_000)] = 80
    """Steps that are kept; more of them lower R-hat."""


def count_walkers(n_parameters: int, n_walkers: int) -> int:
    """Return an even number of walkers, at least as many as asked for and as the moves need."""
    return max(n_walkers, 2 * n_parameters + 2) // 2 * 2


class EvidenceConfig(Section):
    """Effort of the evidence estimators; importance sampling goes on until its standard error is small enough.

    On demand each evidence is checked by tempering, which owes nothing to the search for modes.
    """

    draws: Annotated[int, Field(ge=1000, le=10_000_000)] = 20_000
    """Draws for importance sampling to begin with."""
    max_draws: Annotated[int, Field(ge=1000, le=10_000_000)] = 100_000
    """Draws at which it ends, whatever its error is."""
    target_error: Positive = 0.01
    """Standard error of the log-evidence at which it ends [nat]."""
    check: Literal["tempered"] | None = Field(default=None, exclude_if=lambda value: value is None)
    """`"tempered"`: check each evidence by tempering from the prior, which takes longer."""

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.max_draws < self.draws:
            raise ValueError(f"found max_draws {self.max_draws} below draws {self.draws}, expected it not below")
        return self


class DrawsConfig(Section):
    """Draws of the posterior, all ensembles together."""

    draws: Annotated[int, Field(ge=0, le=10_000_000)] | None = None
    """Number of draws; 0 for none, many where nothing is said."""
    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    """Number of independent ensembles of walkers."""
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    """Walkers of an ensemble."""
    burn_in: Annotated[int, Field(ge=0, le=100_000)] = 20
    """Steps that are dropped at the beginning."""
