"""What may have happened to readings that no machine within its priors comes near."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayescal.density.calibration.elimination import project_out
from bayescal.density.calibration.posterior import CalibrationPosterior
from bayescal.experiments.calibration.inputs import Variant
from bayescal.experiments.shared.reading_slips import find_reading_slip
from bayescal.numerics.geometry import Array


def find_calibration_slip(variant: Variant) -> str | None:
    """Return in words the slip that explains a variant's readings several times better; None where none does."""
    posterior, channels = variant.posterior(), variant.model.channels
    data = posterior.likelihood.data

    def judge(values: Array, chosen: slice) -> Array:
        likelihood = posterior.likelihood
        some = data.pick(np.arange(data.n_poses)[chosen])
        moved = replace(likelihood, data=replace(some, values=values), start=likelihood.start[chosen])
        return _fit_together(replace(posterior, likelihood=moved))

    units = [one.unit for one in channels]
    return find_reading_slip(judge, variant.model.names, units, data.values, variant.model.given)


def _fit_together(posterior: CalibrationPosterior) -> Array:
    """Return the rms of what no pose explains beside the best machine to first order, in the noise's, shape (P,).

    Infinite for poses that are not found, and for those that leave nothing over.
    """
    y = np.zeros(posterior.n_parameters)
    white, at = posterior.stand(y[None])
    error, slope, by_coordinates = posterior.rows(y, white, at.pose)
    found = np.isfinite(error).all(axis=1) & np.isfinite(at.error[0]).all(axis=1)
    beside = project_out(slope[found])
    rest, moves = np.einsum("pij,pj->pi", beside, error[found]), beside @ by_coordinates[found]
    told = np.einsum("pin,pi->n", moves, rest)
    moved = np.linalg.solve(np.eye(moves.shape[-1]) + np.einsum("pin,pim->nm", moves, moves), told)
    square = np.sum((rest - moves @ moved) ** 2, axis=1)
    result = np.full(len(error), np.inf)
    result[found] = np.sqrt(square / np.maximum(posterior.likelihood.n_spare[found], 1))
    return result
