"""Everything a study computes with, read from its files once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.config.load import look_up
from bayescal.data.actuators import check_moves, check_range
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.joint_deflection import (
    JointDeflection,
    KappaEstimate,
    MatrixEstimate,
    fit_linear_deformation,
    fit_matrix_deformation,
    measure_joint_deflection,
)
from bayescal.density.exact import CommonErrors, ExactDensity
from bayescal.density.free_length import FreeLengthLikelihood, count_nodes
from bayescal.density.free_length_posterior import FreeLengthPosterior
from bayescal.density.likelihood import BATCH, Likelihood, PoseLikelihood
from bayescal.density.model_error import INDEPENDENT, KernelScale, LengthPrior, build_kernel
from bayescal.density.posterior import ModelError, Posterior
from bayescal.density.priors import NormalPrior, Prior, UniformPrior
from bayescal.density.robust import RobustPosterior, build_robust
from bayescal.density.schema import FixedConfig, NormalConfig
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.errors import InputError, PoseInputError, name_faults
from bayescal.experiments.frame.memory import Need, check_memory
from bayescal.experiments.shared.per_leg import spread_over_legs, spread_widths
from bayescal.experiments.study.measurement import (
    Measurement,
    TargetMeasurement,
    check_measurement,
    name_actuator_table,
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

    @property
    def deflection(self) -> JointDeflection | None:
        """Deflection of every leg's joint at every pose from the targets on the pads; None without such targets."""
        return self._pads[0]

    @property
    def measured_matrix(self) -> MatrixEstimate | None:
        """K from the calibration poses' ring targets (RR-8096 eqs. 2 to 4)."""
        return self._pads[1]

    @property
    def measured_kappa(self) -> KappaEstimate | None:
        """κ from the calibration poses' ring targets (RR-8096 eq. 1)."""
        return self._pads[2]

    @cached_property
    def _pads(self) -> tuple[JointDeflection | None, MatrixEstimate | None, KappaEstimate | None]:
        """What the targets on the pads tell; where no variant takes K from them, faults of theirs do not count."""
        needed = self.matrix_from_targets and any(one.deformation == "matrix" for one in self.config.variants)
        try:
            deflection = self._measure_deflection()
            if deflection is None:
                return None, None, None
            chosen, travel = deflection.select(~self.verification), self._calibration_travel
            return deflection, fit_matrix_deformation(chosen, travel), fit_linear_deformation(chosen, travel)
        except InputError:
            if needed:
                raise
            return None, None, None

    def _measure_deflection(self) -> JointDeflection | None:
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

    def exact_density(self, variant: VariantConfig, posterior: Posterior) -> ExactDensity | None:
        """Return the exact density beside a variant's at the calibration poses.

        None where these are not measured, and where they may be blunders: to these it hardly matters.
        """
        likelihood = posterior.likelihood
        structured = likelihood if isinstance(likelihood, StructuredLikelihood) else None
        poses = likelihood if structured is None else structured.base
        if not isinstance(poses, PoseLikelihood) or isinstance(posterior, RobustPosterior):
            return None
        noise = self.config.data.actuator_noise_um * MICROMETRE
        return ExactDensity(poses, noise, self.matrix_errors(variant, verification=False), structured=structured)

    def matrix_variance(self, variant: VariantConfig, verification: bool) -> Array | None:
        """Return v_ni of the poses of one use (P, N) in mm² where a variant's K was measured, otherwise None.

        Between poses the error is correlated; the hot path of the density has its variance, pose by pose.
        """
        common = self.matrix_errors(variant, verification)
        return None if common is None else common.variance

    def matrix_errors(self, variant: VariantConfig, verification: bool) -> CommonErrors | None:
        """Return what the uncertainty of the rest of K leaves of Δb_z where a variant's K was measured.

        The diagonal is free or nominal.
        """
        if not (self.machine(variant).deformation.uses_matrix and self.matrix_from_targets):
            return None
        assert self.measured_matrix is not None
        displacement = self.poses(verification).actuators - self.mechanism.initial_actuator_positions
        rest = np.flatnonzero(~np.eye(self.mechanism.n_legs, dtype=bool))
        design = np.einsum("ij,pk->pijk", np.eye(self.mechanism.n_legs), displacement)
        design = design.reshape(*displacement.shape, -1)[..., rest]
        with_poses = None if verification else self._matrix_with_poses[:, rest]
        return CommonErrors(design, self.measured_matrix.covariance[np.ix_(rest, rest)], with_poses)

    @property
    def _matrix_with_poses(self) -> Array:
        """Covariance of K, row by row, with the errors of the calibration poses in the base frame, (P, N * N, 6)."""
        assert self.measured_matrix is not None
        assert self.measured_matrix.with_pose is not None
        assert self.targets is not None
        rotation = self.targets.extraction.base.rotation[~self.verification]
        moved, turned = np.split(self.measured_matrix.with_pose, 2, axis=-1)
        return np.concatenate([moved @ rotation, turned @ rotation], axis=-1)

    def without_shared_errors(self, name: str) -> tuple[Likelihood, Array | None]:
        """Return the density of a variant's calibration poses without the error of a measured K, and that error.

        The error is what each entry of K, in units of its standard deviation, adds to the legs' errors at all poses,
        shape (P, N, N²); None where K is none, or known.
        """
        variant = self.variant(name)
        noise = self.config.data.actuator_noise_um * MICROMETRE
        likelihood = self.measured.likelihood(self.machine(variant), False, noise, None)
        if self.matrix_variance(variant, verification=False) is None:
            return likelihood, None
        assert self.measured_matrix is not None
        travel, n = self._calibration_travel, self.mechanism.n_legs
        change = np.zeros((len(travel), n, n, n))
        for leg in range(n):
            change[:, leg, leg] = travel
            change[:, leg, leg, leg] = 0.0  # the diagonal is free or nominal
        size = np.sqrt(likelihood.actuator_weight)[..., None]
        root = _square_root(self.measured_matrix.covariance.reshape(n * n, n * n))
        return likelihood, size * (change.reshape(len(travel), n, n * n) @ root)

    def posterior(self, variant: VariantConfig, with_model_error: bool, factor: float = 1.0) -> Posterior:
        """Return the posterior of a variant; ``factor`` multiplies the widths of all parameters' priors."""
        priors, fixed = self.priors(variant, factor)
        error = ModelError(None)
        if with_model_error:
            scale = self.config.model_error.scale_um * MICROMETRE
            error = ModelError(scale, shared=not self.config.model_error.per_leg)
        likelihood = self.likelihood(variant, verification=False)
        if with_model_error and self.kernel_name(variant) != INDEPENDENT:
            if self.config.blunders is not None:
                raise InputError(
                    f"blunders: found them beside kernel {self.kernel_name(variant)!r}, by which poses depend on each "
                    f"other, expected kernel {INDEPENDENT!r}, or deformation 'free_matrix' for linear errors"
                )
            structured, kernel_scale = self._structure(likelihood, variant), self._kernel_scale
            lengths = self.kernel_lengths(variant)
            if lengths is not None:
                return FreeLengthPosterior(structured, priors, error, fixed, kernel_scale=kernel_scale, lengths=lengths)
            return StructuredPosterior(structured, priors, error, fixed, kernel_scale=kernel_scale)
        plain = Posterior(likelihood, priors, error, fixed)
        blunders = self.config.blunders
        return plain if blunders is None else build_robust(plain, blunders.expected_share)

    def kernel_name(self, variant: VariantConfig) -> str:
        """Return the kernel of a variant's model error: its own, or that of all."""
        return self.config.model_error.name_for(variant)

    @property
    def has_kernels(self) -> bool:
        """Whether any variant has a structured model error."""
        return any(self.kernel_name(variant) != INDEPENDENT for variant in self.config.variants)

    def _structure(self, likelihood: Likelihood, variant: VariantConfig) -> StructuredLikelihood:
        """Return the density of the calibration poses with a variant's structured model error."""
        kernel = self.kernel_name(variant)
        if not isinstance(likelihood, PoseLikelihood):
            raise InputError(
                f"model_error.kernel: found {kernel!r} with poses measured in part, points, or frames to be found, "
                f"expected whole poses in known frames, or kernel {INDEPENDENT!r}"
            )
        lengths, travel = self.kernel_lengths(variant), self.mechanism.actuator_range
        check_memory(_estimate_kernel(likelihood.n_poses, likelihood.n_legs, lengths is not None), 1)
        if lengths is not None:
            return FreeLengthLikelihood(likelihood, kernel, lengths, travel)
        return StructuredLikelihood(likelihood, build_kernel(kernel, self.kernel_length(variant)), travel)

    def kernel_length(self, variant: VariantConfig) -> float:
        """Return the length of a variant's kernel, or the median of its prior, in ranges of the actuators."""
        return self.config.model_error.length_for(variant)

    def kernel_lengths(self, variant: VariantConfig) -> LengthPrior | None:
        """Return the prior of the length of a variant's kernel; None where there is none, or it is known."""
        return self.config.model_error.lengths_for(variant)

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
                spread = [factor * width for width in spread_widths(widths, len(block.nominal), symbol, block.unit)]
                normal = isinstance(config, NormalConfig)
                for name, value, width in zip(block.names, block.nominal, spread, strict=True):
                    priors[name] = NormalPrior(value, width) if normal else UniformPrior(value - width, value + width)
        return priors | self.measured.frame_priors(factor), fixed


def _estimate_kernel(n_poses: int, n_legs: int, free_length: bool) -> Need:
    """Return what a kernel takes: matrices of all poses by all, and the hot loop over all poses at once.

    Where the length is free there is a matrix for every length at which the density is found, and for every vector.
    """
    matrices = 6.0 + (count_nodes(n_poses) + BATCH if free_length else 0.0)
    return Need(
        each=8.0 * (matrices * n_poses**2 + 6.0 * BATCH * n_poses * n_legs),
        sizes=f"{n_poses} calibration poses with a kernel of the model error",
        remedy=f"fewer poses or kernel {INDEPENDENT!r}",
    )


def _square_root(covariance: Array) -> Array:
    """Return a matrix whose product with its transpose is a covariance, which may be singular."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _measure_deflection(inputs: StudyInputs) -> None:
    """Compute what the ring targets say now, so that a fault shows before any long computation."""
    try:
        _ = inputs.deflection
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
    measured = read_measurement(config, folder, mechanism)
    with name_faults(name_actuator_table(config.data, folder)):
        check_range(measured.actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, measured.names)
        check_moves(measured.actuators[~measured.verification])
    inputs = StudyInputs(config, folder, mechanism, measured)
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
