"""A study of poses that an instrument measured, whole or in part, of a platform on legs.

Every fault of its files is found as they are read, before any long computation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from bayescal.config.load import look_up
from bayescal.config.registry import find_class
from bayescal.data.actuators import check_moves, check_range
from bayescal.data.measured_poses import MeasuredPoses
from bayescal.data.photogrammetry.joint_deflection import JointDeflection, KappaEstimate, MatrixEstimate
from bayescal.density.errors import FunctionScales, LegTerm, ModelError
from bayescal.density.exact import CommonErrors, ExactDensity
from bayescal.density.functions import FunctionLikelihood, list_arrays
from bayescal.density.instruments import InstrumentLikelihood
from bayescal.density.legs import LegPosterior, Likelihood, build_leg_posterior, check_machine
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.priors import Prior
from bayescal.density.schema import TERMS, ModelErrorConfig
from bayescal.density.sorts import FEWEST_POSES, SORTS
from bayescal.errors import InputError, PoseInputError, name_faults
from bayescal.experiments.frame.memory import Need, check_arrays
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuredVariant, see_legs
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.readings.errors import check_floors
from bayescal.experiments.shared.readings.instruments import keep_files
from bayescal.experiments.shared.readings.priors import choose_priors, widen
from bayescal.experiments.shared.search_memory import check_poses, estimate_legs
from bayescal.experiments.shared.slips import FoundSlip
from bayescal.experiments.shared.study_inputs import Described, Inputs, Task
from bayescal.experiments.shared.study_schema import StudyConfig, TargetDataConfig, VariantConfig, stem_of
from bayescal.experiments.study.measurement import (
    Measurement,
    TargetMeasurement,
    check_measurement,
    name_actuator_table,
    name_data,
    read_measurement,
)
from bayescal.experiments.study.pads import Pads, measure_pads
from bayescal.experiments.study.published import read_published
from bayescal.files.csv_tables import read_matrix
from bayescal.machines.deformations import NominalDeformation
from bayescal.machines.kinematics import Machine, check_home_pose
from bayescal.machines.mechanism import Mechanism
from bayescal.machines.read import build_named_machine, load_mechanism
from bayescal.numerics.geometry import Array
from bayescal.numerics.units import MICROMETRE

if TYPE_CHECKING:
    import pandas as pd

    from bayescal.experiments.frame.parallel import Run
    from bayescal.experiments.shared.estimate import Fit, Subject
    from bayescal.experiments.study.claims import Claims

FEW_POSES = f"fewer than {FEWEST_POSES} poses calibrate the machine"
SPOILT = "each pose may be an outlier by itself: intervals do not allow for errors that repeat with the pose"
ALONE_STATED = 'terms = ["independent"]'


@dataclass(frozen=True, eq=False)
class StudyInputs(Inputs):
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
    def machine_name(self) -> str:
        """The mechanism's file."""
        return self.config.machine

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
    def actuator_noise(self) -> float:
        """Standard deviation of an actuator's position about what it reads, mm."""
        return self.config.measured.actuator_noise_um * MICROMETRE

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

    @property
    def matrix_covariance(self) -> Array | None:
        """Covariance of each row of a measured K, shape (N, N, N); None where K was not measured."""
        if not self.matrix_from_targets or self.measured_matrix is None:
            return None
        n = self.mechanism.n_legs
        legs = np.arange(n)
        return np.asarray(self.measured_matrix.covariance.reshape(n, n, n, n)[legs, :, legs, :])

    def likelihood(self, variant: VariantConfig, verification: bool) -> Likelihood:
        """Return the density of the measurements of one use under a variant."""
        extra = self.matrix_variance(variant, verification)
        return self.measured.likelihood(self.machine(variant), verification, self.actuator_noise, extra)

    def exact_density(self, variant: VariantConfig, posterior: LegPosterior) -> ExactDensity | None:
        """Return the exact density beside a variant's at the calibration poses.

        None where these are not measured, and where they may be outliers: to these it hardly matters.
        """
        known = posterior.likelihood
        if known.of_poses is None or posterior.errors.outliers.expected:
            return None
        errors = self.matrix_errors(variant, verification=False)
        functions = known if isinstance(known, FunctionLikelihood) else None
        return ExactDensity(known.of_poses, self.actuator_noise, errors, functions=functions)

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
        likelihood = self.measured.likelihood(self.machine(variant), False, self.actuator_noise, None)
        if self.matrix_variance(variant, verification=False) is None:
            return likelihood, None
        assert self._pads is not None
        return likelihood, self._pads.shared_errors(self.displacement[~self.verification], likelihood.actuator_weight)

    def posterior(self, variant: VariantConfig, with_model_error: bool, factor: float = 1.0) -> LegPosterior:
        """Return the posterior of a variant; ``factor`` multiplies the widths of all parameters' priors."""
        priors, fixed = self.priors(variant, factor)
        error, known = ModelError(None), self.model_error(variant)
        scale, function_scale = known.scales(self.actuator_noise)
        likelihood, terms = self.likelihood(variant, verification=False), list[LegTerm]()
        if with_model_error and "independent" in known.terms:
            floor = known.floors().get("independent", 0.0) * MICROMETRE
            error = ModelError(scale, not known.per_leg, floor)
        if with_model_error and (sorts := self.list_sorts(variant)):
            likelihood = self.give_functions(likelihood, variant)
            floors: dict[str, float] = {name: one * MICROMETRE for name, one in known.floors().items()}
            terms = [FunctionScales(sorts, function_scale, floors)]
        return build_leg_posterior(likelihood, priors, error, fixed, terms, variant.outliers)

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

    def list_sorts(self, variant: VariantConfig) -> tuple[str, ...]:
        """Return the terms of a variant's model error that are functions of the pose: none where these cannot be.

        They cannot with too few poses, and all of them, which nobody asked for by name, not beside outliers.
        """
        beside = variant.outliers.expected and self.model_error(variant).terms == list(TERMS)
        return () if self.has_few_poses or beside else self._want_sorts(variant)

    @property
    def has_few_poses(self) -> bool:
        """Whether errors that are functions of the pose cannot be distinguished from the geometry by so few poses."""
        return bool(np.count_nonzero(~self.verification) < FEWEST_POSES)

    def _want_sorts(self, variant: VariantConfig) -> tuple[str, ...]:
        return tuple(name for name in self.model_error(variant).terms if name in SORTS)

    def model_error(self, variant: VariantConfig) -> ModelErrorConfig:
        """Return the model error of a variant, with its terms."""
        return self.config.leg_error.of(variant.model_error)

    def has_model_error(self, variant: VariantConfig) -> bool:
        """Whether a variant has a model error, of any kind."""
        return bool(self.model_error(variant).terms)

    @property
    def unused(self) -> str:
        """Which terms of the model error are left out, in words; empty where none is."""
        lost = [one for one in self.config.variants if self._want_sorts(one) and not self.list_sorts(one)]
        if not lost:
            return ""
        terms = ", ".join(dict.fromkeys(name for one in lost for name in self._want_sorts(one)))
        whose = "" if len(lost) == len(self.config.variants) else f" of {', '.join(repr(one.name) for one in lost)}"
        return f"the model error{whose} has no terms {terms}, as {FEW_POSES if self.has_few_poses else SPOILT}"

    def give_functions(self, base: Likelihood, variant: VariantConfig) -> FunctionLikelihood:
        """Return a density of the calibration poses with the errors of a variant that are functions of the pose.

        Raises
        ------
        InputError
            Beside outliers, and for more poses than there is memory for.
        """
        sorts, n_poses = self.list_sorts(variant), base.n_poses
        terms = f"the terms {', '.join(sorts)} of the model error, by which poses depend on each other"
        if variant.outliers.expected:
            raise InputError(f"outlier_share: found it beside {terms}, expected model_error with {ALONE_STATED}")
        check_arrays(
            {"calibration poses with errors that are functions of the pose": n_poses},
            list_arrays(n_poses, base.n_legs),
            f"fewer poses or [model_error] with {ALONE_STATED}",
        )
        assert isinstance(base, PoseLikelihood | InstrumentLikelihood)
        order = {name: k / len(self.names) for k, name in enumerate(self.names)}
        return FunctionLikelihood(base, sorts, self.mechanism.actuator_range, order)

    # --- what a study is asked -----------------------------------------------------------------------------------

    @property
    def fit_class(self) -> type[Fit]:
        """A fit without anything of its own."""
        from bayescal.experiments.shared.estimate import Fit

        return Fit

    @cached_property
    def machine_files(self) -> tuple[dict[str, bytes], str]:
        """What the machine is read from, by names in one folder, and where in that folder the config's own one is."""
        return keep_files(self.config, self.folder)

    def list_commands(self) -> dict[str, str]:
        """Return the actuator positions of the calibration poses, and K where it was measured, as files."""
        from bayescal.experiments.study.calibrated import format_actuators

        return format_actuators(self)

    def list_tasks(self) -> list[Task]:
        """Return a task for every variant with its model error, then without, where it has one."""
        own = {one.name: self.has_model_error(one) for one in self.config.variants}
        return [Task(name) for name in own] + [Task(name, False) for name, there in own.items() if there]

    def name_task(self, task: Task) -> str:
        """Return a task's name, from which its random numbers come."""
        return f"{stem_of(task.variant)}-tau-{task.setting}"

    def subject(self, task: Task, factor: float = 1.0) -> Subject:
        """Return the posterior of a variant to be fitted."""
        from bayescal.experiments.study.fit import Legs

        return Legs(self, task, factor)

    def fit(self, task: Task) -> Fit:
        """Return a posterior, with its tree's file in place of what only that has."""
        from bayescal.experiments.study.fit import pack, run_task

        return pack(self, task, run_task(self, task))

    def describe(self, fits: Mapping[Task, Fit], run: Run) -> Described:
        """Return variants, parameters, errors of poses, and what the targets on the pads show of the joints."""
        from bayescal.experiments.study.tables import describe_poses

        return describe_poses(self, fits, run)

    def conclude(self, summary: Mapping[str, Any], run: Run) -> dict[str, pd.DataFrame]:
        """Return least squares, and a publication's claims put to the study."""
        from bayescal.experiments.study.tables import put_to_claims

        return put_to_claims(self, summary, run)

    @property
    def claims(self) -> Claims | None:
        """What a publication claims of the study; InputError for a class that is none, or without targets."""
        name = self.config.claims
        if name is None:
            return None
        if self.targets is None:
            raise InputError(f"{self.folder}: claims: found {name!r} without targets, expected measured targets")
        from bayescal.experiments.study.claims import Claims

        kind = Claims
        return find_class("CLAIMS", name, kind, "claims", self.folder, self.folder)()  # type: ignore[type-abstract]

    def estimate_memory(self) -> Need:
        """Return what the posteriors of all poses take."""
        posteriors = (self.posterior(variant, with_model_error=True) for variant in self.config.variants)
        largest = max(posteriors, key=lambda posterior: posterior.n_parameters)
        config = self.config
        return estimate_legs(largest, config.sampler, config.evidence, len(self.verification), len(self.list_tasks()))

    def outlook(self) -> list[str]:
        """Return what each variant's poses can determine."""
        from bayescal.experiments.study.doubts import list_outlooks

        return list_outlooks(self)

    def find_slip(self) -> FoundSlip | None:
        """Return what explains data that no variant's machine fits many times better; None where one fits."""
        from bayescal.experiments.study.doubts import find_study_slip

        return find_study_slip(self)

    def doubt(self) -> list[str]:
        """Return a slip, or that all poses are shifted alike."""
        from bayescal.experiments.study.doubts import doubt_zero

        return super().doubt() or doubt_zero(self)

    def measure(self, names: Sequence[str], path: Path, with_model_error: bool) -> dict[str, MeasuredReadings]:
        """Return variants as measured; InputError where no whole poses were measured by one noise each."""
        if not self.measured.has_poses:
            raise InputError(
                f"{path}: data: found poses measured in part, points, or frames to be found, expected whole poses in "
                "known frames, since audits and checks of data start from these"
            )
        if any(self.variant(name).outliers.expected for name in names):
            raise InputError(
                f"{path}: found outlier_share, expected none: audits and checks have no poses that may be spoilt"
            )
        # points that tell whole poses are taken as these: the density of poses has no frames among its parameters
        poses = self.poses(verification=False)
        found = {name: self._measure(self.variant(name), with_model_error) for name in names}
        return {
            name: see_legs(one if one.posterior.likelihood.of_poses else one.with_poses(poses))
            for name, one in found.items()
        }

    def _measure(self, variant: VariantConfig, with_model_error: bool) -> MeasuredVariant:
        left, (priors, fixed) = self.matrix_variance(variant, verification=False), self.priors(variant)
        return MeasuredVariant(
            name=variant.name,
            origin=f"{name_origin(self.config.origin.model_dump())}: study {self.config.name}, variant {variant.name}",
            machine=self.machine(variant),
            priors=priors,
            fixed=fixed,
            posterior=self.posterior(variant, with_model_error),
            poses=self.poses(verification=False),
            actuator_noise=self.actuator_noise,
            actuator_variance=left,
            shared_errors=self.without_shared_errors(variant.name)[1],
            described=self.measured.describe(),
            n_held_back=int(self.verification.sum()),
        )


def load_inputs(config: StudyConfig, folder: Path) -> StudyInputs:
    """Read all files of a study and check that every variant can be built.

    Raises
    ------
    InputError
        For anything at fault in the config's files, before any long computation.
    """
    mechanism = load_mechanism(folder / config.machine)
    measured = read_measurement(config, folder, mechanism)
    with name_faults(name_actuator_table(config.measured, folder)):
        check_range(measured.actuators, mechanism.initial_actuator_positions, mechanism.actuator_range, measured.names)
        check_moves(measured.actuators[~measured.verification])
    inputs = StudyInputs(config, folder, mechanism, measured)
    with name_faults(name_data(config.measured, folder)):
        try:
            _ = inputs.deflection  # computed now, so that a fault of the targets on the pads shows at once
        except PoseInputError as error:
            raise InputError(f"pose {inputs.names[error.index]!r}: {error.fault}") from error
    for variant in config.variants:
        machine = inputs.machine(variant)
        with name_faults(folder / config.machine):
            check_home_pose(machine)
        check_poses(len(measured.names), mechanism.n_legs, machine.layout.size)
        check_measurement(inputs.measured, machine, config.measured, folder)
        with name_faults(f"variant {variant.name!r}"):
            posterior = inputs.posterior(variant, with_model_error=True)
            check_machine(posterior)
            _check_terms(inputs, variant, posterior)
            for factor in config.sensitivity.factor:
                with name_faults(f"sensitivity.factor {factor:g}"):
                    check_machine(replace(posterior, priors=inputs.priors(variant, factor)[0]))
            del posterior  # of many poses one is enough at a time
        if variant.published is not None:
            read_published(folder / variant.published, mechanism.n_legs)
    known = {block.symbol for variant in config.variants for block in inputs.machine(variant).layout.blocks}
    for symbol in config.parameters:
        if symbol not in known:
            look_up(dict.fromkeys(known), symbol, "parameters", folder)
    return inputs


def _check_terms(inputs: StudyInputs, variant: VariantConfig, posterior: LegPosterior) -> None:
    """Raise InputError for terms asked for by name that there cannot be, and for a floor beyond all tolerances."""
    error = inputs.model_error(variant)
    terms = error.terms
    units = dict(zip(posterior.names, posterior.units, strict=True))
    missing = [name for name in terms if name in SORTS and name not in inputs.list_sorts(variant)]
    if missing and terms != list(TERMS):
        raise InputError(f"model_error: found term {missing[0]!r}, but {FEW_POSES}, expected other terms")
    check_floors(error.floors(), [one.sd for name, one in posterior.priors.items() if units[name] == "mm"])
