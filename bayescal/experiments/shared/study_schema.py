"""The schema of a study: a machine, what was measured of it, variants; `data` decides how it is computed.

A list of tables, ``[[data]]``, holds readings of channels of any machine. One table, ``[data]``, is an instrument that
measures the pose of a platform on legs, whole or in part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark, label_class
from bayescal.config.load import MEASURED
from bayescal.config.sections import (
    ExperimentConfig,
    Factor,
    InputFile,
    Name,
    Names,
    NotNegative,
    Positive,
    Section,
    check_once,
)
from bayescal.density.outliers import NORMAL, Contaminated, Outliers, StudentT
from bayescal.density.priors import SharePrior
from bayescal.density.schema import FixedConfig, ModelErrorConfig, PriorConfig, TermNames
from bayescal.experiments.shared.readings.schema import (
    ChannelConfig,
    DataTableConfig,
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
    FramesConfig,
    RotationNoiseConfig,
    UnitsConfig,
)
from bayescal.experiments.shared.slips import IgnoredDataErrors
from bayescal.inference.schema import EvidenceConfig, SamplerConfig

TABLES = ("targets", "poses", "points")
"""Kinds of measurement, and the keys of their tables."""


class MeasuredConfig(Section):
    """What all kinds of measurement have."""

    actuator_noise_um: NotNegative
    """Standard deviation of an actuator's position about what it reads."""

    @model_validator(mode="before")
    @classmethod
    def _check_tables(cls, value: Any) -> Any:
        """Refuse the table of another instrument, before it is an unknown key."""
        if isinstance(value, dict):
            own = value.get("instrument", TABLES[0])
            for other in TABLES:
                if other in value and other != own and own in TABLES:
                    raise ValueError(f"found a table of {other} beside instrument {own!r}, expected its own alone")
        return value


class TargetDataConfig(MeasuredConfig):
    """Photogrammetry targets on base and platform and what is known of their noise."""

    instrument: Literal["targets"] = Field(default="targets", exclude_if=lambda value: value == "targets")
    """`"targets"`, which is what holds where nothing is said."""
    targets: InputFile
    """CSV file of measured targets."""
    actuators: InputFile
    """CSV file of actuator positions."""
    reference: InputFile
    """CSV file of where targets sit on their bodies."""
    target_noise_um: Positive
    """Standard deviation of a target's coordinates."""
    pose_estimator: Literal["robust", "line", "least_squares"] = "robust"
    """How a body's pose is found: `robust` (targets may be wrong), `line` (RR-8096) or `least_squares`."""


class PoseDataConfig(RotationNoiseConfig, MeasuredConfig):
    """Poses that an instrument handed out, whole or in part; the table states its noise, or these keys do."""

    instrument: Literal["poses"]
    """`"poses"`."""
    poses: InputFile
    """CSV file of poses."""
    actuators: InputFile | None = None
    """CSV file of actuator positions, where the table of poses lacks them."""
    position_um: Positive | None = None
    """Standard deviation of a position, each axis, where the table does not state it."""


class PointDataConfig(MeasuredConfig):
    """Points on the platform that stations tracked; the table states its noise, or these keys do."""

    instrument: Literal["points"]
    """`"points"`."""
    points: InputFile
    """CSV file of tracked points."""
    probe: InputFile
    """CSV file of where points sit on the platform."""
    actuators: InputFile
    """CSV file of actuator positions."""
    stations: InputFile | None = None
    """CSV file of where stations stand; one in the base frame without it."""
    point_um: Positive | Annotated[list[Positive], Field(min_length=3, max_length=3)] | None = None
    """Standard deviation of coordinates, one or per axis, where the table does not state it."""
    range_um: NotNegative = 0.0
    """Standard deviation of a range."""
    range_ppm: NotNegative = 0.0
    """What is added to it, in millionths of the range."""
    azimuth_arcsec: Positive | None = None
    """Standard deviation of an azimuth."""
    elevation_arcsec: Positive | None = None
    """Standard deviation of an elevation."""

    @model_validator(mode="after")
    def _check_noise(self) -> Self:
        polar = (
            self.range_um + self.range_ppm > 0.0,
            self.azimuth_arcsec is not None,
            self.elevation_arcsec is not None,
        )
        if any(polar) and not all(polar):
            raise ValueError("expected range_um or range_ppm, azimuth_arcsec and elevation_arcsec together")
        if any(polar) and self.point_um is not None:
            raise ValueError("found point_um beside the noise of ranges and angles, expected either")
        return self


def _tag_data(value: Any) -> str:
    found = value.get("instrument", "targets") if isinstance(value, dict) else getattr(value, "instrument", value)
    return f"{MEASURED}{found}"


type InstrumentDataConfig = Annotated[
    Annotated[TargetDataConfig, Tag(f"{MEASURED}targets")]
    | Annotated[PoseDataConfig, Tag(f"{MEASURED}poses")]
    | Annotated[PointDataConfig, Tag(f"{MEASURED}points")],
    Discriminator(_tag_data),
]


def _tag_route(value: Any) -> str:
    return f"{MEASURED}{'tables' if isinstance(value, list) else 'instrument'}"


type DataConfig = Annotated[
    Annotated[Annotated[list[DataTableConfig], Field(min_length=1)], Tag(f"{MEASURED}tables")]
    | Annotated[InstrumentDataConfig, Tag(f"{MEASURED}instrument")],
    Discriminator(_tag_route),
]


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
            raise ValueError("found student_t_dof and outlier_fraction, expected one of them")
        return self


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

    prior_width_factors: Annotated[list[Factor], AfterValidator(check_once)] = Field(default=[0.5, 1.0, 2.0, 5.0])
    """Factors on the widths of all priors for which evidences are computed again; `[]` for none [1]."""
    random_scale_grid_um: Annotated[list[Positive], AfterValidator(check_once)] = Field(
        default=TAU_SCALES, exclude_if=lambda value: value == TAU_SCALES
    )
    """Scales of the model error's prior, tried by reweighting."""


AS_STATED = SensitivityConfig(prior_width_factors=[1.0])
BY_INSTRUMENT = {"frames"}
"""Sections that mean something of an instrument's poses alone."""
BY_TABLES = {"instruments", "sensors"}


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
    data: DataConfig
    """What was measured: tables of readings, or one table of an instrument that sees a platform on legs."""
    sensors: dict[str, ChannelConfig] = Field(default={}, exclude_if=lambda value: not value)
    """Noise of each channel of tables of readings, or of all of a kind."""
    units: UnitsConfig = UnitsConfig()
    """Units of tolerances, requirements and results."""
    deformation: DeformationConfig = DeformationConfig()
    """Nominal deformation of the platform of a machine on legs."""
    parameters: Annotated[dict[str, PriorConfig], Field(min_length=1)]
    """Tolerance of each symbol."""
    frames: FramesConfig = Field(default=FramesConfig(), exclude_if=lambda value: value == FramesConfig())
    """Frames that are found with the machine, mm and degrees."""
    noise_factor_log_sd: dict[str, Positive] = Field(default={}, exclude_if=lambda value: not value)
    """By group of channels: standard deviation of the logarithm of a factor on its noise [1]."""
    model_error: StudyErrorConfig = ModelErrorConfig()
    """What the models leave out, in terms whose sizes are found; or of tables of readings τ alone, by channel or kind.
    """
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
    sensitivity: SensitivityConfig = Field(
        default_factory=lambda known: AS_STATED if _is_tables(known) else SensitivityConfig()
    )
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
    def by_tables(self) -> bool:
        """Whether tables of readings were measured, and not poses by an instrument."""
        return isinstance(self.data, list)

    @property
    def tables(self) -> list[DataTableConfig]:
        """The tables of readings."""
        assert isinstance(self.data, list)
        return self.data

    @property
    def measured(self) -> TargetDataConfig | PoseDataConfig | PointDataConfig:
        """What an instrument measured."""
        assert not isinstance(self.data, list)
        return self.data

    @property
    def leg_error(self) -> ModelErrorConfig:
        """The model error in terms; without any where it is stated by channel."""
        return ModelErrorConfig(terms=[]) if isinstance(self.model_error, dict) else self.model_error

    @property
    def channel_errors(self) -> dict[str, ModelErrorScaleConfig]:
        """Priors of model errors by groups of channels; none where it is stated in terms."""
        return self.model_error if isinstance(self.model_error, dict) else {}

    @model_validator(mode="before")
    @classmethod
    def _name_no_error(cls, content: Any) -> Any:
        """Tables without a model error have none by channel, as results of earlier versions say."""
        if isinstance(content, dict) and _is_tables(content) and content.get("model_error") == {"terms": []}:
            return content | {"model_error": {}}
        return content

    @model_validator(mode="after")
    def _check_variants(self) -> Self:
        if isinstance(self.data, TargetDataConfig) and self.frames != FramesConfig():
            raise ValueError("found [frames] beside targets on the base, which stand for it, expected no [frames]")
        _check_names([variant.name for variant in self.variants])
        self._check_route()
        for variant in self.variants:
            for symbol in variant.free or ():
                prior = self.parameters.get(symbol.partition("[")[0])
                if prior is None and any(symbol.startswith(f"{name}_") for name in self.instruments):
                    continue  # perhaps one that is found from the data
                if prior is None or isinstance(prior, FixedConfig):
                    found = "no prior" if prior is None else "a fixed value"
                    raise ValueError(
                        f"variant {variant.name!r} frees {symbol!r}, which has {found} in [parameters], "
                        "expected a normal or uniform prior"
                    )
        return self

    def _check_route(self) -> None:
        """Raise ValueError for what means nothing beside such data."""
        data, meant = ("tables of readings", "[data]") if self.by_tables else ("an instrument's poses", "[[data]]")
        fields = type(self).model_fields
        stated = {key for key, one in fields.items() if getattr(self, key) != one.default}
        for name in sorted(stated & (BY_INSTRUMENT if self.by_tables else BY_TABLES)):
            raise ValueError(f"{name}: found beside {data}, where it means nothing, expected it beside {meant} alone")
        for variant in self.variants:
            if variant.model is None and (not self.by_tables or variant.deformation != "none"):
                raise ValueError(f"variant {variant.name!r}: model: missing, expected the kinematic model of the legs")
        if self.by_tables and not self.sensors:
            raise ValueError("sensors: missing, expected the noise of the channels")
        if not isinstance(self.model_error, dict):
            every = [name for one in self.variants for name in self.model_error.of(one.model_error).terms]
            try:
                self.model_error.check_floors(dict.fromkeys(every))
            except ValueError as error:
                raise ValueError(f"model_error.{error}") from error


def _is_tables(known: Mapping[str, Any]) -> bool:
    return isinstance(known.get("data"), list)


def _check_names(names: list[str]) -> None:
    """Raise ValueError for variants of one name, or of names that no file system need tell apart."""
    first: dict[str, str] = {}
    for name in names:
        other = first.setdefault(stem_of(name).lower(), name)
        if names.count(name) > 1:
            raise ValueError(
                f"variant {name!r} is there twice, expected each variant once, or a name of its own for each free set"
            )
        if other != name:
            raise ValueError(f"variants {other!r} and {name!r} would share their files, expected other names")
