"""The schema of a calibration study."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, model_validator

from bayescal.config.classes import ClassMark, label_class
from bayescal.config.load import MEASURED
from bayescal.config.sections import ExperimentConfig, Factor, InputFile, NotNegative, Positive, Section, check_once
from bayescal.density.schema import BlundersConfig, FixedConfig, KernelChoiceConfig, ModelErrorConfig, PriorConfig
from bayescal.experiments.shared.schema import DeformationConfig, FramesConfig
from bayescal.inference.schema import EvidenceConfig, SamplerConfig
from bayescal.numerics.units import choose_arcseconds

TABLES = ("targets", "poses", "points")
"""Kinds of measurement, and the keys of their tables."""


class MeasuredConfig(Section):
    """What all kinds of measurement have."""

    origin: str
    """What the page says of where the data come from; simulated data say so here."""
    actuator_noise_um: NotNegative
    """Standard deviation of an actuator's position about what it reads."""

    @model_validator(mode="before")
    @classmethod
    def _check_tables(cls, value: Any) -> Any:
        """Refuse the table of another measurement, before it is an unknown key."""
        if isinstance(value, dict):
            own = value.get("measurement", TABLES[0])
            for other in TABLES:
                if other in value and other != own and own in TABLES:
                    raise ValueError(f"found a table of {other} beside measurement {own!r}, expected its own alone")
        return value


class TargetDataConfig(MeasuredConfig):
    """Photogrammetry targets on base and platform and what is known of their noise."""

    measurement: Literal["targets"] = Field(default="targets", exclude_if=lambda value: value == "targets")
    """`"targets"`, which is what holds where nothing is said."""
    targets: InputFile
    """CSV file of measured targets."""
    actuators: InputFile
    """CSV file of actuator positions."""
    reference: InputFile
    """CSV file of where targets sit on their bodies."""
    target_noise_um: Positive
    """Standard deviation of a target's coordinates."""
    pose_method: Literal["robust", "line", "least_squares"] = "robust"
    """How a body's pose is found: `robust` (targets may be wrong), `line` (RR-8096) or `least_squares`."""


class PoseDataConfig(MeasuredConfig):
    """Poses that an instrument handed out, whole or in part; the table states its noise, or these keys do."""

    measurement: Literal["poses"]
    """`"poses"`."""
    poses: InputFile
    """CSV file of poses."""
    actuators: InputFile | None = None
    """CSV file of actuator positions, where the table of poses lacks them."""
    position_um: Positive | None = None
    """Standard deviation of a position, each axis, where the table does not state it."""
    orientation_arcsec: Positive | None = None
    """Standard deviation of a rotation, each axis, where the table does not state it."""
    orientation_urad: Positive | None = Field(default=None, exclude_if=lambda value: value is None)
    """The same in microradians, in place of arcseconds."""

    @model_validator(mode="after")
    def _check_one_unit(self) -> Self:
        choose_arcseconds(self.orientation_arcsec, self.orientation_urad)
        return self

    @property
    def arcseconds(self) -> float | None:
        """The noise of a rotation in arcseconds, whichever unit states it."""
        return choose_arcseconds(self.orientation_arcsec, self.orientation_urad)


class PointDataConfig(MeasuredConfig):
    """Points on the platform that stations tracked; the table states its noise, or these keys do."""

    measurement: Literal["points"]
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
    found = value.get("measurement", "targets") if isinstance(value, dict) else getattr(value, "measurement", value)
    return f"{MEASURED}{found}"


type DataConfig = Annotated[
    Annotated[TargetDataConfig, Tag(f"{MEASURED}targets")]
    | Annotated[PoseDataConfig, Tag(f"{MEASURED}poses")]
    | Annotated[PointDataConfig, Tag(f"{MEASURED}points")],
    Discriminator(_tag_data),
]


type VariantName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+( [A-Za-z0-9_-]+)*$")]


class VariantConfig(KernelChoiceConfig):
    """A kinematic model with a deformation and its free parameters; all others stay at their nominal values.

    Without a name of its own a variant is called after model and deformation, ``six_pus/none``; several free sets of
    one model and deformation, or several kernels of the model error, need names. A name has no slash, so that nobody
    takes it for the other kind. Kernels of several known lengths are variants, too: their evidences weigh the lengths.
    """

    model: Annotated[str, ClassMark("MODELS")]
    """Kinematic model; `bayescal list models` shows all."""
    deformation: Annotated[str, ClassMark("DEFORMATIONS")]
    """Deformation of the platform: `none`, `linear` or `matrix`, or one of your own."""
    name: VariantName = Field(default_factory=lambda known: name_variant(known.get("model"), known.get("deformation")))
    """What tables call the variant; `model/deformation` where nothing is said."""
    free: Annotated[list[str], Field(min_length=1)]
    """Symbols that are free; all others stay nominal."""
    published: InputFile | None = None
    """CSV file of printed values to compare with."""

    @property
    def has_own_name(self) -> bool:
        """Whether the config names it."""
        return self.name != name_variant(self.model, self.deformation)


def name_variant(model: str | None, deformation: str | None) -> str:
    """Return what a variant without a name of its own is called; of somebody else's classes their own names."""
    if model is None or deformation is None:  # at fault themselves, which is said elsewhere
        return "nameless"
    return f"{label_class(model)}/{label_class(deformation)}"


def stem_of(variant: str) -> str:
    """Return a variant's name as a part of file names."""
    return variant.replace("/", "-").replace(" ", "_")


TAU_SCALES = [1.0, 3.0, 10.0, 30.0, 100.0]


class SensitivityConfig(Section):
    """Factors on the widths of all priors, sd or half width, for which the evidence is computed anew.

    The scale of the model error's prior is varied by itself, without computing anew.
    """

    factor: Annotated[list[Factor], Field(min_length=1), AfterValidator(check_once)] = Field(
        default=[0.5, 1.0, 2.0, 5.0]
    )
    """Factors on the widths of all priors for which evidences are computed anew [1]."""
    tau_scale_um: Annotated[list[Positive], Field(min_length=1), AfterValidator(check_once)] = Field(
        default=TAU_SCALES, exclude_if=lambda value: value == TAU_SCALES
    )
    """Scales of the model error's prior, tried by reweighting."""

    @model_validator(mode="before")
    @classmethod
    def _refuse_tolerance(cls, content: Any) -> Any:
        if isinstance(content, dict) and "tolerance_mm" in content:
            raise ValueError(
                "tolerance_mm: replaced by factor, which multiplies the width of every prior, expected for example "
                "factor = [0.5, 1.0, 2.0, 5.0]"
            )
        return content


class StudyConfig(ExperimentConfig):
    """A calibration study: data, variants, priors and effort; frames in mm and degrees."""

    kind: Literal["study"]
    """`"study"`."""
    mechanism: InputFile
    """The machine's TOML file."""
    claims: Annotated[str, ClassMark("CLAIMS")] | None = None
    """Statements of a publication that are put to the results: their class, as `file.py:Class`."""
    data: DataConfig
    """What was measured, and how well."""
    deformation: DeformationConfig = DeformationConfig()
    """Nominal deformation of the platform."""
    parameters: dict[str, PriorConfig]
    """Tolerance of each symbol."""
    frames: FramesConfig = Field(default=FramesConfig(), exclude_if=lambda value: value == FramesConfig())
    """Frames that are found with the machine, mm and degrees."""
    model_error: ModelErrorConfig = ModelErrorConfig()
    """Prior of what the models leave out."""
    blunders: BlundersConfig | None = Field(default=None, exclude_if=lambda value: value is None)
    """Whether single poses may be wrong."""
    variants: Annotated[list[VariantConfig], Field(min_length=1)]
    """Models to compare."""
    sampler: SamplerConfig = SamplerConfig()
    """Effort of sampling."""
    evidence: EvidenceConfig = EvidenceConfig()
    """Effort of the evidence."""
    sensitivity: SensitivityConfig = SensitivityConfig()
    """Other widths of the priors."""

    @model_validator(mode="after")
    def _check_variants(self) -> Self:
        if isinstance(self.data, TargetDataConfig) and self.frames != FramesConfig():
            raise ValueError("found [frames] beside targets on the base, which stand for it, expected no [frames]")
        _check_names([variant.name for variant in self.variants])
        for variant in self.variants:
            for symbol in variant.free:
                if variant.free.count(symbol) > 1:
                    raise ValueError(f"variant {variant.name!r} frees {symbol!r} twice, expected each symbol once")
                prior = self.parameters.get(symbol)
                if prior is None or isinstance(prior, FixedConfig):
                    found = "no prior" if prior is None else "a fixed value"
                    raise ValueError(
                        f"variant {variant.name!r} frees {symbol!r}, which has {found} in [parameters], "
                        "expected a normal or uniform prior"
                    )
        return self


def _check_names(names: list[str]) -> None:
    """Raise ValueError for variants of one name, or of names that no file system need tell apart."""
    first: dict[str, str] = {}
    for name in names:
        other = first.setdefault(stem_of(name).lower(), name)
        if names.count(name) > 1:
            raise ValueError(
                f"variant {name!r} stands twice, expected each variant once, or a name of its own for each free set"
            )
        if other != name:
            raise ValueError(f"variants {other!r} and {name!r} would share their files, expected other names")
