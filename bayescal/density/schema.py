"""Sections of configs: priors of parameters, and the model error."""

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Final, Literal, Self, get_args

from pydantic import AfterValidator, BeforeValidator, Field

from bayescal.config.sections import NotNegative, PerLeg, Positive, Section, check_once
from bayescal.limits import LASTING
from bayescal.numerics.units import MICROMETRE


def _check_some(values: list[float]) -> list[float]:
    if not any(values):
        raise ValueError("found zeros, expected a width > 0, or prior = 'fixed'")
    return values


type Widths = Positive | Annotated[list[NotNegative], AfterValidator(_check_some)]
"""One for all members, or one each; zero for a member that is known."""


class NormalConfig(Section):
    """Normal tolerance about the nominal value; sd in the parameter's unit (mm for lengths)."""

    prior: Literal["normal"]
    """`"normal"`: a bell curve about the nominal value."""
    sd: Widths
    """Standard deviation, one for all legs or one per leg, zero for one that is known [unit of the parameter]."""


class UniformConfig(Section):
    """Uniform within a half width about the nominal value."""

    prior: Literal["uniform"]
    """`"uniform"`: anything within bounds about the nominal value alike."""
    half_width: Widths
    """Distance of the bounds from the nominal value, one for all legs or one per leg, zero for one that is known
    [unit of the parameter].
    """


class FixedConfig(Section):
    """Not free: held at the nominal value plus an offset."""

    prior: Literal["fixed"]
    """`"fixed"`: known, not to be found."""
    offset: PerLeg = 0.0
    """What is added to the nominal value, one for all legs or one per leg [unit of the parameter]."""


def _check_table(value: object) -> object:
    if isinstance(value, int | float) and not isinstance(value, bool):
        raise ValueError(
            f'found {value:g}, expected {{ prior = "normal", sd = {value:g} }}, "uniform" with half_width, or "fixed"'
        )
    return value


type PriorConfig = Annotated[
    NormalConfig | UniformConfig | FixedConfig, Field(discriminator="prior"), BeforeValidator(_check_table)
]


type TermName = Literal["random", "linear", "positioning", "smooth", "drift"]
TERMS: Final[tuple[TermName, ...]] = get_args(TermName.__value__)
"""What a model error may be made of, in the order in which pages tell it."""
INDEPENDENT: Final[TermName] = "random"
ALONE: Final = [INDEPENDENT]
TAU_UM: Final = 10.0
FUNCTIONS_UM: Final = 20.0
OF_NOISE: Final = 2.0
"""Standard deviations of the noise that functions are as large as where nothing is said, if that is more."""

type TermNames = Annotated[list[TermName], AfterValidator(check_once)]


class ModelErrorConfig(Section):
    """What the models leave out, beside the stated noise: of every leg, or of every channel of the machine itself.

    The terms add up. Nobody has to know how large they are: τ has a half-normal prior, the others half-Cauchy ones.
    Where their scales are not stated, a coarse machine has larger ones, by the noise of its own sensors.
    """

    terms: TermNames = Field(default=list(TERMS))
    """What it is made of, all where nothing is said: `random` (τ, another value at every pose), `linear` (in the
    positions of all actuators: a coupling), `positioning` (functions of the own position: a lead error, an eccentric
    encoder), `smooth` (any smooth function of all positions), `drift` (a random walk in measuring order); `[]` for
    none.
    """
    random_scale_um: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Scale of the half-normal prior of the model error τ. Where nothing is said: 10 µm, or what one standard deviation
    of the noise of the machine's own sensors is at the tool if that is more.
    """
    systematic_scale_um: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Scale of the half-Cauchy prior of the root mean square of each other term. Where nothing is said: 20 µm, or two
    standard deviations of that noise if that is more.
    """
    floor_um: NotNegative | dict[TermName, NotNegative] = Field(default=0.0, exclude_if=lambda value: value == 0.0)
    """Root mean square that a term has at least, where it leaves no trace in the data, too: of `linear`,
    `positioning` and `smooth` together, or by term.
    """
    separate_by_leg: bool = False
    """Whether every leg, or channel, has its own τ, or all share one."""

    def scales(self, noise: float) -> tuple[float, float]:
        """Return the scales of the prior of τ and of those of functions, mm, by the noise of own sensors, mm."""
        tau = max(MICROMETRE * TAU_UM, noise) if self.random_scale_um is None else MICROMETRE * self.random_scale_um
        usual = max(MICROMETRE * FUNCTIONS_UM, OF_NOISE * noise)
        return tau, usual if self.systematic_scale_um is None else MICROMETRE * self.systematic_scale_um

    def of(self, own: list[TermName] | None) -> Self:
        """Return the model error of a variant: with its own terms, or those of all where it has none."""
        return self if own is None else self.model_copy(update={"terms": own})

    def floors(self) -> dict[TermName, float]:
        """Return the least root mean square of each term that has one, µm."""
        if isinstance(self.floor_um, dict):
            return {name: one for name, one in self.floor_um.items() if one > 0.0 and name in self.terms}
        together: list[TermName] = [one for one in LASTING if one in self.terms]
        return {one: self.floor_um / len(together) ** 0.5 for one in together if self.floor_um > 0.0}

    def lengths(self) -> dict[str, float]:
        """Return the same in mm."""
        return {name: MICROMETRE * floor for name, floor in self.floors().items()}

    def check_floors(self, terms: Collection[str]) -> None:
        """Raise ValueError for a floor of what is not among the terms of any variant."""
        if isinstance(self.floor_um, dict):
            if strange := set(self.floor_um) - set(terms):
                raise ValueError(f"floor_um: found {sorted(strange)}, expected one of {[*terms]}")
        elif self.floor_um > 0.0 and not set(LASTING) & set(terms):
            raise ValueError(
                f"floor_um: found {self.floor_um:g} with terms {[*terms]}, expected one of "
                f"{[*LASTING]}, or a size by term"
            )
