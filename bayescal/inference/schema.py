"""Sections of configs that say how much effort inference makes."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self

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


type Effort = Literal["quick", "standard", "thorough"]
MORE: Final = 4
"""By how much more steps and draws are taken for a thorough answer."""
QUICK_DRAWS: Final = 2000
"""Draws for importance sampling where a preliminary answer is enough."""
QUICK_ERROR: Final = 0.05
"""Standard error of the log-evidence, in nats, that is enough then."""


class SamplerConfig(Section):
    """What draws the posteriors: ensembles of walkers, or another sampler.

    Where steps are not stated, their number follows the posterior: few where the proposal is nearly the posterior, and
    more, up to 320, until the diagnostics pass.
    """

    backend: Annotated[str, ClassMark("SAMPLERS"), AfterValidator(check_installed)] = Field(
        default=EMCEE, exclude_if=lambda value: value == EMCEE
    )
    """The sampler by its name, or a table of its `class` and options; `bayescal list samplers` shows all."""
    effort: Effort = Field(default="standard", exclude_if=lambda value: value == "standard")
    """How much is computed: `quick` gives a preliminary answer by importance sampling, without chains; `standard` draws
    until the diagnostics pass; `thorough` takes four times as many steps and draws. Numbers that are stated hold.
    """
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
        burn_in, steps = SHORT if is_easy and self.effort != "thorough" else USUAL
        steps *= MORE if self.effort == "thorough" else 1
        return burn_in if self.burn_in is None else self.burn_in, steps if self.steps is None else self.steps

    @property
    def most_steps(self) -> int:
        """Most steps that are kept."""
        most = MOST_STEPS * (MORE if self.effort == "thorough" else 1)
        return most if self.steps is None else self.steps

    @property
    def is_preliminary(self) -> bool:
        """Whether a preliminary answer is enough."""
        return self.effort == "quick"


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

    def follow(self, effort: Effort) -> Self:
        """Return what a quick or a thorough study takes for what is as by default; what was stated holds."""
        default, changed = type(self)(), dict[str, object]()
        if effort == "quick":
            changed = {"draws": QUICK_DRAWS, "max_draws": QUICK_DRAWS, "tolerance_nat": QUICK_ERROR}
        elif effort == "thorough":
            tolerance, most = default.tolerance_nat / MORE**0.5, default.max_draws * MORE
            changed = {"tolerance_nat": tolerance, "max_draws": most}
        return self.model_copy(
            update={key: value for key, value in changed.items() if getattr(self, key) == getattr(default, key)}
        )

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
