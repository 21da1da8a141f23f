"""The schema of a study: a machine, what was measured of it in tables of ``[[data]]``, variants to compare."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, get_args

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark, label_class
from bayescal.config.load import MEASURED
from bayescal.config.sections import (
    ExperimentConfig,
    Factor,
    InputFile,
    Name,
    Names,
    Positive,
    Section,
    check_once,
)
from bayescal.density.schema import ModelErrorConfig, PriorConfig, TermNames
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.data_schema import DataConfig
from bayescal.experiments.shared.readings.schema import (
    ChannelConfig,
    ErrorTermConfig,
    FreeConfig,
    InstrumentConfig,
    ModelErrorScaleConfig,
    NextReadingsConfig,
    ProvenanceConfig,
    ReferenceValuesConfig,
    ValidationConfig,
)
from bayescal.experiments.shared.schema import (
    AccuracyFrame,
    Bounds,
    DeformationConfig,
    IgnoredDataErrors,
    UnitsConfig,
)
from bayescal.inference.schema import Effort, EvidenceConfig, SamplerConfig

if TYPE_CHECKING:
    from bayescal.density.outliers import Outliers


def _tag_error(value: Any) -> str:
    by_channel = isinstance(value, dict) and all(isinstance(one, dict | Section) for one in value.values())
    by_channel = by_channel and not ModelErrorConfig.model_fields.keys() & set(value)
    return f"{MEASURED}{'channels' if by_channel else 'legs'}"


type StudyErrorConfig = Annotated[
    Annotated[dict[str, ModelErrorScaleConfig], Tag(f"{MEASURED}channels")]
    | Annotated[ModelErrorConfig, Tag(f"{MEASURED}legs")],
    Discriminator(_tag_error),
]


type VariantName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.-]+([ /][A-Za-z0-9_.-]+)*$")]


class VariantConfig(FreeConfig):
    """A model of what was measured: what is free, which channels and errors it takes in; the others stay nominal.

    A machine on legs has a kinematic model with a deformation, and is called after them, ``six_pus/none``, where it has
    no name of its own; several free sets or model errors of one model and deformation need names.
    """

    model: Annotated[str, ClassMark("MODELS")] | None = None
    """Kinematic model of a machine on legs; `bayescal list models` shows all."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")] = "none"
    """Deformation of its platform: `none`, `linear` or `matrix`, or one of your own."""
    name: VariantName = Field(default_factory=lambda known: name_variant(known.get("model"), known.get("deformation")))
    """What tables call the variant; `model/deformation` where nothing is said."""
    title: str = Field(default_factory=lambda known: known.get("name", ""))
    """What the page calls it; its name where nothing is said."""
    model_error: TermNames | None = Field(default=None, exclude_if=lambda value: value is None)
    """The terms of this variant's model error, a list as in [model_error]; those of all where nothing is said."""
    sensors: Annotated[Names, Field(min_length=1)] | None = None
    """Channels that it takes in; all where nothing is said."""
    machine: InputFile | None = None
    """Another machine's file for this variant."""
    noise_known: bool = False
    """Whether noise is as stated; else it is unknown as far as [noise_factor_log_sd] and a [model_error] by channel
    allow. Terms of the model error are no noise, and hold all the same.
    """
    error_terms: Names | None = Field(default=None, exclude_if=lambda value: value is None)
    """Sections of [error_terms] that it has; all whose channels it takes in where nothing is said."""
    student_t_dof: Annotated[float, Field(ge=1.0, le=100.0)] | None = None
    """Degrees of freedom of a Student t density that lets single poses be outliers; fewer forgive more [1]."""
    outlier_fraction: Annotated[float, Field(gt=0.0, lt=0.5)] | None = Field(
        default=None, exclude_if=lambda value: value is None
    )
    """Fraction of poses that are expected to be outliers, whose posterior is inferred; instead of `student_t_dof`
    [1].
    """
    require_columns: Names = Field(default=[])
    """Keep to poses for which these columns are known."""

    @property
    def outliers(self) -> Outliers:
        """What poses are like that are wrong as a whole."""
        from bayescal.density.outliers import NORMAL, Contaminated, StudentT
        from bayescal.density.priors import SharePrior

        if self.outlier_fraction is not None:
            return Contaminated(SharePrior(self.outlier_fraction))
        return NORMAL if self.student_t_dof is None else StudentT.centred(self.student_t_dof)

    @property
    def seen(self) -> tuple[str, str]:
        """Kinematic model and deformation of a machine on legs."""
        assert self.model is not None
        return self.model, self.deformation

    @property
    def has_own_name(self) -> bool:
        """Whether the config names it."""
        return self.name != name_variant(self.model, self.deformation)

    @model_validator(mode="after")
    def _check_name_and_outliers(self) -> Self:
        if {"/", "."} & set(self.name) and self.has_own_name:
            raise ValueError(f"name: found {self.name!r}, expected a name without slashes and dots")
        if self.student_t_dof is not None and self.outlier_fraction is not None:
            raise ValueError("found student_t_dof and outlier_fraction, expected either")
        return self


def change_effort(config: ExperimentConfig, effort: str) -> ExperimentConfig:
    """Return a study's config with another effort; InputError for one that is none, and for other kinds."""
    if not isinstance(config, StudyConfig):
        raise InputError(f"effort: found with kind {config.kind!r}, expected a study")
    if effort not in (known := get_args(Effort.__value__)):
        raise InputError(f"effort: found {effort!r}, expected {', '.join(known[:-1])} or {known[-1]}")
    sampler = config.sampler.model_copy(update={"effort": effort})
    return config.model_copy(update={"sampler": sampler})


def name_variant(model: str | None, deformation: str | None) -> str:
    """Return what a variant without a name of its own is called; of somebody else's classes their own names."""
    return "calibrated" if model is None else f"{label_class(model)}/{label_class(deformation or 'none')}"


def stem_of(variant: str) -> str:
    """Return a variant's name as a part of file names."""
    return variant.replace("/", "-").replace(" ", "_")


TAU_SCALES = [1.0, 3.0, 10.0, 30.0, 100.0]


class SensitivityConfig(Section):
    """Factors on the widths of all priors, sd or half width, for which the evidence is computed again.

    The scale of the model error's prior is varied by itself, without computing again.
    """

    prior_width_factors: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[1.0])
    """Factors on the widths of all priors for which evidences are computed again; as stated alone by default [1]."""
    random_scale_grid_um: Annotated[list[Positive], AfterValidator(check_once)] = Field(
        default=TAU_SCALES, exclude_if=lambda value: value == TAU_SCALES
    )
    """Scales of the model error's prior, tried by reweighting."""


class StudyConfig(ExperimentConfig):
    """A calibration: any machine, what was measured of it and how well, tolerances, variants to compare, effort."""

    kind: Literal["study"]
    """`"study"`."""
    provenance: ProvenanceConfig
    """Where the data come from."""
    machine: InputFile
    """The machine's TOML file."""
    published_claims: Annotated[str, ClassMark("CLAIMS")] | None = None
    """Statements of a publication that are put to the results: their class, as `file.py:Class`."""
    instruments: dict[Name, InstrumentConfig] = Field(default={}, exclude_if=lambda value: not value)
    """By name: instruments beside the machine, which give it more channels."""
    data: Annotated[list[DataConfig], Field(min_length=1)]
    """What was measured, in tables: readings of channels, targets, poses or points."""
    sensors: dict[str, ChannelConfig] = Field(default={}, exclude_if=lambda value: not value)
    """Noise of each channel, or of all of a kind, where its table does not state it."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, requirements and results."""
    deformation: DeformationConfig = DeformationConfig()
    """Nominal deformation of the platform of a machine on legs."""
    parameters: Annotated[dict[str, PriorConfig], Field(min_length=1)]
    """Tolerance of each symbol."""
    noise_factor_log_sd: dict[str, Positive] = Field(default={}, exclude_if=lambda value: not value)
    """By group of channels: standard deviation of the logarithm of a factor on its noise [1]."""
    model_error: StudyErrorConfig = ModelErrorConfig()
    """What the models leave out, in terms whose sizes are found; or τ alone, by channel or kind."""
    error_terms: dict[Name, ErrorTermConfig] = Field(default={}, exclude_if=lambda value: not value)
    """By name: errors that all rows share, such as functions of what is read, or those of a user-defined class."""
    workspace: dict[str, Bounds] = Field(default={}, exclude_if=lambda value: not value)
    """By coordinate: smallest and largest value where accuracy counts; the range of the measured poses where nothing
    is said [unit of the coordinate].
    """
    requirements: dict[str, Positive] = Field(default={}, exclude_if=lambda value: not value)
    """By number of the tool, or `position` for its lengths and `rotation` for its angles together: largest error
    anywhere in the workspace [units].
    """
    accuracy_frame: AccuracyFrame = Field(default="aligned", exclude_if=lambda value: value == "aligned")
    """Whether accuracy is what remains after a best fit of the frames of base and tool (`aligned`), or is relative to
    marks on the `base`.
    """
    ignored_data_errors: IgnoredDataErrors = Field(default=[], exclude_if=lambda value: not value)
    """Kinds of slips that its data look like and are not, as somebody says who looked: `unit`, `legs`, `rows`, `poses`,
    `channel`, `frame`."""
    variants: Annotated[list[VariantConfig], Field(min_length=1)]
    """Models to compare."""
    validation: ValidationConfig = ValidationConfig()
    """Prediction of held-back readings."""
    sensitivity: SensitivityConfig = SensitivityConfig()
    """Other widths of the priors."""
    reference_values: list[ReferenceValuesConfig] = Field(default=[], exclude_if=lambda value: not value)
    """Values from elsewhere that stay out of the fit."""
    next: NextReadingsConfig = NextReadingsConfig()
    """What to measure next."""
    sampler: SamplerConfig = SamplerConfig()
    """Effort of sampling."""
    evidence: EvidenceConfig = EvidenceConfig()
    """Effort of the evidence."""

    @property
    def leg_error(self) -> ModelErrorConfig:
        """The model error in terms; without any where it is stated by channel."""
        return ModelErrorConfig(terms=[]) if isinstance(self.model_error, dict) else self.model_error

    @property
    def channel_errors(self) -> dict[str, ModelErrorScaleConfig]:
        """Priors of model errors by groups of channels; none where it is stated in terms."""
        return self.model_error if isinstance(self.model_error, dict) else {}

    @model_validator(mode="after")
    def _check_variants(self) -> Self:
        _check_names([variant.name for variant in self.variants])
        self._check_errors()
        for variant in self.variants:
            for symbol in variant.free or ():
                prior = self.parameters.get(symbol.partition("[")[0])
                if prior is None and any(symbol.startswith(f"{name}_") for name in self.instruments):
                    continue  # perhaps one that is found from the data
                if prior is None or prior.prior == "fixed":
                    found = "no prior" if prior is None else "a fixed value"
                    raise ValueError(
                        f"variant {variant.name!r} frees {symbol!r}, which has {found} in [parameters], "
                        "expected a normal or uniform prior"
                    )
        return self

    def _check_errors(self) -> None:
        """Raise ValueError for channels without noise, and a model error of which a variant's terms say otherwise."""
        if not self.sensors:
            raise ValueError("sensors: missing, expected the noise of the channels")
        if not isinstance(self.model_error, dict):
            every = [name for one in self.variants for name in self.model_error.of(one.model_error).terms]
            try:
                self.model_error.check_floors(dict.fromkeys(every))
            except ValueError as error:
                raise ValueError(f"model_error.{error}") from error


def _check_names(names: list[str]) -> None:
    """Raise ValueError for variants of one name, or of names that no file system need tell apart."""
    first: dict[str, str] = {}
    for name in names:
        other = first.setdefault(stem_of(name).lower(), name)
        if names.count(name) > 1:
            raise ValueError(f"variant {name!r} is there twice, expected a name for each free set")
        if other != name:
            raise ValueError(f"variants {other!r} and {name!r} would share their files, expected other names")
