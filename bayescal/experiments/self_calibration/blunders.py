"""Readings of single poses that a machine which explains all others cannot have.

Against the machine as expected only what is off by more than its tolerances shows, for angle sensors some ten
millimetres. Against the calibrated one some micrometres do. A pose is refused where the others are explained without
it; where they are not, the model may be at fault as well, and the report says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from bayescal.density.calibration.likelihood import CalibrationLikelihood, CalibrationPosterior
from bayescal.errors import InputError
from bayescal.experiments.self_calibration.inputs import ReadingInputs, Variant, find_cause, list_starts
from bayescal.experiments.shared.sensor_sets import null_basis
from bayescal.experiments.shared.slips import tell_denial
from bayescal.numerics.geometry import Array

DOUBT = 5.0  # standard deviations of χ² beyond which readings are not explained
CHANCE = 1e-8  # of a pose's readings to lie as far off by noise alone, below which they are refused
SUSPECTS = 3


def check_readings(inputs: ReadingInputs, where: Path) -> None:
    """Raise InputError that names a pose whose readings the machine of all others cannot have."""
    held = inputs.table.verification
    names = np.array(inputs.table.poses)
    for variant in inputs.variants.values():
        if not variant.config.is_plain or variant.functions is not None:  # which tie the poses together
            continue
        posterior = inputs.posterior(variant)
        mode = posterior.approach()
        if not _is_explained(posterior, mode):
            suspect = _find_suspect(posterior, mode)
            if suspect is not None:
                _complain(where, variant, str(names[~held][suspect[0]]), suspect[1], find_limit(posterior))
            refuse_slip(inputs, variant, where)
            continue
        if held.any():
            off = measure_misfits(posterior, mode, inputs.likelihood(variant, verification=True))
            for k in np.flatnonzero(~(off <= find_limit(posterior)))[:1]:
                _complain(where, variant, str(names[held][k]), float(off[k]), find_limit(posterior))


def refuse_slip(inputs: ReadingInputs, variant: Variant, where: Path) -> None:
    """Raise InputError where a slip explains what no machine within the tolerances does, and nobody denies it."""
    cause = _find_cause(inputs, variant, inputs.config.data.denied_slips)
    if cause:
        raise InputError(
            f"{where}: found readings of {', '.join(variant.sensors.names)} that no machine within the tolerances has, "
            f"expected this machine's{cause}{tell_denial('data.denied_slips')}"
        )


def _find_cause(inputs: ReadingInputs, variant: Variant, denied: Sequence[str]) -> str:
    sensors, starts = variant.sensors, list_starts(inputs.model, inputs.config.workspace)
    return find_cause(sensors, variant.free, inputs.table.values[:, sensors.chosen], starts, denied)


def list_denied(inputs: ReadingInputs) -> list[str]:
    """Return the slips that readings look like and the config denies, in words."""
    if not inputs.config.data.denied_slips:
        return []
    found = {name: _find_cause(inputs, one, ()) for name, one in inputs.variants.items()}
    return [f"Readings of {name!r}: {cause.removeprefix('; ')}" for name, cause in found.items() if cause]


def find_limit(posterior: CalibrationPosterior) -> float:
    """Return the rms of what no pose explains, in what noise and posterior let one expect, that chance hardly gives."""
    redundancy = _redundancy(posterior)
    return float(np.sqrt(chi2.isf(CHANCE, redundancy) / redundancy))


def _redundancy(posterior: CalibrationPosterior) -> int:
    """Return how many more readings each pose has than coordinates."""
    return int(posterior.likelihood.n_spare[0])


def _complain(where: Path, variant: Variant, name: str, off: float, limit: float) -> None:
    raise InputError(
        f"{where}: pose {name!r}: found readings of {', '.join(variant.sensors.names)} {off:.3g} times as far from any "
        f"pose as their noise allows, where the other poses are explained, expected at most {limit:.2g}"
    )


def _is_explained(posterior: CalibrationPosterior, mode: Array) -> bool:
    """Whether readings and priors together leave no more than their number lets one expect."""
    count = int(posterior.likelihood.n_spare.sum())
    square = float((posterior.likelihood.residuals(*posterior.at(mode[None])) ** 2).sum() + mode @ mode)
    return square <= count + DOUBT * np.sqrt(2.0 * count)


def _find_suspect(posterior: CalibrationPosterior, mode: Array) -> tuple[int, float] | None:
    """Return a pose without which all others are explained, and how far its readings are off then."""
    likelihood = posterior.likelihood
    square, n_poses = (
        (posterior.likelihood.residuals(*posterior.at(mode[None]))[0] ** 2).sum(axis=1),
        likelihood.data.n_poses,
    )
    if (n_poses - 1) * _redundancy(posterior) < posterior.n_parameters:
        return None
    for suspect in np.argsort(-square)[:SUSPECTS]:
        others = replace(posterior, likelihood=likelihood.pick(np.arange(n_poses) != suspect))
        found = others.approach()
        if _is_explained(others, found):
            one = likelihood.pick(np.arange(n_poses) == suspect)
            off = float(measure_misfits(others, found, one)[0])
            if off > find_limit(others):
                return int(suspect), off
    return None


def measure_misfits(posterior: CalibrationPosterior, mode: Array, other: CalibrationLikelihood) -> Array:
    """Return what no pose explains of other readings, rms by what noise and posterior let one expect, shape (P,)."""
    theta, redundancy = posterior.theta(mode[None]), _redundancy(posterior)
    white = other.whiten(*other.noise(posterior.errors, posterior.zeta(mode[None])))
    at = other.stand(theta, white)
    _, slope, by_parameters = other.linearise(theta, at.pose, white, with_parameters=True)
    basis = null_basis(slope[0])
    rest = np.einsum("pzk,pk->pz", basis, at.error[0])
    moved = basis @ by_parameters[0] @ posterior.around(mode)[1].T.T
    covariance = moved @ np.linalg.inv(-posterior.gradient(mode)[1]) @ np.swapaxes(moved, -1, -2) + np.eye(redundancy)
    square = np.einsum("pz,pz->p", rest, np.linalg.solve(covariance, rest[..., None])[..., 0])
    return np.sqrt(square / redundancy)
