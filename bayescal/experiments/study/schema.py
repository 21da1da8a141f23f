"""The schema of a calibration study."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from bayescal.config.load import MEASURED
from bayescal.config.sections import ExperimentConfig, InputFile, NotNegative, Positive, Section
from bayescal.density.schema import FixedConfig, ModelErrorConfig, PriorConfig
from bayescal.experiments.shared.schema import DeformationConfig, FramesConfig
from bayescal.inference.schema import EvidenceConfig, SamplerConfig

TABLES = ("targets", "poses", "points")
"""Kinds of measurement, and the keys of their tables."""


class MeasuredConfig(Section):
    """What all kinds of measurement have."""

    origin: str
    actuator_noise_um: NotNegative

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
    targets: InputFile
    actuators: InputFile
    reference: InputFile
    target_noise_um: Positive
    pose_method: Literal["robust", "line", "least_squares"] = "robust"


class PoseDataConfig(MeasuredConfig):
    """Poses that an instrument handed out, whole or in part; the table states its noise, or these keys do."""

    measurement: Literal["poses"]
    poses: InputFile
    actuators: InputFile | None = None
    position_um: Positive | None = None
    orientation_arcsec: Positive | None = None


class PointDataConfig(MeasuredConfig):
    """Points on the platform that stations tracked; the table states its noise, or these keys do."""

    measurement: Literal["points"]
    points: InputFile
    probe: InputFile
    actuators: InputFile
    stations: InputFile | None = None
    point_um: Positive | Annotated[list[Positive], Field(min_length=3, max_length=3)] | None = None
    range_um: NotNegative = 0.0
    range_ppm: NotNegative = 0.0
    azimuth_arcsec: Positive | None = None
    elevation_arcsec: Positive | None = None

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
    found = value.get("measurement", "targets") if isinstance(value, dict) else value.measurement
    return f"{MEASURED}{found}"


type DataConfig = Annotated[
    Annotated[TargetDataConfig, Tag(f"{MEASURED}targets")]
    | Annotated[PoseDataConfig, Tag(f"{MEASURED}poses")]
    | Annotated[PointDataConfig, Tag(f"{MEASURED}points")],
    Discriminator(_tag_data),
]


class VariantConfig(Section):
    """A kinematic model with a deformation and its free parameters; all others stay at their nominal values."""

    model: str
    deformation: str
    free: Annotated[list[str], Field(min_length=1)]
    published: InputFile | None = None

    @property
    def name(self) -> str:
        """For example ``six_pus/none``."""
        return f"{self.model}/{self.deformation}"


class SensitivityConfig(Section):
    """Tolerances of the lengths for which the evidence is computed anew."""

    tolerance_mm: Annotated[list[Positive], Field(min_length=1)] = Field(default=[0.5, 1.0, 2.0, 5.0])


class StudyConfig(ExperimentConfig):
    """A calibration study: data, variants, priors and effort; frames in mm and degrees."""

    kind: Literal["study"]
    mechanism: InputFile
    claims: str | None = None
    data: DataConfig
    deformation: DeformationConfig = DeformationConfig()
    parameters: dict[str, PriorConfig]
    frames: FramesConfig = Field(default=FramesConfig(), exclude_if=lambda value: value == FramesConfig())
    model_error: ModelErrorConfig = ModelErrorConfig()
    variants: Annotated[list[VariantConfig], Field(min_length=1)]
    sampler: SamplerConfig = SamplerConfig()
    evidence: EvidenceConfig = EvidenceConfig()
    sensitivity: SensitivityConfig = SensitivityConfig()

    @model_validator(mode="after")
    def _check_variants(self) -> Self:
        if isinstance(self.data, TargetDataConfig) and self.frames != FramesConfig():
            raise ValueError("found [frames] beside targets on the base, which stand for it, expected no [frames]")
        names = [variant.name for variant in self.variants]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"variant {name!r} stands twice, expected each variant once")
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
