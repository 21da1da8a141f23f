"""Sections of configs that say what is known of parameters and of a model's error beforehand."""

from __future__ import annotations

from typing import Annotated, Final, Literal, Self, get_args

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from bayescal.config.load import MEASURED
from bayescal.config.sections import NotNegative, PerLeg, Positive, PositivePerLeg, Section, check_once
from bayescal.density.priors import INDEPENDENT, LENGTHY, KernelName, LogNormalPrior
from bayescal.numerics.units import MICROMETRE


class NormalConfig(Section):
    """Normal tolerance about the nominal value; sd in the parameter's unit (mm for lengths)."""

    prior: Literal["normal"]
    """`"normal"`: a bell curve about the nominal value."""
    sd: PositivePerLeg
    """Standard deviation, one for all legs or one per leg [unit of the parameter]."""


class UniformConfig(Section):
    """Uniform within a half width about the nominal value."""

    prior: Literal["uniform"]
    """`"uniform"`: anything within bounds about the nominal value alike."""
    half_width: PositivePerLeg
    """Distance of the bounds from the nominal value, one for all legs or one per leg [unit of the parameter]."""


class FixedConfig(Section):
    """Not free: held at the nominal value plus an offset."""

    prior: Literal["fixed"]
    """`"fixed"`: known, not to be found."""
    offset: PerLeg = 0.0
    """What is added to the nominal value, one for all legs or one per leg [unit of the parameter]."""


type PriorConfig = Annotated[NormalConfig | UniformConfig | FixedConfig, Field(discriminator="prior")]


type TermName = Literal["independent", "linear", "own", "smooth", "drift"]
TERMS: Final[tuple[TermName, ...]] = get_args(TermName.__value__)
"""What a model error may be made of, in the order in which pages tell it."""
ALONE: Final[list[TermName]] = ["independent"]
TAU_UM: Final = 10.0
FUNCTIONS_UM: Final = 20.0
OF_NOISE: Final = 2.0
"""Standard deviations of the noise that functions are as large as where nothing is said, if that is more."""

type TermNames = Annotated[list[TermName], AfterValidator(check_once)]


def _tag_choice(value: object) -> str:
    return f"{MEASURED}{'terms' if isinstance(value, list) else 'kernel'}"


type ModelErrorChoice = Annotated[
    Annotated[KernelName, Tag(f"{MEASURED}kernel")] | Annotated[TermNames, Tag(f"{MEASURED}terms")],
    Discriminator(_tag_choice),
]


class KernelChoiceConfig(Section):
    """Which model error a variant has in place of what its experiment says."""

    model_error: ModelErrorChoice | None = Field(default=None, exclude_if=lambda value: value is None)
    """The terms of this variant's model error, a list as in [model_error]; or what is a function of the pose with a
    stated scale: `independent`, `linear`, `quadratic` or `smooth`.
    """
    kernel_length: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Over how far quadratic and smooth errors change in this variant, in place of what holds for all: a known length
    unless a spread is stated, too [ranges of the actuators].
    """
    kernel_length_spread: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Standard deviation of the logarithm of that length, which is then free about its median [1]."""


class KernelConfig(Section):
    """Prior of an error that is a function of the pose.

    ``kernel_scale_um`` is what one actuator at the end of its range makes a leg err by, one standard deviation, where
    there is a structured error; ``kernel_spread`` the standard deviation of its logarithm, ``kernel_length`` in units
    of the actuators' range.
    """

    kernel: KernelName = Field(default=INDEPENDENT, exclude_if=lambda value: value == INDEPENDENT)
    """What is a function of the pose, for all variants that say nothing: `independent` (nothing is), `linear`,
    `quadratic` (linear and quadratic), or `smooth`.
    """
    kernel_scale_um: Positive = Field(default=20.0, exclude_if=lambda value: value == 20.0)
    """What one actuator at the end of its range makes a leg err by, one standard deviation."""
    kernel_spread: Positive = Field(default=0.05, exclude_if=lambda value: value == 0.05)
    """Standard deviation of the logarithm of that scale [1]."""
    kernel_length: Positive = Field(default=5.0, exclude_if=lambda value: value == 5.0)
    """Over how far quadratic and smooth errors change [ranges of the actuators]."""
    kernel_length_spread: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Standard deviation of the logarithm of that length, free about its median; it is known where this is left out
    [1].
    """
    kernel_per_leg: bool = Field(default=False, exclude_if=lambda value: value is False)
    """Whether every leg has a scale of its own."""

    def name_for(self, choice: KernelChoiceConfig) -> KernelName:
        """Return the kernel of a variant: its own, or that of all where it names no terms of its own."""
        if isinstance(choice.model_error, list):
            return INDEPENDENT
        return choice.model_error or self.kernel

    def length_for(self, choice: KernelChoiceConfig) -> float:
        """Return the length of a variant's kernel, or the median of its prior, in ranges of the actuators."""
        return choice.kernel_length or self.kernel_length

    def lengths_for(self, choice: KernelChoiceConfig) -> LogNormalPrior | None:
        """Return the prior of the length of a variant's kernel; None where there is none, or it is known."""
        spread = choice.kernel_length_spread
        if spread is None and choice.kernel_length is None:
            spread = self.kernel_length_spread
        if spread is None or self.name_for(choice) not in LENGTHY:
            return None
        return LogNormalPrior(self.length_for(choice), spread)


class TermsConfig(Section):
    """What the models leave out, beside the stated noise: of every leg, or of every channel of the machine itself.

    The terms add up. Nobody has to know how large they are: τ has a half-normal prior, the others half-Cauchy ones.
    Where their scales are not stated, a coarse machine has larger ones, by the noise of its own sensors.
    """

    terms: TermNames = Field(default=list(TERMS), exclude_if=lambda value: value == ALONE)
    """What it is made of, all where nothing is said: `independent` (τ, drawn anew at every pose), `linear` (in the
    positions of all actuators: a coupling), `own` (linear in the own position: a lead error), `smooth` (any smooth
    function of the positions), `drift` (a random walk in measuring order); `[]` for no model error.
    """
    scale_um: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Scale of the half-normal prior of the model error τ. Where nothing is said: 10 µm, or what one standard deviation
    of the noise of the machine's own sensors is at the tool if that is more.
    """
    functions_um: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """Scale of the half-Cauchy prior of the root mean square of each other term. Where nothing is said: 20 µm, or two
    standard deviations of that noise if that is more.
    """
    at_least_um: NotNegative | dict[TermName, NotNegative] = Field(default=0.0, exclude_if=lambda value: value == 0.0)
    """Root mean square that a term has at least, where it leaves no trace in the data, too: of `linear`, `own` and
    `smooth` together, or by term.
    """
    per_leg: bool = False
    """Whether every leg has a τ of its own, or all share one."""

    def scales(self, noise: float) -> tuple[float, float]:
        """Return the scales of the prior of τ and of those of functions, mm, by the noise of own sensors, mm."""
        tau = max(MICROMETRE * TAU_UM, noise) if self.scale_um is None else MICROMETRE * self.scale_um
        usual = max(MICROMETRE * FUNCTIONS_UM, OF_NOISE * noise)
        return tau, usual if self.functions_um is None else MICROMETRE * self.functions_um

    def floors(self) -> dict[TermName, float]:
        """Return the least root mean square of each term that has one, µm."""
        if isinstance(self.at_least_um, dict):
            return {name: one for name, one in self.at_least_um.items() if one > 0.0}
        together: list[TermName] = [one for one in ("linear", "own", "smooth") if one in self.terms]
        return {one: self.at_least_um / len(together) ** 0.5 for one in together if self.at_least_um > 0.0}

    def lengths(self) -> dict[str, float]:
        """Return the same in mm."""
        return {name: MICROMETRE * floor for name, floor in self.floors().items()}

    @model_validator(mode="after")
    def _check_floors(self) -> Self:
        if isinstance(self.at_least_um, dict) and (strange := set(self.at_least_um) - set(self.terms)):
            raise ValueError(f"at_least_um: found {sorted(strange)}, expected some of the terms {self.terms}")
        return self


class ModelErrorConfig(TermsConfig, KernelConfig):
    """What the models leave out, beside the stated noise: of every leg, or of every channel of the machine itself.

    The terms add up. Nobody has to know how large they are: τ has a half-normal prior, the others half-Cauchy ones.
    """

    def terms_for(self, choice: KernelChoiceConfig) -> list[TermName]:
        """Return the terms of a variant: its own, or those of all."""
        if isinstance(choice.model_error, str):
            return ALONE
        return self.terms if choice.model_error is None else choice.model_error

    @model_validator(mode="after")
    def _check_kernel(self) -> Self:
        if self.kernel != INDEPENDENT and self.terms != ALONE:
            raise ValueError(
                f"found kernel {self.kernel!r} beside terms {self.terms}, expected terms = {ALONE} with it"
            )
        return self


class BlundersConfig(Section):
    """Poses may be blunders: the share of them that is expected, whose posterior is inferred."""

    expected_share: Annotated[float, Field(gt=0.0, lt=0.5)] = 0.02
    """Share of poses that are expected to be blunders; the posterior of it is inferred [1]."""
