"""The schema of a calibration study."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.classes import ClassMark, label_class
from bayescal.config.sections import ExperimentConfig, InputFile, NotNegative, Positive, Section
from bayescal.density.schema import FixedConfig, ModelErrorConfig, PriorConfig
from bayescal.experiments.shared.schema import DeformationConfig
from bayescal.inference.schema import EvidenceConfig, SamplerConfig


class DataConfig(Section):
    """Measurements of a study and what is known of their noise."""

    origin: str
    targets: InputFile
    actuators: InputFile
    reference: InputFile
    target_noise_um: Positive
    actuator_noise_um: NotNegative
    pose_method: Literal["robust", "line"] = "robust"


class VariantConfig(Section):
    """A kinematic model with a deformation and its free parameters; all others stay at their nominal values."""

    model: Annotated[str, ClassMark("MODELS")]
    deformation: Annotated[str, ClassMark("DEFORMATIONS")]
    free: Annotated[list[str], Field(min_length=1)]
    published: InputFile | None = None

    @property
    def name(self) -> str:
        """For example ``six_pus/none``; of somebody else's classes their own names."""
        return f"{label_class(self.model)}/{label_class(self.deformation)}"


class SensitivityConfig(Section):
    """Tolerances of the lengths for which the evidence is computed anew."""

    tolerance_mm: Annotated[list[Positive], Field(min_length=1)] = Field(default=[0.5, 1.0, 2.0, 5.0])


class StudyConfig(ExperimentConfig):
    """A calibration study: data, variants, priors and effort."""

    kind: Literal["study"]
    mechanism: InputFile
    claims: Annotated[str, ClassMark("CLAIMS")] | None = None
    data: DataConfig
    deformation: DeformationConfig = DeformationConfig()
    parameters: dict[str, PriorConfig]
    model_error: ModelErrorConfig = ModelErrorConfig()
    variants: Annotated[list[VariantConfig], Field(min_length=1)]
    sampler: SamplerConfig = SamplerConfig()
    evidence: EvidenceConfig = EvidenceConfig()
    sensitivity: SensitivityConfig = SensitivityConfig()

    @model_validator(mode="after")
    def _check_variants(self) -> Self:
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
