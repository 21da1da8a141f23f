"""What may have happened to readings that no machine within its priors comes near."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from bayescal.density.calibration.posterior import CalibrationPosterior
from bayescal.density.elimination import project_out
from bayescal.experiments.calibration.inputs import Variant
from bayescal.experiments.shared.reading_slips import Judge, find_reading_slip, measure_misfit
from bayescal.numerics.geometry import Array


def find_calibration_slip(variants: Iterable[Variant]) -> str | None:
    """Return in words the slip that explains readings several times better than they stand; None where none does.

    Of variants of the same readings the one that comes nearest is asked: where one of them fits, nothing has slipped.
    """
    groups: dict[tuple[tuple[str, ...], ...], list[Variant]] = {}
    for one in variants:
        groups.setdefault((tuple(one.model.names), tuple(one.data.poses)), []).append(one)
    for group in groups.values():
        judges = [(_judge(one), one) for one in group]
        judge, nearest = min(judges, key=lambda pair: measure_misfit(pair[0], _values(pair[1])))
        units = [one.unit for one in nearest.model.channels]
        said = find_reading_slip(judge, nearest.model.names, units, _values(nearest), nearest.model.given)
        if said is not None:
            return said
    return None


def _values(variant: Variant) -> Array:
    """Return the readings of the calibration poses, shape (P, K)."""
    return variant.data.values[~variant.verification]


def _judge(variant: Variant) -> Judge:
    posterior = variant.posterior()
    likelihood = posterior.likelihood

    def judge(values: Array, chosen: slice) -> Array:
        some = likelihood.data.pick(np.arange(likelihood.data.n_poses)[chosen])
        moved = replace(likelihood, data=replace(some, values=values), start=likelihood.start[chosen])
        return _fit_together(replace(posterior, likelihood=moved))

    return judge


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
