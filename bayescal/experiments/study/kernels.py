"""The kernels of a study's variants: model errors that are a function of the pose."""

from __future__ import annotations

from bayescal.density.batches import BATCH
from bayescal.density.free_length import FreeLengthLikelihood, count_nodes
from bayescal.density.free_length_posterior import FreeLengthPosterior
from bayescal.density.likelihood import Likelihood
from bayescal.density.model_error import INDEPENDENT, KernelScale, build_kernel
from bayescal.density.pose_likelihood import PoseLikelihood
from bayescal.density.posterior import Posterior
from bayescal.density.structured import StructuredLikelihood
from bayescal.density.structured_posterior import StructuredPosterior
from bayescal.errors import InputError
from bayescal.experiments.frame.memory import check_arrays
from bayescal.experiments.study.schema import StudyConfig, VariantConfig
from bayescal.numerics.units import MICROMETRE


def name_kernel(config: StudyConfig, variant: VariantConfig) -> str:
    """Return the kernel of a variant's model error: its own, or that of all."""
    return config.model_error.name_for(variant)


def has_kernels(config: StudyConfig) -> bool:
    """Return whether any variant has a structured model error."""
    return any(name_kernel(config, variant) != INDEPENDENT for variant in config.variants)


def give_kernel(
    plain: Posterior, config: StudyConfig, variant: VariantConfig, actuator_range: float
) -> StructuredPosterior:
    """Return a posterior with the structured model error of a variant beside its own.

    Raises
    ------
    InputError
        Beside blunders, for measurements that are not whole poses, and for more poses than there is memory for.
    """
    if config.blunders is not None:
        raise InputError(
            f"blunders: found them beside kernel {name_kernel(config, variant)!r}, by which poses depend on each "
            f"other, expected kernel {INDEPENDENT!r}, or deformation 'free_matrix' for linear errors"
        )
    structured = _structure(plain.likelihood, config, variant, actuator_range)
    known, lengths = (structured, plain.priors, plain.model_error, plain.fixed), config.model_error.lengths_for(variant)
    if lengths is not None:
        return FreeLengthPosterior(*known, kernel_scale=_scale_kernels(config), lengths=lengths)
    return StructuredPosterior(*known, kernel_scale=_scale_kernels(config))


def _structure(
    likelihood: Likelihood, config: StudyConfig, variant: VariantConfig, travel: float
) -> StructuredLikelihood:
    """Return the density of the calibration poses with a variant's structured model error."""
    kernel, lengths = name_kernel(config, variant), config.model_error.lengths_for(variant)
    if not isinstance(likelihood, PoseLikelihood):
        raise InputError(
            f"model_error.kernel: found {kernel!r} with poses measured in part, points, or frames to be found, "
            f"expected whole poses in known frames, or kernel {INDEPENDENT!r}"
        )
    _check_kernel(likelihood.n_poses, likelihood.n_legs, lengths is not None)
    if lengths is not None:
        return FreeLengthLikelihood(likelihood, kernel, lengths, travel)
    return StructuredLikelihood(likelihood, build_kernel(kernel, config.model_error.length_for(variant)), travel)


def _scale_kernels(config: StudyConfig) -> KernelScale:
    error = config.model_error
    return KernelScale(error.kernel_scale_um * MICROMETRE, error.kernel_spread, not error.kernel_per_leg)


def _check_kernel(n_poses: int, n_legs: int, free_length: bool) -> None:
    """Raise InputError without memory for a kernel: matrices of all poses by all, the hot loop over all at once.

    Where the length is free there is a matrix for every length at which the density is found, and for every vector.
    """
    matrices = 6.0 + (count_nodes(n_poses) + BATCH if free_length else 0.0)
    check_arrays(
        {"calibration poses with a kernel of the model error": n_poses},
        [(matrices, n_poses, n_poses), (6.0, BATCH, n_poses, n_legs)],
        f"fewer poses or kernel {INDEPENDENT!r}",
    )
