"""Everything a study computes with, read from its files once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.config.load import look_up
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.joint_deflection import (
    JointDeflection,
    KappaEstimate,
    MatrixEstimate,
    fit_linear_deformation,
    fit_matrix_deformation,
    measure_joint_deflection,
)
from bayescal.density.likelihood import Likelihood, PoseLikelihood
from bayescal.density.model_error import INDEPENDENT, KernelScale, build_kernel
from bayescal.density.posterior import ModelError, Posterior
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
from bayescal.density.schema import FixedConfig, NormalConfig
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.errors import InputError, PoseInputError, name_faults
from bayescal.experiments.shared.per_leg import spread_over_legs
from bayescal.experiments.study.measurement import (
    Measurement,
    TargetMeasurement,
    check_measurement,
    name_data,
    read_measurement,
)
from bayescal.experiments.study.published import read_published
from bayescal.experiments.study.schema import StudyConfig, TargetDataConfig, VariantConfig
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import Machine, check_home_pose
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE


@dataclass(frozen=True, eq=False)
class StudyInputs:
    """Config and data of a study.

    Attributes
    ----------
    config : StudyConfig
    folder : Path
        Where the config's file names start.
    mechanism : Mechanism
    measured : Measurement
    """

    config: StudyConfig
    folder: Path
    mechanism: Mechanism
    measured: Measurement

    # --- data ----------------------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all P poses."""
        return self.measured.names

    @property
    def verification(self) -> np.ndarray:
        """Which poses are kept for verification, shape (P,)."""
        return self.measured.verification

    @property
    def targets(self) -> TargetMeasurement | None:
        """The photogrammetry; None of another instrument."""
        return self.measured if isinstance(self.measured, TargetMeasurement) else None

    @property
    def target_noise(self) -> float:
        """Standard deviation of a target coordinate, mm."""
        assert isinstance(self.config.data, TargetDataConfig)
        return self.config.data.target_noise_um * MICROMETRE

    @property
    def displacement(self) -> Array:
        """Actuator displacements from the nominal initial positions, shape (P, N), mm."""
        return self.measured.actuators - self.mechanism.initial_actuator_positions

    def poses(self, verification: bool) -> MeasuredPoses:
        """Return the poses of one use."""
        return self.measured.poses.select(self.verification == verification)

    @cached_property
    def deflection(self) -> JointDeflection | None:
        """Deflection of every leg's joint at every pose from the targets on the pads; None without such targets."""
        if self.targets is None:
            return None
        platform = self.targets.survey.platform
        on_pad = platform.leg > 0
        if not on_pad.any():
            return None
        return measure_joint_deflection(
            self.targets.extraction.platform,
            platform.reference[on_pad],
            platform.measured[:, on_pad],
            platform.leg[on_pad],
            self.target_noise,
            self.mechanism.n_legs,
        )

    @cached_property
    def measured_matrix(self) -> MatrixEstimate | None:
        """K from the calibration poses' ring targets (RR-8096 eqs. 2 to 4)."""
        return (
            None
            if self.deflection is None
            else fit_matrix_deformation(self._calibration_deflection, self._calibration_travel)
        )

    @cached_property
    def measured_kappa(self) -> KappaEstimate | None:
        """κ from the calibration poses' ring targets (RR-8096 eq. 1)."""
        return (
            None
            if self.deflection is None
            else fit_linear_deformation(self._calibration_deflection, self._calibration_travel)
        )

    @property
    def _calibration_deflection(self) -> JointDeflection:
        assert self.deflection is not None
        chosen = ~self.verification
        return JointDeflection(self.deflection.displacement[chosen], self.deflection.covariance[chosen])

    @property
    def _calibration_travel(self) -> Array:
        return self.displacement[~self.verification]

    # --- variants ------------------------------------------------------------------------------------------------

    def variant(self, name: str) -> VariantConfig:
        """Return the variant of a name."""
        return next(v for v in self.config.variants if v.name == name)

    def machine(self, variant: VariantConfig) -> Machine:
        """Return the mechanism seen through a variant."""
        nominal = NominalDeformation(self.config.deformation.kappa, lambda: self.matrix)
        file, names = self.folder / self.config.mechanism, (variant.model, variant.deformation)
        return build_named_machine(self.mechanism, file, *names, nominal, "variants", self.folder)

    @property
    def matrix_from_targets(self) -> bool:
        """Whether K comes from the ring targets."""
        return self.config.deformation.matrix == "targets"

    @cached_property
    def matrix(self) -> Array:
        """K in mm per mm, from the ring targets or from a file in 1e-3."""
        if not self.matrix_from_targets:
            return 1e-3 * read_matrix(self.folder / self.config.deformation.matrix, self.mechanism.n_legs)
        if self.measured_matrix is None:
            data = self.config.data
            where = self.folder / data.reference if isinstance(data, TargetDataConfig) else "deformation.matrix"
            raise InputError(
                f"{where}: found no target on a leg's pad, expected some, since deformation.matrix is 'targets'"
            )
        return self.measured_matrix.matrix

    def likelihood(self, variant: VariantConfig, verification: bool) -> Likelihood:
        """Return the density of the measurements of one use under a variant."""
        noise = self.config.data.actuator_noise_um * MICROMETRE
        extra = self.matrix_variance(variant, verification)
        return self.measured.likelihood(self.machine(variant), verification, noise, extra)

    def matrix_variance(self, variant: VariantConfig, verification: bool) -> Array | None:
        """Return v_ni of the poses of one use (P, N) in mm² where a variant's K was measured, otherwise None."""
        if not (self.machine(variant).deformation.uses_matrix and self.matrix_from_targets):
            return None
        return self._matrix_variance(self.poses(verification).actuators - self.mechanism.initial_actuator_positions)

    def _matrix_variance(self, displacement: Array) -> Array:
        """Return the variance of Δb_z (P, N) in mm² that the uncertainty of the rest of K leaves.

        Between poses the error is correlated; its variance enters pose by pose, which is the larger part of it.
        """
        assert self.measured_matrix is not None
        n = self.mechanism.n_legs
        blocks = self.measured_matrix.covariance.reshape(n, n, n, n)
        variance = np.empty((len(displacement), n))
        for leg in range(n):
            travel = displacement.copy()
            travel[:, leg] = 0.0  # the diagonal is free or nominal
            variance[:, leg] = np.einsum("pj,jk,pk->p", travel, blocks[leg, :, leg, :], travel)
        return variance

    def posterior(self, variant: VariantConfig, with_model_error: bool, factor: float = 1.0) -> Posterior:
        """Return the posterior of a variant; ``factor`` multiplies the widths of all parameters' priors."""
        priors, fixed = self.priors(variant, factor)
        error = ModelError(None)
        if with_model_error:
            scale = self.config.model_error.scale_um * MICROMETRE
            error = ModelError(scale, shared=not self.config.model_error.per_leg)
        likelihood = self.likelihood(variant, verification=False)
        if with_model_error and self.kernel_name(variant) != INDEPENDENT:
            structured = self._structure(likelihood, self.kernel_name(variant))
            return StructuredPosterior(structured, priors, error, fixed, kernel_scale=self._kernel_scale)
        return Posterior(likelihood, priors, error, fixed)

    def kernel_name(self, variant: VariantConfig) -> str:
        """Return the kernel of a variant's model error: its own, or that of all."""
        return variant.model_error or self.config.model_error.kernel

    @property
    def has_kernels(self) -> bool:
        """Whether any variant has a structured model error."""
        return any(self.kernel_name(variant) != INDEPENDENT for variant in self.config.variants)

    def _structure(self, likelihood: Likelihood, kernel: str) -> StructuredLikelihood:
        """Return the density of the calibration poses with a structured model error."""
        if not isinstance(likelihood, PoseLikelihood):
            raise InputError(
                f"model_error.kernel: found {kernel!r} with poses measured in part, points, or frames to be found, "
                f"expected whole poses in known frames, or kernel {INDEPENDENT!r}"
            )
        length = self.config.model_error.kernel_length
        return StructuredLikelihood(likelihood, build_kernel(kernel, length), self.mechanism.actuator_range)

    @property
    def _kernel_scale(self) -> KernelScale:
        config = self.config.model_error
        return KernelScale(config.kernel_scale_um * MICROMETRE, config.kernel_spread, not config.kernel_per_leg)

    def priors(self, variant: VariantConfig, factor: float = 1.0) -> tuple[dict[str, Prior], dict[str, float]]:
        """Return the priors of a variant's free parameters and frames, and what is fixed off nominal.

        A ``factor`` multiplies the width of every prior: the standard deviation of a normal, the half width of a
        uniform one.
        """
        priors: dict[str, Prior] = {}
        fixed: dict[str, float] = {}
        blocks = {block.symbol: block for block in self.machine(variant).layout.blocks}
        for symbol, config in self.config.parameters.items():
            if symbol not in blocks:
                if symbol in variant.free:
                    raise InputError(f"found {symbol!r} free, expected one of {', '.join(blocks)}")
                continue
            block = blocks[symbol]
            if isinstance(config, FixedConfig):
                offsets = spread_over_legs(config.offset, len(block.nominal), symbol)
                fixed |= {n: v + o for n, v, o in zip(block.names, block.nominal, offsets, strict=True)}
            elif symbol in variant.free:
                widths = config.sd if isinstance(config, NormalConfig) else config.half_width
                spread = [factor * width for width in spread_over_legs(widths, len(block.nominal), symbol)]
                normal = isinstance(config, NormalConfig)
                for name, value, width in zip(block.names, block.nominal, spread, strict=True):
                    priors[name] = NormalPrior(value, width) if normal else UniformPrior(value - width, value + width)
        return priors | self.measured.frame_priors(factor), fixed


def _measure_deflection(inputs: StudyInputs) -> None:
    """Compute what the ring targets say now, so that a fault shows before any long computation."""
    try:
        _ = inputs.deflection, inputs.measured_matrix, inputs.measured_kappa
    except PoseInputError as error:
        raise InputError(f"pose {inputs.names[error.index]!r}: {error.fault}") from error


def _check_widths(inputs: StudyInputs, variant: VariantConfig) -> None:
    """Raise InputError for a factor that takes a uniform prior beyond what a parameter may be."""
    for factor in inputs.config.sensitivity.factor:
        with name_faults(f"sensitivity.factor {factor:g}"):
            inputs.posterior(variant, True, factor).check_machine()


def load_inputs(config: StudyConfig, folder: Path) -> StudyInputs:
    """Read all files of a study and check that every variant can be built.

    Raises
    ------
    InputError
        For anything at fault in the config's files, before any long computation.
    """
    mechanism = load_mechanism(folder / config.mechanism)
    inputs = StudyInputs(config, folder, mechanism, read_measurement(config, folder, mechanism))
    with name_faults(name_data(config.data, folder)):
        _measure_deflection(inputs)
    for variant in config.variants:
        machine = inputs.machine(variant)
        with name_faults(folder / config.mechanism):
            check_home_pose(machine)
        check_measurement(inputs.measured, machine, config.data, folder)
        with name_faults(f"variant {variant.name!r}"):
            inputs.posterior(variant, with_model_error=True).check_machine()
            _check_widths(inputs, variant)
        if variant.published is not None:
            read_published(folder / variant.published, mechanism.n_legs)
    known = {block.symbol for variant in config.variants for block in inputs.machine(variant).layout.blocks}
    for symbol in config.parameters:
        if symbol not in known:
            look_up(dict.fromkeys(known), symbol, "parameters", folder)
    return inputs
