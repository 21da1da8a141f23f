"""Posteriors of machines on legs: how they are built, and what legs alone are asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from bayescal.density.errors import NO_MODEL_ERROR, LegErrors, LegTerm, ModelError
from bayescal.density.leg_sampling import LegSampling, check_bounds
from bayescal.density.likelihood import Likelihood
from bayescal.density.model_error import LENGTH, SCALE, Kernel
from bayescal.density.outliers import NORMAL, Outliers
from bayescal.density.posterior import Posterior
from bayescal.density.priors import Prior
from bayescal.errors import InputError
from bayescal.numerics.geometry import Array

type LegPosterior = Posterior[Likelihood, LegSampling, LegErrors]
"""The posterior of a machine on legs."""


def build_leg_posterior(
    likelihood: Likelihood,
    priors: Mapping[str, Prior],
    model_error: ModelError = NO_MODEL_ERROR,
    fixed: Mapping[str, float] | None = None,
    terms: Sequence[LegTerm] = (),
    outliers: Outliers = NORMAL,
) -> LegPosterior:
    """Return the posterior of a machine on legs.

    Parameters
    ----------
    likelihood : Likelihood
        Density of the measurements at the calibration poses.
    priors : mapping of parameter name to Prior
        Of the free parameters.
    model_error : ModelError
        The model error τ, or none.
    fixed : mapping of parameter name to float, optional
        Values of fixed parameters that are not nominal.
    terms : sequence of LegTerm
        What else the likelihood takes: scale and length of an error that is a function of the pose.
    outliers : Outliers
        What poses are like that are wrong as a whole; by default none is expected.
    """
    errors = LegErrors.of_legs(likelihood.n_legs, (model_error, *terms), outliers)
    return Posterior(likelihood, priors, errors, fixed or {})


def check_machine(posterior: LegPosterior) -> None:
    """Raise InputError where the priors' centres, or the ends of a uniform prior, are no machine's parameters."""
    sampling = posterior.sampling
    sampling.layout.check(sampling.start)
    check_bounds(sampling.coordinates)
    if not np.isfinite(posterior.likelihood.errors(sampling.start[None])).all():
        raise InputError("found no machine at the priors' centres, expected unit directions and a home pose")


def find_function_of_pose(posterior: LegPosterior, natural: Array) -> tuple[Kernel, Array] | None:
    """Return the kernel, of the draws' median length, and the rms of each leg's scale (N,), mm, over draws (S, n).

    None where the legs have no error that is a function of the pose; the draws are in natural units.
    """
    structured, zeta, errors = posterior.likelihood.structured, posterior.zeta(natural), posterior.errors
    if structured is None:
        return None
    scale = np.sqrt(np.mean(zeta[:, errors.place(SCALE)] ** 2, axis=0))
    kernel = structured.kernel_of(np.median(zeta[:, errors.place(LENGTH)], axis=0))
    return kernel, np.broadcast_to(scale, posterior.likelihood.n_legs)
