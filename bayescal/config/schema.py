"""The schema of every config. Keys carry their units; lengths are in mm, noise in µm, angles in degrees."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator

LARGEST = 1e9  # beyond it, or as close to zero, a number is a slip and overflows when squared often enough
type Number = Annotated[FiniteFloat, Field(ge=-LARGEST, le=LARGEST)]
type Positive = Annotated[FiniteFloat, Field(gt=0, ge=1 / LARGEST, le=LARGEST)]
type NotNegative = Annotated[FiniteFloat, Field(ge=0, le=LARGEST)]
type PerLeg = Number | list[Number]
type PositivePerLeg = Positive | list[Positive]
type Beta = Annotated[FiniteFloat, Field(gt=0, lt=0.5)]
type Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]


class Section(BaseModel):
    """A table of a config: unknown keys and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


# --- mechanism ---------------------------------------------------------------------------------------------------


class PointsConfig(Section):
    """Points of a body: on a circle by azimuth, or one by one."""

    radius_mm: Positive | None = None
    azimuth_deg: list[Number] | None = None
    height_mm: Number = 0.0
    points_mm: list[Vector] | None = None

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        circle = {"radius_mm", "azimuth_deg"} & self.model_fields_set
        one_by_one = self.points_mm is not None and not ({"height_mm"} | circle) & self.model_fields_set
        if not one_by_one and (len(circle) < 2 or self.points_mm is not None):
            raise ValueError("expected either radius_mm with azimuth_deg, or points_mm")
        return self


class LegsConfig(Section):
    """Lengths, actuator directions and initial actuator positions: one value for all legs or one per leg.

    Actuators drive the joints at the ``base`` along their directions, or each the length of a ``strut``; the lengths of
    struts may follow from the home pose.
    """

    drive: Literal["base", "strut"] = "base"
    length_mm: PositivePerLeg | None = None
    direction: Vector | list[Vector] | None = None
    initial_actuator_position_mm: PerLeg = 0.0
    actuator_range_mm: Positive

    @model_validator(mode="after")
    def _check_drive(self) -> Self:
        if self.drive == "strut" and self.direction is not None:
            raise ValueError("found direction with drive 'strut', expected none, since a strut acts along itself")
        return self


class HomeConfig(Section):
    """Where the platform's origin stands at home, base frame, with the platform level."""

    position_mm: Vector


class FlexuresConfig(Section):
    """Flexure joints at both ends of every leg: length l_b and β, one value for all legs or one per leg."""

    length_mm: PositivePerLeg
    beta: Beta | list[Beta] = 0.25


class BeamSectionConfig(Section):
    """A round solid section of an elastic material, or k1 = EI, k2 = ES and k3 = GJ themselves."""

    diameter_mm: Positive | None = None
    young_modulus_gpa: Positive | None = None
    shear_modulus_gpa: Positive | None = None
    k1_n_mm2: Positive | None = None
    k2_n: Positive | None = None
    k3_n_mm2: Positive | None = None

    @model_validator(mode="after")
    def _check_one_way(self) -> Self:
        rod, numbers = {"diameter_mm", "young_modulus_gpa", "shear_modulus_gpa"}, {"k1_n_mm2", "k2_n", "k3_n_mm2"}
        if self.model_fields_set not in (rod, numbers):
            raise ValueError(
                "expected either diameter_mm, young_modulus_gpa and shear_modulus_gpa, or k1_n_mm2, k2_n and k3_n_mm2"
            )
        return self


class StiffnessConfig(Section):
    """Sections of a flexure and of a leg between its flexures, the same for all legs."""

    flexure: BeamSectionConfig
    leg: BeamSectionConfig


class LoadConfig(Section):
    """What pulls at the platform besides its legs, base frame; its weight acts at the centre of mass."""

    force_n: Vector = Field(default=[0.0, 0.0, 0.0])
    moment_n_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    mass_kg: NotNegative = 0.0
    centre_of_mass_mm: Vector = Field(default=[0.0, 0.0, 0.0])
    gravity_m_s2: Vector = Field(default=[0.0, 0.0, -9.80665])


class MechanismConfig(Section):
    """A platform on legs, driven at the base or as struts."""

    name: str
    base: PointsConfig
    platform: PointsConfig
    legs: LegsConfig
    home: HomeConfig | None = None
    flexures: FlexuresConfig | None = None
    stiffness: StiffnessConfig | None = None
    load: LoadConfig = LoadConfig()

    @model_validator(mode="after")
    def _check_flexures(self) -> Self:
        if self.stiffness is not None and self.flexures is None:
            raise ValueError("found [stiffness] without [flexures], expected both")
        return self


# --- study -------------------------------------------------------------------------------------------------------


class DataConfig(Section):
    """Measurements of a study and what is known of their noise."""

    origin: str
    targets: str
    actuators: str
    reference: str
    target_noise_um: Positive
    actuator_noise_um: NotNegative
    pose_method: Literal["robust", "line"] = "robust"


class DeformationConfig(Section):
    """Nominal platform deformation: κ for the linear variant, K for the matrix variant.

    ``matrix`` is the name of a CSV file, or ``targets`` to take K from the targets on the platform.
    """

    kappa: Number = 0.0
    matrix: str = "targets"


class NormalConfig(Section):
    """Normal tolerance about the nominal value; sd in the parameter's unit (mm for lengths)."""

    prior: Literal["normal"]
    sd: PositivePerLeg


class UniformConfig(Section):
    """Uniform within a half width about the nominal value."""

    prior: Literal["uniform"]
    half_width: PositivePerLeg


class FixedConfig(Section):
    """Not free: held at the nominal value plus an offset."""

    prior: Literal["fixed"]
    offset: PerLeg = 0.0


type PriorConfig = Annotated[NormalConfig | UniformConfig | FixedConfig, Field(discriminator="prior")]


class ModelErrorConfig(Section):
    """Half-normal prior of the model error τ; one τ per leg or one for all legs."""

    scale_um: Positive = 10.0
    per_leg: bool = True


class VariantConfig(Section):
    """A kinematic model with a deformation and its free parameters; all others stay at their nominal values."""

    model: str
    deformation: str
    free: Annotated[list[str], Field(min_length=1)]
    published: str | None = None

    @property
    def name(self) -> str:
        """For example ``six_pus/none``."""
        return f"{self.model}/{self.deformation}"


class SamplerConfig(Section):
    """Ensembles of walkers."""

    ensembles: Annotated[int, Field(ge=4, le=64)] = 4
    walkers: Annotated[int, Field(ge=8, le=4096)] = 128
    burn_in: Annotated[int, Field(ge=0)] = 40
    steps: Annotated[int, Field(ge=2)] = 80


class EvidenceConfig(Section):
    """Effort of the evidence estimators; importance sampling goes on until its standard error is small enough."""

    draws: Annotated[int, Field(ge=1000)] = 20_000
    max_draws: Annotated[int, Field(ge=1000)] = 100_000
    target_error: Positive = 0.01

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.max_draws < self.draws:
            raise ValueError(f"found max_draws {self.max_draws} below draws {self.draws}, expected it not below")
        return self


class SensitivityConfig(Section):
    """Tolerances of the lengths for which the evidence is computed anew."""

    tolerance_mm: Annotated[list[Positive], Field(min_length=1)] = [0.5, 1.0, 2.0, 5.0]


class StudyConfig(Section):
    """A calibration study: data, variants, priors and effort."""

    kind: Literal["study"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    title: str
    seed: Annotated[int, Field(ge=0)]
    mechanism: str
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


# --- comparison of pose extraction methods -----------------------------------------------------------------------


class PoseMethodsConfig(Section):
    """The simulation of RR-8096 figure 5: two ways to find a body's pose from its targets."""

    kind: Literal["pose_methods"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    title: str
    seed: Annotated[int, Field(ge=0)]
    n_targets: Annotated[list[Annotated[int, Field(ge=3)]], Field(min_length=1)]
    repeats: Annotated[int, Field(ge=2)]
    length_mm: Positive
    radius_mm: Positive
    target_noise_um: Positive


# --- simulation of a twin ----------------------------------------------------------------------------------------


class TruthConfig(Section):
    """The machine behind the simulated data: nominal plus offsets, and a deformation matrix; rigid without one."""

    deformation_matrix: str | None = None
    offsets: dict[str, PerLeg]


class PosesConfig(Section):
    """Actuator configurations as CSV tables in units of ``unit_mm`` about the initial position."""

    calibration: str
    verification: str
    unit_mm: Positive


class NoiseConfig(Section):
    """Standard deviations."""

    target_um: NotNegative
    actuator_um: NotNegative


class TargetRingConfig(Section):
    """Targets evenly on a circle of a body."""

    count: Annotated[int, Field(ge=1)]
    radius_mm: Positive
    height_mm: Number
    azimuth_deg: Number = 0.0


class TargetsConfig(Section):
    """Targets on the rigid parts of both bodies and, where there are any, on the pads that carry the legs' joints."""

    base: Annotated[list[TargetRingConfig], Field(min_length=1)]
    platform: Annotated[list[TargetRingConfig], Field(min_length=1)]
    per_pad: Annotated[int, Field(ge=0)] = 0
    pad_radius_mm: Positive | None = None

    @model_validator(mode="after")
    def _check_pads(self) -> Self:
        if self.per_pad and self.pad_radius_mm is None:
            raise ValueError(f"found per_pad {self.per_pad} without pad_radius_mm, expected both")
        return self


class MeasurementFrameConfig(Section):
    """How far the measurement frame wanders from pose to pose."""

    distance_mm: NotNegative
    angle_deg: NotNegative


class SimulationConfig(Section):
    """Simulated photogrammetry of a machine."""

    kind: Literal["simulation"]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9_-]+$")]
    title: str
    origin: str
    seed: Annotated[int, Field(ge=0)]
    mechanism: str
    model: str
    truth: TruthConfig
    poses: PosesConfig
    noise: NoiseConfig
    targets: TargetsConfig
    measurement_frame: MeasurementFrameConfig
