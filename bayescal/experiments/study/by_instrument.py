"""Studies of poses that an instrument measured, whole or in part, of a platform on legs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bayescal.calibrated.machine import CalibratedMachine
from bayescal.config.registry import find_class
from bayescal.density.legs import LegPosterior
from bayescal.errors import InputError
from bayescal.experiments.frame.memory import Need
from bayescal.experiments.frame.parallel import Run
from bayescal.experiments.frame.results import Results
from bayescal.experiments.shared.measured import MeasuredReadings, MeasuredVariant, see_legs
from bayescal.experiments.shared.origin import name_origin
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.experiments.study.claims import Claims
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.load import load_inputs
from bayescal.experiments.study.memory import estimate_study
from bayescal.experiments.study.route import Route
from bayescal.numerics.units import MICROMETRE


class ByInstrument(Route):
    """An instrument's poses: the density of machines on legs in closed form."""

    def read(self, config: StudyConfig, folder: Path) -> StudyInputs:
        """Return everything the study computes with."""
        inputs = load_inputs(config, folder)
        if config.claims is not None and inputs.targets is None:
            raise InputError(f"{folder}: claims: found {config.claims!r} without targets, expected measured targets")
        find_claims(config, folder)
        return inputs

    def estimate_memory(self, inputs: StudyInputs) -> Need:
        """Return what the posteriors of all poses take."""
        return estimate_study(inputs)

    def outlook(self, inputs: StudyInputs) -> list[str]:
        """Return what each variant's poses can determine."""
        from bayescal.experiments.study.doubts import list_outlooks

        return list_outlooks(inputs)

    def doubt(self, inputs: StudyInputs) -> list[str]:
        """Return what may have happened to data that no machine explains, or only one within wide tolerances."""
        from bayescal.experiments.study.doubts import doubt_zero, find_study_slip

        slip = find_study_slip(inputs)
        return doubt_zero(inputs) if slip is None else [slip.say()]

    def compute(self, inputs: StudyInputs, run: Run) -> Results:
        """Return posteriors, evidence and predictions of all variants."""
        from bayescal.experiments.study.compute import compute_study  # seconds to import, as its inputs are read first

        return compute_study(inputs, find_claims(inputs.config, inputs.folder), run)

    def calibrate(
        self, results: Results, config: StudyConfig, variant: str | None, experiment: Path | None, trust: bool
    ) -> CalibratedMachine:
        """Return the machine of a variant."""
        from bayescal.experiments.study.calibrated import calibrate_study

        return calibrate_study(results, config, variant, experiment, trust)

    def measure(
        self, config: StudyConfig, path: Path, names: Sequence[str], with_model_error: bool
    ) -> dict[str, MeasuredReadings]:
        """Return variants as measured; InputError where no whole poses were measured by one noise each."""
        inputs = load_inputs(config, path.parent)
        if not inputs.measured.has_poses:
            raise InputError(
                f"{path}: data: found poses measured in part, points, or frames to be found, expected whole poses in "
                "known frames, since audits and checks of data start from these"
            )
        chosen = [inputs.variant(name) for name in names]
        return {one.name: see_legs(_measure(inputs, one, path, with_model_error)) for one in chosen}


def find_claims(config: StudyConfig, folder: Path) -> Claims | None:
    """Return what a publication claims of a study; InputError for a class that is none."""
    if config.claims is None:
        return None
    kind: type[Claims] = Claims  # type: ignore[type-abstract]  # only subclasses of it are found
    return find_class("CLAIMS", config.claims, kind, "claims", folder, folder)()


def _measure(inputs: StudyInputs, variant: VariantConfig, path: Path, with_model_error: bool) -> MeasuredVariant:
    posterior, config = inputs.posterior(variant, with_model_error), inputs.config
    _check_noise(posterior, path)
    left = inputs.matrix_variance(variant, verification=False)
    priors, fixed = inputs.priors(variant)
    return MeasuredVariant(
        name=variant.name,
        origin=f"{name_origin(config.origin.model_dump())}: study {config.name}, variant {variant.name}",
        mechanism=path.parent / config.machine,
        free=inputs.free(variant),
        machine=inputs.machine(variant),
        priors=priors,
        fixed=fixed,
        posterior=posterior,
        poses=inputs.poses(verification=False),
        actuator_noise=config.measured.actuator_noise_um * MICROMETRE,
        left_variance=0.0 if left is None else float(left.mean()),
        actuator_variance=left,
        shared_errors=inputs.without_shared_errors(variant.name)[1],
        described=inputs.measured.describe(),
        n_held_back=int(inputs.verification.sum()),
    )


def _check_noise(posterior: LegPosterior, path: Path) -> None:
    """Raise InputError for poses that may be blunders, which audits and checks do not have."""
    if posterior.errors.outliers.expected:
        raise InputError(f"{path}: found blunders, expected none: audits and checks have no poses that may be spoilt")
