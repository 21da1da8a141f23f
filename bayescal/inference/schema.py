"""Sections of configs that say how much effort inference makes."""

from __future__ import annotations

from typing import Annotated, Final, Self

from pydantic import AfterValidator, Field, field_validator, model_validator

from bayescal.config.classes import ClassMark
from bayescal.config.sections import Positive, Section
from bayescal.errors import InputError

SHORT: Final = (5, 15)
"""Steps to drop and to keep where importance weights show that the proposal is nearly the posterior."""
USUAL: Final = (40, 80)
"""The same elsewhere."""
MOST_STEPS: Final = 320
"""Steps up to which ensembles go on by themselves while their diagnostics ask for more."""
FIRST_DRAWS: Final = 4000
"""Draws for importance sampling to begin with."""


def is_none(value: object) -> bool:
    """Whether a key of a config was not stated."""
    return value is None


EMCEE: Final = "emcee"


def check_installed[S: (str, str | None)](name: S) -> S:
    """Return a sampler's name; ValueError where its library is not installed."""
    found = getattr(name, "found", None)
    if found is not None:
        try:
            found.check_installed()
        except InputError as error:
            raise ValueError(str(error)) from error
    return name


class SamplerConfig(Section):
    """What draws the posteriors: ensembles of walkers, or another sampler.

    Where steps are not stated, their number follows the posterior: few where the proposal is nearly the posterior, and
    more, up to 320, until the diagnostics pass.
    """

    backend: Annotated[str, ClassMark("SAMPLERS"), AfterValidator(check_installed)] = Field(
        default=EMCEE, exclude_if=lambda value: value == EMCEE
    )
    """The sampler by its name, or a table of its `class` and options; `bayescal list samplers` shows all."""
    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    """Number of independent ensembles of walkers, each of which is a chain."""
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    """Walkers of an ensemble."""
    burn_in: Annotated[int, Field(ge=0, le=100_000)] | None = Field(default=None, exclude_if=is_none)
    """Steps that are dropped at the beginning; 10 or 40 where nothing is said."""
    steps: Annotated[int, Field(ge=2, le=100_000)] | None = Field(default=None, exclude_if=is_none)
    """Steps that are kept; more of them lower R-hat. Where nothing is said as many as the diagnostics ask for."""

    def plan(self, is_easy: bool) -> tuple[int, int]:
        """Return the steps to drop and to keep at first, of a proposal that is nearly the posterior or is not."""
        burn_in, steps = SHORT if is_easy else USUAL
        return burn_in if self.burn_in is None else self.burn_in, steps if self.steps is None else self.steps

    @property
    def most_steps(self) -> int:
        """Most steps that are kept."""
        return MOST_STEPS if self.steps is None else self.steps


def count_walkers(n_parameters: int, n_walkers: int) -> int:
    """Return an even number of walkers, at least as many as asked for and as the moves need."""
    return max(n_walkers, 2 * n_parameters + 2) // 2 * 2


class EvidenceConfig(Section):
    """Effort of the evidence estimators; importance sampling goes on until its standard error is small enough.

    On demand each evidence is checked by another sampler, which owes nothing to the search for modes.
    """

    draws: Annotated[int, Field(ge=1000, le=10_000_000)] = FIRST_DRAWS
    """Draws for importance sampling to begin with."""
    max_draws: Annotated[int, Field(ge=1000, le=10_000_000)] = 100_000
    """Draws at which it ends, whatever its error is."""
    tolerance_nat: Positive = 0.01
    """Standard error of the log-evidence at which it ends [nat]."""
    cross_check: Annotated[str, ClassMark("SAMPLERS")] | None = Field(default=None, exclude_if=is_none)
    """A sampler that checks each evidence by its own: `"smc"`, sequential Monte Carlo from the prior, or `"nautilus"`,
    nested sampling by another library; both take longer."""

    @field_validator("cross_check")
    @classmethod
    def _check_sampler(cls, value: str | None) -> str | None:
        found = getattr(check_installed(value), "found", None)
        if found is not None and not found.finds_evidence:
            raise ValueError(f"found {value!r}, expected a sampler with an evidence, such as 'smc'")
        return value

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.max_draws < self.draws:
            raise ValueError(f"found max_draws {self.max_draws}, expected at least draws {self.draws}")
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
