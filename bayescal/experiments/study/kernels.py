"""The kernels of a study's variants: model errors that are a function of the pose."""

from __future__ import annotations

from bayescal.density.errors import KernelLength, KernelScale, LegTerm
from bayescal.density.legs import BATCH, Likelihood
from bayescal.density.priors import INDEPENDENT, build_kernel
from bayescal.density.structured import StructuredLikelihood, count_nodes
from bayescal.errors import InputError
from bayescal.experiments.frame.memory import check_arrays
from bayescal.experiments.shared.study_schema import StudyConfig, VariantConfig
from bayescal.numerics.units import MICROMETRE


def name_kernel(config: StudyConfig, variant: VariantConfig) -> str:
    """Return the kernel of a variant's model error: its own, or that of all."""
    return config.leg_error.name_for(variant)


def has_kernels(config: StudyConfig) -> bool:
    """Return whether any variant has a structured model error."""
    return any(name_kernel(config, variant) != INDEPENDENT for variant in config.variants)


def give_kernel(
    likelihood: Likelihood, config: StudyConfig, variant: VariantConfig, travel: float
) -> tuple[Likelihood, list[LegTerm]]:
    """Return the density of poses with the structured model error of a variant, and the terms that it takes beside τ.

    Raises
    ------
    InputError
        Beside blunders, for measurements that are not whole poses, and for more poses than there is memory for.
    """
    kernel, lengths, error = name_kernel(config, variant), config.leg_error.lengths_for(variant), config.leg_error
    if config.blunders is not None:
        raise InputError(
            f"blunders: found them beside kernel {kernel!r}, by which poses depend on each "
            f"other, expected kernel {INDEPENDENT!r}, or deformation 'free_matrix' for linear errors"
        )
    poses = likelihood.of_poses
    if poses is None:
        raise InputError(
            f"model_error.kernel: found {kernel!r} with poses measured in part, points, or frames to be found, "
            f"expected whole poses in known frames, or kernel {INDEPENDENT!r}"
        )
    _check_kernel(poses.n_poses, poses.n_legs, lengths is not None)
    terms: list[LegTerm] = [
        KernelScale(error.kernel_scale_um * MICROMETRE, error.kernel_spread, not error.kernel_per_leg)
    ]
    if lengths is not None:
        terms.append(KernelLength(lengths))
    found = build_kernel(kernel, error.length_for(variant))
    return StructuredLikelihood(poses, found, travel, lengths), terms


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
