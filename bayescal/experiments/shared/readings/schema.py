"""The schema of a calibration. Keys carry their units; those of tolerances and of the workspace stand in [units]."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from bayescal.config.classes import ClassMark, OwnSection
from bayescal.config.sections import (
    ExperimentConfig,
    Factor,
    InputFile,
    Name,
    Names,
    NotNegative,
    Number,
    Positive,
    Section,
    check_once,
)
from bayescal.density.outliers import NORMAL, Contaminated, Outliers, StudentT
from bayescal.density.priors import SharePrior
from bayescal.density.schema import PriorConfig
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.inference.schema import EvidenceConfig, SamplerConfig

NOISE_UNITS = {"noise_um": "um", "noise_mm": "mm", "noise_arcsec": "arcsec", "noise_deg": "deg", "noise_rad": "rad"}


class OriginConfig(Section):
    """Where the data come from: measured ones name their source and its licence."""

    status: Literal["measured", "simulated", "reconstructed", "unstated"]
    """Whether the data are `measured`, `simulated` or `reconstructed`; `unstated` where nobody says it."""
    text: str
    """What they are, in a sentence."""
    source: str = ""
    """Where they can be found; needed of measured ones."""
    licence: str = ""
    """Their licence; needed of measured ones."""

    @model_validator(mode="after")
    def _check_source(self) -> Self:
        if self.status == "measured" and not (self.source and self.licence):
            raise ValueError("found measured data without source or licence, expected both")
        return self


class DataTableConfig(Section):
    """A CSV table of readings, a row a pose; rows of the same pose in several tables belong together.

    ``channels`` must be there, all others are optional; columns in ``ignore`` may be there and are not read; poses in
    ``hold_back`` are kept for verification. Channels in ``commanded`` say where the machine was sent to: its poses are
    uniformly distributed in these then, and not in its coordinates.
    """

    file: InputFile
    """CSV file of readings, a row a pose."""
    channels: Names = Field(default=[])
    """Channels, or kinds of them, that must be in the table."""
    ignore: Names = Field(default=[])
    """Columns that are not read."""
    hold_back: Names = Field(default=[])
    """Poses that are kept for verification."""
    commanded: Names = Field(default=[], exclude_if=lambda value: not value)
    """Channels, or kinds of them, that the machine was commanded by: before they are measured its poses are uniformly
    distributed in these; in its coordinates where nothing is said.
    """


class ChannelConfig(Section):
    """Noise of a channel or of all of a kind, one value or one each; zero for a constraint.

    ``group`` is under what name it shares unknown noise with others; by default its kind's.
    """

    noise: NotNegative | list[NotNegative] | None = None
    """Standard deviation of a reading; zero for a constraint [unit of the channel]."""
    noise_um: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_mm: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_arcsec: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_deg: NotNegative | list[NotNegative] | None = None
    """The same."""
    noise_rad: NotNegative | list[NotNegative] | None = None
    """The same."""
    group: str = ""
    """Under what name it shares unknown noise with others; its kind's where nothing is said."""

    @model_validator(mode="after")
    def _check_one(self) -> Self:
        given = [name for name in ("noise", *NOISE_UNITS) if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) or "no noise"
            raise ValueError(f"found {found}, expected one of noise, {', '.join(NOISE_UNITS)}")
        return self


class ModelErrorScaleConfig(Section):
    """Scale of the half-normal prior of a model error τ, in the channels' unit: mm, rad or another."""

    scale: Positive
    """Scale of the half-normal prior of the model error [unit of the channel]."""


class ErrorTermConfig(OwnSection):
    """An error of one cause that variants may have: `function`, or a class of one's own with its options beside it."""

    kind: Annotated[str, ClassMark("ERRORS", beside=True), Field(validate_default=True)] = "function"
    """`"function"`, or `file.py:Class` of one's own; its options stand beside it."""


class InstrumentConfig(OwnSection):
    """An instrument beside the machine: channels and parameters, after its name, that any machine has more."""

    kind: Annotated[str, ClassMark("INSTRUMENTS", beside=True)]
    """`"point"`, `"pose"`, `"distance"`, or `file.py:Class` of one's own; its options stand beside it."""


class FreeConfig(Section):
    """What is free: symbols or parameters with a prior, all of them or those in ``free``, but for those in ``fixed``.

    Those of an entry of ``common`` deviate alike, a symbol or a list of parameters. Sensors inside a machine tell
    nothing of where its frames are: ``fixed`` are then the parameters that define these.
    """

    free: Annotated[Names, Field(min_length=1)] | None = None
    """Symbols or parameters that are free; all with a prior where nothing is said."""
    fixed: Names = Field(default=[], exclude_if=lambda value: not value)
    """Symbols or parameters of these that stay nominal all the same."""
    common: list[str | Names] = Field(default=[])
    """Symbols, or lists of parameters, that deviate alike."""


class SensorSetConfig(Section):
    """Channels that a variant takes in, and what it is called."""

    name: Name
    """What tables call the variant."""
    title: str
    """What the page calls it."""
    sensors: Annotated[Names, Field(min_length=1)] | None = None
    """Channels that it takes in; all where nothing is said."""


class CalibrationVariantConfig(FreeConfig, SensorSetConfig):
    """A model of the readings.

    ``noise`` says whether the noise is as stated or unknown as far as [unknown_noise] and [model_error] allow,
    ``errors`` which further errors it has;
    ``robust`` is the degree of freedom ν of a density that lets single poses be wrong; ``poses_with`` keeps to poses
    for which these columns are known; ``machine`` is another file for this variant.
    """

    machine: InputFile | None = None
    """Another machine's file for this variant."""
    noise: Literal["unknown", "stated"] = "unknown"
    """Noise as `stated`, or `unknown` as far as [unknown_noise] and [model_error] allow."""
    errors: Names | None = Field(default=None, exclude_if=lambda value: value is None)
    """Sections of [errors] that it has; all whose channels it takes in where nothing is said."""
    robust: Annotated[float, Field(ge=1.0, le=100.0)] | None = None
    """Degrees of freedom of a density that lets single poses be wrong; fewer forgive more [1]."""
    outlier_share: Annotated[float, Field(gt=0.0, lt=0.5)] | None = Field(
        default=None, exclude_if=lambda value: value is None
    )
    """Share of poses that are expected to be outliers, whose posterior is inferred; in place of `robust` [1]."""
    poses_with: Names = Field(default=[])
    """Keep to poses for which these columns are known."""

    @model_validator(mode="after")
    def _check_outliers(self) -> Self:
        if self.robust is not None and self.outlier_share is not None:
            raise ValueError("found robust and outlier_share, expected one of them")
        return self

    @property
    def outliers(self) -> Outliers:
        """What poses are like that are wrong as a whole."""
        if self.outlier_share is not None:
            return Contaminated(SharePrior(self.outlier_share))
        return NORMAL if self.robust is None else StudentT(self.robust)


class ValidationConfig(Section):
    """Prediction of held-back readings: the poses for verification, or each of several folds of poses in turn."""

    folds: Annotated[int, Field(ge=0, le=100)] = 0
    """Folds of poses, each of which is predicted from the others; 0 for poses marked `verification` alone."""
    draws: Annotated[int, Field(ge=100, le=100_000)] = 400
    """Posterior draws that predict."""


class PriorWidthsConfig(Section):
    """Factors on the widths of all priors, sd or half width, for which the evidence is computed again."""

    factor: Annotated[list[Factor], Field(min_length=1), AfterValidator(check_once)] = Field(default=[1.0])
    """Factors on the widths of all parameters' priors for which evidences are computed [1]."""


AS_STATED = PriorWidthsConfig()


class BesideConfig(Section):
    """Values from elsewhere, which stay out of the fit: a CSV with ``quantity``, ``unit``, ``value``.

    A quantity is a parameter, or a channel that is read at home; an optional column ``sd`` says how well it is known.
    """

    title: str
    """What the page calls the values."""
    file: InputFile
    """CSV file: quantity, unit, value, and sd where it is known; or the true parameters that a simulation wrote."""
    source: str = ""
    """Where they come from."""


class NextConfig(Section):
    """What to measure next: that many random poses of the workspace are tried."""

    candidates: Annotated[int, Field(ge=0, le=10_000)] = 300
    """How many random poses are tried; 0 for none."""
    shown: Annotated[int, Field(ge=1, le=50)] = 5
    """How many of them are shown."""


class CalibrationConfig(ExperimentConfig):
    """Any machine calibrated from readings of its own sensors, of instruments beside it, or both."""

    kind: Literal["calibration"]
    """`"calibration"`."""
    origin: OriginConfig
    """Where the data come from."""
    machine: InputFile
    """The machine's TOML file."""
    instruments: dict[Name, InstrumentConfig] = Field(default={}, exclude_if=lambda value: not value)
    """By name: instruments beside the machine."""
    data: Annotated[list[DataTableConfig], Field(min_length=1)]
    """Tables of readings."""
    sensors: Annotated[dict[str, ChannelConfig], Field(min_length=1)]
    """Noise of each channel, or of all of a kind."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, requirements and results."""
    parameters: Annotated[dict[str, PriorConfig], Field(min_length=1)]
    """Tolerance of each symbol."""
    unknown_noise: dict[str, Positive] = Field(default={})
    """By group: standard deviation of the logarithm of a factor on its noise [1]."""
    model_error: dict[str, ModelErrorScaleConfig] = Field(default={})
    """By channel or kind: an error that the stated noise lacks."""
    errors: dict[Name, ErrorTermConfig] = Field(default={}, exclude_if=lambda value: not value)
    """By name: errors common to all rows, such as functions of what is read, or those of a class of one's own."""
    workspace: dict[str, Annotated[list[Number], Field(min_length=2, max_length=2)]] = Field(default={})
    """By coordinate: smallest and largest value where accuracy counts; the machine's own where nothing is said [unit
    of the coordinate].
    """
    variants: Annotated[list[CalibrationVariantConfig], Field(min_length=1)]
    """Models to compare."""
    validation: ValidationConfig = ValidationConfig()
    """Prediction of held-back readings."""
    sensitivity: PriorWidthsConfig = Field(default=AS_STATED, exclude_if=lambda value: value == AS_STATED)
    """Other widths of the priors."""
    beside: list[BesideConfig] = Field(default=[])
    """Values from elsewhere that stay out of the fit."""
    next: NextConfig = NextConfig()
    """What to measure next."""
    sampler: SamplerConfig = SamplerConfig()
    """Effort of sampling."""
    evidence: EvidenceConfig = EvidenceConfig()
    """Effort of the evidence."""

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        _check_once([variant.name for variant in self.variants])
        _check_bounds(self.workspace)
        return self


def _check_once(names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"variants: found {name!r} twice, expected each name once")


def _check_bounds(workspace: dict[str, list[float]]) -> None:
    for name, (low, high) in workspace.items():
        if not low < high:
            raise ValueError(f"workspace.{name}: found {low:g} to {high:g}, expected the smaller number first")
