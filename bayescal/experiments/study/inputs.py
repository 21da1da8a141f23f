"""Everything a study computes with: its measurements, and the density of each variant."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.joint_deflection import JointDeflection, KappaEstimate, MatrixEstimate
from bayescal.density.errors import LegTerm, ModelError
from bayescal.density.exact import CommonErrors, ExactDensity
from bayescal.density.legs import LegPosterior, Likelihood, build_leg_posterior
from bayescal.density.outliers import NORMAL, Contaminated
from bayescal.density.priors import INDEPENDENT, Prior, SharePrior
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.priors import choose_priors, widen
from bayescal.experiments.shared.study_schema import StudyConfig, TargetDataConfig, VariantConfig
from bayescal.experiments.study.kernels import give_kernel, name_kernel
from bayescal.experiments.study.measurement import Measurement, TargetMeasurement
from bayescal.experiments.study.pads import Pads, measure_pads
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import Machine
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import build_named_machine
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
        assert isinstance(self.config.measured, TargetDataConfig)
        return self.config.measured.target_noise_um * MICROMETRE

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
        return None if self._pads is None else self._pads.deflection

    @property
    def measured_matrix(self) -> MatrixEstimate | None:
        """K from the calibration poses' ring targets (RR-8096 eqs. 2 to 4)."""
        return None if self._pads is None else self._pads.matrix

    @property
    def measured_kappa(self) -> KappaEstimate | None:
        """κ from the calibration poses' ring targets (RR-8096 eq. 1)."""
        return None if self._pads is None else self._pads.kappa

    @cached_property
    def _pads(self) -> Pads | None:
        """What the targets on the pads tell; where no variant takes K from them, faults of theirs do not count."""
        needed = self.matrix_from_targets and any(one.deformation == "matrix" for one in self.config.variants)
        if self.targets is None:
            return None
        try:
            return measure_pads(self.targets, self.displacement, self.target_noise)
        except InputError:
            if needed:
                raise
            return None

    # --- variants ------------------------------------------------------------------------------------------------

    def variant(self, name: str) -> VariantConfig:
        """Return the variant of a name."""
        return next(v for v in self.config.variants if v.name == name)

    def machine(self, variant: VariantConfig) -> Machine:
        """Return the mechanism seen through a variant."""
        nominal = NominalDeformation(self.config.deformation.kappa, lambda: self.matrix)
        file, names = self.folder / self.config.machine, variant.seen
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
            data = self.config.measured
            where = self.folder / data.reference if isinstance(data, TargetDataConfig) else "deformation.matrix"
            raise InputError(
                f"{where}: found no target on a leg's pad, expected some, since deformation.matrix is 'targets'"
            )
        return self.measured_matrix.matrix

    def likelihood(self, variant: VariantConfig, verification: bool) -> Likelihood:
        """Return the density of the measurements of one use under a variant."""
        noise = self.config.measured.actuator_noise_um * MICROMETRE
        extra = self.matrix_variance(variant, verification)
        return self.measured.likelihood(self.machine(variant), verification, noise, extra)

    def exact_density(self, variant: VariantConfig, posterior: LegPosterior) -> ExactDensity | None:
        """Return the exact density beside a variant's at the calibration poses.

        None where these are not measured, and where they may be blunders: to these it hardly matters.
        """
        poses, structured = posterior.likelihood.of_poses, posterior.likelihood.structured
        if poses is None or posterior.errors.outliers.expected:
            return None
        noise = self.config.measured.actuator_noise_um * MICROMETRE
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
        assert self._pads is not None
        used = self.verification == verification
        return self._pads.errors(self.displacement[used], None if verification else used)

    def without_shared_errors(self, name: str) -> tuple[Likelihood, Array | None]:
        """Return the density of a variant's calibration poses without the error of a measured K, and that error.

        The error is what each entry of K, in units of its standard deviation, adds to the legs' errors at all poses,
        shape (P, N, N²); None where K is none, or known.
        """
        variant = self.variant(name)
        noise = self.config.measured.actuator_noise_um * MICROMETRE
        likelihood = self.measured.likelihood(self.machine(variant), False, noise, None)
        if self.matrix_variance(variant, verification=False) is None:
            return likelihood, None
        assert self._pads is not None
        return likelihood, self._pads.shared_errors(self.displacement[~self.verification], likelihood.actuator_weight)

    def posterior(self, variant: VariantConfig, with_model_error: bool, factor: float = 1.0) -> LegPosterior:
        """Return the posterior of a variant; ``factor`` multiplies the widths of all parameters' priors."""
        priors, fixed = self.priors(variant, factor)
        error = ModelError(None)
        if with_model_error:
            scale = self.config.leg_error.scale_um * MICROMETRE
            error = ModelError(scale, shared=not self.config.leg_error.per_leg)
        likelihood, terms = self.likelihood(variant, verification=False), list[LegTerm]()
        if with_model_error and name_kernel(self.config, variant) != INDEPENDENT:
            likelihood, terms = give_kernel(likelihood, self.config, variant, self.mechanism.actuator_range)
        blunders = self.config.blunders
        outliers = NORMAL if blunders is None else Contaminated(SharePrior(blunders.expected_share))
        return build_leg_posterior(likelihood, priors, error, fixed, terms, outliers)

    def priors(self, variant: VariantConfig, factor: float = 1.0) -> tuple[dict[str, Prior], dict[str, float]]:
        """Return the priors of a variant's free parameters and frames, and what is fixed off nominal.

        A ``factor`` multiplies the width of every prior: the standard deviation of a normal, the half width of a
        uniform one.
        """
        layout, others = self.machine(variant).layout, self.config.parameters
        known, fixed, _ = choose_priors(self.config, variant, layout, others)
        priors = {name: one if factor == 1.0 else widen(one, factor) for name, one in known.items()}
        return priors | self.measured.frame_priors(factor), fixed

    def free(self, variant: VariantConfig) -> tuple[str, ...]:
        """Return the symbols of a variant's free parameters."""
        known = {name.partition("[")[0] for name in self.priors(variant)[0]}
        stated = dict.fromkeys(name.partition("[")[0] for name in self.config.list_free(variant))
        return tuple(symbol for symbol in stated if symbol in known)
